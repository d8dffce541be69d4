"""What is exported: orders that say which file, of what, and how; each can write itself. Needs no torch to be made or checked.

An order crosses to the process that writes it (`export_worker.py`). Its file is there whole or not at all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from avatarrex_studio.jobs.export_look import Look
from avatarrex_studio.session.soundtrack import soundtrack
from avatarrex_studio.session.state import StudioState

from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.export.target import ENDINGS, check_export, files_of
from avatarrex.files.gate import check_writable, what_is
from avatarrex.files.video import SOUND_RATE, VIDEOS, Sound
from avatarrex.signals.sequence import SignalSequence

if TYPE_CHECKING:
    from avatarrex_studio.engine.engine import Engine
    from avatarrex_studio.jobs.export_picture import Drawer

Tell = Callable[[int], None]
"""`tell(done)`: so many of the order's steps are done."""
Make = Callable[[], "Engine"]
PICTURES, LAYERS = (".png", ".jpg"), (".exr",)
SIGNALS, CAMERAS = (".json", ".npz", ".csv"), (".json",)
FOLDER = "folder of PNG"
"""In place of an ending: a picture a frame."""
EXPORTED: dict[str, tuple[str, ...]] = {
    "Picture": PICTURES, "Layers": LAYERS, "Video": (*VIDEOS, FOLDER), "3D model": ENDINGS, "Signals": SIGNALS, "Camera": CAMERAS,
}  # fmt: skip
"""Endings by kind, as a user knows it."""
PASSES = ("depth", "normal", "position")


@runtime_checkable
class Order(Protocol):
    """One export."""

    @property
    def path(self) -> Path:
        """The file, or the folder of a sequence of pictures."""

    @property
    def steps(self) -> int:
        """How many there are to do."""

    def check(self) -> list[Path]:
        """The files that it writes. Raises `InputError` for what can be seen to be wrong before any work."""

    def write(self, make: Make, tell: Tell) -> None:
        """Do it; `make()` gives an engine. Raises `InputError`."""


@dataclass(frozen=True)
class PictureOrder:
    """One picture, as PNG or JPEG, with its state in it."""

    path: Path
    state: StudioState
    look: Look
    steps: int = 1

    def check(self) -> list[Path]:
        """The file."""
        self.look.check(self.path)
        self.look.check_stage(self.state.stage)
        _ending(self.path, PICTURES)
        if self.path.suffix.lower() == ".jpg" and (self.look.clear or self.state.background[3] < 1):
            raise InputError(self.path, "", "an opaque background, or .png", "a transparent picture in a JPEG")
        check_writable(self.path)
        return [self.path]

    def write(self, make: Make, tell: Tell) -> None:
        """Render and write it."""
        _drawer(make, self.look).write_picture(self.path, self.state)
        tell(1)


@dataclass(frozen=True)
class LayersOrder:
    """Colour, alpha and passes of one picture as OpenEXR."""

    path: Path
    state: StudioState
    look: Look
    passes: tuple[str, ...] = PASSES
    steps: int = 1

    def check(self) -> list[Path]:
        """The file."""
        from avatarrex.files.exr import check_exr

        self.look.check(self.path)
        _ending(self.path, LAYERS)
        check_exr(self.path)
        check_writable(self.path)
        return [self.path]

    def write(self, make: Make, tell: Tell) -> None:
        """Render and write them."""
        _drawer(make, self.look).write_layers(self.path, self.state, self.passes)
        tell(1)


