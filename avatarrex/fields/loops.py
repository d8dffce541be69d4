"""The body field's compiled loops (ops/native.py): pairs, neighbours among the anchors, weights, means, patch features.

What each computes is said where its torch operations are: influence.py, local_frame.py, patches.py. Pieces of the rows
`begin : end` run on several threads; no result depends on where they are cut. Arrays are float32 and int64.

Letters: n nodes, a anchors, p points, k pairs, c channels.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Shaped

from avatarrex.ops.native import borrowing, native

Array = Shaped[np.ndarray, "..."]
Point = tuple[np.float32, np.float32, np.float32]

CELL_SIZE = np.float32(0.06)
"""Side of the grid that anchors are sorted into, metres: the fifth nearest is 3 to 6 cm off."""
WIDE_REACH = np.float32(0.15)
"""Metres: from such a bound on the search starts anew, for so many cells take longer."""
LARGER = np.float32(1.00001)
"""Factor on the bound of that distance: an anchor at the bound itself is found."""
BLOCK_POINTS = 32
"""Adjacent points whose common box is tested against each node first."""
ONE, TWO, THREE, HALF = np.float32(1), np.float32(2), np.float32(3), np.float32(0.5)
"""numba takes a plain number together with a float32 as float64."""


class AnchorGrid(NamedTuple):
    """Anchors sorted into cells."""

    position: Array
    """(a, 3) in the order of the cells."""
    anchor: Array
    """(a,) the number of each anchor before it was sorted."""
    start: Array
    """(cells + 1,)."""
    origin: Array
    """(3,)."""
    cells: Array
    """(3,) cells along each axis."""

    @classmethod
    def of(cls, position: Array) -> AnchorGrid:
        """Of positions (a, 3)."""
        origin = position.min(0) if len(position) else np.zeros(3, np.float32)
        cell = ((position - origin) / CELL_SIZE).astype(np.int64)
        cells = cell.max(0, initial=0) + 1
        flat = np.ravel_multi_index(tuple(cell.T), tuple(cells))
        order = np.argsort(flat, kind="stable")
        start = np.searchsorted(flat[order], np.arange(cells.prod() + 1))
        return cls(np.ascontiguousarray(position[order]), order, start, origin, cells)


class Anchors(NamedTuple):
    """(a, 3) each: where samples are posed and at rest, and their unit normals (local_frame.py)."""

    position: Array
    rest: Array
    outward: Array


class AnchorWeights(NamedTuple):
    """The constants of local_frame.py, float32."""

    spread: np.float32
    aside: np.float32
    open: np.float32
    shut: np.float32
    never_zero: np.float32


class NodePairs(NamedTuple):
    """(point, node) pairs (k,), the points (p, 3) and nodes (n, 3), posed and at rest."""

    point: Array
    node: Array
    position: Array
    rest: Array
    node_position: Array
    node_rest: Array


class Support(NamedTuple):
    """The constants of influence.py, float32."""

    radius: np.float32
    sigma: np.float32
    epsilon: np.float32
    open: np.float32
    shut: np.float32


@native
def _reached(begin: int, end: int, point: Array, node: Array, radius: np.float32, reached: Array) -> int:
    """reached (n,): which nodes may be within `radius` of some point (3, p) in `begin : end`, by their box; their number."""
    found = 0
    low, high = np.empty(3, np.float32), np.empty(3, np.float32)
    for axis in range(3):
        low[axis] = high[axis] = point[axis, begin]
        for p in range(begin + 1, end):
            low[axis], high[axis] = min(low[axis], point[axis, p]), max(high[axis], point[axis, p])
    for i in range(len(node)):
        squared = np.float32(0)
        for axis in range(3):
            off = max(low[axis] - node[i, axis], node[i, axis] - high[axis])
            if off > 0:
                squared += off * off
        if squared <= radius * radius * LARGER:
            reached[found] = i
            found += 1
    return found


@native
def list_pairs(begin: int, end: int, point: Array, node: Array, radius: np.float32, place: Array, out: Array) -> None:
    """The pairs of the points (3, p) in `begin : end`: their number for each node is added to place (n,); where `out` has
    room, the points are written there, those of node i from place[i] on.
    """
    x, y, z = point[0], point[1], point[2]
    reached = np.empty(len(node), np.int64)
    for block in range(begin, end, BLOCK_POINTS):
        last = min(block + BLOCK_POINTS, end)
        for r in range(_reached(block, last, point, node, radius, reached)):
            i = reached[r]
            k, nx, ny, nz = place[i], node[i, 0], node[i, 1], node[i, 2]
            if len(out):
                for p in range(block, last):
                    dx, dy, dz = x[p] - nx, y[p] - ny, z[p] - nz
                    if dx * dx + dy * dy + dz * dz < radius * radius:
                        out[k] = p
                        k += 1
            else:
                for p in range(block, last):
                    dx, dy, dz = x[p] - nx, y[p] - ny, z[p] - nz
                    k += dx * dx + dy * dy + dz * dz < radius * radius
            place[i] = k


@borrowing
def _insert(first: int, last: int, point: Point, position: Array, best: Array, found: Array) -> None:
    """Put those of the anchors `first : last` that are nearer than the farthest of `best` (m,) there and in `found` (m,)."""
    x, y, z = point
    farthest = len(best) - 1
    for s in range(first, last):
        dx, dy, dz = x - position[s, 0], y - position[s, 1], z - position[s, 2]
        squared = dx * dx + dy * dy + dz * dz
        if squared >= best[farthest]:
            continue
        m = farthest
        while m > 0 and best[m - 1] > squared:
            best[m], found[m] = best[m - 1], found[m - 1]
            m -= 1
        best[m], found[m] = squared, s


@borrowing
def _cell_gap(at: int, x: np.float32, low: np.float32) -> np.float32:
    """Squared distance along an axis from x to the cell `at`."""
    edge = low + np.float32(at) * CELL_SIZE
    off = max(edge - x, x - edge - CELL_SIZE, np.float32(0))
    return off * off


@borrowing
def _span(x: np.float32, reach: np.float32, origin: np.float32, cells: int) -> tuple[int, int]:
    """First and last + 1 of the cells along an axis that an interval meets."""
    return max(int((x - reach - origin) / CELL_SIZE), 0), min(int((x + reach - origin) / CELL_SIZE) + 1, cells)


@borrowing
def _search_cells(reach: np.float32, point: Point, grid: AnchorGrid, best: Array, found: Array) -> None:
    """`_insert` the anchors of all cells within `reach` of a point."""
    x, y, z = point
    origin, cells = grid.origin, grid.cells
    low, high = _span(z, reach, origin[2], cells[2])
    left, right = _span(x, reach, origin[0], cells[0])
    near, far = _span(y, reach, origin[1], cells[1])
    for i in range(left, right):
        across = _cell_gap(i, x, origin[0])
        for j in range(near, far):
            if low < high and across + _cell_gap(j, y, origin[1]) < best[-1]:
                row = (i * cells[1] + j) * cells[2]
                _insert(grid.start[row + low], grid.start[row + high], point, grid.position, best, found)


@native
def nearest(begin: int, end: int, point: Array, grid: AnchorGrid, out: Array) -> None:
    """out (p, m): the m nearest anchors of the points (p, 3), nearest first; there are at least m.

    Those of the point before bound how far they can be; where that bound is large, the search widens from one cell on.
    """
    wanted, position, anchor = out.shape[1], grid.position, grid.anchor
    best, found = np.empty(wanted, np.float32), np.zeros(wanted, np.int64)
    for p in range(begin, end):
        at = x, y, z = point[p, 0], point[p, 1], point[p, 2]
        bound = np.float32(0 if p > begin else np.inf)
        for m in range(wanted):
            s = found[m]
            dx, dy, dz = x - position[s, 0], y - position[s, 1], z - position[s, 2]
            bound = max(bound, dx * dx + dy * dy + dz * dz)
        reach, known = np.sqrt(bound) * LARGER, bound <= WIDE_REACH * WIDE_REACH
        best[:] = reach * reach if known else np.float32(np.inf)
        if not known:
            reach = CELL_SIZE
        _search_cells(reach, at, grid, best, found)
        while not (known or best[-1] <= reach * reach):
            best[:] = np.inf
            reach *= TWO
            _search_cells(reach, at, grid, best, found)
        for m in range(wanted):
            out[p, m] = anchor[found[m]]


@native
def weigh_neighbours(
    begin: int, end: int, point: Array, index: Array, anchors: Anchors, constants: AnchorWeights, weight: Array
) -> None:
    """weight (p, m) of the anchors `index` (p, m) of the points (p, 3): see `Samples.neighbours_of`."""
    position, rest, outward = anchors
    spread, aside, open_at, shut_at, never_zero = constants
    count = index.shape[1]
    squared = np.empty(count, np.float32)
    for p in range(begin, end):
        leader, least = 0, np.float32(np.inf)
        for m in range(count):
            s = index[p, m]
            dx, dy, dz = point[p, 0] - position[s, 0], point[p, 1] - position[s, 1], point[p, 2] - position[s, 2]
            squared[m] = dx * dx + dy * dy + dz * dz
            height = dx * outward[s, 0] + dy * outward[s, 1] + dz * outward[s, 2]
            limb = height * abs(height) + aside * squared[m]
            if limb < least:
                leader, least = s, limb
        farthest = np.exp((squared[0] - squared[count - 1]) / (TWO * spread * spread))
        total = np.float32(0)
        for m in range(count):
            s = index[p, m]
            dx, dy, dz = rest[s, 0] - rest[leader, 0], rest[s, 1] - rest[leader, 1], rest[s, 2] - rest[leader, 2]
            apart = (dx * dx + dy * dy + dz * dz) / (spread * spread)
            t = min(max((shut_at * shut_at - apart) / (shut_at * shut_at - open_at * open_at), np.float32(0)), ONE)
            near = np.exp((squared[0] - squared[m]) / (TWO * spread * spread)) - farthest + never_zero
            weight[p, m] = near * t * t * (THREE - TWO * t)
            total += weight[p, m]
        for m in range(count):
            weight[p, m] /= total


@borrowing
def _expm1(x: np.float32) -> np.float32:
    """e^x − 1 of x ≥ 0 to 3e-7 of it; the library's takes three times as long."""
    if x > HALF:
        return np.float32(np.exp(x) - ONE)
    total = ONE
    for n in range(8, 1, -1):
        total = ONE + total * x / np.float32(n)
    return total * x


