"""The pseudonormals of a mesh in compiled loops on a CPU (ops/native.py): the same as ops/pseudonormal.py finds, float64.

Letters: v vertices, f faces, s slots of a hash table.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Shaped

from avatarrex.ops.native import native
from avatarrex.ops.triangle import THIN

Array = Shaped[np.ndarray, "..."]
FREE = -1
HASH_PRIMES = (73856093, 19349663, 83492791)
"""Primes of a hash of triples (Teschner et al. 2003)."""
Found = tuple[Array, Array, Array, Array, Array, Array, Array]


def gathered(vertices: Array, faces: Array) -> Found:
    """Of vertices (v, 3) float64 and faces (f, 3) int64: the fields of `Pseudonormals`, in their order."""
    bits = (vertices + 0.0).view(np.int64)  # zero has one sign
    joined = _welded(bits, _slots(len(vertices)))
    normal, edge, vertex, flat, flat_edge, flat_vertex, kept, edge_of = _gather(
        vertices, faces, joined, _slots(3 * len(faces))
    )
    return normal, edge[edge_of], vertex[joined], flat, flat_edge[edge_of], flat_vertex[joined], kept


def _slots(keys: int) -> int:
    """A power of two of which so many fill a quarter to a half."""
    return 2 << keys.bit_length()


@native
def _welded(place: Array, slots: int) -> Array:
    """(v,) the first vertex at the same place (v, 3)."""
    table, joined = np.full(slots, FREE, np.int64), np.empty(len(place), np.int64)
    for v in range(len(place)):
        slot = _slot(table, place, place[v, 0], place[v, 1], place[v, 2])
        if table[slot] == FREE:
            table[slot] = v
        joined[v] = table[slot]
    return joined


@native
def _slot(table: Array, key: Array, a: int, b: int, c: int) -> int:
    """Where the triple is in a table, or is to be: `table` (s,) contains rows of `key`."""
    mixed = (a * HASH_PRIMES[0]) ^ (b * HASH_PRIMES[1]) ^ (c * HASH_PRIMES[2])
    at = (mixed ^ (mixed >> 20) ^ (mixed >> 40)) & (len(table) - 1)  # numbers that were float32 have no low bits
    while table[at] != FREE:
        row = table[at]
        if key[row, 0] == a and key[row, 1] == b and key[row, 2] == c:
            break
        at = (at + 1) & (len(table) - 1)
    return at


@native
def _gather(vertices: Array, faces: Array, joined: Array, slots: int) -> tuple[Array, ...]:
    """The fields, of edges and of joined vertices once each, and the edge opposite each corner (f, 3)."""
    count = len(faces)
    table, corners = np.full(slots, FREE, np.int64), np.empty((count, 3), np.int64)
    edges, ends, used = np.full(slots, FREE, np.int64), np.zeros((3 * count, 3), np.int64), 0
    kept, flat, edge_of = np.empty(count, np.bool_), np.empty(count, np.bool_), np.empty((count, 3), np.int64)
    normal = np.zeros((count, 3))
    of_edge, flat_edge = np.zeros((3 * count, 3)), np.zeros(3 * count, np.bool_)
    of_vertex, flat_vertex = np.zeros((len(vertices), 3)), np.zeros(len(vertices), np.bool_)
    side, corner = np.empty((3, 3)), np.empty(3, np.int64)
    for f in range(count):
        for i in range(3):
            corner[i] = joined[faces[f, i]]
            a, b = faces[f, (i + 1) % 3], faces[f, (i + 2) % 3]
            for axis in range(3):
                side[i, axis] = vertices[b, axis] - vertices[a, axis]
        # The first of triangles with the same corners in the same cyclic order counts.
        first = 0
        for i in range(1, 3):
            if corner[i] < corner[first]:
                first = i
        for i in range(3):
            corners[f, i] = corner[(first + i) % 3]
        slot = _slot(table, corners, corners[f, 0], corners[f, 1], corners[f, 2])
        kept[f] = table[slot] == FREE
        if kept[f]:
            table[slot] = f
        x = side[2, 1] * -side[1, 2] - side[2, 2] * -side[1, 1]
        y = side[2, 2] * -side[1, 0] - side[2, 0] * -side[1, 2]
        z = side[2, 0] * -side[1, 1] - side[2, 1] * -side[1, 0]
        area, longest = math.sqrt(x * x + y * y + z * z), 0.0
        for i in range(3):
            longest = max(longest, side[i, 0] ** 2 + side[i, 1] ** 2 + side[i, 2] ** 2)
        flat[f] = area <= THIN * longest
        if not flat[f]:
            normal[f, 0], normal[f, 1], normal[f, 2] = x / area, y / area, z / area
        for i in range(3):
            a, b = corner[(i + 1) % 3], corner[(i + 2) % 3]
            ends[used, 0], ends[used, 1] = min(a, b), max(a, b)
            slot = _slot(edges, ends, ends[used, 0], ends[used, 1], 0)
            if edges[slot] == FREE:
                edges[slot] = used
                used += 1
            edge_of[f, i] = edges[slot]
            if flat[f]:
                flat_edge[edge_of[f, i]] = flat_vertex[corner[i]] = True
            if kept[f]:
                # The angle lies between side (i+1) reversed and side (i+2); atan2 keeps digits for slivers.
                j, k = (i + 1) % 3, (i + 2) % 3
                dot = side[j, 0] * side[k, 0] + side[j, 1] * side[k, 1] + side[j, 2] * side[k, 2]
                angle = math.atan2(area, -dot)
                for axis in range(3):
                    of_edge[edge_of[f, i], axis] += normal[f, axis]
                    of_vertex[corner[i], axis] += angle * normal[f, axis]
    return normal, of_edge, of_vertex, flat, flat_edge, flat_vertex, kept, edge_of
