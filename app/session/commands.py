"""What a user does: one frozen dataclass per action, with its rule, the pure `apply(state) -> state`.

Commands carry values, never files or tensors, so a journal of them replays anywhere. Angles in degrees for the camera,
radians for joints; metres.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from typing import Any, dataclass_transform

import numpy as np
from avatarrex_studio.session import posing
from avatarrex_studio.session.cut import Cut
from avatarrex_studio.session.figures import Figure, Place, beside, standing
from avatarrex_studio.session.state import Colour, OrbitView, SizePolicy, StudioState, Vector
from avatarrex_studio.session.timeline import Feeds, Layer, Share, Timeline

from avatarrex.errors import InputError
from avatarrex.signals.driving import SHAPES, Signals
from avatarrex.signals.ground import on_floor
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.joints import FINGERS
from avatarrex.signals.library import hands_of_pose, mirror, named_expression, named_hand, named_pose
from avatarrex.signals.limits import random_signals
from avatarrex.signals.macros import set_face, set_hand
from avatarrex.signals.sequence import interpolate

KINDS: dict[str, type[Command]] = {}
"""Commands by name, those that a journal writes down."""


@dataclass_transform(frozen_default=True)
class Command:
    """A user action; every kind of it is a frozen dataclass."""

    def __init_subclass__(cls, kind: bool = True) -> None:
        """`kind`: whether it is a command, and not what several have in common."""
        dataclass(frozen=True)(cls)
        if kind and not issubclass(cls, Choice):
            KINDS[cls.__name__] = cls

    def apply(self, state: StudioState) -> StudioState:
        """The state after this command: its fields set, unless it has a rule of its own. Raises `InputError` for a value
        that cannot be set.
        """
        return state.change(**vars(self))

    def to_json(self) -> dict[str, Any]:
        """Its name and fields, plain values."""
        return {"command": type(self).__name__, **{key: _plain(value) for key, value in vars(self).items()}}

    @staticmethod
    def from_json(data: Any, source: str = "session") -> Command:
        """The command that `to_json` wrote. Raises `InputError`."""
        name = data.get("command") if isinstance(data, dict) else None
        if name not in KINDS:
            raise InputError(source, "command", "the name of a command", name)
        content = {key: _read(key, value, source) for key, value in data.items() if key != "command"}
        try:
            return KINDS[name](**content)
        except TypeError as error:
            raise InputError(source, name, "the fields of that command", error) from None


class Setting(Command, kind=False):
    """Of several in one gesture the last alone decides."""


class Choice(Command, kind=False):
    """Of a tool: it changes nothing of what is made, is no step of undo and is not written down."""


class Select(Choice):
    """A joint or a region of the face; None: nothing."""

    name: str | None

    def apply(self, state: StudioState) -> StudioState:
        return state.use(selected=self.name)


class Pin(Choice):
    """Whether handles stay where they are while another is pulled, or a slider or ring turns what carries them."""

    handles: tuple[str, ...]
    pinned: bool

    def apply(self, state: StudioState) -> StudioState:
        pins = state.tools.pins
        return state.use(pins=pins.union(self.handles) if self.pinned else pins.difference(self.handles))


class ShowOverlay(Choice):
    overlay: str
    shown: bool

    def apply(self, state: StudioState) -> StudioState:
        overlays, overlay = state.tools.overlays, {self.overlay}
        return state.use(overlays=overlays | overlay if self.shown else overlays - overlay)


class ShowPicture(Choice):
    """One of `state.PICTURES`."""

    picture: str

    def apply(self, state: StudioState) -> StudioState:
        return state.use(shows=self.picture)


class MoveCut(Choice):
    """Along which axis the slice lies, and where, metres of the world."""

    axis: str
    offset: float

    def apply(self, state: StudioState) -> StudioState:
        return state.use(cut=Cut(self.axis, self.offset))


class PullHandle(Setting):
    """A handle was pulled to `target`, metres in the frame of the figure's place; `signals` are what followed: a journal needs no solver."""

    handle: str
    target: Vector
    signals: Signals

    def apply(self, state: StudioState) -> StudioState:
        return state.change(signals=self.signals)


class LookAt(Setting):
    """Eyes and head were turned to `target`, metres in the frame of the figure's place; `signals` are what followed."""

    target: Vector
    signals: Signals

    def apply(self, state: StudioState) -> StudioState:
        return state.change(signals=self.signals)