@borrowing
def localise(begin: int, end: int, pairs: NodePairs, constants: Support, local: Array, weight: Array) -> None:
    """local (3, k) and weight (k,) of the pairs: equation 5 and the gate, see influence.py."""
    radius, sigma, epsilon, open_at, shut_at = constants
    for k in range(begin, end):
        p, i = pairs.point[k], pairs.node[k]
        position, node = pairs.position[p], pairs.node_position[i]
        rest, node_rest = pairs.rest[p], pairs.node_rest[i]
        dx, dy, dz = position[0] - node[0], position[1] - node[1], position[2] - node[2]
        squared = dx * dx + dy * dy + dz * dz
        x, y, z = rest[0] - node_rest[0], rest[1] - node_rest[1], rest[2] - node_rest[2]
        apart = x * x + y * y + z * z
        local[0, k], local[1, k], local[2, k] = x, y, z
        if squared >= radius * radius or apart >= shut_at * shut_at:
            weight[k] = 0
            continue
        t = min((shut_at * shut_at - apart) / (shut_at * shut_at - open_at * open_at), ONE)
        influence = epsilon * _expm1((radius * radius - squared) / (TWO * sigma * sigma))
        weight[k] = influence * t * t * (THREE - TWO * t)


@borrowing
def keep_supported(pair_point: Array, weight: Array, cutoff: np.float32, total: Array, keep: Array) -> int:
    """keep (k,): the pairs with weight, and with `cutoff` of their point's, are written first in it; their number."""
    for k in range(len(weight)):
        total[pair_point[k]] += weight[k]
    found = 0
    for k in range(len(weight)):
        if weight[k] > 0 and weight[k] >= cutoff * total[pair_point[k]]:
            keep[found] = k
            found += 1
    return found


