"""Point map: where each pixel's ray first meets the avatar (paper sec. 4, Step II).

Letters: h w image rows and columns, p covered pixels, k parts. Root frame, metres; the SDF is negative inside.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.ops.finite import require_finite


@dataclass(frozen=True, eq=False)
class PointMap:
    """What the rays met. All zero where nothing is covered."""

    position: Float[Tensor, "h w 3"]
    """Surface point, root frame, metres."""
    normal: Float[Tensor, "h w 3"]
    """Unit gradient of the composed field there, root frame."""
    depth: Float[Tensor, "h w"]
    """Camera z, metres."""
    hit: Bool[Tensor, "h w"]
    """Whether the ray through the pixel's centre meets the surface."""
    coverage: Float[Tensor, "h w"]
    """Share of the pixel that is covered: 1 inside, between 0 and 1 at silhouettes. Where the centre misses but the
    pixel is partly covered, the nearest covered sub-position gives the point."""
    part_weight: Float[Tensor, "h w k"]
    """Effective ω of `PARTS`."""
    steps: Float[Tensor, "h w"]
    """Field samples that the covered pixel's centre ray took."""
    renderer: str
    """What cast the rays."""
    counters: dict[str, int] = field(default_factory=dict)
    side: Int[Tensor, "h w"] | None = None
    """The limb that each point is on (`Composed.side`), where the exact field was evaluated; None: the volume tells."""

    def __post_init__(self) -> None:
        require_finite(
            "point map",
            position=self.position,
            normal=self.normal,
            depth=self.depth,
            coverage=self.coverage,
            part_weight=self.part_weight,
        )


@dataclass(frozen=True)
class CoveredPixels:
    """What a ray caster knows of the pixels that the avatar covers; a hit through the pixel's centre unless told."""

    pixel: Int[Tensor, " p"]
    """Row · width + column."""
    position: Float[Tensor, "p 3"]
    normal: Float[Tensor, "p 3"]
    part_weight: Float[Tensor, "p k"]
    hit: Bool[Tensor, " p"] | None = None
    coverage: Float[Tensor, " p"] | None = None
    steps: Float[Tensor, " p"] | None = None

    def scatter(self, camera: Camera, renderer: str, counters: dict[str, int]) -> PointMap:
        """The images; depth is taken in float64."""
        row, one = torch.as_tensor(camera.camera_from_world[2]), torch.ones(len(self.pixel))

        def image(values: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
            out = torch.zeros(camera.height * camera.width, *values.shape[1:], dtype=dtype)
            out[self.pixel] = values.to(dtype)
            return out.view(camera.height, camera.width, *values.shape[1:])

        return PointMap(
            position=image(self.position),
            normal=image(self.normal),
            depth=image(self.position.double() @ row[:3] + row[3]),
            hit=image(one if self.hit is None else self.hit, torch.bool),
            coverage=image(one if self.coverage is None else self.coverage),
            part_weight=image(self.part_weight),
            steps=image(0 * one if self.steps is None else self.steps),
            renderer=renderer,
            counters=counters,
        )
