"""The raycast in float64 by walking every cell: what the fast ones are judged by. Small images only.

Along a ray a trilinear cell is a cubic in t, so its first outside-to-inside crossing is found from the cubic's monotone
pieces; no step length, no assumption on the field's slope. Inside part boxes, where the composed field is a product of
two trilinear ones cut at the band (eq. 13), each piece between cell faces is sampled nine times and bisected.

Letters: r rays, i intervals between cell faces. Root frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.pointmap.point_map import CoveredPixels, PointMap
from avatarrex.pointmap.rays import RayPlane, Rays, pixel_centres, slab
from avatarrex.volume.sdf_volume import SdfVolume, sample

CHUNK_RAYS = 2048
"""Rays at a time: the cell faces of 2048 rays take 25 MB."""
PIECES = 8
"""Samples per piece inside boxes: 0.6 mm at 5 mm, dips of a surface with 5 mm radius are seen from 9e-6 m."""
BISECTIONS = 48
"""Halvings of at most 35 mm: 1e-16 m."""


def raycast_reference(volume: SdfVolume, camera: Camera, antialias: bool, march: str) -> PointMap:
    """See `avatarrex.pointmap.raycast.raycast`; always exact, and the coverage is the centre's."""
    plane = RayPlane.of(camera, volume.middle)
    rays = plane.rays(pixel_centres(camera, torch.float64))
    t = first_crossing(volume, rays)
    pixel = torch.nonzero(t.isfinite())[:, 0]
    position = rays[pixel].at(t[pixel])
    covered = CoveredPixels(pixel, position, *surface(volume, position))
    return covered.scatter(camera, "float64 reference", {"rays": len(t), "ray_steps": 0})


def surface(volume: SdfVolume, position: Float[Tensor, "p 3"]) -> tuple[Float[Tensor, "p 3"], Float[Tensor, "p 3"]]:
    """Unit normals by central differences half a local voxel apart, and effective ω."""
    here = sample(volume, position)
    slope = torch.zeros_like(position)
    for axis in range(3):
        offset = torch.zeros_like(position)
        offset[:, axis] = 0.5 * here.scale
        slope[:, axis] = sample(volume, position + offset).composed.sdf - sample(volume, position - offset).composed.sdf
    return torch.nn.functional.normalize(slope, dim=-1), here.composed.part_weight


def first_crossing(volume: SdfVolume, rays: Rays) -> Float[Tensor, " r"]:
    """t of the first crossing from s ≥ 0 to s < 0 on each ray, +inf where there is none."""
    signs = _cell_signs(volume)
    chunks = torch.arange(len(rays.camera)).split(CHUNK_RAYS)
    return torch.cat([_first_crossing(volume, rays[rows], signs) for rows in chunks])


def _first_crossing(volume: SdfVolume, rays: Rays, signs: Tensor) -> Tensor:
    t, in_box = _pieces(volume, rays)
    start, end = t[:, :-1], t[:, 1:]
    row, piece = torch.nonzero(end > start, as_tuple=True)
    start, end, in_box = start[row, piece], end[row, piece], in_box[row, piece]
    sign = _signs_at(volume, signs, rays[row].at((start + end) / 2))
    sign[in_box] = 0
    first = torch.full((len(row),), torch.inf, dtype=t.dtype)
    value = torch.stack([sign, sign], 1).double()
    for rows, crossing in (
        (torch.nonzero((sign == 0) & ~in_box)[:, 0], _cubic_crossing),
        (torch.nonzero(in_box)[:, 0], _sampled_crossing),
    ):
        first[rows], value[rows] = crossing(volume, rays[row[rows]], start[rows], end[rows])
    # A jump between two pieces, at the border of a box.
    jump = (row[1:] == row[:-1]) & (value[:-1, 1] >= 0) & (value[1:, 0] < 0)
    first[1:][jump] = start[1:][jump]
    return torch.full_like(t[:, 0], torch.inf).scatter_reduce(0, row, first, "amin")


def _pieces(volume: SdfVolume, rays: Rays) -> tuple[Tensor, Tensor]:
    """Sorted t of all cell faces (r, i + 1) in any box, and whether a piece (r, i) lies in a part box."""
    grid = volume.body
    body = torch.eye(4, dtype=torch.float64)
    body[:3, 3] = -torch.as_tensor(grid.origin)
    side = grid.bricks.side if grid.bricks else 1
    lattices = [(body, grid.voxel / side, tuple((n - 1) * side + 1 for n in grid.sdf.shape))]
    lattices += [(torch.as_tensor(p.box_from_root), p.voxel, tuple(p.field.shape[:3])) for p in volume.parts]
    faces, spans = [], []
    for matrix, voxel, shape in lattices:
        origin = (rays.origin @ matrix[:3, :3].T + matrix[:3, 3]) / voxel
        direction = rays.direction @ matrix[:3, :3].T / voxel
        direction = torch.where(direction.abs() < 1e-15, 1e-15, direction)
        size = torch.tensor(shape).flip(0).double() - 1
        entry, exit = slab(origin, direction, size)
        missed = (entry > exit) | (exit < rays.camera)
        entry, exit = entry.maximum(rays.camera).masked_fill(missed, torch.inf), exit.masked_fill(missed, -torch.inf)
        spans.append((entry, exit))
        for axis in range(3):
            plane = torch.arange(shape[2 - axis], dtype=torch.float64)
            at = (plane - origin[:, axis, None]) / direction[:, axis, None]
            faces.append(at.maximum(entry[:, None]).minimum(exit[:, None]))
        faces.append(torch.stack([entry, exit], 1))
    start = torch.stack([entry for entry, _ in spans]).amin(0)[:, None]
    end = torch.stack([exit for _, exit in spans]).amax(0)[:, None]
    t = torch.cat(faces, 1).maximum(start).minimum(end).sort(1).values
    middle = (t[:, 1:] + t[:, :-1]) / 2
    in_box = torch.zeros_like(middle, dtype=torch.bool)
    for entry, exit in spans[1:]:
        in_box |= (middle >= entry[:, None]) & (middle <= exit[:, None])
    return torch.where(start <= end, t, 0.0), in_box