class Followed(Setting, kind=False):
    """A setting of the pose while parts are pinned. `signals`: the whole pose, limbs that keep the pins with it; None without pins."""

    _: KW_ONLY
    signals: Signals | None = None

    def to_json(self) -> dict[str, Any]:
        content = super().to_json()
        return content if self.signals else {key: value for key, value in content.items() if key != "signals"}


class SetJoint(Followed):
    joint: str
    rotation: Vector
    linked: bool = False
    """Whether its counterpart on the other side turns like its mirror image."""

    def apply(self, state: StudioState) -> StudioState:
        if self.signals:
            return state.change(signals=self.signals)
        signals = posing.set_joint(state.signals, self.joint, self.rotation, state.limit_joints)
        if self.linked and (other := posing.counterpart(self.joint)) != self.joint:
            x, y, z = self.rotation
            signals = posing.set_joint(signals, other, (x, -y, -z), state.limit_joints)
        return state.change(signals=signals)


class SetTranslation(Followed):
    translation: Vector

    def apply(self, state: StudioState) -> StudioState:
        if self.signals:
            return state.change(signals=self.signals)
        return state.pose(translation=np.array(self.translation))


class SetExpression(Setting):
    name: str
    value: float
    linked: bool = False
    """Whether its counterpart on the other side gets the same value."""

    def apply(self, state: StudioState) -> StudioState:
        value = float(np.clip(self.value, 0, 1)) if state.limit_joints else self.value
        signals = posing.set_expression(state.signals, self.name, value)
        if self.linked:
            signals = posing.set_expression(signals, posing.counterpart(self.name), value)
        return state.change(signals=signals)


class SetShape(Setting):
    index: int
    value: float
    rise: float = 0.0
    """Metres that the person is moved upwards, so that its lowest point stays where it is."""

    def apply(self, state: StudioState) -> StudioState:
        shape = state.signals.shape.copy()
        if not 0 <= self.index < len(shape):
            raise InputError("shape", "", f"a coefficient from 0 to {len(shape) - 1}", self.index)
        shape[self.index] = self.value
        return state.pose(shape=shape, translation=state.signals.translation + np.array([0, self.rise, 0]))


class SetHandPose(Command):
    side: str
    name: str

    def apply(self, state: StudioState) -> StudioState:
        if self.side not in ("left", "right"):
            raise InputError("hand", "", "left or right", self.side)
        return state.pose(**{f"{self.side}_hand_pose": named_hand(self.name, self.side)})


class ApplyPose(Command):
    """A named body pose with the hands that it needs, if any; the face stays."""

    name: str

    def apply(self, state: StudioState) -> StudioState:
        return state.pose(body_pose=named_pose(self.name), **hands_of_pose(self.name))


class ApplyExpression(Command):
    name: str

    def apply(self, state: StudioState) -> StudioState:
        return state.pose(expression=named_expression(self.name))


class SetSignals(Setting):
    """All signals at once: a pasted pose, a file."""

    signals: Signals


class Randomise(Command):
    """A group within `strength` times its limits, drawn from `seed`."""

    group: str
    strength: float
    seed: int

    def apply(self, state: StudioState) -> StudioState:
        drawn = random_signals(np.random.default_rng(self.seed), self.strength)
        return state.change(signals=posing.copy_group(state.signals, drawn, self.group))


class Mirror(Command):
    """Left and right exchanged; the place stays."""

    def apply(self, state: StudioState) -> StudioState:
        return state.change(signals=mirror(state.signals).replace(translation=state.signals.translation))


class Reset(Command):
    """Pose, hands, face, shape and place at rest."""

    def apply(self, state: StudioState) -> StudioState:
        return state.change(signals=Signals.rest())


class ResetGroup(Command):
    group: str

    def apply(self, state: StudioState) -> StudioState:
        return state.change(signals=posing.reset(state.signals, self.group))


class SetLimits(Setting):
    limited: bool

    def apply(self, state: StudioState) -> StudioState:
        return state.change(limit_joints=self.limited)


