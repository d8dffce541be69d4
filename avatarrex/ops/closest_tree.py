"""The closest triangle of a mesh by a tree of boxes, and the side, in compiled loops on a CPU (ops/native.py): exact, float64.

A box holds a run of triangles, halved at the median of their centres along the longest extent, down to `LEAF`. Each point
starts from the triangle that was closest to the point before: points of a lattice or of a picture lie in order, and few boxes
are nearer. Which of the triangles of an edge is found depends on it, too. Where distances saturate, a point whose neighbour
in the row is so far from the surface that it must be beyond the bound, too, is not searched: of a closed mesh it lies on the
same side.

Letters: p points, v vertices, f faces, b boxes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from avatarrex.ops.native import native, spread
from avatarrex.ops.pseudonormal import Pseudonormals
from avatarrex.ops.triangle import THIN

LEAF = 2
"""Triangles of a box that is not split."""
DEEP = 64
"""Boxes that may wait at once: the tree's depth, with room to spare."""
MARGIN = 0.04
"""Metres beyond the bound up to which all points are searched: what is looked up at them is interpolated with what lies within.
The diagonal of the coarsest cells of a hand's box (`volume/part_box.py`) at voxels of 5 mm."""
ON = 1e-30
"""Square metres: nearer, the distance is the height over the surface."""
TINY = float(np.finfo(np.float64).tiny)
Array = Shaped[np.ndarray, "..."]


@dataclass(frozen=True)
class TriangleTree:
    """A mesh, prepared."""

    corner: Array
    """(f, 3, 3) float64, in the order of the boxes."""
    face: Array
    """(f,) which is which."""
    box: Array
    """(b, 2, 3) lowest and highest corner; a box's first half follows it."""
    other: Array
    """(b,) its other half; of a box that is not split its first triangle."""
    count: Array
    """(b,) triangles of a box that is not split, else 0."""

    @classmethod
    def of(cls, vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]) -> TriangleTree:
        """Of at least one triangle, metres."""
        unsorted = vertices.detach().double()[faces].contiguous()
        order, box, other, count = build(unsorted.numpy(), unsorted.mean(1).numpy(), LEAF)
        return cls(unsorted.numpy()[order], order, box, other, count)

    @torch.no_grad()
    def closest(self, points: Float[Tensor, "p 3"]) -> tuple[Int[Tensor, " p"], Float[Tensor, "p 3"]]:
        """Closest face and the barycentrics of its closest point (float64, exact zeros off the feature that holds it)."""
        query = points.double().contiguous().numpy()
        face, weight = np.empty(len(query), np.int64), np.empty((len(query), 3))
        spread(_search, len(query), query, self.corner, self.box, self.other, self.count, face, weight)
        return torch.from_numpy(self.face[face]), torch.from_numpy(weight)

    @torch.no_grad()
    def signed(
        self,
        points: Float[Tensor, "p 3"],
        faces: Int[Tensor, "f 3"],
        normals: Pseudonormals,
        bound: tuple[float, float] | None = None,
    ) -> tuple[Float[Tensor, " p"], Int[Tensor, " p"], Float[Tensor, "p 3"], Bool[Tensor, " p"]]:
        """`closest`, with the signed distance before (float64, not yet clamped to the bound) and behind where it is unsure.

        Of a point that is farther than `MARGIN` beyond the bound: the bound, and the face of a point before it in the row.
        """
        query = points.double().contiguous().numpy()
        low, high = (-np.inf, np.inf) if bound is None else bound
        face, weight = np.empty(len(query), np.int64), np.empty((len(query), 3))
        sdf, unsure = np.empty(len(query)), np.empty(len(query), np.bool_)
        outward = tuple(part.double().numpy() for part in (normals.face, normals.edge, normals.vertex))
        flat = tuple(part.numpy() for part in (normals.flat_face, normals.flat_edge, normals.flat_vertex))
        tree = self.corner, self.box, self.other, self.count, self.face
        found = sdf, face, weight, unsure
        spread(_sign, len(query), query, *tree, faces.numpy(), *outward, *flat, float(low), float(high), *found)
        return tuple(torch.from_numpy(values) for values in found)  # type: ignore[return-value]


