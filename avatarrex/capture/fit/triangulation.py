"""Where points are in space that several cameras have found in their pictures, some of them wrongly.

Each pair of cameras proposes a point, where their rays are nearest to each other; the proposal that most cameras agree with is then moved to
where its agreeing rays are met best. Letters: t frames, c cameras, l points. World metres; pixels of ideal pinholes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from avatarrex.camera import Camera

SIGMA, AGREES = 0.006, 0.018
"""Of a picture's longer side: σ of a point of confidence 1, and how far one may be that agrees."""
PAIRS = 60
"""Pairs of cameras that propose, at most."""
LEAST_ANGLE = np.radians(4.0)
"""Between the rays of a pair."""
STEPS = 4
"""Of Gauss–Newton."""
NEAREST = 0.05
"""Metres before a camera."""


@dataclass(frozen=True, eq=False)
class Points:
    """Triangulated points."""

    position: np.ndarray
    """(t, l, 3); zero where there is none."""
    information: np.ndarray
    """(t, l, 3, 3) inverse covariance, 1/m²; zero where there is none."""
    agree: np.ndarray
    """(t, l) how many cameras agree; 0 where there is none."""

    @property
    def found(self) -> np.ndarray:
        """(t, l) bool."""
        return self.agree > 1


def triangulate(cameras: tuple[Camera, ...], points: np.ndarray, confidence: np.ndarray) -> Points:
    """Of points (t, c, l, 2) with confidence (t, c, l)."""
    frames, _, count, _ = points.shape
    seen = np.moveaxis(points, 2, 1).reshape(frames * count, len(cameras), 2)
    sure = np.moveaxis(confidence, 2, 1).reshape(frames * count, len(cameras))
    place, weight, agree = np.zeros((len(seen), 3)), np.zeros((len(seen), 3, 3)), np.zeros(len(seen), int)
    for start in range(0, len(seen), 2000):
        part = slice(start, start + 2000)
        place[part], weight[part], agree[part] = _some(cameras, seen[part], sure[part])
    return Points(place.reshape(frames, count, 3), weight.reshape(frames, count, 3, 3), agree.reshape(frames, count))


def _some(cameras: tuple[Camera, ...], seen: np.ndarray, sure: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of n points (n, c, 2): place (n, 3), information (n, 3, 3), how many cameras agree (n,)."""
    best, score = np.zeros((len(seen), 3)), np.zeros(len(seen))
    pairs = list(combinations(range(len(cameras)), 2))
    rays = [_rays(camera, seen[:, view]) for view, camera in enumerate(cameras)]
    for one, other in pairs[:: max(1, -(-len(pairs) // PAIRS))]:
        place, apart = _between(cameras[one].centre, rays[one], cameras[other].centre, rays[other])
        valid = (sure[:, one] > 0) & (sure[:, other] > 0) & apart
        off, ahead = _off(cameras, place, seen)
        votes = (sure * np.clip(1 - (off / AGREES) ** 2, 0, None) * ahead).sum(1) * valid
        better = votes > score
        best[better], score[better] = place[better], votes[better]
    weight = np.zeros((len(seen), 3, 3))
    agree = np.zeros((len(seen), len(cameras)), bool)
    for _ in range(STEPS):
        off, ahead = _off(cameras, best, seen)
        agree = (off < AGREES) & ahead & (sure > 0) & (score > 0)[:, None]
        weight, right = _equations(cameras, best, seen, sure * agree)
        solvable = agree.sum(1) > 1
        best[solvable] += np.linalg.solve(weight[solvable], right[solvable][..., None])[..., 0]
    number = agree.sum(1) * (agree.sum(1) > 1)
    kept = number > 0
    return best * kept[:, None], weight * kept[:, None, None], number


def _rays(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Unit directions (n, 3), world, of pixels (n, 2)."""
    rays = np.concatenate([pixels, np.ones((len(pixels), 1))], 1) @ np.linalg.inv(camera.intrinsics).T
    rays = rays @ camera.camera_from_world[:3, :3]
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _between(
    one: np.ndarray, ray: np.ndarray, other: np.ndarray, ray_other: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Middles (n, 3) of the shortest ways between rays, and whether these are far enough from parallel."""
    base, cosine = other - one, (ray * ray_other).sum(1)
    sine = np.maximum(1 - cosine**2, 1e-9)
    along, along_other = ray @ base, ray_other @ base
    first = (along - cosine * along_other) / sine
    second = (cosine * along - along_other) / sine
    return (one + first[:, None] * ray + other + second[:, None] * ray_other) / 2, sine > np.sin(LEAST_ANGLE) ** 2


def _off(cameras: tuple[Camera, ...], place: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, c) distance in the picture, in shares of its longer side, and whether the place is before the camera."""
    off, ahead = np.zeros(seen.shape[:2]), np.zeros(seen.shape[:2], bool)
    for view, camera in enumerate(cameras):
        pixel, depth = camera.pixels(place, NEAREST)
        off[:, view] = np.linalg.norm(pixel - seen[:, view], axis=1) / max(camera.width, camera.height)
        ahead[:, view] = depth > NEAREST
    return off, ahead


def _equations(
    cameras: tuple[Camera, ...], place: np.ndarray, seen: np.ndarray, sure: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations (n, 3, 3) and (n, 3) of a step of each place."""
    matrix, right = np.zeros((len(place), 3, 3)), np.zeros((len(place), 3))
    for view, camera in enumerate(cameras):
        here = camera.seen(place)
        depth = np.maximum(here[:, 2], NEAREST)
        slope = np.zeros((len(place), 2, 3))
        slope[:, 0, 0] = slope[:, 1, 1] = 1 / depth
        slope[:, :, 2] = -here[:, :2] / depth[:, None] ** 2
        rows = camera.intrinsics[:2, :2] @ slope @ camera.camera_from_world[:3, :3]
        off = seen[:, view] - camera.pixels(place, NEAREST)[0]
        weight = (sure[:, view] / (SIGMA * max(camera.width, camera.height))) ** 2
        matrix += np.einsum("n,nai,naj->nij", weight, rows, rows)
        right += np.einsum("n,nai,na->ni", weight, rows, off)
    return matrix, right
