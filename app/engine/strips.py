"""A large picture in horizontal strips, so that a slow one can be shown as it grows and dropped when the user moves.

Letters: h w image rows and columns.
"""

from __future__ import annotations

import torch
from avatarrex_studio.engine.engine import Engine, Shot
from avatarrex_studio.session.state import StudioState
from jaxtyping import Float32
from torch import Tensor

STRIP_SECONDS = 0.15
"""What one strip may take: the interface answers in between."""
OVERLAP_ROWS = 1
"""Rows rendered beyond a strip on each side: antialiasing looks at the neighbours."""


class Strips:
    """The picture of one state, a strip at a time from the top."""

    def __init__(
        self,
        engine: Engine,
        state: StudioState,
        size: tuple[int, int],
        draft: Float32[Tensor, "h w 4"],
        seconds_per_pixel: float,
        dragged: bool = False,
    ) -> None:
        """`draft`, an image of any raster, is shown enlarged where no strip is rendered yet. `dragged`: see `Engine.render`."""
        self.engine, self.state, self.size, self.dragged = engine, state, size, dragged
        width, height = size
        enlarged = torch.nn.functional.interpolate(draft.permute(2, 0, 1)[None], (height, width), mode="bilinear")
        self.image = enlarged[0].permute(1, 2, 0).contiguous()
        self.rows = max(8, int(STRIP_SECONDS / (seconds_per_pixel * width)))
        self.done = 0

    @property
    def finished(self) -> bool:
        """Whether every row is there."""
        return self.done >= self.size[1]

    def step(self) -> Shot:
        """Render the next strip into `image`; the shot contains that strip alone."""
        first, last = self.done, min(self.done + self.rows, self.size[1])
        low, high = max(first - OVERLAP_ROWS, 0), min(last + OVERLAP_ROWS, self.size[1])
        shot = self.engine.render(self.state, self.size, (low, high), self.dragged)
        if shot.frame is not None and shot.error is None:
            self.image[first:last] = shot.frame.image[first - low : last - low]
        self.done = self.size[1] if shot.error else last
        return shot
