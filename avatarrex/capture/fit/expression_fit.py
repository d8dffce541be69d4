"""Expression coefficients from a face's landmarks in several cameras, where the head is known: all frames together.

    argmin  Σ_c,l ρ |π_c(H (R (x_l + o_l + D_l ψ) + s)) − p_cl|²/σ²  +  |ψ|²/σ_ψ²  +  2λ Σ ψ  +  |ψ_t − (ψ_{t−1} + ψ_{t+1})/2|²/σ_s²
            +  |R|²/σ_R²  +  |s|²/σ_t²  +  |o|²/σ_o²        with 0 ≤ ψ ≤ 1

H is the head's pose of the first fit, R and s what it is off by. o_l is how this person's face differs from the template's at rest, the same
in all frames: an expression that never changes is taken for the face itself. The face is linear in ψ, so that Gauss–Newton has little
to do; bounds are kept by coordinate descent. No network has a say. Letters: t frames, c cameras, l landmarks, n coefficients that are
sought, m = 6 + n unknowns of a frame. World metres, pixels of ideal pinholes, radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.camera import Camera
from avatarrex.capture.fit.face_marks import FaceMarks
from avatarrex.signals.joints import EXPRESSION_NAMES

SOUGHT = (
    "eyeBlinkLeft", "eyeBlinkRight", "eyeWideLeft", "eyeWideRight", "jawRight", "jawLeft", "jawOpen", "mouthFunnel", "mouthPucker",
    "mouthRight", "mouthLeft", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight", "mouthStretchLeft",
    "mouthStretchRight", "mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft", "mouthUpperUpRight", "browDownLeft",
    "browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight",
)  # fmt: skip
"""What 52 landmarks tell; gaze, squint, cheeks, nose, tongue, jawForward and what rolls, presses, shrugs or closes the lips stay at rest."""
ROWS = np.array([EXPRESSION_NAMES.index(name) for name in SOUGHT])
MARK_SIGMA, PIXEL_SIGMA = 0.002, 1.0
"""σ of a landmark: metres on the face, because detectors do not mark vertices, and pixels beside."""
OUTLIERS = (*np.geomspace(30, 4, 6), *[4.0] * 14)
"""σ at which a landmark's weight has fallen to ¼ (Geman–McClure), by step: the head may be a few centimetres off at first."""
SPARSE = 3.0
"""λ, what a coefficient of 1 costs: of two that undo each other neither is raised."""
WEIGHT_SIGMA, SMOOTH_SIGMA, APART = 1.0, 0.3, 0.3
"""σ_ψ, σ_s, and how far from its neighbours' middle a frame's tie to them has fallen to ¼."""
TURN_SIGMA, SHIFT_SIGMA, OFFSET_SIGMA = 0.1, 0.015, 0.004
"""Radians and metres that the head is off, and metres that a face differs from the template's."""
BEHIND, GRAZING = 0.12, (0.2, 0.5)
"""Metres behind the landmarks from which they face outwards; cosines towards a camera up to which one has no weight, and all of it."""
NEAREST = 0.05
"""Metres before a camera."""
SWEEPS = 40


@dataclass(frozen=True, eq=False)
class Expressions:
    """What landmarks say."""

    weights: np.ndarray
    """ψ, (t, 52)."""
    offsets: np.ndarray
    """o, (l, 3)."""
    places: np.ndarray
    """(t, l, 3) of the fitted landmarks."""
    believed: np.ndarray
    """(t, c, l) which landmarks had more than ¼ of their weight."""


def fit_expressions(
    cameras: tuple[Camera, ...], points: np.ndarray, confidence: np.ndarray, heads: np.ndarray, marks: FaceMarks
) -> Expressions:
    """From points (t, c, l, 2) with confidence (t, c, l), 0 to 1, 0 not seen, and heads (t, 4, 4), world from head."""
    count, directions = len(heads), marks.directions[..., ROWS]
    weights, shifts, offsets = np.zeros((count, len(ROWS))), np.zeros((count, 3)), np.zeros(marks.rest.shape)
    turns = np.tile(np.eye(3), (count, 1, 1))
    for outlier in OUTLIERS:
        turned = _turned(turns, marks.rest + offsets, directions, weights)
        places = _placed(heads, turned + shifts[:, None])
        matrix, right, _ = _equations(cameras, points, confidence, (heads, places, marks.rest), outlier)
        rows = _rows(turned, turns, directions)
        change = _steps(rows, matrix, right, weights, (turns, shifts))
        missing = right - (matrix @ (rows @ change[:, None, :, None]))[..., 0]
        offsets = offsets + _offset_steps(matrix, missing, turns, offsets)
        turns = Rotation.from_rotvec(change[:, 3:6]).as_matrix() @ turns
        shifts, weights = shifts + change[:, :3], np.clip(weights + change[:, 6:], 0, 1)
    places = _placed(heads, _turned(turns, marks.rest + offsets, directions, weights) + shifts[:, None])
    believed = _equations(cameras, points, confidence, (heads, places, marks.rest), OUTLIERS[-1])[2]
    whole = np.zeros((count, len(EXPRESSION_NAMES)))
    whole[:, ROWS] = _filled(weights, np.asarray(believed.any((1, 2))))
    return Expressions(whole, offsets, places, believed)


def _filled(weights: np.ndarray, known: np.ndarray) -> np.ndarray:
    """ψ (t, n), in frames that show nothing between those of the nearest that do (t,)."""
    if not known.any():
        return weights
    frames = np.arange(len(weights))
    return np.stack([np.interp(frames, frames[known], column[known]) for column in weights.T], 1)