def build(corner: Array, centre: Array, leaf: int) -> tuple[Array, Array, Array, Array]:
    """Order, box, other and count (see `TriangleTree`) of things with corners (f, c, 3), `leaf` at most in a box, by their
    centres (f, 3)."""
    if not len(corner):
        raise ValueError("a tree of nothing")
    room = max(1, 4 * len(corner) // leaf)
    order, box, other, count = np.arange(len(corner)), np.empty((room, 2, 3)), *np.zeros((2, room), np.int64)
    used = _build(corner, centre, leaf, order, box, other, count)
    return order, box[:used], other[:used], count[:used]


@native
def _build(corner: Array, centre: Array, leaf: int, order: Array, box: Array, other: Array, count: Array) -> int:
    """Sort (`order`) and fill the boxes; how many there are."""
    begin, end, above = np.empty(DEEP, np.int64), np.empty(DEEP, np.int64), np.empty(DEEP, np.int64)
    begin[0], end[0], above[0] = 0, len(order), -1
    waiting, used = 1, 0
    while waiting:
        waiting -= 1
        first, last, here = begin[waiting], end[waiting], used
        used += 1
        if above[waiting] >= 0:
            other[above[waiting]] = here
        if last - first <= leaf:
            other[here], count[here] = first, last - first
            continue
        middle = (first + last) // 2
        _split(centre, order, first, middle, last)
        begin[waiting], end[waiting], above[waiting] = middle, last, here
        begin[waiting + 1], end[waiting + 1], above[waiting + 1] = first, middle, -1
        waiting += 2
    fit(corner, order, box[:used], other, count)
    return used


@native
def fit(corner: Array, order: Array, box: Array, other: Array, count: Array) -> None:
    """Fill the boxes (b, 2, 3) around what they hold."""
    for here in range(len(box) - 1, -1, -1):  # halves come after the whole
        for axis in range(3):
            low, high = np.inf, -np.inf
            if not count[here]:
                low = min(box[here + 1, 0, axis], box[other[here], 0, axis])
                high = max(box[here + 1, 1, axis], box[other[here], 1, axis])
            for k in range(other[here], other[here] + count[here]):
                for i in range(corner.shape[1]):
                    low, high = min(low, corner[order[k], i, axis]), max(high, corner[order[k], i, axis])
            box[here, 0, axis], box[here, 1, axis] = low, high


@native
def _split(centre: Array, order: Array, first: int, middle: int, last: int) -> None:
    """Bring those of `order` from `first` to `last` that lie lower along their longest extent before `middle`."""
    along, longest = 0, -1.0
    for axis in range(3):
        low, high = np.inf, -np.inf
        for k in range(first, last):
            low, high = min(low, centre[order[k], axis]), max(high, centre[order[k], axis])
        if high - low > longest:
            along, longest = axis, high - low
    low_end, high_end = first, last - 1
    while low_end < high_end:  # Hoare's selection
        pivot = centre[order[(low_end + high_end) // 2], along]
        i, j = low_end, high_end
        while i <= j:
            while centre[order[i], along] < pivot:
                i += 1
            while centre[order[j], along] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high_end = j
        elif middle >= i:
            low_end = i
        else:
            return


@native
def _search(
    begin: int,
    end: int,
    query: Array,
    corner: Array,
    box: Array,
    other: Array,
    count: Array,
    face: Array,
    weight: Array,
) -> None:
    """face (p,), in the order of the boxes, and weight (p, 3) of the points (p, 3)."""
    waiting, gap = np.empty(DEEP, np.int64), np.empty(DEEP)
    winner = 0
    for p in range(begin, end):
        at = query[p, 0], query[p, 1], query[p, 2]
        winner, _, u, v, w = _nearest(at, winner, corner, box, other, count, waiting, gap)
        face[p] = winner
        weight[p, 0], weight[p, 1], weight[p, 2] = u, v, w


@native
def _sign(
    begin: int,
    end: int,
    query: Array,
    corner: Array,
    box: Array,
    other: Array,
    count: Array,
    original: Array,
    faces: Array,
    face_normal: Array,
    edge_normal: Array,
    vertex_normal: Array,
    flat_face: Array,
    flat_edge: Array,
    flat_vertex: Array,
    low: float,
    high: float,
    sdf: Array,
    face: Array,
    weight: Array,
    unsure: Array,
) -> None:
    """sdf (p,), face (p,), weight (p, 3) and unsure (p,) of the points (p, 3)."""
    waiting, gap = np.empty(DEEP, np.int64), np.empty(DEEP)
    winner, u, v, w = 0, 1.0, 0.0, 0.0
    side, clear = 0.0, 0.0  # of the point before, and how far it at least is from the surface
    for p in range(begin, end):
        x, y, z = query[p, 0], query[p, 1], query[p, 2]
        if p > begin:
            clear -= math.sqrt((x - query[p - 1, 0]) ** 2 + (y - query[p - 1, 1]) ** 2 + (z - query[p - 1, 2]) ** 2)
        unsure[p] = False
        limit = high if side > 0 else -low
        if side != 0 and clear > limit + MARGIN:
            sdf[p] = side * limit
        else:
            winner, square, u, v, w = _nearest((x, y, z), winner, corner, box, other, count, waiting, gap)
            f, zeros = original[winner], (u <= 0) + (v <= 0) + (w <= 0)
            if zeros == 0:
                normal, unsure[p] = face_normal[f], flat_face[f]
            elif zeros == 1:
                edge = 0 if u <= 0 else (1 if v <= 0 else 2)
                normal, unsure[p] = edge_normal[f, edge], flat_edge[f, edge]
            else:
                vertex = faces[f, 0 if u > 0 else (1 if v > 0 else 2)]
                normal, unsure[p] = vertex_normal[vertex], flat_vertex[vertex]
            on = corner[winner]
            dx = x - (u * on[0, 0] + v * on[1, 0] + w * on[2, 0])
            dy = y - (u * on[0, 1] + v * on[1, 1] + w * on[2, 1])
            dz = z - (u * on[0, 2] + v * on[1, 2] + w * on[2, 2])
            height = dx * normal[0] + dy * normal[1] + dz * normal[2]
            side, clear = 1.0 if height >= 0 else -1.0, math.sqrt(square)
            sdf[p] = side * clear
            if square <= ON:
                length = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
                sdf[p] = height / length if length > 0 else 0.0
            if unsure[p]:
                side = 0.0
        face[p] = original[winner]
        weight[p, 0], weight[p, 1], weight[p, 2] = u, v, w


@native
def _nearest(
    at: tuple[float, float, float],
    winner: int,
    corner: Array,
    box: Array,
    other: Array,
    count: Array,
    waiting: Array,
    gap: Array,
) -> tuple[int, float, float, float, float]:
    """Closest triangle, squared distance and barycentrics; `winner` is tried first."""
    x, y, z = at
    best, u, v, w = _closest(x, y, z, corner, winner)
    b = depth = 0
    while True:
        if count[b]:
            for t in range(other[b], other[b] + count[b]):
                square, of_a, of_b, of_c = _closest(x, y, z, corner, t)
                if square < best:
                    best, winner, u, v, w = square, t, of_a, of_b, of_c
        else:
            near, far = b + 1, other[b]
            near_gap, far_gap = beyond(x, y, z, box, near), beyond(x, y, z, box, far)
            if far_gap < near_gap:
                near, far, near_gap, far_gap = far, near, far_gap, near_gap
            if near_gap < best:
                waiting[depth], gap[depth] = far, far_gap
                b, depth = near, depth + 1
                continue
        while depth and gap[depth - 1] >= best:
            depth -= 1
        if not depth:
            break
        depth -= 1
        b = waiting[depth]
    return winner, best, u, v, w


@native
def beyond(x: float, y: float, z: float, box: Array, b: int) -> float:
    """Squared distance to box b of (b, 2, 3)."""
    dx = max(box[b, 0, 0] - x, x - box[b, 1, 0], 0.0)
    dy = max(box[b, 0, 1] - y, y - box[b, 1, 1], 0.0)
    dz = max(box[b, 0, 2] - z, z - box[b, 1, 2], 0.0)
    return dx * dx + dy * dy + dz * dz


@native
def _closest(x: float, y: float, z: float, corner: Array, t: int) -> tuple[float, float, float, float]:
    """Squared distance and barycentrics of one point on triangle t: ops/triangle.py, step by step."""
    ax, ay, az = corner[t, 0, 0], corner[t, 0, 1], corner[t, 0, 2]
    abx, aby, abz = corner[t, 1, 0] - ax, corner[t, 1, 1] - ay, corner[t, 1, 2] - az
    acx, acy, acz = corner[t, 2, 0] - ax, corner[t, 2, 1] - ay, corner[t, 2, 2] - az
    apx, apy, apz = x - ax, y - ay, z - az
    bcx, bcy, bcz = acx - abx, acy - aby, acz - abz
    bpx, bpy, bpz = apx - abx, apy - aby, apz - abz
    ab2, ac2, bc2 = (
        abx * abx + aby * aby + abz * abz,
        acx * acx + acy * acy + acz * acz,
        bcx * bcx + bcy * bcy + bcz * bcz,
    )
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    area2, longest = nx * nx + ny * ny + nz * nz, max(ab2, ac2, bc2)
    if area2 > (THIN * longest) ** 2:
        v = ((apy * acz - apz * acy) * nx + (apz * acx - apx * acz) * ny + (apx * acy - apy * acx) * nz) / area2
        w = ((aby * apz - abz * apy) * nx + (abz * apx - abx * apz) * ny + (abx * apy - aby * apx) * nz) / area2
        u = 1 - v - w
        if min(v, w, u) >= 0:
            height = apx * nx + apy * ny + apz * nz
            return height * height / area2, u, v, w
    on_ab = min(max((apx * abx + apy * aby + apz * abz) / max(ab2, TINY), 0.0), 1.0)
    on_ac = min(max((apx * acx + apy * acy + apz * acz) / max(ac2, TINY), 0.0), 1.0)
    on_bc = min(max((bpx * bcx + bpy * bcy + bpz * bcz) / max(bc2, TINY), 0.0), 1.0)
    square_ab = (apx - on_ab * abx) ** 2 + (apy - on_ab * aby) ** 2 + (apz - on_ab * abz) ** 2
    square_ac = (apx - on_ac * acx) ** 2 + (apy - on_ac * acy) ** 2 + (apz - on_ac * acz) ** 2
    square_bc = (bpx - on_bc * bcx) ** 2 + (bpy - on_bc * bcy) ** 2 + (bpz - on_bc * bcz) ** 2
    best = min(square_ab, square_ac, square_bc)
    if square_ab <= best:
        return best, 1 - on_ab, on_ab, 0.0
    if square_ac <= best:
        return best, 1 - on_ac, 0.0, on_ac
    return best, 0.0, 1 - on_bc, on_bc
