"""Skinning: closed forms, the loops that read like the equations, invariances, and the bounded inverse."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.skinning import (
    AMPLIFICATION,
    blend,
    blend_rotations,
    invert_affine,
    joint_transforms,
    skin,
    skin_reference,
    skinning_matrices,
    tree_levels,
)

TREE = (-1, 0, 0, 1, 3, 3, 2)


def scene(seed: int, vertices: int = 40, parents: tuple[int, ...] = TREE) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Random rotations (one half turn, one at rest), joints, weights, rest positions; float64."""
    rng = torch.Generator().manual_seed(seed)
    rotvec = torch.randn(len(parents), 3, generator=rng, dtype=torch.float64) * 1.5
    rotvec[1] *= np.pi / rotvec[1].norm()
    rotvec[2] = 0
    joints = torch.randn(len(parents), 3, generator=rng, dtype=torch.float64)
    weights = torch.rand(vertices, len(parents), generator=rng, dtype=torch.float64) ** 4
    rest = torch.randn(vertices, 3, generator=rng, dtype=torch.float64)
    return matrix_from_rotvec(rotvec), joints, weights / weights.sum(1, keepdim=True), rest


def lbs(rotation: Tensor, joints: Tensor, weights: Tensor, rest: Tensor, parents: tuple[int, ...] = TREE) -> Tensor:
    skinning = skinning_matrices(joint_transforms(rotation, joints, parents), joints)
    return skin(blend(skinning, weights), rest)


def opposed_twist(degrees: float, dtype: torch.dtype = torch.float64) -> Tensor:
    """(I + R)/2 about a skew axis, with an offset."""
    axis = torch.nn.functional.normalize(torch.tensor([1.0, 0.5, -0.2], dtype=dtype), dim=0)
    linear = (torch.eye(3, dtype=dtype) + matrix_from_rotvec(np.radians(degrees) * axis)) / 2
    return torch.cat([linear, torch.tensor([[0.3], [-0.2], [0.1]], dtype=dtype)], 1)


def test_two_bone_arm() -> None:
    """Shoulder at the origin, elbow at 1, tip at 2 on x, turned by α and β about z: tip = (cos α + cos(α+β), sin …)."""
    alpha, beta = 0.7, -2.1
    rotation = matrix_from_rotvec(torch.tensor([[0, 0, alpha], [0, 0, beta]], dtype=torch.float64))
    joints = torch.tensor([[0.0, 0, 0], [1.0, 0, 0]], dtype=torch.float64)
    rest = torch.tensor([[2.0, 0, 0], [1.0, 0, 0], [0.5, 0, 0]], dtype=torch.float64)
    weights = torch.tensor([[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]], dtype=torch.float64)
    elbow = np.array([np.cos(alpha), np.sin(alpha), 0])
    tip = elbow + np.array([np.cos(alpha + beta), np.sin(alpha + beta), 0])
    assert np.abs(lbs(rotation, joints, weights, rest, (-1, 0)).numpy() - [tip, elbow, elbow / 2]).max() < 1e-15


@pytest.mark.parametrize("seed", range(4))
def test_the_fast_path_is_the_reference(seed: int) -> None:
    rotation, joints, weights, rest = scene(seed)
    wanted = skin_reference(rotation, joints, TREE, weights, rest)
    assert (lbs(rotation, joints, weights, rest) - wanted).abs().max() < 1e-13
    single = lbs(rotation.float(), joints.float(), weights.float(), rest.float())
    assert (single - wanted).abs().max() < 5e-6  # positions of several metres


def test_joints_may_come_in_any_order() -> None:
    """Levels follow the tree, not the numbering: a permuted tree gives the permuted transforms."""
    rotation, joints, _, _ = scene(5)
    order = [3, 6, 0, 5, 2, 4, 1]
    parents = tuple(-1 if TREE[j] < 0 else order.index(TREE[j]) for j in order)
    wanted = joint_transforms(rotation, joints, TREE)[order]
    assert (joint_transforms(rotation[order], joints[order], parents) - wanted).abs().max() < 1e-14


def test_at_rest_nothing_moves() -> None:
    _, joints, weights, rest = scene(0)
    still = torch.eye(3, dtype=torch.float64).expand(len(TREE), 3, 3)
    assert (lbs(still, joints, weights, rest) - rest).abs().max() < 1e-14