def _turned(turns: np.ndarray, rest: np.ndarray, directions: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(t, l, 3) R (x + o + D ψ)."""
    return np.asarray(np.einsum("tij,tlj->tli", turns, rest + np.einsum("lin,tn->tli", directions, weights)))


def _placed(heads: np.ndarray, local: np.ndarray) -> np.ndarray:
    """(t, l, 3) in the world, of places in head frames."""
    return np.asarray(np.einsum("tij,tlj->tli", heads[:, :3, :3], local) + heads[:, None, :3, 3])


def _rows(turned: np.ndarray, turns: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(t, l, 3, m) how landmarks move with s, a further turn, and ψ, head frame."""
    frames, count, _ = turned.shape
    rows = np.zeros((frames, count, 3, 6 + directions.shape[2]))
    rows[..., :3] = np.eye(3)
    rows[..., 3:6] = np.cross(np.eye(3), turned[..., None, :]).swapaxes(-1, -2)
    rows[..., 6:] = np.einsum("tij,ljn->tlin", turns, directions)
    return rows


def _equations(
    cameras: tuple[Camera, ...],
    points: np.ndarray,
    confidence: np.ndarray,
    faces: tuple[np.ndarray, np.ndarray, np.ndarray],
    outlier: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each landmark in head frames (t, l, 3, 3), (t, l, 3), and which are believed (t, c, l); `faces` are heads, places and rest."""
    heads, places, rest = faces
    outward = rest - rest.mean(0) + [0, 0, BEHIND]
    outward = np.einsum("tij,lj->tli", heads[:, :3, :3], outward / np.linalg.norm(outward, axis=1, keepdims=True))
    matrix, right = np.zeros((*places.shape, 3)), np.zeros(places.shape)
    believed = np.zeros(confidence.shape, bool)
    for view, camera in enumerate(cameras):
        pixel, depth = camera.pixels(places, NEAREST)
        sigma = np.hypot(PIXEL_SIGMA, MARK_SIGMA * camera.intrinsics[0, 0] / np.maximum(depth, NEAREST))
        away = points[:, view] - pixel
        robust = (1 + (away**2).sum(-1) / (outlier * sigma) ** 2) ** -2
        there = camera.centre - places
        facing = (outward * there).sum(-1) / np.linalg.norm(there, axis=-1)
        seen = (
            np.clip((facing - GRAZING[0]) / (GRAZING[1] - GRAZING[0]), 0, 1) * (depth > NEAREST) * confidence[:, view]
        )
        slopes = camera.slopes(places.reshape(-1, 3)).reshape(*places.shape[:2], 2, 3) @ heads[:, None, :3, :3]
        weighted = (robust * (seen / sigma) ** 2)[..., None, None] * slopes.swapaxes(-1, -2)
        matrix += weighted @ slopes
        right += (weighted @ away[..., None])[..., 0]
        believed[:, view] = (robust > 0.25) & (seen > 0)
    return matrix, right, believed


def _steps(
    rows: np.ndarray, matrix: np.ndarray, right: np.ndarray, weights: np.ndarray, rigid: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """(t, m) steps of all frames, ψ within its bounds."""
    frames, _, _, unknowns = rows.shape
    weighted = (matrix @ rows).reshape(frames, -1, unknowns).swapaxes(1, 2)
    whole = weighted @ rows.reshape(frames, -1, unknowns)
    pull = np.einsum("tlim,tli->tm", rows, right)
    turns, shifts = rigid
    tie = np.repeat([SHIFT_SIGMA**-2, TURN_SIGMA**-2, WEIGHT_SIGMA**-2], (3, 3, len(ROWS)))
    pull -= tie * np.concatenate([shifts, Rotation.from_matrix(turns).as_rotvec(), weights], 1)
    pull[:, 6:] -= SPARSE
    diagonal = np.tile(tie, (frames, 1))
    if frames > 1:
        before, after = np.r_[1, : frames - 1], np.r_[1:frames, frames - 2]
        middle = (weights[before] + weights[after]) / 2 - weights
        joined = (1 + middle**2 / APART**2) ** -2 / SMOOTH_SIGMA**2
        diagonal[:, 6:] += joined
        pull[:, 6:] += joined * middle
    whole[:, np.arange(unknowns), np.arange(unknowns)] += diagonal
    free = np.full((frames, 6), np.inf)
    return _bounded(whole, pull, np.concatenate([-free, -weights], 1), np.concatenate([free, 1 - weights], 1))


def _bounded(matrix: np.ndarray, right: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(t, m) least x·A x/2 − b·x between bounds, of t systems at once: coordinate descent from the free minimum."""
    found = np.clip(np.linalg.solve(matrix, right[..., None])[..., 0], low, high)
    for _ in range(SWEEPS):
        for k in range(found.shape[1]):
            rest = right[:, k] - (matrix[:, k] * found).sum(1)
            found[:, k] = np.clip(found[:, k] + rest / matrix[:, k, k], low[:, k], high[:, k])
    return np.asarray(found)


def _offset_steps(matrix: np.ndarray, missing: np.ndarray, turns: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(l, 3) of o, by what all frames miss together."""
    whole = np.einsum("tji,tljk,tkm->lim", turns, matrix, turns, optimize=True) + np.eye(3) / OFFSET_SIGMA**2
    right = np.einsum("tji,tlj->li", turns, missing) - offsets / OFFSET_SIGMA**2
    return np.asarray(np.linalg.solve(whole, right[..., None])[..., 0])
