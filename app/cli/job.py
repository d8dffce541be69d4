"""A render order: which frames of which motion, from where, and the files they go to. Needs no torch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from avatarrex_studio.session.clips import Clips
from avatarrex_studio.session.commands import Command
from avatarrex_studio.session.evaluation import state_at
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.soundtrack import soundtrack
from avatarrex_studio.session.state import StudioState

from avatarrex.files.video import SOUND_RATE, Sound
from avatarrex.signals.driving import Signals

DEFAULT_SIZE = (512, 512)
"""Width and height, pixels."""


@dataclass(frozen=True)
class Job:
    """A checked render order."""

    out: Path
    kind: str
    """`image`, `folder` or `video`."""
    start: StudioState
    motion: Motion | None = None
    frames: tuple[int, ...] = (0,)
    edits: tuple[Command, ...] = ()
    """Applied on top of each frame of the motion."""
    size: tuple[int, int] = DEFAULT_SIZE
    aovs: tuple[str, ...] = ()
    stats: Path | None = None
    detail: Signals | None = None
    """The pose that feature patches are decoded from, where it is not the frame's own."""
    framing: str = ""
    """What is chosen so that the person is seen in every frame: `place` (target and distance), `target`, `distance`."""
    shading_tolerance: float = 0.0
    """Of `RenderSettings`."""

    @property
    def fps(self) -> float:
        """Of a video: the motion's, or less where frames are left out."""
        if self.motion is None:
            return 30.0
        step = self.frames[1] - self.frames[0] if len(self.frames) > 1 else 1
        return self.motion.sequence.fps / abs(step)

    @property
    def sound(self) -> Sound | None:
        """Of a video: that of a sound file, where its frames are not played backwards."""
        if self.motion is None or self.frames[-1] < self.frames[0]:
            return None
        timeline = self.motion.loaded().apply(self.start).timeline
        return soundtrack(timeline, self.frames[0] / timeline.fps, len(self.frames) / self.fps, SOUND_RATE)

    def states(self) -> Iterator[tuple[int, StudioState]]:
        """Each frame's number and state."""
        clips = Clips()
        if self.motion:
            clips.take(self.motion)
        for number in self.frames:
            state = self.start
            if self.motion:
                state = self.motion.loaded().apply(state)
                state = state_at(state, number / state.timeline.fps, clips)
            for command in self.edits:
                state = command.apply(state)
            yield number, state

    def image_path(self, number: int) -> Path:
        """Where the image of a frame goes; its passes lie beside it as `.npz`."""
        if self.kind == "folder":
            return self.out / f"frame_{number:06d}.png"
        return self.out if self.kind == "image" else self.out.with_name(f"{self.out.stem}_{number:06d}.png")
