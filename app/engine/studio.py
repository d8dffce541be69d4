"""The studio without its window: the journal, the playback, and what is on screen of surface and exact pictures.

`tick` draws the surface when something changed, passes requests to the exact engine and says whether there is anything new to
show; it waits for nothing. Everything a user does goes through `do`.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import moderngl
import numpy as np
from avatarrex_studio.engine.adaptive_detail import FINEST, AdaptiveDetail, Detail, finer
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.framing import Outline, framed
from avatarrex_studio.engine.pictures import Pictures, Subject
from avatarrex_studio.engine.request import Exact, Seen
from avatarrex_studio.live.listening import Listening
from avatarrex_studio.session.clips import Clips
from avatarrex_studio.session.commands import AddFigure, Command, Followed, SetCamera, SetShape
from avatarrex_studio.session.evaluation import go_to, layers_at, settled
from avatarrex_studio.session.figures import Place, standing
from avatarrex_studio.session.greeting import Greeting
from avatarrex_studio.session.grip import LOOK, Beginning, Grip, followed, stood
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.keys import CAMERA
from avatarrex_studio.session.motion import Motion, driven_words
from avatarrex_studio.session.notice import NOTICE, refusals_logged
from avatarrex_studio.session.playback import Playback
from avatarrex_studio.session.posing import entries
from avatarrex_studio.session.state import OrbitView, StudioState, Vector, vector
from avatarrex_studio.session.take import Take, to_key, values, with_keys
from avatarrex_studio.session.timeline import PARTS, Layer, Timeline
from avatarrex_studio.session.timeline_commands import AddLayer, OnTimeline, SetFrame, SetLayer

from avatarrex.avatar import Avatar
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.surface.shadow import SurfaceShadow
from avatarrex.surface.surface_file import weights_key
from avatarrex.templates.figure import Figure

log = logging.getLogger(__name__)
DRIVES = "%s drives %s%s; a right click on its name in the Timeline changes that"
FBX_SECONDS = 60.0
"""The longest that the window, which stands still meanwhile, waits for Blender."""
SOUND = ".wav"
FACE = np.array([0.0, 0.037, 0.0])
"""Metres: from the head's joint to what is in the middle of a picture of the face, at rest."""
HAND_DISTANCE = 0.6
"""Metres from which a hand fills the picture."""


@runtime_checkable
class Drawn(Protocol):
    """A picture in the OpenGL context; its texture is its own as long as it is kept."""

    @property
    def texture(self) -> moderngl.Texture:
        """Premultiplied sRGB-encoded, first row at the top."""


@runtime_checkable
class Live(Protocol):
    """Draws surfaces of avatars, fast enough for every frame of the interface, in the OpenGL context that is current."""

    @property
    def ms(self) -> dict[str, float]:
        """Milliseconds of the last picture by stage, and `total`."""

    @property
    def shadow(self) -> SurfaceShadow | None:
        """The floor's light under the last picture; None without a stage."""

    def draw(
        self, avatars: Sequence[Avatar | None], state: StudioState, size: tuple[int, int], samples: int
    ) -> Drawn | None:
        """The picture of all figures, (width, height) pixels; `avatars`: of each, None for one that is not read yet and left out.

        `samples` of a pixel: 4, 2 or 1. None where nobody is there, or an avatar has no surface.
        """

    def point(self, column: int, row: int) -> Seen | None:
        """What is under the centre of a pixel of the last picture; None where nothing is."""

    def forget(self) -> None:
        """Let go of the last picture and what it was made of."""