def test_a_turned_root_moves_everything_rigidly() -> None:
    rotation, joints, weights, rest = scene(1)
    turn = matrix_from_rotvec(torch.tensor([0.3, -2.0, 0.9], dtype=torch.float64))
    turned = torch.cat([(turn @ rotation[0])[None], rotation[1:]])
    posed = lbs(rotation, joints, weights, rest)
    wanted = (posed - joints[0]) @ turn.T + joints[0]
    assert (lbs(turned, joints, weights, rest) - wanted).abs().max() < 1e-13


def test_moving_the_rest_moves_the_posed() -> None:
    """Weights sum to one, so a translation of rest and joints is one of the result."""
    rotation, joints, weights, rest = scene(2)
    shift = torch.tensor([3.0, -1.0, 2.0], dtype=torch.float64)
    wanted = lbs(rotation, joints, weights, rest) + shift
    assert (lbs(rotation, joints + shift, weights, rest + shift) - wanted).abs().max() < 1e-13


def test_gradients() -> None:
    rotation, joints, weights, rest = (value.requires_grad_() for value in scene(3, vertices=3))
    assert torch.autograd.gradcheck(lbs, (rotation, joints, weights, rest))


def test_gradients_after_inference_mode() -> None:
    """What is cached per tree in inference mode still serves a backward pass."""
    rotation, joints, weights, rest = scene(4, vertices=3, parents=(-1, 0, 1, 1, 0))
    with torch.inference_mode():
        lbs(rotation, joints, weights, rest, (-1, 0, 1, 1, 0))
    lbs(rotation.requires_grad_(), joints, weights, rest, (-1, 0, 1, 1, 0)).sum().backward()
    assert rotation.grad is not None


def test_tree_levels() -> None:
    assert tree_levels(TREE) == ((0,), (1, 2), (3, 6), (4, 5))
    for wrong in ((0,), (1, 0), (-1, 2, 1), (-1, 7)):
        with pytest.raises(InputError, match="parents"):
            tree_levels(wrong)


