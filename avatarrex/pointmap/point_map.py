"""Point map: where each pixel's ray first meets the avatar (paper sec. 4, Step II).

Letters: h w image rows and columns, p covered pixels, k parts. Root frame, metres; the SDF is negative inside.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.ops import native
from avatarrex.ops.finite import require_finite
from avatarrex.pointmap import image_loops
from avatarrex.pointmap.occlusion_edges import OcclusionEdges


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
    edges: OcclusionEdges = field(default_factory=OcclusionEdges.none)
    """Pixels that show a farther or nearer sheet of the surface, too."""

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
    """What a ray caster knows of the pixels that the avatar covers, those of no coverage left out; a hit through the pixel's centre
    unless told."""

    pixel: Int[Tensor, " p"]
    """Row · width + column."""
    position: Float[Tensor, "p 3"]
    normal: Float[Tensor, "p 3"]
    part_weight: Float[Tensor, "p k"]
    hit: Bool[Tensor, " p"] | None = None
    coverage: Float[Tensor, " p"] | None = None
    steps: Float[Tensor, " p"] | None = None
    edges: OcclusionEdges = field(default_factory=OcclusionEdges.none)

    def scatter(self, camera: Camera, renderer: str, counters: dict[str, int], impl: str = "auto") -> PointMap:
        """The images; depth is taken in float64. `impl`: `auto` (compiled loops, for float32), `torch`."""
        one = torch.ones(len(self.pixel))
        hit = one.bool() if self.hit is None else self.hit
        coverage = one if self.coverage is None else self.coverage
        steps = 0 * one if self.steps is None else self.steps
        rows = self.position, self.normal, self.part_weight, hit, coverage, steps
        serves = native.serves(*(values for values in rows if values is not hit))
        lay = _compiled if impl == "auto" and serves else _scattered
        position, normal, part_weight, hit, coverage, steps, depth = lay(self.pixel, rows, camera)
        return PointMap(
            position, normal, depth, hit, coverage, part_weight, steps, renderer, counters, None, self.edges
        )


def _compiled(pixel: Tensor, rows: tuple[Tensor, ...], camera: Camera) -> tuple[Tensor, ...]:
    """The images of `rows`, and depth, by compiled loops."""
    height, width = camera.height, camera.width
    at, shown = np.full(height * width, -1, np.int32), np.flatnonzero(rows[4].numpy() > 0)
    at[pixel.numpy()[shown]] = shown
    out = [torch.empty(height * width, *values.shape[1:], dtype=values.dtype) for values in (*rows, rows[4])]
    covered = image_loops.CoveredRows(*(values.detach().numpy() for values in rows))
    images = image_loops.Images(*(image.numpy() for image in out))
    axis = np.ascontiguousarray(camera.camera_from_world[2], np.float64)
    native.spread(image_loops.scatter, len(at), at, covered, axis, images)
    return tuple(image.view(height, width, *image.shape[1:]) for image in out)


def _scattered(pixel: Tensor, rows: tuple[Tensor, ...], camera: Camera) -> tuple[Tensor, ...]:
    """The same by torch operations, of any type."""
    axis, shown = torch.as_tensor(camera.camera_from_world[2]), rows[4] > 0
    pixel, rows = pixel[shown], tuple(values[shown] for values in rows)

    def image(values: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        out = torch.zeros(camera.height * camera.width, *values.shape[1:], dtype=dtype)
        out[pixel] = values.to(dtype)
        return out.view(camera.height, camera.width, *values.shape[1:])

    depth = rows[0].double() @ axis[:3] + axis[3]
    return tuple(image(values, torch.bool if values is rows[3] else torch.float32) for values in (*rows, depth))
