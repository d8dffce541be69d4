"""The corrections of a surface: kernel ridge regression on joint rotations, group by group, then the strongest directions.

    [Δp, Δc](v) = basis(v)ᵀ · clip(weightsᵀ k),   k_n how like the pose is to the n-th observed one (surface/pose_kernel.py)

Where a vertex was not found in a pose, it lies between its neighbours (gaps.py); for its colour what the fit says is taken, and the fit
is made again (expectation and maximisation). Neither counts for the penalty.

Letters: n poses, v vertices, p vertices of a group, g groups, q joints of a group, r rank. Metres at rest; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from avatarrex.fields.body import VISIBLE
from avatarrex.signals.driving import Signals
from avatarrex.surface.pose_kernel import pose_kernel, turns
from avatarrex.surface.surface import Correction

REACH = 3
"""Bones between a group's joint and those whose turns correct it."""
CLOSENESS = 0.25
"""c of a joint by each bone that it is farther away."""
MOST_JOINTS = 12
RIDGES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Penalties that are tried on held-out poses."""
HELD_OUT = 0.2
"""Share of the poses that choose the penalty."""
FILLED = 3
"""How often colours that were not found are taken from the fit."""
RANK = 12
WIDEN = 0.1
"""Share of its range beyond which a coefficient is clipped."""


@dataclass(frozen=True)
class Residuals:
    """What skinning with the baked albedo misses in each pose."""

    signals: list[Signals]
    value: Float[np.ndarray, "n v 6"]
    """Metres at rest, without gaps; sRGB, anything where it was not found."""
    found: Bool[np.ndarray, "n v"]


def fit_correction(
    residuals: Residuals, joint: np.ndarray, parents: tuple[int, ...], most: int = RANK
) -> tuple[np.ndarray, Correction]:
    """The means (v, 6), and the correction around them; `joint` (v,) is the strongest of each vertex, `most` the rank."""
    groups = np.unique(joint)
    group = np.searchsorted(groups, joint).astype(np.uint8)
    joints, closeness = (np.stack(column) for column in zip(*(_near(int(j), parents) for j in groups)))
    poses = np.stack([one.full_pose() for one in residuals.signals]).astype(np.float32)
    turn, v = turns(poses), len(joint)
    mean, basis = np.zeros((v, 6), np.float32), np.zeros((v, most, 6), np.float32)
    weights = np.zeros((len(groups), len(poses), most), np.float32)
    low, high = np.zeros((2, len(groups), most), np.float32)
    for g in range(len(groups)):
        rows = np.flatnonzero(group == g)
        kernel = pose_kernel(turn, turn, joints[g], closeness[g])
        mean[rows], found, directions = _low_rank(kernel, residuals, rows, most)
        rank = found.shape[1]
        weights[g, :, :rank], basis[rows, :rank] = found, directions
        value = kernel @ found
        wide = WIDEN * np.ptp(value, 0)
        low[g, :rank], high[g, :rank] = value.min(0) - wide, value.max(0) + wide
    return mean, Correction(group, poses, joints, closeness, weights, low, high, basis)


def _near(joint: int, parents: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The joints within `REACH` bones, nearest first, padded with −1, and their c; the root does not turn."""
    distance = {joint: 0}
    for step in range(1, REACH + 1):
        edge = [j for j, d in distance.items() if d == step - 1]
        for j in edge:
            for other in [parents[j], *(k for k, parent in enumerate(parents) if parent == j)]:
                if other >= 0:
                    distance.setdefault(other, step)
    near = [j for j in sorted(distance, key=lambda j: (distance[j], j)) if j != 0][:MOST_JOINTS]
    none = MOST_JOINTS - len(near)
    closeness = [CLOSENESS ** distance[j] for j in near] + [0.0] * none
    return np.array(near + [-1] * none, np.int32), np.array(closeness, np.float32)


def _low_rank(
    kernel: Float[np.ndarray, "n n"], residuals: Residuals, rows: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means (p, 6), weights (n, r) and directions (p, r, 6) of the vertices `rows`; r ≤ `most`."""
    scale = np.array([1, 1, 1, *[1 / VISIBLE] * 3])
    value, found = residuals.value[:, rows] * scale, residuals.found[:, rows, None]
    n = len(kernel)
    settled = found | (np.arange(6) < 3)
    mean = (value * settled).sum(0) / np.maximum(settled.sum(0), 1)
    target = np.where(settled, value - mean, 0).reshape(n, -1)
    known, settled = np.broadcast_to(found, value.shape).reshape(n, -1), settled.reshape(n, -1)
    ridge = min(RIDGES, key=lambda penalty: _miss(kernel, target, known, penalty))
    inverse = np.linalg.inv(kernel + ridge * np.eye(n))
    for _ in range(FILLED):
        target = np.where(settled, target, kernel @ (inverse @ target))
    weights = inverse @ target
    _, size, right = np.linalg.svd(kernel @ weights, full_matrices=False)
    rank = min(most, int((size > 1e-9 * max(size[0], 1e-30)).sum()))
    directions = right[:rank]
    return mean / scale, weights @ directions.T, directions.reshape(rank, len(rows), 6).transpose(1, 0, 2) / scale


def _miss(kernel: np.ndarray, target: np.ndarray, known: np.ndarray, ridge: float) -> float:
    """Mean square on held-out poses."""
    n = len(kernel)
    cut = round((1 - HELD_OUT) * n)
    weights = np.linalg.solve(kernel[:cut, :cut] + ridge * np.eye(cut), target[:cut])
    return float(np.square((kernel[cut:, :cut] @ weights - target[cut:])[known[cut:]]).mean())