def _cell_signs(volume: SdfVolume) -> Tensor:
    """+1 where all eight corners of a body cell are outside, −1 where all are inside, 0 where they differ or a brick is."""
    inside = (volume.body.sdf < 0)[None, None].float()
    if min(volume.body.sdf.shape) < 2:
        return torch.zeros(volume.body.sdf.shape, dtype=torch.int8)
    share = torch.nn.functional.avg_pool3d(inside, 2, 1)[0, 0]
    signs = (share == 0).to(torch.int8) - (share == 1).to(torch.int8)
    if volume.body.bricks is not None:
        signs[volume.body.bricks.number > 0] = 0
    return signs


def _signs_at(volume: SdfVolume, signs: Tensor, position: Tensor) -> Tensor:
    place = ((position - torch.as_tensor(volume.body.origin)) / volume.body.voxel).floor().long()
    x, y, z = place.clamp(min=0).minimum(torch.tensor(signs.shape).flip(0) - 1).unbind(1)
    return signs[z, y, x]


def _field(volume: SdfVolume, rays: Rays, t: Tensor) -> Tensor:
    return sample(volume, rays.at(t)).composed.sdf


def _cubic_crossing(volume: SdfVolume, rays: Rays, start: Tensor, end: Tensor) -> tuple[Tensor, Tensor]:
    """First crossing in a body cell, from the exact cubic; and the values (·, 2) at both ends."""
    # The ends are taken a hair inside: beside a brick the field jumps.
    u = torch.tensor([1e-9, 1 / 3, 2 / 3, 1 - 1e-9], dtype=start.dtype)
    f = torch.stack([_field(volume, rays, start + k * (end - start)) for k in u], 1)
    c = f @ torch.linalg.inv(torch.stack([u**k for k in range(4)])).to(f)
    root = (c[:, 2] ** 2 - 3 * c[:, 1] * c[:, 3]).clamp(min=0).sqrt()
    q = -(c[:, 2] + torch.where(c[:, 2] >= 0, root, -root))
    tiny = torch.finfo(f.dtype).tiny
    turns = torch.stack([q / (3 * c[:, 3] + tiny), c[:, 1] / (q + tiny)], 1).nan_to_num(0.0).clamp(0, 1)
    knots = torch.cat([torch.zeros_like(turns[:, :1]), turns.sort(1).values, torch.ones_like(turns[:, :1])], 1)

    def cubic(u: Tensor) -> Tensor:
        value: Tensor = ((c[:, 3] * u + c[:, 2]) * u + c[:, 1]) * u + c[:, 0]
        return value

    first = torch.full_like(start, torch.inf)
    for k in (2, 1, 0):
        first = torch.where(*_bisect(cubic, knots[:, k], knots[:, k + 1]), first)
    return start + first * (end - start), f[:, [0, 3]]


def _sampled_crossing(volume: SdfVolume, rays: Rays, start: Tensor, end: Tensor) -> tuple[Tensor, Tensor]:
    """First crossing in a piece inside a part box, from nine samples; and the values (·, 2) at both ends."""
    u = torch.linspace(0, 1, PIECES + 1, dtype=start.dtype)
    # The ends are taken a hair inside: at a box's border the field jumps.
    u[0], u[-1] = 1e-9, 1 - 1e-9
    f = torch.stack([_field(volume, rays, start + k * (end - start)) for k in u], 1)
    falls = (f[:, :-1] >= 0) & (f[:, 1:] < 0)
    rows = torch.nonzero(falls.any(1))[:, 0]
    place = falls[rows].int().argmax(1)
    first = torch.full_like(start, torch.inf)
    length = (end - start)[rows]

    def along(u: Tensor) -> Tensor:
        return _field(volume, rays[rows], start[rows] + u * length)

    if len(rows):
        first[rows] = start[rows] + _bisect(along, u[place], u[place + 1])[1] * length
    return first, f[:, [0, -1]]


def _bisect(f: Callable[[Tensor], Tensor], low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """Where f falls from ≥ 0 at `low` to < 0 at `high`: whether it does, and the place."""
    falls = (f(low) >= 0) & (f(high) < 0)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        outside = f(middle) >= 0
        low, high = torch.where(outside, middle, low), torch.where(outside, high, middle)
    return falls, (low + high) / 2
