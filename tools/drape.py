"""Cloth as level sets: convex cross sections that hang, smooth unions, hems cut and turned in (build time only).

A garment starts as a field F(p) < 0 inside: a *loft* is a stack of convex cross sections along an axis, each stored
as its support function h(t, φ) = max over the section of ⟨x, u_φ⟩, so that F = max_φ ⟨x, u_φ⟩ − h(t, φ); hanging
cloth is a running maximum of h down the axis; lofts and the offset body meet in a polynomial smooth minimum. The zero
level is extracted by marching cubes, relaxed, cut where a second field g > 0, and closed by a turned-in hem and a
recessed cap.

Letters: v vertices, f faces, p points, t positions along an axis, m directions φ. Rest pose, metres, float64.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import igl
import numpy as np
import scipy.ndimage as ndi

from avatarrex.capture.synthetic.mesh import averaging, vertex_normals

Field = Callable[[np.ndarray], np.ndarray]
DIRECTIONS = 72


@dataclass(frozen=True)
class Loft:
    """Convex sections along `frame[2]` from `origin`; section coordinates along `frame[0]` and `frame[1]`."""

    origin: np.ndarray
    frame: np.ndarray
    """(3, 3) orthonormal rows: two section axes, then the loft axis."""
    t: np.ndarray
    """(t,) ascending, uniform."""
    support: np.ndarray
    """(t, m) metres."""

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """(p,) signed distance bound: exact normal to a straight loft's side, negative inside; open at both ends."""
        local = (points - self.origin) @ self.frame.T
        row = np.clip((local[:, 2] - self.t[0]) / (self.t[1] - self.t[0]), 0, len(self.t) - 1.001)
        i, f = row.astype(int), (row % 1)[:, None]
        best = np.full(len(points), -np.inf)
        angle = _angles()
        for start in range(0, len(points), 50_000):
            part = slice(start, start + 50_000)
            h = self.support[i[part]] * (1 - f[part]) + self.support[i[part] + 1] * f[part]
            reach = local[part, :1] * np.cos(angle) + local[part, 1:2] * np.sin(angle)
            best[part] = (reach - h).max(1)
        return best


def loft(
    points: np.ndarray, origin: np.ndarray, frame: np.ndarray, start: float, stop: float, step: float = 0.01
) -> Loft:
    """Sections of the `points` (p, 3) of a body part, from `start` to `stop` along the axis."""
    local = (points - origin) @ frame.T
    t = np.arange(start, stop + step / 2, step)
    support = np.full((len(t), DIRECTIONS), np.nan)
    angle = _angles()
    for k, at in enumerate(t):
        near = local[np.abs(local[:, 2] - at) < 0.75 * step]
        if len(near) >= 3:
            support[k] = (near[:, :1] * np.cos(angle) + near[:, 1:2] * np.sin(angle)).max(0)
    known = np.flatnonzero(~np.isnan(support[:, 0]))
    for m in range(DIRECTIONS):
        support[:, m] = np.interp(t, t[known], support[known, m])
    return Loft(np.asarray(origin), np.asarray(frame), t, support)


def hang(section: Loft, ease: float | np.ndarray, taper: float, smooth: tuple[float, float] = (1.5, 2.0)) -> Loft:
    """Cloth over a loft: `ease` metres off it, narrowing by at most `taper` metres per metre, smoothed."""
    support = section.support + np.broadcast_to(ease, len(section.t))[:, None]
    step = section.t[1] - section.t[0]
    for k in range(1, len(support)):
        support[k] = np.maximum(support[k], support[k - 1] - taper * step)
    wide = ndi.gaussian_filter(support, smooth, mode=("nearest", "wrap"))
    return Loft(section.origin, section.frame, section.t, wide)


def smooth_min(a: np.ndarray, b: np.ndarray, k: float) -> np.ndarray:
    """min(a, b), rounded where they differ by less than `k` metres (lower by k/4 where equal)."""
    h = np.maximum(k - np.abs(a - b), 0) / k
    return np.minimum(a, b) - h * h * k / 4


def smooth_max(a: np.ndarray, b: np.ndarray, k: float) -> np.ndarray:
    """max(a, b), rounded likewise."""
    return -smooth_min(-a, -b, k)


def mesh_distance(vertices: np.ndarray, faces: np.ndarray) -> Field:
    """Signed distance to a closed mesh; the sign is the winding number's."""

    def distance(points: np.ndarray) -> np.ndarray:
        points = np.ascontiguousarray(points)
        squared = igl.point_mesh_squared_distance(points, vertices, faces)[0]
        inside = igl.fast_winding_number(vertices, faces, points) > 0.5
        return np.where(inside, -1, 1) * np.sqrt(squared)

    return distance