@native
def mean(begin: int, end: int, pair_point: Array, weight: Array, value: Array, total: Array, out: Array) -> None:
    """out (p, c) = Σ w v / Σ w and total (p,) = Σ w of the points `begin : end`; both zero before."""
    for k in range(len(weight)):
        p = pair_point[k]
        if begin <= p < end:
            total[p] += weight[k]
            for c in range(value.shape[1]):
                out[p, c] += weight[k] * value[k, c]
    for p in range(begin, end):
        if total[p] > 0:
            for c in range(value.shape[1]):
                out[p, c] /= total[p]


@native
def sample_patches(
    begin: int, end: int, patches: Array, node: Array, axes: Array, local: Array, extent: np.float32, out: Array
) -> None:
    """out (k, c): bilinear features of patches (n, s, s, c) where local (3, k) falls on the plane `axes` (n, 2, 3)."""
    size, channels = patches.shape[1], patches.shape[3]
    half, border = np.float32(size) * HALF, np.float32(size - 1)
    for k in range(begin, end):
        i = node[k]
        x, y, z = local[0, k], local[1, k], local[2, k]
        u = axes[i, 0, 0] * x + axes[i, 0, 1] * y + axes[i, 0, 2] * z
        v = axes[i, 1, 0] * x + axes[i, 1, 1] * y + axes[i, 1, 2] * z
        u = min(max((u / extent + ONE) * half - HALF, np.float32(0)), border)
        v = min(max((v / extent + ONE) * half - HALF, np.float32(0)), border)
        column, row = min(int(u), size - 2), min(int(v), size - 2)
        right, down = u - np.float32(column), v - np.float32(row)
        left, up = ONE - right, ONE - down
        for c in range(channels):
            above = patches[i, row, column, c] * left + patches[i, row, column + 1, c] * right
            below = patches[i, row + 1, column, c] * left + patches[i, row + 1, column + 1, c] * right
            out[k, c] = above * up + below * down