@pytest.mark.parametrize("degrees", [0, 30, 90, 150, 165])
def test_the_inverse_is_exact_up_to_its_bound(degrees: float) -> None:
    matrix = opposed_twist(degrees).expand(50, 3, 4)
    points = torch.randn(50, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    assert (skin(invert_affine(matrix), skin(matrix, points)) - points).abs().max() < 1e-13


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("degrees", [170, 178, 179.9, 180])
def test_the_inverse_of_opposed_twists_is_bounded(degrees: float, dtype: torch.dtype) -> None:
    """The exact inverse stretches by 11, 57, 1146 and infinity (docs/stress.md)."""
    matrix = opposed_twist(degrees, dtype)
    inverse = invert_affine(matrix)
    assert inverse.isfinite().all()
    stretch = torch.linalg.svdvals(inverse[:, :3])
    assert stretch.max() <= AMPLIFICATION * (1 + 1e-5)
    # A point 10 cm beside the collapsed limb stays at least that far from it: no phantom flesh.
    axis = torch.linalg.svd(matrix[:, :3].double()).Vh[0].to(dtype)
    beside = torch.linalg.cross(axis, torch.tensor([0.0, 0.0, 1.0], dtype=dtype))
    beside = 0.1 * beside / beside.norm()
    origin = skin(inverse, matrix[:, 3])
    moved = skin(inverse, matrix[:, 3] + beside) - origin
    assert (moved - (moved @ axis) * axis).norm() >= 0.1


def test_the_inverse_is_continuous_where_the_bound_sets_in() -> None:
    degrees = np.degrees(2 * np.arccos(1 / AMPLIFICATION))
    below, above = (invert_affine(opposed_twist(degrees + step)) for step in (-1e-6, 1e-6))
    assert (below - above).abs().max() < 1e-5
    # And over the whole sweep no step of 0.1° moves it by more than its slope allows (8² times 0.1° in radians).
    sweep = invert_affine(torch.stack([opposed_twist(d) for d in np.arange(150.0, 180.0, 0.1)]))
    assert (sweep[1:] - sweep[:-1]).abs().max() < AMPLIFICATION**2 * np.radians(0.1)


def test_the_inverse_is_finite_for_anything() -> None:
    rng = torch.Generator().manual_seed(0)
    matrices = [torch.zeros(3, 4), torch.full((3, 4), 1e-30), torch.diag(torch.tensor([1.0, 1.0, -1.0]))]
    matrices[2] = torch.cat([matrices[2], torch.ones(3, 1)], 1)
    several = matrix_from_rotvec(torch.randn(2000, 5, 3, generator=rng) * 3)
    share = torch.rand(2000, 5, 1, 1, generator=rng)
    blended = (several * share / share.sum(1, keepdim=True)).sum(1)
    matrices += list(torch.cat([blended, torch.randn(2000, 3, 1, generator=rng)], -1))
    inverse = invert_affine(torch.stack(matrices))
    assert inverse.isfinite().all()
    assert torch.linalg.svdvals(inverse[..., :3]).max() <= AMPLIFICATION * (1 + 1e-4)


def test_the_inverse_has_its_own_gradient() -> None:
    rng = torch.Generator().manual_seed(1)
    matrix = torch.randn(4, 3, 4, generator=rng, dtype=torch.float64) + torch.eye(3, 4, dtype=torch.float64) * 3
    assert torch.autograd.gradcheck(invert_affine, matrix.requires_grad_())
    collapsed = opposed_twist(180)[None].requires_grad_()
    invert_affine(collapsed).sum().backward()
    assert collapsed.grad is not None
    assert collapsed.grad.isfinite().all()
    assert collapsed.grad.abs().max() <= AMPLIFICATION**2 * 3


def test_half_a_joint_turns_halfway_whatever_turns_before_it() -> None:
    """A vertex that parent and child share turns by half of the child's own angle, within the parent's turn."""
    axis = torch.nn.functional.normalize(torch.tensor([1.0, 0.5, -0.2], dtype=torch.float64), dim=0)
    joints, weights = torch.zeros(3, 3, dtype=torch.float64), torch.tensor([[0, 0.5, 0.5]], dtype=torch.float64)
    for before in np.linspace(-6.0, 6.0, 25):
        parent = torch.tensor([0.3, before, -0.4], dtype=torch.float64)
        for degrees in (-170, -100, 30, 170):
            bend = np.radians(degrees) * axis
            rotation = matrix_from_rotvec(torch.stack([torch.full((3,), 0.7, dtype=torch.float64), parent, bend]))
            skinning = skinning_matrices(joint_transforms(rotation, joints, (-1, 0, 1)), joints)
            expected = rotation[0] @ rotation[1] @ matrix_from_rotvec(bend / 2)
            assert (blend_rotations(skinning, weights, (-1, 0, 1))[0] - expected).abs().max() < 1e-12


def test_a_joint_of_its_own_turns_as_its_matrix() -> None:
    rotation, joints, _, _ = scene(5)
    skinning = skinning_matrices(joint_transforms(rotation, joints, TREE), joints)
    found = blend_rotations(skinning, torch.eye(len(TREE), dtype=torch.float64), TREE)
    torch.testing.assert_close(found, skinning[:, :3, :3], atol=1e-12, rtol=0)


def test_which_way_a_half_turn_goes_is_not_a_matter_of_rounding() -> None:
    """Both ways are equally far: float32 and float64 must take the same one, whatever turns before it."""
    generator = torch.Generator().manual_seed(3)
    joints, weights = torch.zeros(3, 3, dtype=torch.float64), torch.tensor([[0, 0.5, 0.5]], dtype=torch.float64)
    axes = [*torch.eye(3, dtype=torch.float64), *torch.randn(60, 3, generator=generator, dtype=torch.float64)]
    for axis in axes:
        before = torch.randn(2, 3, generator=generator, dtype=torch.float64)
        bend = np.pi * torch.nn.functional.normalize(axis, dim=0)
        rotation = matrix_from_rotvec(torch.stack([*before, bend]))
        skinning = skinning_matrices(joint_transforms(rotation, joints, (-1, 0, 1)), joints)
        exact = blend_rotations(skinning, weights, (-1, 0, 1))
        assert (blend_rotations(skinning.float(), weights.float(), (-1, 0, 1)) - exact).abs().max() < 1e-5, axis
