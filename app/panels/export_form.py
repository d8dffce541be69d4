"""What an export is of, as it is filled in: fields by kind, and the order that they make. No window library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from avatarrex_studio.jobs.export_look import Look
from avatarrex_studio.jobs.export_order import (
    EXPORTED,
    FOLDER,
    CamerasOrder,
    LayersOrder,
    ModelOrder,
    Order,
    PictureOrder,
    SignalsOrder,
    VideoOrder,
    turned,
)  # fmt: skip
from avatarrex_studio.session.state import StudioState

from avatarrex.export.target import BONES, MESHES
from avatarrex.signals.sequence import SignalSequence

ABOUT = {
    ".png": "transparent where nobody is, if you like; the pose and the view are kept in the file",
    ".jpg": "smaller, opaque", ".exr": "linear colour, alpha, depth, normals, positions, for compositing",
    ".mp4": "H.264, plays everywhere, opaque", ".webm": "VP9 with transparency, for browsers and OBS",
    FOLDER: "one PNG a frame", ".glb": "skeleton, expressions, texture: Blender, Unity, Unreal, web",
    ".vrm": "VRM 1.0 avatar for VTubing programs", ".usdz": "USD for Apple's and Pixar's programs", ".usdc": "USD, texture beside it",
    ".html": "a page that shows it in any browser", ".obj": "mesh with texture in this pose", ".ply": "mesh with vertex colours in this pose",
    ".json": "ours: everything, exactly",
    ".npz": "SMPL-X in AMASS' layout, with the 52 coefficients", ".csv": "the face, as Live Link Face writes it",
}  # fmt: skip
"""What an ending is for."""
ALONE = ("3D model", "Signals")
"""Kinds that contain one avatar of several, and last as long as its own timeline."""
MOST_RATE = 60.0
"""Frames a second of a video unless told: motion capture has up to 240."""


@runtime_checkable
class Frames(Protocol):
    """The motion that is loaded, as the studio shows it."""

    count: int
    """Until the last of all figures ends."""
    own: int
    """Until the selected one does."""
    fps: float

    def at(self, frame: int) -> StudioState:
        """The state at a frame. May be called by any thread."""


@dataclass
class ExportForm:
    """The fields."""

    kind: str = "Picture"
    format: dict[str, str] = field(default_factory=lambda: {kind: endings[0] for kind, endings in EXPORTED.items()})
    """The ending of each kind."""
    folder: str = ""
    name: str = "avatar"
    size: tuple[int, int] = (1024, 1024)
    samples: int = 1
    levels: dict[str, str] = field(
        default_factory=lambda: {"Picture": "quality", "Layers": "quality", "Video": "balanced"}
    )
    """By kind."""
    clear: bool = False
    stage: bool = False
    """Whether floor, light and background of the stage are drawn."""
    labelled: bool = False
    label: str = "AvatarReX Studio"
    marked: bool = False
    moving: bool = True
    """Whether the motion plays, where there is one."""
    first: int = 0
    last: int = 0
    rate: float = 30.0
    turns: float = 0.0
    seconds: float = 4.0
    """Of a video without a motion."""

    @property
    def ending(self) -> str:
        """Of the kind that is chosen."""
        return self.format[self.kind]

    @property
    def path(self) -> Path:
        """The file, or the folder."""
        name = self.name.strip() or "avatar"
        return Path(self.folder).expanduser() / (name if self.ending == FOLDER else name + self.ending)

    @property
    def moves(self) -> bool:
        """Whether frames of a motion can go in."""
        return self.kind in ("Video", "Signals", "Camera") or (
            self.ending in (*MESHES, *BONES) and self.ending != ".vrm"
        )

    @property
    def drawn(self) -> bool:
        """Whether pictures are made."""
        return self.kind in ("Picture", "Layers", "Video")

    def take(self, path: str) -> None:
        """A path that was chosen; an ending of this kind is its format."""
        chosen = Path(path)
        self.folder, self.name = str(chosen.parent), chosen.name
        if chosen.suffix.lower() in EXPORTED[self.kind]:
            self.format[self.kind], self.name = chosen.suffix.lower(), chosen.stem

    def begin(self, viewport: tuple[int, int], state: StudioState, frames: Frames | None) -> None:
        """Fill in what depends on what is shown."""
        if not self.folder:  # the first time: what is seen is what is exported
            self.folder, self.stage = str(Path.cwd()), state.stage.shown
        width, height = state.size.pixels(viewport)
        self.size = (width // 2 * 2, height // 2 * 2)
        if frames is not None:
            self.first, self.last = 0, frames.count - 1
            self.rate = frames.fps if frames.fps <= MOST_RATE else 30.0

    def count(self, frames: Frames | None) -> int:
        """How many frames a video has."""
        if frames is None or not self.moving:
            return max(1, round(self.seconds * self.rate))
        return max(1, round((self.last - self.first + 1) / frames.fps * self.rate))

    def order(self, state: StudioState, frames: Frames | None) -> Callable[[], Order]:
        """What makes the order; it may take a moment, and be called by any thread."""
        level, label = self.levels.get(self.kind, ""), self.label if self.labelled else ""
        path, look = self.path, Look(self.size, self.samples, level, self.clear, label, self.marked, self.stage)
        frames = frames if self.moving else None
        count, rate, turns = self.count(frames), self.rate, self.turns
        last = min(self.last, frames.own - 1) if frames and self.kind in ALONE else self.last
        first = min(self.first, last)

        def states(wanted: float | None = None) -> tuple[StudioState, ...]:
            """At the rate of the form, or of the motion."""
            if frames is None:
                return (state,) * count
            step = frames.fps / (wanted or frames.fps)
            numbers = np.arange(first, last + 0.5, step) if wanted is None else first + step * np.arange(count)
            return tuple(frames.at(min(int(number + 0.5), last)) for number in numbers)

        def motion() -> SignalSequence:
            if frames is None:
                return SignalSequence((state.signals,), 30.0, path.stem)
            return SignalSequence(tuple(each.signals for each in states()), frames.fps, path.stem)

        def cameras() -> CamerasOrder:
            shown = (state,) if frames is None else states()
            return CamerasOrder(path, {f"frame_{k:06d}": each.view.camera(*self.size) for k, each in enumerate(shown)})

        def model() -> ModelOrder:
            posed = self.ending in MESHES or frames is not None
            return ModelOrder(path, state.avatar, motion() if posed and self.moves else None)

        makers: dict[str, Callable[[], Order]] = {
            "Picture": lambda: PictureOrder(path, state, look), "Layers": lambda: LayersOrder(path, state, look),
            "Video": lambda: VideoOrder(path, turned(states(rate), turns), rate, look, frames is not None),
            "3D model": model, "Signals": lambda: SignalsOrder(path, motion()), "Camera": cameras,
        }  # fmt: skip
        return makers[self.kind]
