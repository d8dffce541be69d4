"""The run as a process sees it that trains with others and does not lead: it reads what is there, and writes nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from avatarrex.avatar import Avatar
from avatarrex.training.runs.control import Wish
from avatarrex.training.runs.folder import Run, read_about


class Follower(Run):
    """A run that another process has open. What is reported to it goes nowhere."""

    def __init__(self, path: str | Path) -> None:
        """Raises `InputError` where there is none."""
        self.path = Path(path)
        self.about = read_about(self.path)
        self.step, self.part, self.pass_name, self.steps = 0, str(self.about.get("part") or ""), "", 0
        self._events = None

    def stage(self, part: str, pass_name: str, steps: int) -> None:
        """See `Run`."""
        self.part, self.pass_name, self.steps = part, pass_name, steps

    def scalars(self, step: int, values: Any) -> None:
        """Nothing."""

    def picture(self, step: int, name: str, pixels: UInt8[np.ndarray, "h w 3"]) -> Path:
        """Nothing; where the leader writes it."""
        return self.path / "samples" / name / f"step_{step:08d}.png"

    def save(self, step: int, state: dict[str, Any], avatar: Avatar | None = None, score: float | None = None) -> Path:
        """Nothing; where the leader writes it."""
        return self.path / "checkpoints" / f"step_{step:08d}"

    def control(self) -> Wish:
        """The leader looks."""
        return "run"
