"""Exact search for the closest triangle of many points at once: bricks of points share their candidates.

Triangle t can be nearest to a point of a brick (centre C, radius r) only if d(C, t) ≤ d(C, mesh) + 2r. Bricks form a
tree of eight children each (a lattice falls into 2³, 4³, 8³ … voxels); every level tests its centres against the
candidates of its parent, the last level tests the points. Few points, or points too sparse to share candidates, are tested
against every triangle at once. A triangle lies in a disc: the smallest circle around it, its
centre m a point of the triangle, radius ρ, in its plane. With height h and lateral distance l of C from m,

    h² + max(l − ρ, 0)² ≤ d(C, t)² ≤ |C − m|².

These tests are float32 with a safe margin; the triangles left per point are compared exactly, in float64.
Letters: b bricks, m children, k candidates, p points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor, nn

from avatarrex.ops.pseudonormal import Pseudonormals
from avatarrex.ops.triangle import closest_on_triangle

FAN = 8
ROOTS = 64
"""Bricks of the coarsest level, all tested against every triangle."""
FEW = 500
"""Points that are not worth a tree."""
SPARSE, MANY = 1 / 8, 5000
"""Nor are points, up to so many, that lie farther apart than this share of the mesh's extent (2000 about a hand: half the
time)."""
ROW = 64
"""Points of one such test."""
PAIRS = 1 << 16
"""Pairs per chunk: its temporaries stay in the cache of a CPU core (CUDA takes 64 times as many)."""
MARGIN = 64 * torch.finfo(torch.float32).eps
"""Bound of the error of a squared float32 distance, in units of squared extents."""


def search_bricks(
    mesh: Tensor,
    faces: Tensor,
    query: Tensor,
    normals: Pseudonormals,
    reach: tuple[float, float] | None,
    culled: bool = False,
) -> tuple[Tensor, Tensor, Tensor]:
    """Closest face, barycentrics and `skipped` (±1: the side of a point beyond `reach` = (inside, outside), else 0).

    All inputs float64; `culled`: by a tree, however few the points. A skipped point carries the face and barycentrics of
    its brick's centre.
    """
    face = torch.zeros(len(query), dtype=torch.long, device=query.device)
    barycentric = torch.zeros_like(query)
    skipped = torch.zeros(len(query), dtype=query.dtype, device=query.device)
    if not len(query):
        return face, barycentric, skipped
    middle = (mesh.amin(0) + mesh.amax(0)) / 2
    corner, query = mesh[faces] - middle, query - middle
    discs = _discs(corner)
    levels = _tree(query, None if culled else SPARSE * float((mesh.amax(0) - mesh.amin(0)).amax()))
    lists = _Lists.everything(len(levels[-1].members), len(faces), query.device)
    for level in reversed(levels[1:]):
        lists = _cull(discs, level, lists)
        if reach is not None:
            bricks = level.children
            far, near_face, near_weight, side = _beyond(corner, faces, normals, reach, bricks, lists)
            point, brick = bricks.points(far)
            face[point], barycentric[point], skipped[point] = near_face[brick], near_weight[brick], side[brick]
            lists.count[far] = 0
    lists = _cull(discs, levels[0], lists)
    points = levels[0].children
    done = lists.count > 0
    if not done.any():
        return face, barycentric, skipped
    owner, place = lists.pairs(done)
    winner, weight = _exact(corner, points.centre, owner, lists.triangle[place])
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

    @cached_property
    def centre(self) -> Tensor:
        return (self.low + self.high) / 2

    @cached_property
    def radius(self) -> Tensor:
        return (self.high - self.low).norm(dim=-1) / 2

    def points(self, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """Points that lie in the `chosen` (n,) nodes, and the node of each."""
        node, place = _runs(torch.nonzero(chosen)[:, 0], self.first, self.last - self.first)
        return self.order[place], node


@dataclass(frozen=True)
class _Level:
    members: Tensor
    """(n, m) child numbers, -1 where a brick has fewer."""
    children: _Nodes
    centre: Tensor
    """(n, 3) of the bricks themselves."""


@dataclass(frozen=True)
class _Lists:
    """Candidates of each node as a run of flat pairs (triangle, lower bound of the node centre's squared distance)."""

    triangle: Tensor
    lower: Tensor
    first: Tensor
    """(n,) start and length of each node's run."""
    count: Tensor
    nearest: Tensor
    """(n,) upper bound of the centre's squared distance to the mesh. All bounds err by less than `margin`."""
    margin: Tensor

    @staticmethod
    def everything(nodes: int, faces: int, device: torch.device) -> _Lists:
        first = torch.zeros(nodes, dtype=torch.long, device=device)
        zero = torch.zeros(nodes, device=device)
        return _Lists(torch.arange(faces, device=device), zero, first, first + faces, zero, zero)

    def pairs(self, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """Node and place in the flat arrays of every pair of the `chosen` (n,) nodes."""
        return _runs(torch.nonzero(chosen)[:, 0], self.first, self.count)


def _runs(node: Tensor, first: Tensor, count: Tensor) -> tuple[Tensor, Tensor]:
    """The node and the index of each member of the runs [first, first + count) of nodes `node`."""
    length = count[node]
    shift = first[node] - (length.cumsum(0) - length)
    place = torch.arange(int(length.sum()), device=node.device) + shift.repeat_interleave(length)
    return node.repeat_interleave(length), place


def _discs(corner: Tensor) -> Tensor:
    """(f, 8) float32: centre, radius, unit normal of the disc around each triangle; no normal makes it a ball."""
    a, b, c = corner.unbind(1)
    opposite = torch.stack([c - b, a - c, b - a], 1).square().sum(-1)
    weight = opposite * (opposite.sum(1, keepdim=True) - 2 * opposite)
    # An obtuse corner (weight ≤ 0) leaves the longest side as the diameter.
    obtuse = (weight <= 0).any(1, keepdim=True)
    half = (1 - nn.functional.one_hot(opposite.argmax(1), 3)) / 2
    weight = torch.where(obtuse, half.to(corner.dtype), weight)
    centre = (corner * (weight / weight.sum(1, keepdim=True))[..., None]).sum(1)
    radius = (corner - centre[:, None]).norm(dim=-1).amax(1)
    normal = nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=-1, eps=1e-300)
    return torch.cat([centre, radius[:, None], normal, torch.zeros_like(centre[:, :1])], 1).float()


def _tree(query: Tensor, sparse: float | None) -> list[_Level]:
    """Levels from the finest (children: points) to the coarsest (at most `ROOTS` bricks).

    One level for few points, and for points whose spacing exceeds `sparse` metres, unless that is None.
    """
    low, extent = query.amin(0), query.amax(0) - query.amin(0)
    side = float(extent.max()) / len(query) ** (1 / 3) or 1.0
    for _ in range(20):  # the spacing of a full lattice is the fixed point
        side = float((extent + side).prod() / len(query)) ** (1 / 3)
    flat = sparse is not None and (len(query) <= FEW or (side > sparse and len(query) <= MANY))
    side = max(side, float(extent.max()) * 2.0**-19, 1e-12)
    cell = ((query - low) / side + 0.5).long()
    key, order = morton(cell).sort()
    number = torch.arange(len(query), device=query.device)
    nodes = _Nodes(query[order], query[order], number, number + 1, order)
    levels: list[_Level] = []
    while not levels or not (flat or len(levels[-1].members) <= ROOTS):
        members, key = (_rows(number), key) if flat else _group(key >> 3)
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


def _rows(number: Tensor) -> Tensor:
    """(n, ROW) of the sorted points in turn, -1 where the last row has fewer."""
    return nn.functional.pad(number, (0, -len(number) % ROW), value=-1).unflatten(0, (-1, ROW))


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


def morton(cell: Tensor) -> Tensor:
    """(n,) the order of cells (n, 3), 20 bits an axis, in which those that are adjacent stay close."""
    return _spread(cell[:, 0]) | (_spread(cell[:, 1]) << 1) | (_spread(cell[:, 2]) << 2)


def _spread(x: Tensor) -> Tensor:
    """Insert two zero bits between the 20 low bits: one axis of a Morton code."""
    for shift, mask in ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F)):
        x = (x | (x << shift)) & mask
    x = (x | (x << 4)) & 0x10C30C30C30C30C3
    return (x | (x << 2)) & 0x1249249249249249


