"""Exact search for the closest triangle of many points at once: bricks of points share their candidates.

Triangle t can be nearest to a point of a brick (centre C, radius r) only if d(C, t) ≤ d(C, mesh) + 2r. Bricks form a
tree of eight children each (a lattice falls into 2³, 4³, 8³ … voxels); every level tests its centres against the
candidates of its parent, the last level tests the points. Distances there are float32 in brick-local coordinates, with
a safe margin; the few triangles left per point are compared in float64. Letters: p points, f faces, k candidates.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from avatarrex.ops.pseudonormal import Pseudonormals
from avatarrex.ops.triangle import THIN, closest_on_triangle

FAN = 8
ROOTS = 64
"""Bricks of the coarsest level, all tested against every triangle."""
PAIRS = 1 << 16
"""Pairs per chunk: its temporaries stay in the cache of a CPU core (CUDA takes 64 times as many)."""
MARGIN = 64 * torch.finfo(torch.float32).eps
"""Bound of the error of a squared float32 distance, in units of the squared extent of brick and candidates."""


def search_bricks(
    mesh: Tensor, faces: Tensor, query: Tensor, normals: Pseudonormals, reach: tuple[float, float] | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Closest face, barycentrics and `skipped` (±1: the side of a point beyond `reach` = (inside, outside), else 0).

    All inputs float64. A skipped point carries the face and barycentrics of its brick's centre.
    """
    face = torch.zeros(len(query), dtype=torch.long, device=query.device)
    barycentric = torch.zeros_like(query)
    skipped = torch.zeros(len(query), dtype=query.dtype, device=query.device)
    if not len(query):
        return face, barycentric, skipped
    corner = mesh[faces]
    table = _Table.of(corner)
    levels = _tree(query)
    lists = _Lists.everything(len(levels[-1].members), len(faces), query.device)
    for level in reversed(levels[1:]):
        lists = _cull(table, level, lists)
        if reach is not None:
            bricks = level.children
            far, near_face, near_weight, side = _beyond(corner, faces, normals, reach, bricks, lists)
            point, brick = bricks.points(far)
            face[point], barycentric[point], skipped[point] = near_face[brick], near_weight[brick], side[brick]
            lists.count[far] = 0
    lists = _cull(table, levels[0], lists)
    points = levels[0].children
    winner, weight = _exact(corner, points.centre, lists.owner, lists.triangle)
    done = lists.count > 0
    face[points.order[done]], barycentric[points.order[done]] = winner[done], weight[done]
    return face, barycentric, skipped


