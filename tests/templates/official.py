"""Tiny random models in the official SMPL-X layout, and an evaluation of that layout written from the page alone."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

PARENTS = (
    -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15,
    20, 25, 26, 20, 28, 29, 20, 31, 32, 20, 34, 35, 20, 37, 38,
    21, 40, 41, 21, 43, 44, 21, 46, 47, 21, 49, 50, 21, 52, 53,
)  # fmt: skip


def random_official(seed: int, vertices: int = 90) -> dict[str, np.ndarray]:
    """Arrays as an official file holds them: 10 + 10 directions, 486 posedirs, a dense regressor, unsigned parents."""
    rng = np.random.default_rng(seed)
    weights = rng.random((vertices, 55)) ** 12
    regressor = rng.random((55, vertices)) ** 8
    parents = np.array(PARENTS, dtype=np.int64)
    parents[0] = 2**32 - 1
    return {
        "v_template": rng.normal(size=(vertices, 3)) * 0.5,
        "f": rng.integers(0, vertices, (2 * vertices, 3)).astype(np.uint32),
        "shapedirs": rng.normal(size=(vertices, 3, 20)) * 0.02,
        "posedirs": rng.normal(size=(vertices, 3, 486)) * 0.002,
        "J_regressor": regressor / regressor.sum(1, keepdims=True),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": np.stack([parents, np.arange(55)]),
    }


def evaluate(arrays: dict[str, np.ndarray], pose: np.ndarray, shape: np.ndarray, expression: np.ndarray) -> np.ndarray:
    """Posed vertices (v, 3), float64, straight from the formulas of the layout; `n_shape` and joints where given.

    A point skinned to a joint is carried up the tree: turned about the joint, then about its parent, up to the root.
    """
    real = {key: value.astype(np.float64) for key, value in arrays.items() if value.dtype.kind == "f"}
    n_shape = int(arrays.get("n_shape", 10))
    coefficients = np.zeros(real["shapedirs"].shape[2])
    coefficients[: len(shape)] = shape
    coefficients[n_shape : n_shape + len(expression)] = expression
    rest = real["v_template"] + real["shapedirs"] @ coefficients
    explicit = "J_template" in real
    joints = (
        real["J_template"] + real["J_shapedirs"] @ coefficients[:n_shape] if explicit else real["J_regressor"] @ rest
    )
    turn = Rotation.from_rotvec(pose).as_matrix()
    if "posedirs" in real:
        columns = arrays.get("pose_columns", np.arange(real["posedirs"].shape[2]))
        rest = rest + real["posedirs"] @ (turn[1:] - np.eye(3)).ravel()[columns]
    weights = real["weights"] / real["weights"].sum(1, keepdims=True)
    posed = np.zeros_like(rest)
    for joint in range(len(joints)):
        carried, above = rest.copy(), joint
        while above >= 0:
            carried = (carried - joints[above]) @ turn[above].T + joints[above]
            parent = int(arrays["kintree_table"][0, above])
            above = -1 if parent in (-1, 2**32 - 1) else parent
        posed += weights[:, joint, None] * carried
    return posed


def random_pose(rng: np.random.Generator, joints: int = 55) -> np.ndarray:
    """Rotvecs up to π on every joint, about every seventh exactly π."""
    axes = rng.normal(size=(joints, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angle = np.where(rng.random(joints) < 1 / 7, np.pi, rng.uniform(-np.pi, np.pi, joints))
    return axes * angle[:, None]
