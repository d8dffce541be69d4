"""Case `mesh`: a closed mesh made degenerate (slivers, faces of no area, doubled vertices and faces), and its distances.

Every implementation must agree with brute force; the sign must be that of the winding number. Metres, float64.
"""

from __future__ import annotations

import numpy as np
import torch

from avatarrex.measure.stress.case import MOST_ROWS, Entry, Inputs, Kind
from avatarrex.measure.stress.findings import Findings
from avatarrex.ops.closest_point import available, closest_point
from avatarrex.ops.pseudonormal import pseudonormals, winding_number

Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices and faces."""
BOUND = (-0.02, 0.025)
SLIVER_ERROR = 1e-9
"""Metres that implementations may differ by beside triangles 1e-12 as wide as long; 6e-11 was seen of libigl."""
SIGNED_FROM = 1e-7
"""Metres within which a sign is a matter of rounding (dirty faces lie that near the clean ones)."""


def draw(rng: np.random.Generator, number: int) -> Inputs:
    """A dented ball of 5 cm with dirt, and points about it."""
    vertices, faces = _ball(1 + number % 3)
    vertices = vertices * (0.05 * rng.uniform(0.5, 1, (len(vertices), 1)))
    for _ in range(int(rng.integers(1, 12))):
        vertices, faces = DIRT[rng.integers(len(DIRT))](rng, vertices, faces)
    corner = vertices[faces[rng.integers(len(faces), size=150)]]
    surface = (corner * rng.dirichlet(np.ones(3), len(corner))[..., None]).sum(1)
    edge = corner[:50, 0] + rng.random((50, 1)) * (corner[:50, 1] - corner[:50, 0])
    noise = 10.0 ** rng.uniform(-9, -2, (150, 1)) * rng.normal(size=(150, 3))
    points = [surface + noise, edge, vertices[rng.integers(len(vertices), size=50)], rng.uniform(-0.1, 0.1, (100, 3))]
    return {"vertices": vertices, "faces": faces, "points": np.concatenate(points)}


def check(inputs: Inputs, found: Findings) -> None:
    """All checks of the case."""
    vertices, faces, points = (torch.as_tensor(inputs[name]) for name in ("vertices", "faces", "points"))
    want = closest_point(vertices, faces, points, impl="reference")
    found.finite("distances finite", want.sdf, want.barycentric)
    inside = winding_number(vertices, faces[pseudonormals(vertices, faces).kept], points) > 0.5
    wrong = ((want.sdf < 0) != inside) & (want.sdf.abs() > SIGNED_FROM)
    found.at_most("sign unlike the winding number", wrong.double(), 0)
    for impl in available():
        have = closest_point(vertices, faces, points, impl=impl)
        found.finite(f"{impl}: distances finite", have.sdf, have.barycentric)
        found.at_most(f"{impl}: distance off brute force (m)", (have.sdf.abs() - want.sdf.abs()).abs(), SLIVER_ERROR)
        flips = (have.sdf * want.sdf < 0) & (want.sdf.abs() > SIGNED_FROM)
        found.at_most(f"{impl}: sign off brute force", flips.double(), 0)
        found.within(f"{impl}: barycentrics in 0 to 1", have.barycentric, 0, 1, 1e-15)
        bounded = closest_point(vertices, faces, points, BOUND, impl=impl).sdf
        off = (bounded - want.sdf.clamp(*BOUND)).abs()
        found.at_most(f"{impl}: bounded distance off (m)", off[want.sdf.abs() > SIGNED_FROM], 1e-12)


def _ball(rounds: int) -> Mesh:
    """An octahedron with faces split in four `rounds` times, on the unit sphere."""
    vertices = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    for _ in range(rounds):
        sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], -1).reshape(-1, 2)
        edge, number = np.unique(sides, axis=0, return_inverse=True)
        middle = len(vertices) + number.reshape(-1, 3)
        vertices = np.concatenate([vertices, vertices[edge].mean(1)])
        (a, b, c), (ab, bc, ca) = faces.T, middle.T
        faces = np.concatenate([np.stack(f, -1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces


def _split(vertices: np.ndarray, faces: np.ndarray, face: int, share: float, both: bool) -> Mesh:
    """A new vertex on the first edge of `face`, at `share`; its neighbour is split, too, or gets a face of no area."""
    a, b, c = faces[face]
    new = len(vertices)
    vertices = np.concatenate([vertices, vertices[a] + share * (vertices[b : b + 1] - vertices[a])])
    added = [[a, new, c], [new, b, c]]
    beside = [k for k, f in enumerate(faces) if k != face and a in f and b in f]
    gone = [face]
    if both and len(beside) == 1:
        turned = np.roll(faces[beside[0]], -int(np.flatnonzero(faces[beside[0]] == b)[0]))
        added += [[b, new, turned[2]], [new, a, turned[2]]]
        gone += beside
    else:
        added.append([a, b, new])
    return vertices, np.concatenate([np.delete(faces, gone, 0), np.array(added)])


def _sliver(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    return _split(vertices, faces, int(rng.integers(len(faces))), 10.0 ** rng.uniform(-12, -2), True)


def _no_area(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    return _split(vertices, faces, int(rng.integers(len(faces))), float(rng.choice([0.0, 1e-9, 0.5, 1.0])), False)


def _doubled_vertex(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """One face gets its own copy of a corner."""
    faces, face = faces.copy(), rng.integers(len(faces))
    corner = rng.integers(3)
    vertices = np.concatenate([vertices, vertices[faces[face, corner]][None]])
    faces[face, corner] = len(vertices) - 1
    return vertices, faces


def _doubled_face(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """A face twice, turned, and one with a corner twice."""
    face = np.roll(faces[rng.integers(len(faces))], rng.integers(3))
    return vertices, np.concatenate([faces, face[None], face[None, [0, 0, 1]]])


DIRT = (_sliver, _no_area, _doubled_vertex, _doubled_face)
ENTRIES = {"vertices": Entry((-1, 3)), "faces": Entry((-1, 3), (0, MOST_ROWS)), "points": Entry((-1, 3))}
KIND = Kind("mesh", ENTRIES, draw, check, repeat=20, fewer=("points",))