class Studio:
    """An open session without its window: state, engine, playback and the picture as far as it is rendered."""

    def __init__(
        self,
        exact: Exact,
        avatars: Avatars,
        journal: Journal | None = None,
        live: Live | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.avatars, self.live = avatars, live
        self.journal = journal or Journal()
        self.pictures = Pictures(exact)
        self.playback = Playback()
        self.clips = Clips(lambda path, options: Motion.read(path, options, FBX_SECONDS))
        self.take = Take()
        self.listening = Listening(clock)
        self.greeting: Greeting | None = None
        """What moves the avatar until somebody does something."""
        self.surface: Drawn | None = None
        """The surface of the present state; None where the avatar has none."""
        self.adaptive = AdaptiveDetail()
        self._detail = FINEST
        """Of the surface."""
        self.weight = 0.0
        """Share of the exact picture over the surface, 0 to 1."""
        self._clock = clock
        self._step: object = None
        """What is done within `one_step`."""
        self._beginning = Beginning()
        self._drawn: Subject | None = None
        self._read: dict[str, Avatar] = {}
        """The figures' avatars by name, as far as they have been read."""
        self._avatars: list[Avatar | None] = []
        """Of the surface's figures."""
        self._faulty: list[Avatar | None] = []
        """Whose surfaces could not be drawn."""
        self._figure: Figure | None = None

    @property
    def state(self) -> StudioState:
        """The present state."""
        return self.journal.state

    def do(self, command: Command, gesture: object = None) -> None:
        """Apply a command; a value that cannot be set is said in the console and changes nothing.

        While something is recorded, an edit becomes keys; while something plays, all edits are undone together with it.
        """
        self.end_greeting()
        with refusals_logged():
            shared = self._step or (self.playback.gesture if self.playback.playing else gesture)
            figure = self.figure if isinstance(command, Followed) and self.state.tools.pins else None
            if isinstance(command, Followed) and figure:
                start = self._beginning.of(gesture, self.state)
                command = followed(command, self.state, figure.skeleton, start)
            command = self.take.keyed(command, self.state, gesture)
            if isinstance(command, AddFigure):
                command = command.begun(self.state.timeline)
            if isinstance(command, SetFrame):
                command = replace(command, feeds=self.listening.feeds(self.state.timeline))
            if isinstance(command, SetShape) and self.figure:
                command = stood(command, self.journal.before(command, shared), self.figure.body)
            if isinstance(command, OnTimeline):
                command = settled(command, self.journal.before(command, shared), self.clips, self.listening.feeds)
            self.journal.do(command, shared)

    @contextmanager
    def one_step(self) -> Iterator[None]:
        """All that is done within is undone together, and with it what is played after it."""
        self._step = self.playback.anew() if self.playback.playing else object()
        try:
            yield
        finally:
            self._step = None

    def undo(self) -> None:
        """Back over the last step."""
        self.playback.playing = False
        self.journal.undo()

    def redo(self) -> None:
        """Forward again."""
        self.journal.redo()

    def tick(self, viewport: tuple[int, int]) -> bool:
        """Advance the motion, draw the surface, take and request exact pictures; whether there is something new to show."""
        now, before = self._clock(), self.weight
        due = self.playback.due(self.state, now)
        sent = self.listening.tick([figure.timeline for figure in self.state.figures])
        if due is not None:
            self.go_to(due, self.playback.gesture)
        elif sent:
            self._follow()
        size = self.state.size.pixels(viewport)
        shown = self._greeted(now)
        self._see_avatars(now)
        self.adaptive.begin(now)
        drawn = self._draw(now, size, shown)
        moves = self.playback.playing or shown is not self.state
        new = self.pictures.tick(now, self.state, size, self.surface is not None, moves)
        self.weight = self.pictures.weight(now, self.surface is not None)
        return drawn or new or self.weight != before

    def _follow(self) -> None:
        """Show what live sources sent."""
        with refusals_logged():
            frame = SetFrame(self.state.timeline.frame, self.listening.feeds(self.state.timeline))
            before = self.journal.before_following(frame)
            self.journal.follow(settled(frame, before, self.clips, self.listening.feeds))

    def greet(self) -> None:
        """Have the avatar move gently until somebody does something."""
        self.greeting = Greeting(self._clock())

    def end_greeting(self) -> None:
        """Somebody did something."""
        if self.greeting:
            self.greeting.stop(self._clock())

    def _greeted(self, now: float) -> StudioState:
        """The state as the surface shows it."""
        if self.greeting is None or self.surface is None:
            return self.state
        if self.greeting.over(now):
            self.greeting = None
            return self.state
        return self.greeting.shown(self.state, now)

    def _see_avatars(self, now: float) -> None:
        """Have exact pictures made anew where an avatar's files were read again, and say so."""
        self.avatars.notice(now)
        names = [figure.avatar for figure in self.state.figures]
        read = {name: avatar for name, avatar in zip(names, self.avatars.all_ready(names)) if avatar}
        for name, avatar in read.items():
            before = self._read.get(name, avatar)
            if before is not avatar:
                self.pictures.renew()
                _tell_of(name, before, avatar)
        self._read = {name: avatar for name, avatar in (self._read | read).items() if name in names}

    def _draw(self, now: float, size: tuple[int, int], shown: StudioState) -> bool:
        """Draw the surface where what it shows has changed, and more finely where that has stopped; whether it was drawn."""
        subject, avatars = Subject.of(shown, size), self.avatars.all_ready(own.avatar for own in shown.figures)
        if self.live is None or not any(avatars) or _same(avatars, self._faulty):
            self.surface = self._drawn = None
            return False
        detail = finer(self._detail)
        if subject != self._drawn or not _same(avatars, self._avatars):
            detail = self._moving_detail(now, shown)
        elif self._detail == FINEST or not self.pictures.rests(now):
            return False
        try:
            self.surface = self.live.draw(avatars, shown, detail.size(size), detail.samples)
            self._drawn, self._avatars, self._detail = subject, avatars, detail
        except Exception:  # a fault of ours: its trace goes to the log, and exact pictures are shown
            log.exception("the surface could not be drawn")
            self.surface, self._drawn, self._faulty = None, None, avatars
        return self.surface is not None

    def _moving_detail(self, now: float, shown: StudioState) -> Detail:
        """How finely what has changed is drawn: a first picture, and the gentle motion of a greeting, as finely as can be."""
        if self.surface is None or shown is not self.state:
            return FINEST
        self.adaptive.drawn(now)
        return self.adaptive.detail

    def seen(self, x: float, y: float) -> Seen | None:
        """What the picture shows at a place, shares of its width and height; None for the background."""
        if self.surface is None or self.live is None:
            return self.pictures.point(x, y)
        width, height = self.surface.texture.size
        return self.live.point(min(int(x * width), width - 1), min(int(y * height), height - 1))

    @property
    def figure(self) -> Figure | None:
        """The selected person as its signals pose it, in the frame of its place; None while the avatar is read."""
        avatar, signals = self.avatars.ready(self.state.avatar), self.state.signals
        if avatar is None:
            return None
        body, figure = avatar.person.body, self._figure
        if figure is None or figure.body is not body or figure.signals is not signals:
            self._figure = figure = Figure(body, signals)
        return figure

    @property
    def world(self) -> np.ndarray:
        """(4, 4): from the frame of the selected person's place to the world."""
        figure, place = self.figure, self.state.place
        return np.eye(4) if figure is None or place == Place() else place.world(figure.skeleton.joints[0])

    def own(self, point: Vector) -> Vector:
        """A point of the world in the frame of the selected person's place."""
        world = self.world
        return vector((np.asarray(point) - world[:3, 3]) @ world[:3, :3])

    def part_at(self, x: float, y: float) -> str | None:
        """The joint or the region of the face of the selected person that the picture shows at a place; None for all else."""
        seen, figure = self.seen(x, y), self.figure
        if seen is None or figure is None or seen.figure != self.state.slot:
            return None
        return figure.part_at(np.array(self.own(seen.point)))

    @property
    def fading(self) -> bool:
        """Whether the exact picture is being faded in."""
        return self.pictures.covers and self.weight < 1

    @property
    def moving(self) -> bool:
        """Whether what is shown changes by itself, or the state has just changed."""
        greets = self.greeting is not None and self.surface is not None
        return (
            self.playback.playing
            or self.listening.present
            or self.fading
            or greets
            or (self.surface is not None and self._detail != FINEST)
            or not self.pictures.rests(self._clock())
        )

    def forget_surface(self) -> None:
        """The OpenGL context that it was drawn in goes; it is drawn anew in the next."""
        self.surface = self._drawn = None
        self._detail = FINEST
        self._avatars, self._faulty = [], []
        if self.live:
            self.live.forget()

    def close(self) -> None:
        """End the exact engine, and listen no more."""
        self.listening.close()
        self.pictures.exact.close()
        self.avatars.close()

    def frame_person(self, viewport: tuple[int, int]) -> None:
        """The front view with every person in it."""
        with refusals_logged():
            bodies = [(self.avatars.get(own.avatar).person.body, own.signals) for own in self.state.each()]
            points = np.concatenate([Outline(body).points(signals) for body, signals in bodies])
            view = framed(
                OrbitView(orthographic=self.state.view.orthographic), points, self.state.size.pixels(viewport)
            )
            self.do(SetCamera(view.azimuth, view.elevation, view.distance, view.fov, view.target))

    def frame_face(self) -> None:
        """The face fills the picture, seen from where the view is, wherever the head has gone."""
        figure = self.figure
        if figure is not None:
            head, posed = JOINT_NAMES.index("head"), figure.posed
            face, world = posed.position[head] + posed.rotation[head] @ FACE, self.world
            self.do(SetCamera(distance=0.75, target=vector(world[:3, :3] @ face + world[:3, 3])))

    def frame_hand(self, hand: str) -> None:
        """A hand, `left_hand` or `right_hand`, fills the picture, seen from where the view is."""
        figure = self.figure
        if figure is not None:
            place, world = figure.posed.position[JOINT_NAMES.index(hand.replace("hand", "middle1"))], self.world
            self.do(SetCamera(distance=HAND_DISTANCE, target=vector(world[:3, :3] @ place + world[:3, 3])))

    def look_at_camera(self) -> None:
        """Eyes and head turn to who looks at the picture."""
        figure = self.figure
        if figure is not None:
            grip = Grip(LOOK, figure.skeleton, self.state.signals)
            self.do(grip.to(self.state, np.array(self.own(vector(self.state.view.camera(1, 1).centre)))))

    def open_motion(self, path: str) -> None:
        """Load a motion file, or one that comes with the program by its name, and go to its first frame."""
        with refusals_logged(opening=path):
            self.take_motion(Motion.read(path, None, FBX_SECONDS))

    def take_motion(self, motion: Motion) -> None:
        """Go to the first frame of a motion that was read; a sound, which moves the mouth alone, comes over what is there."""
        self.playback.playing = False
        sound, name = Path(motion.path).suffix.lower() == SOUND, Path(motion.path).name
        self.clips.take(motion)
        self._put(motion.layer() if sound else motion.loaded(), name, motion.over if sound else motion.parts)
        for note in motion.sequence.notes:
            log.info("%s: %s", name, note)
        log.info("%s: %d frames, %g a second", name, len(motion), motion.sequence.fps)

    def _put(self, command: OnTimeline, name: str, parts: Collection[str]) -> None:
        """Put a clip on the timeline; tell what it drives, and which layers over it hide that, unless it was refused."""
        before = self.state.timeline
        self.do(command)
        if self.state.timeline is before:
            return
        layers = self.state.timeline.layers
        place = max(
            (k for k, layer in enumerate(layers) if layer.clip and layer.clip.name == name), default=len(layers)
        )
        over = [layer.name for layer in layers[place + 1 :] if not layer.muted and layer.parts & set(parts)]
        below = f", below {' and '.join(over)}" if over else ""
        log.log(NOTICE, DRIVES, name, driven_words(parts), below)

    @property
    def motion(self) -> Motion | None:
        """The lowest clip's motion; None without one, and where it cannot be read."""
        clip = self.state.timeline.motion
        return self.clips.motion(clip) if clip else None

    def add_motion(self, path: str) -> None:
        """A motion, face or sound file as a layer over all others."""
        with refusals_logged(opening=path):
            self.take_layer(Motion.read(path, None, FBX_SECONDS))

    def take_layer(self, motion: Motion) -> None:
        """A motion that was read, as a layer over all others."""
        self.clips.take(motion)
        self._put(motion.layer(), Path(motion.path).name, motion.over)

    def set_key(self) -> None:
        """Keys at the playhead: of what is selected, else of what is posed there and what has keys already."""
        state, selected = self.state, self.state.tools.selected
        layer = self.take.target(state.timeline)
        names = entries(selected) if selected else self._to_key(layer)
        if names:
            self.do(with_keys(state, values(state, names), layer))

    def _to_key(self, layer: Layer | None) -> tuple[str, ...]:
        """Where nothing is selected. That what a motion moves gets no keys, for it cannot be read, is said."""
        driven, unread = self._driven(self.state.timeline), self.clips.unread(self.state.timeline)
        for each in unread:
            words = driven_words(each.parts)
            log.warning("no keys of what %s drives (%s): it cannot be read; select a part to key it", each.name, words)
        moved = {name for each in unread for part in each.parts for name in PARTS[part]}
        return to_key(self.state, layer, driven, moved)

    def _driven(self, timeline: Timeline) -> tuple[Signals, ...]:
        """What its layers give at the playhead over the rest pose and, where not all of them are keys, as a new avatar stands."""
        own = timeline.local(timeline.seconds)
        bases = (Signals.rest(),) if all(layer.keyed for layer in timeline.layers) else (Signals.rest(), standing())
        return tuple(layers_at(timeline, base, own, self.clips) for base in bases)

    def key_camera(self) -> None:
        """Keys of the view at the playhead."""
        self.do(with_keys(self.state, values(self.state, tuple(CAMERA)), self.take.target(self.state.timeline)))

    def record_live(self, layer: str) -> None:
        """Begin to record what drives a live layer, or end it: it becomes a clip that begins where the recording did, where a motion
        repeats in its round; at 0 where nothing played then.

        It goes on for its avatar while another one is selected.
        """
        live = self.state.timeline.layer(layer).live
        drive = self.listening.drives[live]
        if drive.take is None:
            self.listening.record(live, layer, self.state.timeline.key_seconds if self.playback.playing else 0.0)
            return
        with refusals_logged():
            motion = Motion.read(self.listening.recorded(live))
            parts = self.state.timeline.layer(layer).parts
            self.clips.take(motion)
            clip = Layer(motion.clip.name, motion.clip, parts=parts, offset=drive.begins)
            with self.one_step():
                self.do(AddLayer(clip))
                self.do(SetLayer(layer, muted=True))

    def toggle_recording(self) -> None:
        """Whether what is changed becomes keys."""
        self.take.recording = not self.take.recording

    def toggle_play(self) -> None:
        """Start or stop the timeline."""
        self.clips.retry()
        if not self.clips.silent(self.state.timeline):
            self.playback.toggle(self.state, self._clock())

    def go_to(self, frame: int, gesture: object = None) -> None:
        """Go to a frame of the timeline; beyond its ends to the nearest."""
        command = go_to(self.state, frame, self.clips)
        if command is not None:
            self.do(command, gesture)

    def step_by(self, frames: int) -> None:
        """Some frames on or back."""
        self.playback.playing = False
        self.go_to(self.state.timeline.frame + frames)

    def save_session(self, path: str) -> bool:
        """Write the journal; whether it was written."""
        with refusals_logged():
            self.journal.save(path)
            log.log(NOTICE, "Saved %s", path)
            return True
        return False

    def open_session(self, path: str) -> None:
        """Go on from a saved journal."""
        with refusals_logged(opening=path):
            self.go_on(Journal.load(path))
            log.info("opened %s", path)

    def go_on(self, journal: Journal) -> None:
        """Go on from a journal in place of this one. Raises `InputError` where an avatar cannot be read, and changes nothing."""
        for figure in journal.state.figures:
            self.avatars.get(figure.avatar)
        self.take_journal(journal)

    def take_journal(self, journal: Journal) -> None:
        """Go on from a journal that was read."""
        self.journal = journal
        self.playback.playing = False
        self.clips.forget()

    def save_image(self, path: str | Path, viewport: tuple[int, int]) -> None:
        """Have the state rendered at its full raster and written as PNG; the console tells when it is there."""
        self.pictures.save(self.state, self.state.size.pixels(viewport), str(path))


def _tell_of(name: str, before: Avatar, after: Avatar) -> None:
    """Of an avatar that was read anew."""
    file = Path(name).name
    if before.surface is None and after.surface is not None and weights_key(before) == weights_key(after):
        log.info("%s has its surface now", file)
        return
    how = "" if after.surface else ", by exact pictures alone, for it has no surface"
    log.log(NOTICE, "%s has changed on the disk: shown as it is now%s", file, how)


def _same(avatars: Sequence[Avatar | None], others: Sequence[Avatar | None]) -> bool:
    """Whether they are the very same."""
    return len(avatars) == len(others) and all(one is other for one, other in zip(avatars, others))
