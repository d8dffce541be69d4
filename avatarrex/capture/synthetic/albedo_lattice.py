"""The subject's albedo sampled once, at rest, on a triangular lattice over every triangle.

Albedo is a function of the rest surface point (texture.py), so it does not change with the pose: a capture of thousands of
pictures evaluates it once. Triangle f with corners a, b, c stores its values at a + (i/n)(b − a) + (j/n)(c − a), i + j ≤ n,
row by row in j; n is such that the samples lie `spacing` metres apart, which the caller sets to what its cameras resolve.
Between samples the value is linear, so it is continuous inside a triangle and, where n is the same, across edges.

Letters: f faces, s samples. Root frame, metres; colours sRGB-encoded, 10 bits a channel.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from avatarrex.capture.synthetic.subject import Subject

MOST_SAMPLES = 255
"""Samples along an edge; the longest edge of the subject at the finest spacing needs about 100."""
BATCH_SAMPLES = 400_000
"""Samples evaluated at a time: about 300 MB of temporaries."""


@dataclass(frozen=True)
class AlbedoLattice:
    """Packed samples of every triangle."""

    lattice: np.ndarray
    """(f, 2) uint32: index of the first sample, n."""
    samples: np.ndarray
    """(s,) uint32: red in the lowest ten bits, then green, then blue."""


def lattice_points(n: int) -> np.ndarray:
    """Barycentrics (s, 3) of a lattice with n + 1 samples a side, in the order in which they are stored."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1))
    inside = i + j <= n
    second, third = i[inside] / n, j[inside] / n
    return np.stack([1 - second - third, second, third], 1)


def bake(subject: Subject, spacing: np.ndarray) -> AlbedoLattice:
    """Sample the albedo of every triangle at most `spacing` (f,) metres apart; fully buried ones only at their corners."""
    n = _subdivisions(subject, spacing)
    count = (n + 1) * (n + 2) // 2
    start = np.cumsum(count) - count
    samples = np.empty(int(count.sum()), np.uint32)
    plain = np.flatnonzero(n == 1)
    samples[(start[plain][:, None] + np.arange(3)).ravel()] = _corners(subject)[subject.faces[plain]].ravel()
    for faces, per_side in _batches(np.where(n == 1, 0, n)):
        points = _points(per_side)
        colour = subject.albedo(np.repeat(faces, len(points)), np.tile(points, (len(faces), 1)))
        samples[(start[faces][:, None] + np.arange(len(points))).ravel()] = pack(colour)
    return AlbedoLattice(np.stack([start, n], 1).astype(np.uint32), samples)


def _corners(subject: Subject) -> np.ndarray:
    """(v,) packed albedo of every vertex: what a lattice of three samples stores, once instead of six times."""
    face = np.empty(len(subject.vertices), np.int64)
    face[subject.faces.ravel()] = np.repeat(np.arange(len(subject.faces)), 3)
    return pack(subject.albedo(face, (subject.faces[face] == np.arange(len(face))[:, None]).astype(np.float64)))


def pack(colour: np.ndarray) -> np.ndarray:
    """(s, 3) in [0, 1] as (s,) words of three times ten bits."""
    level = np.rint(np.clip(colour, 0, 1) * 1023).astype(np.uint32)
    return np.asarray(level[:, 0] | level[:, 1] << np.uint32(10) | level[:, 2] << np.uint32(20))


def _subdivisions(subject: Subject, spacing: np.ndarray) -> np.ndarray:
    corner = subject.vertices[subject.faces]
    edge = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(1)
    n = np.clip(np.ceil(edge / spacing), 1, MOST_SAMPLES).astype(np.int64)
    n = np.where(n <= 8, n, (n + 3) // 4 * 4)  # few distinct lattices: each is evaluated in one go
    return np.where((subject.openness[subject.faces] == 0).all(1), 1, n)


def _batches(n: np.ndarray) -> Iterator[tuple[np.ndarray, int]]:
    """Triangles with the same n > 0, in pieces of `BATCH_SAMPLES` samples."""
    for per_side in np.unique(n[n > 0]).tolist():
        faces = np.flatnonzero(n == per_side)
        most = max(BATCH_SAMPLES // len(_points(per_side)), 1)
        for first in range(0, len(faces), most):
            yield faces[first : first + most], per_side


_points = lru_cache(maxsize=256)(lattice_points)
