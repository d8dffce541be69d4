"""Which texels of a static detail lie side by side: within their triangle, and over the edges that it shares.

Texels of neighbouring triangles do not coincide where one has more along the shared edge than the other: each is then beside the
nearest of the other triangle's on that edge.

Letters: f triangles, t texels, e pairs, h half-edges.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from avatarrex.fields.detail_texture import texel_count, texel_number

CORNERS = np.array([[1, 2], [2, 0], [0, 1]])
"""Of the edge opposite to each corner, in the triangle's sense."""


def texel_neighbours(edge: Int[np.ndarray, " f"], faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "e 2"]:
    """Pairs of texels, each once; `edge` texel intervals along the edges of each triangle, 0 where it has none."""
    edge = edge.astype(np.int64)
    first = np.concatenate([[0], np.cumsum(texel_count(edge))[:-1]])
    pairs = np.concatenate([*_within(edge, first), _across(edge, first, faces)])
    return np.unique(np.sort(pairs, 1), axis=0)


def _within(edge: np.ndarray, first: np.ndarray) -> list[np.ndarray]:
    """Along the three directions of each triangle's lattice."""
    found = []
    for r in np.unique(edge[edge > 0]).tolist():
        i, j = (table.ravel() for table in np.indices((r + 1, r + 1)))
        for step in ((1, 0), (0, 1), (1, -1)):
            there = (i + j <= r) & (i + step[0] + j + step[1] <= r) & (j + step[1] >= 0)
            a, b = i[there], j[there]
            both = np.stack([texel_number(a, b, r), texel_number(a + step[0], b + step[1], r)], 1)
            found.append((first[edge == r][:, None, None] + both).reshape(-1, 2))
    return found


def _across(edge: np.ndarray, first: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Over edges that two triangles with texels share."""
    shown = np.flatnonzero(edge)
    face, corner = np.repeat(shown, 3), np.tile(np.arange(3), len(shown))
    start, end = (faces[face, CORNERS[corner, side]] for side in (0, 1))
    key = np.minimum(start, end) * (int(faces.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    one = np.concatenate([order[same], order[same + 1]])
    other = np.concatenate([order[same + 1], order[same]])
    count = edge[face[one]] + 1
    row = np.repeat(np.arange(len(one)), count)
    along = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    own, beside = one[row], other[row]
    turned = start[own] != start[beside]
    r, beyond = edge[face[own]], edge[face[beside]]
    there = np.rint(along / r * beyond).astype(np.int64)
    there = np.where(turned, beyond - there, there)
    return np.stack(
        [_on_edge(first, face[h], corner[h], at, n) for h, at, n in ((own, along, r), (beside, there, beyond))], 1
    )


def _on_edge(first: np.ndarray, face: np.ndarray, corner: np.ndarray, at: np.ndarray, r: np.ndarray) -> np.ndarray:
    """The texel `at` of `r` steps from the start of the edge opposite to a corner."""
    counts = np.zeros((len(face), 3), np.int64)
    rows = np.arange(len(face))
    counts[rows, CORNERS[corner, 0]] = r - at
    counts[rows, CORNERS[corner, 1]] = at
    number: np.ndarray = first[face] + texel_number(counts[:, 0], counts[:, 1], r)
    return number
