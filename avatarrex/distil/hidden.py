"""What no side of the head shows: the inside of the mouth and of the lips, the sockets, the eyes beneath their lids.

The exact field is one skin over all of it; such a vertex stays where the template has it, or it would come out through the skin.

Letters: v vertices, f faces. Metres at rest.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from avatarrex.camera import Camera
from avatarrex.capture.zbuffer import visible_faces

AZIMUTHS, ELEVATIONS = (-60, -30, 0, 30, 60), (-30, 0, 30)
"""Degrees: the sides from which a face is looked at."""
SIDE = 1024
"""Pixels: 0.3 mm, a tenth of a triangle at the lids."""
BESIDE = 0.03
"""Metres about points in which something may lie before them: lids, brows before eyes."""
BEHIND = 3e-4
"""Metres by which a point may lie behind the first triangle of its pixel."""
DISTANCE, FIELD_OF_VIEW = 1.0, 20.0
"""Metres, degrees: a whole head."""


def hidden(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], face: Bool[np.ndarray, " v"]
) -> Bool[np.ndarray, " v"]:
    """Vertices of the `face`, which looks along +Z, that are a corner of no triangle seen."""
    seen = ~face
    if seen.all():
        return face
    middle = vertices[face].mean(0)
    for azimuth in AZIMUTHS:
        for elevation in ELEVATIONS:
            camera = Camera.orbit(azimuth, elevation, DISTANCE, FIELD_OF_VIEW, middle, SIDE, SIDE)
            first, _, _ = visible_faces(vertices, faces, camera)
            seen[faces[np.unique(first[first >= 0])]] = True
    return ~seen


def shown(
    points: Float[np.ndarray, "p 3"], vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Bool[np.ndarray, " p"]:
    """Points on a mesh of a head, which looks along +Z, that are seen from some side. What lies farther off than `BESIDE` covers none."""
    low, high = points.min(0) - BESIDE, points.max(0) + BESIDE
    near = faces[((vertices > low) & (vertices < high)).all(1)[faces].all(1)]
    seen = np.zeros(len(points), bool)
    for azimuth in AZIMUTHS:
        camera = Camera.orbit(azimuth, 0, DISTANCE, FIELD_OF_VIEW, points.mean(0), SIDE, SIDE)
        _, _, first = visible_faces(vertices, near, camera)
        pixels, depth = camera.pixels(points)
        column, row = np.clip(np.floor(pixels).astype(int), 0, SIDE - 1).T
        seen |= depth < first[row, column] + BEHIND
    return seen


def joined_to(start: Bool[np.ndarray, " v"], within: Bool[np.ndarray, " v"], faces: np.ndarray) -> np.ndarray:
    """(v,) the vertices `within` that edges among them join to one of `start`, and `start`."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    edges = edges[within[edges].all(1)]
    link = coo_array((np.ones(len(edges)), edges.T), (len(start),) * 2)
    _, label = connected_components(link, directed=False)
    return start | (within & np.isin(label, label[start & within]))


def caps(faces: Int[np.ndarray, "f 3"], where: Bool[np.ndarray, " v"]) -> Int[np.ndarray, "n 3"]:
    """Triangles that close every hole of `faces` whose rim lies in `where` (v,): fans, with the faces' orientation."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    known = {(int(a), int(b)) for a, b in edges}
    following = {b: a for a, b in known if (b, a) not in known and where[a] and where[b]}
    found: list[tuple[int, int, int]] = []
    while following:
        first, at = following.popitem()
        rim = [first]
        while at != first and at in following:
            rim.append(at)
            at = following.pop(at)
        if at == first:
            found += [(first, b, c) for b, c in pairwise(rim[1:])]
    return np.array(found, faces.dtype).reshape(-1, 3)
