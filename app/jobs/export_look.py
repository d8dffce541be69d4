"""How the pictures of an export look: raster, samples, level, background, labels. Needs no torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from avatarrex_studio.session.state import SIZES

from avatarrex.errors import InputError
from avatarrex.files.watermark import SMALLEST
from avatarrex.stage.picture import check_picture
from avatarrex.stage.stage import Stage

SAMPLES = (1, 2, 3, 4)
"""Samples of a pixel along each side."""


@dataclass(frozen=True)
class Look:
    """How pictures are made."""

    size: tuple[int, int]
    """Width and height, pixels."""
    samples: int = 1
    """Of a pixel along each side: of `SAMPLES`."""
    level: str = "quality"
    clear: bool = False
    """Transparent where nobody is, instead of the background."""
    label: str = ""
    """Text at the lower right; empty for none."""
    marked: bool = False
    """Whether pictures get the invisible mark."""
    stage: bool = False
    """Whether the state's stage is drawn, where it has one that is shown."""

    def check(self, path: Path) -> None:
        """Raise `InputError` for a raster that cannot be made."""
        sides = [side * self.samples for side in self.size]
        if not all(SIZES[0] <= side <= SIZES[1] for side in sides):
            expected = f"sides of {SIZES[0]} to {SIZES[1]} pixels, times the samples"
            raise InputError(path, "size", expected, " x ".join(map(str, sides)))
        if self.marked and min(self.size) < SMALLEST:
            raise InputError(
                path, "size", f"sides of at least {SMALLEST} pixels for the invisible mark", min(self.size)
            )

    def check_stage(self, stage: Stage) -> None:
        """Raise `InputError` for a stage's picture that is drawn and cannot be read."""
        if self.stage:
            check_picture(stage)