@dataclass(frozen=True)
class _Nodes:
    """Bricks of one level, or the points themselves (radius 0), with the range of sorted points that each holds."""

    low: Tensor
    high: Tensor
    first: Tensor
    last: Tensor
    order: Tensor
    """Point number of each sorted point."""

    @property
    def centre(self) -> Tensor:
        return (self.low + self.high) / 2

    @property
    def radius(self) -> Tensor:
        return (self.high - self.low).norm(dim=-1) / 2

    def points(self, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """Points that lie in the `chosen` (n,) nodes, and the node of each."""
        node = torch.nonzero(chosen)[:, 0]
        count = self.last[node] - self.first[node]
        start = self.first[node] - (count.cumsum(0) - count)
        place = torch.arange(int(count.sum()), device=node.device) + start.repeat_interleave(count)
        return self.order[place], node.repeat_interleave(count)


@dataclass(frozen=True)
class _Level:
    members: Tensor
    """(n, m) child numbers, -1 where a brick has fewer."""
    children: _Nodes
    centre: Tensor
    """(n, 3) of the bricks themselves."""


@dataclass(frozen=True)
class _Lists:
    """Candidates of each node as flat pairs (owner, triangle, float32 squared distance), with first and count."""

    owner: Tensor
    triangle: Tensor
    square: Tensor
    first: Tensor
    count: Tensor
    nearest: Tensor
    """(n,) least squared distance of the node's centre, its error below `margin`."""
    margin: Tensor

    @staticmethod
    def everything(nodes: int, faces: int, device: torch.device) -> _Lists:
        first = torch.zeros(nodes, dtype=torch.long, device=device)
        zero = torch.zeros(nodes, device=device)
        return _Lists(first, torch.arange(faces, device=device), zero, first, first + faces, zero, zero)


@dataclass(frozen=True)
class _Table:
    """What a float32 pair distance needs of each triangle: seven linear functionals, an anchor and three lengths."""

    direction: Tensor
    """(6, f, 3): unit ab, ac, bc; unit normal; gradients of the barycentrics v and w."""
    anchor: Tensor
    """(f, 3) float64, corner a."""
    length: Tensor
    """(3, f)."""
    shift: Tensor
    """(f,): where b lies along bc, seen from a."""
    thin: Tensor
    """(f,): 0, or infinity for a triangle without a normal."""

    @staticmethod
    def of(corner: Tensor) -> _Table:
        a, b, c = corner.unbind(1)
        sides = torch.stack([b - a, c - a, c - b])
        length = sides.norm(dim=-1)
        unit = sides / length.clamp_min(1e-300)[..., None]
        normal = torch.linalg.cross(b - a, c - a)
        area = normal.norm(dim=-1)
        flat = area <= THIN * length.amax(0) ** 2
        scale = torch.where(flat, 1.0, area)[:, None]
        normal = torch.where(flat[:, None], 0.0, normal / scale)
        v = torch.linalg.cross(c - a, normal) / scale
        w = torch.linalg.cross(normal, b - a) / scale
        direction = torch.cat([unit, torch.stack([normal, v, w])])
        shift = (unit[2] * (b - a)).sum(-1)
        thin = torch.where(flat, torch.inf, 0.0)
        return _Table(direction.float(), a, length.float(), shift.float(), thin.float())


def _tree(query: Tensor) -> list[_Level]:
    """Levels from the finest (children: points) to the coarsest (at most `ROOTS` bricks)."""
    low, extent = query.amin(0), query.amax(0) - query.amin(0)
    side = float(extent.max()) / len(query) ** (1 / 3) or 1.0
    for _ in range(20):  # the spacing of a full lattice is the fixed point
        side = float((extent + side).prod() / len(query)) ** (1 / 3)
    side = max(side, float(extent.max()) * 2.0**-19, 1e-12)
    cell = ((query - low) / side + 0.5).long()
    key = _spread(cell[:, 0]) | (_spread(cell[:, 1]) << 1) | (_spread(cell[:, 2]) << 2)
    key, order = key.sort()
    number = torch.arange(len(query), device=query.device)
    nodes = _Nodes(query[order], query[order], number, number + 1, order)
    levels: list[_Level] = []
    while not levels or len(levels[-1].members) > ROOTS:
        members, key = _group(key >> 3)
        filled = torch.where(members >= 0, members, members[:, :1])
        bricks = _Nodes(
            nodes.low[filled].amin(1),
            nodes.high[filled].amax(1),
            nodes.first[members[:, 0]],
            nodes.last[members.amax(1)],
            order,
        )
        levels.append(_Level(members, nodes, bricks.centre))
        nodes = bricks
    return levels


def _group(key: Tensor) -> tuple[Tensor, Tensor]:
    """Sorted keys to groups of at most `FAN` equal ones: members (n, FAN) with -1, and each group's key."""
    _, count = torch.unique_consecutive(key, return_counts=True)
    first = count.cumsum(0) - count
    number = torch.arange(len(key), device=key.device)
    rank = number - first.repeat_interleave(count)
    starts = rank % FAN == 0
    group = starts.cumsum(0) - 1
    members = torch.full((int(group[-1]) + 1, FAN), -1, device=key.device)
    members[group, rank % FAN] = number
    return members, key[starts]


def _spread(x: Tensor) -> Tensor:
    """Insert two zero bits between the 20 low bits: one axis of a Morton code."""
    for shift, mask in ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F)):
        x = (x | (x << shift)) & mask
    x = (x | (x << 4)) & 0x10C30C30C30C30C3
    return (x | (x << 2)) & 0x1249249249249249


