"""One tree of boxes for all searches among triangles or vertices, in compiled loops on a CPU (ops/native.py): exact, float64.

A leaf is a triangle (three corners) or a vertex (one). A box holds a run of leaves, halved at the median of their centres along
the longest extent. `specialised` makes the walk of a search from two small functions: the least distance to a box, and what a leaf
changes. The closest triangle (closest_triangle.py), the closest vertices (closest_vertex.py) and the crossings of a ray
(crossings.py) are such searches.

Letters: f leaves, c corners of a leaf, b boxes.
"""

from __future__ import annotations

import inspect
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

from avatarrex.ops.native import borrowing, native

TRIANGLES, VERTICES = 2, 8
"""Leaves of a box that is not split."""
MAX_DEPTH = 64
"""Boxes that may wait at once: the tree's depth, with room to spare."""
Array = Shaped[np.ndarray, "..."]
Stack = tuple[Array, Array]
Point = tuple[float, float, float]
box_gap: Any
visit: Any
"""What `specialised` fills in."""


class SearchTree(NamedTuple):
    """Triangles or vertices, metres, in boxes."""

    corner: Array
    """(f, c, 3) float64, in the order of the boxes."""
    number: Array
    """(f,) the number of each leaf before it was sorted."""
    box: Array
    """(b, 2, 3) lowest and highest corner; a box's first half follows it."""
    other: Array
    """(b,) its other half; of a box that is not split its first leaf."""
    leaves: Array
    """(b,) number of leaves of a box that is not split, else 0."""

    @classmethod
    def of_triangles(cls, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> SearchTree:
        """The triangles of a mesh. Raises ValueError for none, or NaN."""
        corner = finite(vertices)[faces]
        return _tree(corner, corner.mean(1), TRIANGLES)

    @classmethod
    def of_vertices(cls, vertices: Float[np.ndarray, "v 3"]) -> SearchTree:
        """A cloud of vertices. Raises ValueError for none, or NaN."""
        cloud = finite(vertices)
        return _tree(cloud[:, None], cloud, VERTICES)

    def moved(self, vertices: Float[np.ndarray, "v 3"]) -> SearchTree:
        """The tree of the same vertices elsewhere: the order stays, the boxes are fitted anew, in a tenth of the time.

        Far from where the boxes were made, searches take up to half as long again.
        """
        tree = self._replace(corner=finite(vertices)[self.number][:, None], box=np.empty_like(self.box))
        _fit(tree.corner, tree.box, tree.other, tree.leaves)
        return tree


def finite(places: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
    """`places` in float64. Raises ValueError for NaN or Inf."""
    if not np.isfinite(places).all():
        raise ValueError("vertices and points must be finite")
    return np.ascontiguousarray(places, np.float64)


def specialised(box_gap: Any, visit: Any) -> Any:
    """The compiled walk `(tree, point, stack, out, state) -> state` of one kind of search.

    `box_gap(box, b, point)`: the least squared distance of what matters in box b. `visit(tree, leaf, point, out, state) -> state`
    looks at a leaf and may write to the arrays `out`. A state is a tuple of numbers; the first is the squared distance from which
    a box need not be opened.
    """
    loop = inspect.unwrap(_walk)
    walk = FunctionType(loop.__code__, {**loop.__globals__, "box_gap": box_gap, "visit": visit})
    walk.__qualname__ = f"walk_{visit.__module__}_{visit.__name__}"  # names its file in numba's cache
    return borrowing(walk)


def _walk(tree: SearchTree, point: Point, stack: Stack, out: Any, state: Any) -> Any:
    """Visit the leaves of all boxes that are nearer than the state's limit, the nearer half of a box first."""
    waiting, gap = stack
    b = depth = 0
    while True:
        if tree.leaves[b]:
            for leaf in range(tree.other[b], tree.other[b] + tree.leaves[b]):
                state = visit(tree, leaf, point, out, state)
        else:
            near, far = b + 1, tree.other[b]
            near_gap, far_gap = box_gap(tree.box, near, point), box_gap(tree.box, far, point)
            if far_gap < near_gap:
                near, far, near_gap, far_gap = far, near, far_gap, near_gap
            if near_gap < state[0]:
                waiting[depth], gap[depth] = far, far_gap  # in reach or not: that is tested once, when it is taken
                b, depth = near, depth + 1
                continue
        while depth and gap[depth - 1] >= state[0]:
            depth -= 1
        if not depth:
            return state
        depth -= 1
        b = waiting[depth]


@native
def new_stack() -> Stack:
    """Boxes that wait, and their distances: one for all walks of a thread."""
    return np.empty(MAX_DEPTH, np.int64), np.empty(MAX_DEPTH)


@borrowing
def point_gap(box: Array, b: int, point: Point) -> float:
    """Squared distance of a point to box b of (b, 2, 3)."""
    x, y, z = point
    dx = max(box[b, 0, 0] - x, x - box[b, 1, 0], 0.0)
    dy = max(box[b, 0, 1] - y, y - box[b, 1, 1], 0.0)
    dz = max(box[b, 0, 2] - z, z - box[b, 1, 2], 0.0)
    return float(dx * dx + dy * dy + dz * dz)


def _tree(corner: Array, centre: Array, leaf: int) -> SearchTree:
    """Of leaves with corners (f, c, 3) and centres (f, 3), `leaf` at most in a box."""
    if not len(corner):
        raise ValueError("a tree of nothing")
    room = max(1, 4 * len(corner) // leaf)
    order, other, leaves = np.arange(len(corner)), *np.zeros((2, room), np.int64)
    boxes = _sort(centre, leaf, order, other, leaves)
    tree = SearchTree(corner[order], order, np.empty((boxes, 2, 3)), other[:boxes], leaves[:boxes])
    _fit(tree.corner, tree.box, tree.other, tree.leaves)
    return tree


@native
def _sort(centre: Array, leaf: int, order: Array, other: Array, leaves: Array) -> int:
    """Sort (`order`) into boxes; how many there are."""
    begin, end, above = np.empty(MAX_DEPTH, np.int64), np.empty(MAX_DEPTH, np.int64), np.empty(MAX_DEPTH, np.int64)
    begin[0], end[0], above[0] = 0, len(order), -1
    waiting, used = 1, 0
    while waiting:
        waiting -= 1
        first, last, here = begin[waiting], end[waiting], used
        used += 1
        if above[waiting] >= 0:
            other[above[waiting]] = here
        if last - first <= leaf:
            other[here], leaves[here] = first, last - first
            continue
        middle = (first + last) // 2
        _split(centre, order, first, middle, last)
        begin[waiting], end[waiting], above[waiting] = middle, last, here
        begin[waiting + 1], end[waiting + 1], above[waiting + 1] = first, middle, -1
        waiting += 2
    return used


@borrowing
def _fit(corner: Array, box: Array, other: Array, leaves: Array) -> None:
    """Fill the boxes (b, 2, 3) around their leaves."""
    for here in range(len(box) - 1, -1, -1):  # halves follow the whole
        for axis in range(3):
            low, high = np.inf, -np.inf
            if not leaves[here]:
                low = min(box[here + 1, 0, axis], box[other[here], 0, axis])
                high = max(box[here + 1, 1, axis], box[other[here], 1, axis])
            for k in range(other[here], other[here] + leaves[here]):
                for i in range(corner.shape[1]):
                    low, high = min(low, corner[k, i, axis]), max(high, corner[k, i, axis])
            box[here, 0, axis], box[here, 1, axis] = low, high


@borrowing
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