@dataclass(frozen=True)
class VideoOrder:
    """A picture of each state: a video, or a folder of PNG files where the path has no ending."""

    path: Path
    states: tuple[StudioState, ...]
    fps: float
    look: Look
    plays: bool = False
    """Whether the states are the timeline's one after the other: sound files in it sound."""

    @property
    def steps(self) -> int:
        """Pictures."""
        return len(self.states)

    def check(self) -> list[Path]:
        """The file; a folder must be free."""
        self.look.check(self.path)
        if not self.states:
            raise InputError(self.path, "frames", "at least one", 0)
        self.look.check_stage(self.states[0].stage)
        if not self.path.suffix:
            if what_is(self.path) != "nothing there":
                raise InputError(self.path, "", "a folder that is not there yet", what_is(self.path))
            check_writable(self.path / "frame")
            return []
        _ending(self.path, VIDEOS)
        if any(side % 2 for side in self.look.size):
            raise InputError(self.path, "size", "even sides for a video", "x".join(map(str, self.look.size)))
        if self.path.suffix.lower() == ".mp4" and (self.look.clear or self.states[0].background[3] < 1):
            raise InputError(self.path, "", "an opaque background, .webm or a folder", "a transparent video in .mp4")
        check_video(self.path)
        check_writable(self.path)
        return [self.path]

    def write(self, make: Make, tell: Tell) -> None:
        """Render and encode one after the other."""
        from avatarrex.files.gate import written_folder
        from avatarrex.files.video import video_writer

        drawer = _drawer(make, self.look)
        video = video_writer(self.path, *self.look.size, self.fps, self._sound()) if self.path.suffix else None
        folder = nullcontext(self.path) if video else written_folder(self.path)
        with video or nullcontext() as append, folder as place:
            for number, state in enumerate(self.states):
                if append:
                    append(drawer.pixels(state))
                else:
                    drawer.write_picture(place / f"frame_{number:06d}.png", state)
                tell(number + 1)

    def _sound(self) -> Sound | None:
        if not self.plays:
            return None
        state, seconds = self.states[0], len(self.states) / self.fps
        others = [figure.timeline for figure in state.others]
        return soundtrack(state.timeline, state.timeline.seconds, seconds, SOUND_RATE, others)


@dataclass(frozen=True)
class ModelOrder:
    """The avatar's surface for other programs, with a clip where there is one; `.obj` and `.ply` show its frames."""

    path: Path
    avatar: str
    clip: SignalSequence | None = None
    steps: int = 1

    def check(self) -> list[Path]:
        """Every file."""
        path = check_export(self.path, int(self.clip is not None), len(self.clip or [0]))
        return files_of(path, len(self.clip or [0]))

    def write(self, make: Make, tell: Tell) -> None:
        """Write the file and what lies beside it."""
        from avatarrex.export.clips import Clip
        from avatarrex.export.export import export_avatar

        clips = []
        if self.clip is not None:
            frames = tuple(frame.replace(shape=np.zeros(10)) for frame in self.clip)
            clips = [Clip(self.clip.name or "clip", replace(self.clip, frames=frames))]
        export_avatar(make().avatar(self.avatar), self.path, clips)
        tell(1)


@dataclass(frozen=True)
class SignalsOrder:
    """What drives the avatar: of one frame, or of a motion."""

    path: Path
    sequence: SignalSequence
    steps: int = 1

    def check(self) -> list[Path]:
        """The file."""
        _ending(self.path, SIGNALS)
        check_writable(self.path)
        return [self.path]

    def write(self, make: Make, tell: Tell) -> None:
        """Write it."""
        from avatarrex.signals.write import write_motion

        write_motion(self.path, self.sequence)
        tell(1)


@dataclass(frozen=True)
class CamerasOrder:
    """Calibrated cameras by name, in the layout of a capture's `calibration_full.json`."""

    path: Path
    cameras: dict[str, Camera] = field(hash=False)
    steps: int = 1

    def check(self) -> list[Path]:
        """The file."""
        _ending(self.path, CAMERAS)
        check_writable(self.path)
        return [self.path]

    def write(self, make: Make, tell: Tell) -> None:
        """Write it."""
        from avatarrex.capture.synthetic.cameras import calibration
        from avatarrex.files.json_text import write_json

        write_json(self.path, calibration(self.cameras, lambda name: np.zeros(5)))
        tell(1)


def check_video(path: Path) -> None:
    """Raise `InputError` where no video can be encoded."""
    from importlib.util import find_spec

    if find_spec("av") is None:
        raise InputError(path, "", "the 'video' extra: pip install 'avatarrex-studio[video]'", "no PyAV")


def turned(states: Iterable[StudioState], turns: float) -> tuple[StudioState, ...]:
    """The states with the view going round the person `turns` times; the last is one step short of the first."""
    listed = tuple(states)
    azimuths = (state.view.azimuth + 360 * turns * k / len(listed) for k, state in enumerate(listed))
    return tuple(state.change(view=replace(state.view, azimuth=azimuth)) for state, azimuth in zip(listed, azimuths))


def _ending(path: Path, endings: tuple[str, ...]) -> None:
    if path.suffix.lower() not in endings:
        raise InputError(path, "", "a file that ends in " + ", ".join(endings), path.suffix or "no extension")


def _drawer(make: Make, look: Look) -> Drawer:
    from avatarrex_studio.jobs.export_picture import Drawer

    return Drawer(make(), look)