class OrbitBy(Command):
    azimuth: float
    elevation: float

    def apply(self, state: StudioState) -> StudioState:
        azimuth = (state.view.azimuth + self.azimuth + 180) % 360 - 180
        elevation = float(np.clip(state.view.elevation + self.elevation, -89, 89))
        return state.change(view=replace(state.view, azimuth=azimuth, elevation=elevation))


class PanBy(Command):
    """Moves the target in the image plane, in shares of the view's height: right, up."""

    right: float
    up: float

    def apply(self, state: StudioState) -> StudioState:
        view = state.view
        azimuth, elevation = np.radians([view.azimuth, view.elevation])
        right = np.array([np.cos(azimuth), 0, -np.sin(azimuth)])
        up = np.array([-np.sin(azimuth) * np.sin(elevation), np.cos(elevation), -np.cos(azimuth) * np.sin(elevation)])
        height = 2 * view.distance * np.tan(np.radians(view.fov) / 2)
        return state.change(view=view.moved(height * (self.right * right + self.up * up)))


class ZoomBy(Command):
    """Multiplies the distance."""

    factor: float

    def apply(self, state: StudioState) -> StudioState:
        distance = float(np.clip(state.view.distance * self.factor, 0.3, 50))
        return state.change(view=replace(state.view, distance=distance))


class SetCamera(Command):
    """The named entries of the view; None keeps one."""

    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None
    fov: float | None = None
    target: Vector | None = None
    follow: bool | None = None
    orthographic: bool | None = None

    def apply(self, state: StudioState) -> StudioState:
        named = {name: value for name, value in vars(self).items() if value is not None}
        return state.change(view=replace(state.view, **named))


class SetBackground(Setting):
    colour: Colour

    def apply(self, state: StudioState) -> StudioState:
        return state.change(background=self.colour)


class SetStage(Setting):
    """One field of the stage."""

    name: str
    value: Any

    def apply(self, state: StudioState) -> StudioState:
        if self.name not in vars(state.stage):
            raise InputError("stage", self.name, "one of " + ", ".join(vars(state.stage)), "an unknown field")
        return state.change(stage=replace(state.stage, **{self.name: self.value}))


class SetSize(Setting):
    scale: float = 1.0
    fixed: tuple[int, int] | None = None

    def apply(self, state: StudioState) -> StudioState:
        return state.change(size=SizePolicy(self.scale, self.fixed))


class SetHidden(Command):
    part: str
    hidden: bool

    def apply(self, state: StudioState) -> StudioState:
        part = {self.part}
        return state.change(hidden=state.hidden | part if self.hidden else state.hidden - part)


class SetLevel(Setting):
    """Run time against error: one of `state.LEVELS`."""

    level: str


class OpenAvatar(Command):
    avatar: str


class AmongFigures(Command, kind=False):
    """Another figure is selected afterwards: what differs is no edit."""


class AddFigure(AmongFigures):
    """One more avatar, which is then selected; without a place beside all others, without signals it stands."""

    avatar: str
    place: Place | None = None
    signals: Signals | None = None
    fps: float | None = None
    """Of its timeline; None: 30, as in sessions of before."""
    frame: int | None = None
    """Of its playhead; None: the first."""

    def begun(self, timeline: Timeline) -> AddFigure:
        """With rate and playhead of another's timeline where it has none of its own: one playhead moves all."""
        if self.fps is not None or self.frame is not None:
            return self
        return replace(self, fps=timeline.fps, frame=timeline.frame)

    def apply(self, state: StudioState) -> StudioState:
        figures = state.figures
        place = self.place or beside([figure.place for figure in figures])
        timeline = Timeline(fps=30.0 if self.fps is None else self.fps, frame=self.frame or 0)
        new = Figure(self.avatar, self.signals or standing(), timeline, place=place)
        return state.with_figures((*figures, new), len(figures))


class RemoveFigure(AmongFigures):
    """One of several, by its number."""

    index: int

    def apply(self, state: StudioState) -> StudioState:
        figures, index = state.figures, self.index
        if len(figures) == 1 or not 0 <= index < len(figures):
            raise InputError("figures", "", "one of several to remove", f"number {index} of {len(figures)}")
        kept = figures[:index] + figures[index + 1 :]
        return _selected(state, kept, min(state.slot - (index < state.slot), len(kept) - 1))


