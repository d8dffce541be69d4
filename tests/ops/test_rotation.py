"""Rotations against scipy, at their hard angles, and their gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation, Slerp

from avatarrex.ops.rotation import (
    cross_matrix,
    matrix_from_quaternion,
    matrix_from_rotvec,
    quaternion_from_matrix,
    quaternion_from_rotvec,
    quaternion_multiply,
    rotvec_from_matrix,
    rotvec_from_quaternion,
    slerp,
)

HARD_ANGLES = (0.0, 1e-12, 1e-7, 1e-4, 3e-3, 3.2e-3, 0.0999, 0.1001, 1.0, 3.1, np.pi - 1e-5, np.pi - 1e-9, np.pi)


def rotvecs(angles: tuple[float, ...] = HARD_ANGLES, seed: int = 0) -> torch.Tensor:
    """Each angle about 20 random axes and the six coordinate ones."""
    rng = np.random.default_rng(seed)
    axes = np.concatenate([rng.normal(size=(20, 3)), np.eye(3), -np.eye(3)])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return torch.from_numpy(np.concatenate([angle * axes for angle in angles]))


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 4e-15), (torch.float32, 1e-6)])
def test_matrices_and_quaternions_are_scipys(dtype: torch.dtype, tolerance: float) -> None:
    rotvec = rotvecs()
    wanted = torch.from_numpy(Rotation.from_rotvec(rotvec.numpy()).as_matrix())
    matrix = matrix_from_rotvec(rotvec.to(dtype))
    quaternion = quaternion_from_rotvec(rotvec.to(dtype))
    for found in (matrix, matrix_from_quaternion(quaternion), matrix_from_quaternion(quaternion_from_matrix(matrix))):
        assert found.dtype == dtype
        assert (found - wanted).abs().max() < tolerance


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-14), (torch.float32, 2e-6)])
def test_rotvec_comes_back(dtype: torch.dtype, tolerance: float) -> None:
    # Up to just short of π, where the axis' sign is free (tested below by the matrix).
    rotvec = rotvecs(HARD_ANGLES[:-3]).to(dtype)
    assert (rotvec_from_matrix(matrix_from_rotvec(rotvec)) - rotvec).abs().max() < tolerance
    assert (rotvec_from_quaternion(quaternion_from_rotvec(rotvec)) - rotvec).abs().max() < tolerance


def test_half_turns_come_back_as_the_same_rotation() -> None:
    matrix = matrix_from_rotvec(rotvecs(HARD_ANGLES[-3:]))
    back = rotvec_from_matrix(matrix)
    assert (back.norm(dim=-1) - np.pi).abs().max() < 2e-5
    assert (matrix_from_rotvec(back) - matrix).abs().max() < 1e-14


def test_small_angles_keep_their_digits() -> None:
    """A relative error: sin θ from 1 − cos θ would lose half of them."""
    rotvec = rotvecs((1e-12, 1e-8, 1e-5))
    back = rotvec_from_quaternion(quaternion_from_rotvec(rotvec))
    assert ((back - rotvec).norm(dim=-1) / rotvec.norm(dim=-1)).max() < 1e-15


def test_gradients() -> None:
    rotvec = rotvecs((0.0, 1e-4, 1.0, 3.1), seed=1)[::7].clone().requires_grad_()
    assert torch.autograd.gradcheck(matrix_from_rotvec, rotvec)
    assert torch.autograd.gradcheck(quaternion_from_rotvec, rotvec)
    assert torch.autograd.gradcheck(lambda r: rotvec_from_matrix(matrix_from_rotvec(r)), rotvec)


def test_the_gradient_at_zero_is_the_cross_product() -> None:
    """dR/dr at 0 is [e_k]×, exactly; the +1e-8 trick is wrong by 1e-4 here and the plain formula NaN."""
    for dtype in (torch.float64, torch.float32):
        jacobian = torch.autograd.functional.jacobian(matrix_from_rotvec, torch.zeros(3, dtype=dtype))
        assert torch.equal(jacobian.permute(2, 0, 1), cross_matrix(torch.eye(3, dtype=dtype)))


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_gradients_are_finite_everywhere(dtype: torch.dtype) -> None:
    rotvec = torch.cat([rotvecs(), rotvecs((np.pi, 2 * np.pi, 6.0, 40.0))]).to(dtype).requires_grad_()
    matrix = matrix_from_rotvec(rotvec)
    total = rotvec_from_matrix(matrix).sum() + quaternion_from_rotvec(rotvec).sum() + matrix.sum()
    (gradient,) = torch.autograd.grad(total, rotvec)
    assert gradient.isfinite().all()


def test_quaternion_product_composes() -> None:
    first, second = rotvecs((1.0, 2.5), seed=2), rotvecs((0.3, 3.0), seed=3)
    product = quaternion_multiply(quaternion_from_rotvec(first), quaternion_from_rotvec(second))
    wanted = matrix_from_rotvec(first) @ matrix_from_rotvec(second)
    assert (matrix_from_quaternion(product) - wanted).abs().max() < 1e-14


def test_slerp_is_scipys_and_takes_the_short_way() -> None:
    start, end = rotvecs((0.2, 1.0, 3.0), seed=4), rotvecs((2.0, 1.0, 3.0), seed=5)
    fraction = torch.linspace(0, 1, len(start), dtype=torch.float64)
    from_, to = quaternion_from_rotvec(start), -quaternion_from_rotvec(end)
    found = matrix_from_quaternion(slerp(from_, to, fraction))
    for a, b, t, matrix in zip(start.numpy(), end.numpy(), fraction.numpy(), found.numpy()):
        wanted = Slerp([0, 1], Rotation.from_rotvec([a, b]))(t).as_matrix()
        assert np.abs(matrix - wanted).max() < 1e-12
    same = slerp(from_, from_, 0.5)
    assert (same - from_).abs().max() < 1e-15
    assert (slerp(from_, to, 0.0) - from_).abs().max() < 1e-15


def test_batches_of_any_shape() -> None:
    assert matrix_from_rotvec(torch.zeros(3)).shape == (3, 3)
    assert matrix_from_rotvec(torch.zeros(0, 3)).shape == (0, 3, 3)
    assert rotvec_from_matrix(torch.eye(3).expand(2, 1, 5, 3, 3)).shape == (2, 1, 5, 3)
