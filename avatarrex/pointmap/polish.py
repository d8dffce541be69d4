"""Hit points moved along their rays onto the exact composed field: what the stored voxels blur, put right where it is seen.

A ray met the stored volume at p with normal n. Along it the exact field falls at about n·d, so that the first step is
Newton's, −s(p)/(n·d); later ones are secants through the last two points tried. A step that does not lower |s| is not
taken, and no point leaves the interval of one local voxel around p. A last step costs no evaluation: the root of the
last secant where it has converged. Normals stay the volume's.

Letters: p covered pixels, h w image, s samples. Root frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.fields.composition import WHOLE, Composed
from avatarrex.pointmap.point_map import PointMap
from avatarrex.templates.parts import PARTS
from avatarrex.volume.sdf_volume import SdfVolume

Field = Callable[[Tensor], Composed]
SETTLED = 1e-4
"""Metres of |s| from which the slope at hand is trusted: a step leaves some 3 % of it (docs/accuracy.md)."""
CONVERGED = 1e-3
"""Metres of |s| from which a secant is trusted whose last step has halved |s| at least."""
STEEPEST, FLATTEST = -1.5, -0.2
"""Bounds of the field's slope along a ray: a grazing ray must not be thrown a voxel away by a tenth of a millimetre."""
REFERENCE_SPACING = 2.5e-4
"""Metres between the reference's samples."""
HALVINGS = 15
"""Of `REFERENCE_SPACING`: 8e-9 m."""


@torch.no_grad()
def polish(
    pointmap: PointMap, field: Field, volume: SdfVolume, view: Camera, steps: int, counters: Counters
) -> PointMap:
    """`pointmap` of `volume` seen by the root-frame camera `view`, its covered points taken onto `field`.

    At most `steps` evaluations follow the first; a point moves by at most the local voxel, and position, depth, part
    weights and side change.
    """
    covered = pointmap.coverage > 0
    start = pointmap.position[covered]
    if not len(start):
        return pointmap
    direction = normalize(start - torch.as_tensor(view.centre).to(start), dim=-1)
    along = (pointmap.normal[covered] * direction).sum(-1)
    moved, found = descend(field, start, direction, along, reach(volume, pointmap.part_weight[covered]), steps)
    counters.add("hits_polished", len(start))
    position, part_weight, depth = pointmap.position.clone(), pointmap.part_weight.clone(), pointmap.depth.clone()
    position[covered] = start + moved[:, None] * direction
    part_weight[covered] = found.part_weight
    side = torch.full_like(pointmap.hit, WHOLE, dtype=torch.int64)
    if found.side is not None:
        side[covered] = found.side
    row = torch.as_tensor(view.camera_from_world[2])
    depth[covered] = (position[covered].double() @ row[:3] + row[3]).to(depth)
    return replace(pointmap, position=position, depth=depth, part_weight=part_weight, side=side)


def descend(
    field: Field,
    start: Float[Tensor, "p 3"],
    direction: Float[Tensor, "p 3"],
    along: Float[Tensor, " p"],
    bound: Float[Tensor, " p"],
    steps: int,
) -> tuple[Float[Tensor, " p"], Composed]:
    """How far to move each point along its unit `direction`, |move| ≤ `bound`, and the field at the best point tried.

    `along` is the guessed slope of the field along the ray. Points with |s| below `SETTLED` are not evaluated again.
    """
    here = field(start)
    share, fall = here.part_weight, along.clamp(STEEPEST, FLATTEST)
    side = torch.full_like(start[:, 0], WHOLE, dtype=torch.int64) if here.side is None else here.side
    tried, value = torch.zeros_like(fall), here.sdf.clone()
    best, least = tried.clone(), value.clone()
    for _ in range(steps):
        proposed = _within(bound, tried - value / fall)
        rows = torch.nonzero((least.abs() > SETTLED) & (proposed != tried))[:, 0]
        there = field(start[rows] + proposed[rows, None] * direction[rows])
        fall[rows] = ((there.sdf - value[rows]) / (proposed[rows] - tried[rows])).clamp(STEEPEST, FLATTEST)
        tried[rows], value[rows] = proposed[rows], there.sdf
        lower = there.sdf.abs() < least[rows].abs()
        better = rows[lower]
        best[better], least[better], share[better] = tried[better], value[better], there.part_weight[lower]
        side[better] = WHOLE if there.side is None else there.side[lower]
    converged = (tried == best) & (least.abs() <= (here.sdf.abs() / 2).clamp(SETTLED, CONVERGED))
    return torch.where(converged, _within(bound, best - least / fall), best), Composed(least, share, side)


def descend_reference(
    field: Field, start: Float[Tensor, "p 3"], direction: Float[Tensor, "p 3"], bound: Float[Tensor, " p"]
) -> Float[Tensor, " p"]:
    """The root that `descend` looks for: the nearest fall of the field through zero within `bound`; NaN without one."""
    half = int(bound.max() / REFERENCE_SPACING) + 1
    t = REFERENCE_SPACING * torch.arange(-half, half + 1).to(start)
    value = torch.stack([field(start + at * direction).sdf for at in t], 1)
    falls = (value[:, :-1] >= 0) & (value[:, 1:] < 0) & (t[1:].abs() <= bound[:, None])
    distance = torch.where(falls, ((t[:-1] + t[1:]) / 2).abs(), torch.inf)
    low = t[distance.argmin(1)]
    high = low + REFERENCE_SPACING
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        outside = field(start + middle[:, None] * direction).sdf >= 0
        low, high = torch.where(outside, middle, low), torch.where(outside, high, middle)
    return torch.where(falls.any(1), (low + high) / 2, torch.nan)


def reach(volume: SdfVolume, part_weight: Float[Tensor, "p k"]) -> Float[Tensor, " p"]:
    """Side of the voxels that made each hit, metres: body voxels and part voxels mixed by ω."""
    side = torch.full_like(part_weight[:, 0], volume.body.voxel)
    for part in volume.parts:
        side = side + part_weight[:, PARTS.index(part.name)] * (part.voxel - volume.body.voxel)
    return side


def _within(bound: Tensor, move: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(move, -bound), bound)