def extract(
    field: Field, low: np.ndarray, high: np.ndarray, step: float, rounds: int = 12
) -> tuple[np.ndarray, np.ndarray]:
    """Zero level of `field` in a box: vertices and outward faces, evenly spread by tangential relaxation."""
    count = np.ceil((high - low) / step).astype(int) + 1
    axes = [low[k] + step * np.arange(count[k]) for k in range(3)]
    z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
    grid = np.stack([x.ravel(), y.ravel(), z.ravel()], 1)
    values = field(grid)
    vertices, faces, _ = igl.marching_cubes(values, grid, *count.tolist(), 0.0)
    vertices, faces = np.asarray(vertices), np.asarray(faces)
    lattice = ndi.spline_filter(values.reshape(z.shape), order=2)

    def sample(p: np.ndarray) -> np.ndarray:
        return ndi.map_coordinates(lattice, ((p - low) / step).T[::-1], order=2, prefilter=False, mode="nearest")

    if np.linalg.det(vertices[faces]).sum() < 0:  # six times the volume inside
        faces = faces[:, ::-1]
    mean = averaging(faces, len(vertices))
    for _ in range(rounds):
        move = mean @ vertices - vertices
        normal = vertex_normals(vertices, faces)
        vertices = vertices + 0.6 * (move - normal * (move * normal).sum(1, keepdims=True))
        for _ in range(2):
            gradient = _gradient(sample, vertices, step / 2)
            slope = np.maximum((gradient**2).sum(1), 0.05)
            vertices = vertices - gradient * (sample(vertices) / slope)[:, None]
    return vertices, np.ascontiguousarray(faces)


def cut(vertices: np.ndarray, faces: np.ndarray, level: Field, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Keep where `level` < 0, with clean edges: vertices nearer than 0.3 `step` are first moved onto the cut."""
    value = level(vertices)
    slope = _gradient(level, vertices, 1e-4)
    near = np.abs(value) < 0.3 * step
    pull = value[:, None] * slope / np.maximum((slope**2).sum(1, keepdims=True), 1e-6)
    vertices = np.where(near[:, None], vertices - pull, vertices)
    value = np.where(near, 0.0, value)
    points, kept, split = list(vertices), [], {}

    def between(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in split:
            f = value[a] / (value[a] - value[b])
            split[key] = len(points)
            points.append(vertices[a] + f * (vertices[b] - vertices[a]))
        return split[key]

    sign = np.sign(value)[faces]
    whole = (sign <= 0).all(1) & (sign < 0).any(1)
    for face in faces[(sign < 0).any(1) & (sign > 0).any(1)]:
        ring = []
        for a, b in zip(face, np.roll(face, -1)):
            if value[a] <= 0:
                ring.append(int(a))
            if value[a] * value[b] < 0:
                ring.append(between(int(a), int(b)))
        kept += [[ring[0], ring[k], ring[k + 1]] for k in range(1, len(ring) - 1)]
    faces = np.concatenate([faces[whole], np.array(kept, int).reshape(-1, 3)])
    used, flat = np.unique(faces, return_inverse=True)
    return np.array(points)[used], flat.reshape(-1, 3)


def loops(faces: np.ndarray) -> list[np.ndarray]:
    """Open edge loops as vertex indices, each in the direction of its faces' half-edges."""
    have = set(map(tuple, faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()))
    step = {a: b for a, b in have if (b, a) not in have}
    found = []
    while step:
        start = min(step)
        ring = [start]
        while (following := step.pop(ring[-1])) != start:
            ring.append(following)
        found.append(np.array(ring))
    return sorted(found, key=len, reverse=True)


def close_hems(
    vertices: np.ndarray, faces: np.ndarray, level: Field, thickness: float, depth: Callable[[np.ndarray], float]
) -> tuple[np.ndarray, np.ndarray]:
    """Close every loop of cut cloth: `thickness` inwards, `depth(loop centre)` metres up the inside, a flat cap."""
    normal = vertex_normals(vertices, faces)
    pieces, triangles = [vertices], [faces]
    count = len(vertices)
    for ring in loops(faces):
        edge = vertices[ring]
        centre = edge.mean(0)
        slope = _gradient(level, edge, 1e-4)
        out = _along(normal[ring], 4)
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        up = -_along(slope - out * (out * slope).sum(1, keepdims=True), 4)
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        inner = edge - out * thickness
        top = inner + up * depth(centre) - out * 1.5 * thickness
        middle = top.mean(0)
        rings = [inner, (inner + top) / 2, top, *[middle + (top - middle) * s for s in (0.85, 0.6, 0.3)]]
        previous, size = ring, len(ring)
        for points in rings:
            now = count + np.arange(size)
            triangles.append(_band(previous, now))
            pieces.append(points)
            previous, count = now, count + size
        pieces.append(middle[None])
        triangles.append(np.stack([np.roll(previous, -1), previous, np.full(size, count)], 1))
        count += 1
    return np.concatenate(pieces), np.concatenate(triangles)


def _gradient(field: Field, points: np.ndarray, step: float) -> np.ndarray:
    """(p, 3) central differences, `step` metres to either side."""
    return np.stack([field(points + e) - field(points - e) for e in np.eye(3) * step], 1) / (2 * step)


def _angles() -> np.ndarray:
    return 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS


def _along(values: np.ndarray, rounds: int) -> np.ndarray:
    """Values on a closed loop, smoothed along it."""
    for _ in range(rounds):
        values = 0.5 * values + 0.25 * (np.roll(values, 1, 0) + np.roll(values, -1, 0))
    return values


def _band(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Triangles between an open loop (in its faces' direction) and the loop that continues it."""
    a, b, c, d = first, np.roll(first, -1), second, np.roll(second, -1)
    return np.concatenate([np.stack([b, a, c], 1), np.stack([b, c, d], 1)])