class SelectFigure(AmongFigures):
    """Which one the panels show, by its number."""

    index: int

    def apply(self, state: StudioState) -> StudioState:
        return state if self.index == state.slot else _selected(state, state.figures, self.index)


class PlaceFigure(Setting):
    """Where the selected one stands."""

    place: Place


class SetFingers(Setting):
    """A macro of one finger, or of `all`: `name` is e.g. `left index curl`; `linked`: of both hands."""

    name: str
    value: float
    linked: bool = False

    def apply(self, state: StudioState) -> StudioState:
        side, _, rest = self.name.partition(" ")
        finger, _, macro = rest.partition(" ")
        fingers = FINGERS if finger == "all" else (finger,)
        sides = ("left", "right") if self.linked and side in ("left", "right") else (side,)
        hands = {}
        for each in sides:
            pose = getattr(state.signals, f"{each}_hand_pose", np.zeros((15, 3)))
            hands[f"{each}_hand_pose"] = set_hand(pose, each, fingers, macro, self.value)
        changed = state.pose(**hands)
        return changed.change(signals=posing.limited(changed.signals, tuple(hands))) if state.limit_joints else changed


class SetFaceMacro(Setting):
    """A macro of the face, such as `smile`, at a value from 0 to 1."""

    name: str
    value: float

    def apply(self, state: StudioState) -> StudioState:
        return state.pose(expression=set_face(state.signals.expression, self.name, self.value))


class ScaleGroup(Setting):
    """A group's joints and coefficients times `factor`: 0 is rest, 1 what they are."""

    name: str
    factor: float

    def apply(self, state: StudioState) -> StudioState:
        if not 0 <= self.factor <= 2:
            raise InputError("factor", "", "0 to 2", self.factor)
        return state.change(signals=posing.scaled(state.signals, self.name, self.factor))


class PutOnFloor(Command):
    """The lowest point of the figure on the floor."""

    def apply(self, state: StudioState) -> StudioState:
        return state.change(signals=on_floor(state.signals))


class Blend(Setting):
    """From the present state, or `start`, towards an entry of a library: `amount` of the way (0 to 1) in the fields `parts` of `signals`."""

    name: str
    signals: Signals
    parts: tuple[str, ...]
    amount: float = 1.0
    start: Signals | None = None

    def apply(self, state: StudioState) -> StudioState:
        if not 0 <= self.amount <= 1:
            raise InputError("blend", "", "0 to 1", self.amount)
        if unknown := sorted(set(self.parts) - set(SHAPES)):
            raise InputError("blend", unknown[0], "one of " + ", ".join(SHAPES), "an unknown field")
        start = self.start or state.signals
        ends = {0.0: start, 1.0: self.signals}  # to the bit
        target = ends[self.amount] if self.amount in ends else interpolate(start, self.signals, self.amount)
        return state.pose(**{part: getattr(target, part) for part in self.parts})


def _selected(state: StudioState, figures: tuple[Figure, ...], slot: int) -> StudioState:
    """With one of `figures` selected; the playhead stays where it is, also where it has not moved that one before."""
    chosen = state.with_figures(figures, slot)
    return chosen.change(timeline=chosen.timeline.along(state.timeline))


def _plain(value: Any) -> Any:
    if isinstance(value, Signals | ImportOptions | Layer):
        return value.to_json()
    if isinstance(value, OrbitView | Share | Place):
        return vars(value)
    return [_plain(entry) for entry in value] if isinstance(value, tuple) else value


def _read(key: str, value: Any, source: str) -> Any:
    if value is None:
        return None
    if key in ("signals", "start"):
        return Signals.from_json(value, source)
    if key == "others":
        return tuple(None if signals is None else Signals.from_json(signals, source) for signals in value)
    if key == "options":
        return ImportOptions.from_json(value, source)
    if key == "layer":
        return Layer.from_json(value, source)
    if key == "view":
        return OrbitView(**{name: _tuples(entry) for name, entry in value.items()})
    if key == "share":
        return Share(**value)
    if key == "place":
        return Place(**value)
    if key == "feeds":
        return _feeds(value, source)
    if key == "sent":
        return tuple(_feeds(feeds, source) for feeds in value)
    return _tuples(value)


def _feeds(value: Any, source: str) -> Feeds:
    return tuple((name, Signals.from_json(signals, source), presence) for name, signals, presence in value)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
