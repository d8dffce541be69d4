"""The linear corrections of a surface: ridge regression on joint rotations, group by group, then the strongest directions.

    [Δp, Δc](v) = basis(v)ᵀ · clip(coefficientsᵀ f),   f = vec(R_j − I) of the joints near the group

Letters: n poses, v vertices, g groups, q joints of a group, r rank. Metres at rest; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from avatarrex.fields.body import VISIBLE
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.signals.driving import Signals
from avatarrex.surface.surface import Correction

REACH = 2
"""Bones between a group's joint and those whose turns correct it."""
MOST_JOINTS = 10
RIDGES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Penalties per pose that are tried on held-out poses."""
HELD_OUT = 0.2
"""Share of the poses that choose the penalty."""
RANK = 12
WIDEN = 0.1
"""Share of its range beyond which a coefficient is clipped."""


@dataclass(frozen=True)
class Residuals:
    """What skinning with the baked albedo misses in each pose."""

    signals: list[Signals]
    value: Float[np.ndarray, "n v 6"]
    """Metres at rest, sRGB."""
    found: Bool[np.ndarray, "n v"]


def fit_correction(residuals: Residuals, joint: np.ndarray, parents: tuple[int, ...]) -> tuple[np.ndarray, Correction]:
    """The means (v, 6), and the correction around them; `joint` (v,) is the strongest of each vertex."""
    groups = np.unique(joint)
    group = np.searchsorted(groups, joint).astype(np.uint8)
    joints = np.stack([_near(int(j), parents) for j in groups])
    turns = rotations(residuals.signals)
    v = len(joint)
    mean, basis = np.zeros((v, 6), np.float32), np.zeros((v, RANK, 6), np.float32)
    coefficients = np.zeros((len(groups), 9 * MOST_JOINTS, RANK), np.float32)
    low, high = np.zeros((2, len(groups), RANK), np.float32)
    for g, near in enumerate(joints):
        rows = np.flatnonzero(group == g)
        feature = _features(turns, near)
        mean[rows], weights, directions = _low_rank(feature, residuals, rows)
        rank = weights.shape[1]
        coefficients[g, :, :rank], basis[rows, :rank] = weights, directions
        value = feature @ weights
        wide = WIDEN * np.ptp(value, 0)
        low[g, :rank], high[g, :rank] = value.min(0) - wide, value.max(0) + wide
    return mean, Correction(group, joints.astype(np.int32), coefficients, low, high, basis)


def rotations(signals: list[Signals]) -> Float[np.ndarray, "n 55 9"]:
    """R_j − I of every joint, read row by row."""
    pose = torch.as_tensor(np.stack([one.full_pose() for one in signals]))
    return (matrix_from_rotvec(pose) - torch.eye(3, dtype=pose.dtype)).reshape(len(signals), 55, 9).numpy()


def _near(joint: int, parents: tuple[int, ...]) -> np.ndarray:
    """The joints within `REACH` bones, nearest first, padded with −1; the root does not turn."""
    distance = {joint: 0}
    for step in range(1, REACH + 1):
        edge = [j for j, d in distance.items() if d == step - 1]
        for j in edge:
            for other in [parents[j], *(k for k, parent in enumerate(parents) if parent == j)]:
                if other >= 0:
                    distance.setdefault(other, step)
    near = [j for j in sorted(distance, key=lambda j: (distance[j], j)) if j != 0][:MOST_JOINTS]
    return np.array(near + [-1] * (MOST_JOINTS - len(near)))


def _features(turns: np.ndarray, near: Int[np.ndarray, " q"]) -> Float[np.ndarray, "n 9*q"]:
    return np.where(near[None, :, None] < 0, 0, turns[:, near]).reshape(len(turns), -1)


def _low_rank(feature: np.ndarray, residuals: Residuals, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means (p, 6), coefficients (9q, r) and directions (p, r, 6) of the vertices `rows`."""
    scale = np.array([1, 1, 1, *[1 / VISIBLE] * 3])
    value, found = residuals.value[:, rows] * scale, residuals.found[:, rows]
    n = len(feature)
    mean = (value * found[..., None]).sum(0) / np.maximum(found.sum(0), 1)[:, None]
    centre = feature.mean(0)
    target = np.where(found[..., None], value - mean, 0).reshape(n, -1)
    test = np.arange(n) >= round((1 - HELD_OUT) * n)
    ridge = min(RIDGES, key=lambda r: _miss(feature - centre, target, test, r))
    weights = _solve(feature - centre, target, ridge)
    _, size, right = np.linalg.svd((feature - centre) @ weights, full_matrices=False)
    rank = min(RANK, int((size > 1e-9 * max(size[0], 1e-30)).sum()))
    directions = right[:rank]
    used = weights @ directions.T
    start = mean - ((centre @ used) @ directions).reshape(mean.shape)  # f, not f − its mean, is what is multiplied
    return start / scale, used, directions.reshape(rank, len(rows), 6).transpose(1, 0, 2) / scale


def _solve(feature: np.ndarray, target: np.ndarray, ridge: float) -> np.ndarray:
    gram = feature.T @ feature + ridge * np.eye(feature.shape[1])
    return np.linalg.solve(gram, feature.T @ target)


def _miss(feature: np.ndarray, target: np.ndarray, test: np.ndarray, ridge: float) -> float:
    """Mean square on held-out poses."""
    weights = _solve(feature[~test], target[~test], ridge)
    return float(np.square(feature[test] @ weights - target[test]).mean())