def _cull(discs: Tensor, level: _Level, lists: _Lists) -> _Lists:
    """Keep for each child the triangles that can be nearest to one of its points."""
    budget = PAIRS * (64 if lists.triangle.is_cuda else 1)
    nodes = len(level.children.low)
    first, count = torch.zeros(2, nodes, dtype=torch.long, device=lists.first.device)
    nearest, margin = torch.zeros(2, nodes, device=lists.first.device)
    busy = torch.nonzero(lists.count > 0)[:, 0]
    busy = busy[lists.count[busy].argsort()]
    sizes = lists.count[busy].tolist()
    triangle, lower = [lists.triangle[:0]], [lists.lower[:0]]
    end, total = len(busy), 0
    while end > 0:
        start = max(0, end - max(1, budget // (level.members.shape[1] * sizes[end - 1])))
        kept = _cull_chunk(discs, level, lists, busy[start:end], sizes[end - 1])
        node, kept_count = kept.node, kept.count
        first[node] = total + kept_count.cumsum(0) - kept_count
        count[node], nearest[node], margin[node] = kept_count, kept.nearest, kept.margin
        triangle.append(kept.triangle)
        lower.append(kept.lower)
        total += len(kept.triangle)
        end = start
    return _Lists(torch.cat(triangle), torch.cat(lower), first, count, nearest, margin)


@dataclass(frozen=True)
class _Kept:
    """What a chunk of bricks leaves for their children `node`."""

    node: Tensor
    count: Tensor
    nearest: Tensor
    margin: Tensor
    triangle: Tensor
    lower: Tensor


def _cull_chunk(discs: Tensor, level: _Level, lists: _Lists, rows: Tensor, size: int) -> _Kept:
    """Test the children of bricks `rows`, all with at most `size` candidates, against these candidates."""
    slot = torch.arange(size, device=rows.device)
    present = slot < lists.count[rows, None]
    place = lists.first[rows, None] + slot.masked_fill(~present, 0)
    candidate = lists.triangle.index_select(0, place.reshape(-1)).reshape(place.shape)
    members = level.members[rows]
    real = members >= 0
    member = torch.where(real, members, members[:, :1])
    origin = level.centre[rows]
    local = (level.children.centre[member] - origin[:, None]).float()
    disc = discs.index_select(0, candidate.reshape(-1)).reshape(*candidate.shape, 8).transpose(1, 2).contiguous()
    normal = disc[:, 4:7]
    anchor = origin.float()[:, :, None] - disc[:, :3]
    away, inner = anchor.square().sum(1), local.square().sum(-1)
    extent = away.amax(1).sqrt() + inner.amax(1).sqrt()
    error = (MARGIN * extent * (extent + origin.float().abs().amax(1)))[:, None].expand_as(member)
    away.masked_fill_(~present, torch.inf)
    height = torch.baddbmm((anchor * normal).sum(1)[:, None], local, normal).square_()
    square = torch.baddbmm(away[:, None], local, anchor.mul_(2)).add_(inner[..., None])
    nearest = square.amin(-1).clamp_min_(0)
    lower = square.sub_(height).clamp_min_(0).sqrt_().sub_(disc[:, None, 3]).clamp_min_(0).square_().add_(height)
    radius = level.children.radius[member].float() * (1 + 1e-5)
    limit = ((nearest + error).sqrt() + 2 * radius).square() + error
    keep = lower <= torch.where(real, limit, -torch.inf)[..., None]
    count = keep.sum(-1).reshape(-1)
    flat = keep.reshape(-1).nonzero()[:, 0]
    # From (brick, child, column) to (brick, column), without a division per pair.
    row = torch.arange(len(count), device=rows.device)
    shift = ((row // members.shape[1] - row) * size).repeat_interleave(count)
    chosen = real.reshape(-1)
    return _Kept(
        member.reshape(-1)[chosen],
        count[chosen],
        nearest.reshape(-1)[chosen],
        error.reshape(-1)[chosen],
        candidate.reshape(-1).index_select(0, flat + shift),
        lower.reshape(-1).index_select(0, flat),
    )


def _exact(corner: Tensor, query: Tensor, owner: Tensor, triangle: Tensor) -> tuple[Tensor, Tensor]:
    """The float64 winner among (owner, triangle) pairs: face and barycentrics per owner."""
    chunk = PAIRS // 4 * (64 if owner.is_cuda else 1)
    values = [
        closest_on_triangle(query.index_select(0, o), *corner.index_select(0, t).unbind(1))
        for o, t in zip(owner.split(chunk), triangle.split(chunk))
    ]
    square, weight = (torch.cat(column) for column in zip(*values))
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
    far = (lists.count > 0) & (lists.nearest.double().sqrt() - bricks.radius > min(reach))
    owner, place = lists.pairs(far)
    near = lists.lower.index_select(0, place) <= (lists.nearest + lists.margin).index_select(0, owner)
    owner, triangle = owner[near], lists.triangle[place[near]]
    face = torch.zeros(len(far), dtype=torch.long, device=far.device)
    weight = torch.zeros(len(far), 3, dtype=corner.dtype, device=far.device)
    side = torch.ones(len(far), dtype=corner.dtype, device=far.device)
    if len(owner):
        found, share = _exact(corner, bricks.centre, owner, triangle)
        face[far], weight[far] = found[far], share[far]
        offset = bricks.centre - (corner[face] * weight[..., None]).sum(1)
        side = torch.where((offset * normals.at(faces, face, weight)).sum(-1) >= 0, 1.0, -1.0).to(corner.dtype)
        clearance = offset.norm(dim=-1) - bricks.radius
        far &= (clearance > torch.where(side > 0, reach[1], reach[0])) & ~normals.unsure(faces, face, weight)
    return far, face, weight, side
