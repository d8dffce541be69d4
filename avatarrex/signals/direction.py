"""Rotations between directions and between frames of two directions. Letters: … leading dimensions."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

TINY = 1e-12


def unit(vectors: np.ndarray) -> np.ndarray:
    """(…, 3) of length one; zero stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), TINY))


def degrees_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(…) angles between directions."""
    sine, cosine = np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1)
    return np.asarray(np.degrees(np.arctan2(sine, cosine)))


def smallest_turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(…, 3, 3) the smallest rotation between directions; the identity where one has no length."""
    a, b = np.broadcast_arrays(start, end)
    length = np.linalg.norm(a, axis=-1, keepdims=True) * np.linalg.norm(b, axis=-1, keepdims=True)
    safe = np.maximum(length, TINY)
    axis, cosine = np.cross(a, b) / safe, (a * b).sum(-1, keepdims=True) / safe
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    # opposite directions have no smallest rotation: a half turn about any normal of them
    spare = unit(np.cross(a, np.eye(3)[np.abs(a).reshape(-1, 3).sum(0).argmin()]))
    axis = np.where(sine > 1e-9, axis / np.maximum(sine, TINY), spare)
    angle = np.where(length > TINY, np.arctan2(sine, cosine), 0.0)
    return np.asarray(Rotation.from_rotvec((axis * angle).reshape(-1, 3)).as_matrix().reshape(*a.shape, 3))


def frame(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(3, 3) columns along `first`, along what of `second` is across it, and across both."""
    first = unit(first)
    second = unit(second - (second @ first) * first)
    return np.stack([first, second, np.cross(first, second)], 1)


def frame_turn(ours: tuple[np.ndarray, np.ndarray], theirs: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(3, 3) the rotation that takes our first direction to theirs, and our second as near to theirs as that lets it."""
    if any(np.linalg.norm(np.cross(unit(a), unit(b))) < 0.1 for a, b in (ours, theirs)):
        return smallest_turn(ours[0], theirs[0])
    return np.asarray(frame(*theirs) @ frame(*ours).T)