@native
def texels_around(
    begin: int, end: int, face: Array, weight: Array, point: Array, tables: Any, off: Any, texel: Array, share: Array
) -> None:
    """texel (p, 3) and share (p, 3) of places on triangles: `detail_texture._Lattice.around`, step by step."""
    first, edge, vertices, faces = tables
    for p in range(begin, end):
        f = face[p]
        r = edge[f]
        si, sj, sk = weight[p, 0] * r, weight[p, 1] * r, weight[p, 2] * r
        i, j, k = math.floor(si + 1e-9), math.floor(sj + 1e-9), math.floor(sk + 1e-9)
        a, b, c = min(max(si - i, 0.0), 1.0), min(max(sj - j, 0.0), 1.0), min(max(sk - k, 0.0), 1.0)
        left, turned, upright = r - i - j - k, 0, 0
        if left == 2:
            a, b, c, turned = 1 - a, 1 - b, 1 - c, 1
        elif left == 1:
            upright = 1
        else:
            a, b, c = 1.0, 0.0, 0.0
        total = max(a + b + c, 1e-9)
        x = y = z = 0.0
        for corner in range(3):
            on = vertices[faces[f, corner]]
            x, y, z = x + weight[p, corner] * on[0], y + weight[p, corner] * on[1], z + weight[p, corner] * on[2]
        x, y, z = point[p, 0] - x, point[p, 1] - y, point[p, 2] - z
        away = math.sqrt(x * x + y * y + z * z)
        scale = min(max((off[1] - away) / (off[1] - off[0]), 0.0), 1.0) / total
        share[p, 0], share[p, 1], share[p, 2] = scale * a, scale * b, scale * c
        for axis in range(3):
            m = i + (turned if axis != 0 else 0) + (upright if axis == 0 else 0)
            n = j + (turned if axis != 1 else 0) + (upright if axis == 1 else 0)
            texel[p, axis] = first[f] + m * (r + 1) - m * (m - 1) // 2 + n