def _cull(table: _Table, level: _Level, lists: _Lists) -> _Lists:
    """Keep for each child the triangles that can be nearest to one of its points."""
    budget = PAIRS * (64 if lists.triangle.is_cuda else 1)
    nodes = len(level.children.low)
    nearest, margin = torch.zeros(2, nodes, device=lists.first.device)
    busy = torch.nonzero(lists.count > 0)[:, 0]
    busy = busy[lists.count[busy].argsort()]
    sizes = lists.count[busy].tolist()
    owner, triangle, square = [], [], []
    end = len(busy)
    while end > 0:
        start = max(0, end - max(1, budget // (level.members.shape[1] * sizes[end - 1])))
        chunk = _cull_chunk(table, level, lists, busy[start:end], sizes[end - 1], nearest, margin)
        for column, values in zip((owner, triangle, square), chunk):
            column.append(values)
        end = start
    if not owner:
        empty = torch.zeros(nodes, dtype=torch.long, device=lists.first.device)
        return _Lists(lists.owner[:0], lists.triangle[:0], lists.square[:0], empty, empty, nearest, margin)
    owners = torch.cat(owner)
    # Owners come in runs: the pairs of a chunk are ordered by (brick, child).
    run, length = torch.unique_consecutive(owners, return_counts=True)
    first, count = torch.zeros(2, nodes, dtype=torch.long, device=owners.device)
    first[run], count[run] = length.cumsum(0) - length, length
    return _Lists(owners, torch.cat(triangle), torch.cat(square), first, count, nearest, margin)


def _cull_chunk(
    table: _Table, level: _Level, lists: _Lists, rows: Tensor, size: int, nearest: Tensor, margin: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Pairs kept for the children of bricks `rows`; fills their `nearest` and `margin`."""
    slot = torch.arange(size, device=rows.device)
    present = slot < lists.count[rows, None]
    candidate = lists.triangle[lists.first[rows, None] + torch.where(present, slot, 0)]
    members = level.members[rows]
    real = members >= 0
    member = torch.where(real, members, members[:, :1])
    origin = level.centre[rows]
    local = (level.children.centre[member] - origin[:, None]).float()
    anchor = (origin[:, None] - table.anchor[candidate]).float()
    square = _square_distances(table, candidate, local, anchor)
    square.masked_fill_(~present[:, None], torch.inf)
    extent = (
        anchor.square().sum(-1).amax(1) + local.square().sum(-1).amax(1) + table.length[:, candidate].amax((0, 2)) ** 2
    )
    error = (MARGIN * extent)[:, None].expand_as(member)
    least = square.amin(-1)
    nearest[member], margin[member] = least, error
    radius = level.children.radius[member].float() * (1 + 1e-5)
    limit = ((least + error).sqrt() + 2 * radius).square() + error
    brick, child, column = ((square <= limit[..., None]) & real[..., None]).nonzero(as_tuple=True)
    return members[brick, child], candidate[brick, column], square[brick, child, column]


def _square_distances(table: _Table, candidate: Tensor, local: Tensor, anchor: Tensor) -> Tensor:
    """(b, m, k) squared distances of b·m local points to their brick's k candidates, error below MARGIN·extent²."""
    direction = torch.cat([table.direction[:, candidate], 2 * anchor[None]])
    offset = (direction * anchor).sum(-1)
    offset[2] -= table.shift[candidate]
    offset[6] *= 0.5
    count, bricks, size, _ = direction.shape
    value = torch.baddbmm(
        offset.reshape(count * bricks, 1, size),
        local[None].expand(count, -1, -1, -1).reshape(count * bricks, -1, 3),
        direction.reshape(count * bricks, size, 3).transpose(1, 2),
    ).reshape(count, bricks, -1, size)
    ab, ac, bc, height, v, w, from_a = value
    from_a = from_a + local.square().sum(-1, keepdim=True)
    lengths = table.length[:, candidate][:, :, None]
    from_b = from_a - lengths[0] * (2 * ab - lengths[0])
    best = from_a + _along(ab, lengths[0])
    best = torch.minimum(best, from_a + _along(ac, lengths[1]))
    best = torch.minimum(best, from_b + _along(bc, lengths[2]))
    inside = torch.minimum(torch.minimum(v, w), 1 - v - w) >= 0
    plane = height.square() + table.thin[candidate][:, None]
    return torch.where(inside, torch.minimum(plane, best), best).clamp_min(0)


def _along(t: Tensor, length: Tensor) -> Tensor:
    """|p − segment|² − |p − start|² for the coordinate t along the unit direction."""
    clamped = torch.minimum(t, length).clamp_min(0)
    return clamped * (clamped - 2 * t)


def _exact(corner: Tensor, query: Tensor, owner: Tensor, triangle: Tensor) -> tuple[Tensor, Tensor]:
    """The float64 winner among (owner, triangle) pairs: face and barycentrics per owner."""
    square, weight = closest_on_triangle(query[owner], *corner[triangle].unbind(1))
    best = torch.full((len(query),), torch.inf, dtype=square.dtype, device=square.device)
    best.scatter_reduce_(0, owner, square, "amin")
    won = torch.nonzero(square == best[owner])[:, 0]
    pick = torch.zeros(len(query), dtype=torch.long, device=owner.device)
    pick[owner[won]] = won
    return triangle[pick], weight[pick]


def _beyond(
    corner: Tensor, faces: Tensor, normals: Pseudonormals, reach: tuple[float, float], bricks: _Nodes, lists: _Lists
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Bricks wholly beyond `reach`, with face, barycentrics and side (±1) of every such brick's centre.

    No surface crosses a brick whose centre is farther than its radius, so that one side holds for all its points.
    """
    clearance = lists.nearest.double().sqrt() - lists.margin.double().sqrt() - bricks.radius
    far = (lists.count > 0) & (clearance > min(reach))
    pair = torch.nonzero(far[lists.owner] & (lists.square <= (lists.nearest + 2 * lists.margin)[lists.owner]))[:, 0]
    face = torch.zeros(len(far), dtype=torch.long, device=far.device)
    weight = torch.zeros(len(far), 3, dtype=corner.dtype, device=far.device)
    side = torch.ones(len(far), dtype=corner.dtype, device=far.device)
    if len(pair):
        found, share = _exact(corner, bricks.centre, lists.owner[pair], lists.triangle[pair])
        face[far], weight[far] = found[far], share[far]
        nearest = (corner[face] * weight[..., None]).sum(1)
        outward = normals.at(faces, face, weight)
        side = torch.where(((bricks.centre - nearest) * outward).sum(-1) >= 0, 1.0, -1.0).to(corner.dtype)
        allowed = torch.where(side > 0, reach[1], reach[0])
        far &= (clearance > allowed) & ~normals.unsure(faces, face, weight)
    return far, face, weight, side
