"""Linear blend skinning (SMPL-X): joints to matrices to vertices, and back.

    G_i = G_parent(i) [R_i | J_i − J_parent(i)]        A_i = G_i − [0 | G_i J_i]        v = Σ_i w_i A_i v_rest

The way back inverts blended matrices, which opposed twists make singular: `invert_affine` bounds it.
Letters: b batch, j joints, v vertices. Metres; rotations as matrices; a 3×4 matrix maps x to M[:, :3] x + M[:, 3].
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.ops.rotation import matrix_from_quaternion, quaternion_from_matrix, quaternion_multiply

AMPLIFICATION = 8.0
"""The most that an inverse may stretch a distance. Opposed twists at equal weights shrink a limb by cos θ/2, and the
exact inverse stretches 11 times at 170°, 57 at 178°, 1146 at 179.9°. 8 is a twist of 166°, beyond any joint's limit."""
NEARER = (1.0, 0.061, 0.041, 0.023)
"""A bend's quaternion times this is positive where it is nearer to no bend than its negative. Of bends beyond 171° the axis
decides: any such rule has axes on whose two sides it differs, and the larger these numbers, the fewer are within rounding of one."""


@lru_cache(maxsize=64)
def tree_levels(parents: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    """Joints by depth: roots (parent −1), their children, … Raises `InputError` where `parents` is no forest."""
    levels: list[tuple[int, ...]] = []
    above, placed = {-1}, 0
    while placed < len(parents):
        level = tuple(j for j, parent in enumerate(parents) if parent in above)
        if not level:
            raise InputError("template", "parents", "a tree (−1 at the root)", list(parents))
        levels.append(level)
        above, placed = set(level), placed + len(level)
    return tuple(levels)


def joint_transforms(
    rotation: Float[Tensor, "j 3 3"], joints: Float[Tensor, "j 3"], parents: Sequence[int]
) -> Float[Tensor, "j 4 4"]:
    """Global transform G of every joint, one batched product per level of the tree; `parents` has −1 at the root."""
    order, parent, back, rows = _breadth_first(tuple(parents), rotation.device)
    local, offset = rotation[order], joints[order] - joints[parent]
    roots = len(order) - sum(map(len, rows))
    turns, places = [local[:roots]], [joints[order[:roots]]]
    start = roots
    for row in rows:
        level = slice(start, start + len(row))
        turn, place = turns[-1][row], places[-1][row]
        turns.append(turn @ local[level])
        places.append(place + (turn @ offset[level, :, None])[..., 0])
        start += len(row)
    upper = torch.cat([torch.cat(turns), torch.cat(places)[..., None]], -1)[back]
    bottom = upper.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(len(order), 1, 4)
    return torch.cat([upper, bottom], 1)


@lru_cache(maxsize=64)
@torch.inference_mode(False)
def _breadth_first(parents: tuple[int, ...], device: torch.device) -> tuple[Tensor, Tensor, Tensor, list[Tensor]]:
    """Joints level by level, their parents, the way back, and for each level its parents' rows in the level above."""
    levels = tree_levels(parents)
    order = torch.tensor([joint for level in levels for joint in level], device=device)
    parent = torch.tensor(parents, device=device)[order].clamp_min(0)
    rows = [
        torch.tensor([above.index(parents[joint]) for joint in level], device=device)
        for above, level in pairwise(levels)
    ]
    return order, parent, order.argsort(), rows


def skinning_matrices(transforms: Float[Tensor, "j 4 4"], joints: Float[Tensor, "j 3"]) -> Float[Tensor, "j 4 4"]:
    """A_i = G_i − [0 | G_i J_i]: rest positions to posed positions."""
    moved = transforms[:, :, :3] @ joints[:, :, None]
    return torch.cat([transforms[:, :, :3], transforms[:, :, 3:] - moved], -1)


def blend(skinning: Float[Tensor, "j 4 4"], weights: Float[Tensor, "v j"]) -> Float[Tensor, "v 3 4"]:
    """Σ_i w_i A_i, the upper three rows."""
    return (weights @ skinning[:, :3].reshape(len(skinning), 12)).reshape(-1, 3, 4)


def blend_rotations(
    skinning: Float[Tensor, "j 4 4"], weights: Float[Tensor, "v j"], parents: Sequence[int]
) -> Float[Tensor, "v 3 3"]:
    """The rotation of Σ_i w_i q_i (Le and Hodgins 2016, eq. 3), q_i the joints' unit quaternions, each of the sign that is
    nearer to its parent's. A joint bent by less than 180° does not let it vanish; about a half turn, whose ways are equally
    far, the axis decides, and not what is rounded."""
    quaternion = quaternion_from_matrix(skinning[:, :3, :3])
    parent, lineage = _lineage(tuple(parents), skinning.device)
    back = quaternion[parent] * quaternion.new_tensor((1, -1, -1, -1))
    bend = quaternion_multiply(back, quaternion)
    turned = (bend * bend.new_tensor(NEARER)).sum(-1) < 0
    sign = 1 - 2 * ((lineage & turned).sum(-1) % 2)
    return matrix_from_quaternion(weights @ (sign[:, None] * quaternion))


@lru_cache(maxsize=64)
@torch.inference_mode(False)
def _lineage(parents: tuple[int, ...], device: torch.device) -> tuple[Tensor, Tensor]:
    """Each joint's parent, a root's itself, and whom it descends from (j, j), itself among them."""
    line = torch.eye(len(parents), dtype=torch.bool)
    for level in tree_levels(parents)[1:]:
        for joint in level:
            line[joint] |= line[parents[joint]]
    parent = [joint if above < 0 else above for joint, above in enumerate(parents)]
    return torch.tensor(parent, device=device), line.to(device)


def skin(matrices: Float[Tensor, "*b 3 4"], position: Float[Tensor, "*b 3"]) -> Float[Tensor, "*b 3"]:
    """Apply one matrix to each position."""
    x, y, z = position[..., None].unbind(-2)
    return matrices[..., 0] * x + matrices[..., 1] * y + matrices[..., 2] * z + matrices[..., 3]


def skin_reference(
    rotation: Float[Tensor, "j 3 3"],
    joints: Float[Tensor, "j 3"],
    parents: Sequence[int],
    weights: Float[Tensor, "v j"],
    rest: Float[Tensor, "v 3"],
) -> Float[Tensor, "v 3"]:
    """The three equations of the module, joint by joint and vertex by vertex; parents come before children."""
    transforms: list[Tensor] = []
    skinning: list[Tensor] = []
    for i, parent in enumerate(parents):
        local = torch.eye(4, dtype=rest.dtype)
        local[:3, :3] = rotation[i]
        local[:3, 3] = joints[i] if parent < 0 else joints[i] - joints[parent]
        transforms.append(local if parent < 0 else transforms[parent] @ local)
        moved = torch.zeros(4, 4, dtype=rest.dtype)
        moved[:3, 3] = transforms[i][:3, :3] @ joints[i]
        skinning.append(transforms[i] - moved)
    posed = torch.zeros_like(rest)
    for v in range(len(rest)):
        for i in range(len(parents)):
            posed[v] += weights[v, i] * (skinning[i][:3, :3] @ rest[v] + skinning[i][:3, 3])
    return posed


def invert_affine(matrices: Float[Tensor, "*b 3 4"]) -> Float[Tensor, "*b 3 4"]:
    """Inverse of blended skinning matrices by adjugate: finite for every finite input, a stretch of at most
    `AMPLIFICATION` where the exact inverse has more.

    There the matrix's polar rotation is kept (for a twist, half its angle) and only its singular values are raised to
    the floor, so that a point far from a collapsed limb stays far from it at rest; the inverse is continuous where the
    two meet. Differentiable: d(M⁻¹) = −M⁻¹ dM M⁻¹ with the returned inverse.
    """
    linear, offset = matrices[..., :3], matrices[..., 3]
    a, b, c = linear.unbind(-2)
    adjugate = torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], -1)
    determinant = (a * adjugate[..., 0]).sum(-1)
    # |M⁻¹| (Frobenius) = |adj| / |det| bounds 1 / smallest singular value.
    weak = determinant * AMPLIFICATION <= adjugate.detach().square().sum((-2, -1)).sqrt()
    inverse = adjugate / torch.where(weak, torch.ones_like(determinant), determinant)[..., None, None]
    if weak.any():
        exact = linear[weak]
        floored, change = _floored_inverse(exact.detach()), exact - exact.detach()
        inverse = inverse.masked_scatter(weak[..., None, None], floored - floored @ change @ floored)
    return torch.cat([inverse, -(inverse * offset[..., None, :]).sum(-1, keepdim=True)], -1)


def _floored_inverse(linear: Float[Tensor, "b 3 3"]) -> Float[Tensor, "b 3 3"]:
    """V max(S, 1/AMPLIFICATION)⁻¹ Uᵀ, with U Vᵀ a rotation."""
    u, stretch, vt = torch.linalg.svd(linear.double())
    flip = torch.linalg.det(u @ vt).sign()
    # A reflection (three or more opposed joints) counts as collapsed through zero along its weakest axis.
    u = torch.cat([u[..., :2], u[..., 2:] * flip[:, None, None]], -1)
    stretch = torch.cat([stretch[:, :2], stretch[:, 2:] * flip[:, None]], -1).clamp_min(1 / AMPLIFICATION)
    inverse: Tensor = (vt.mT @ (u / stretch[:, None, :]).mT).to(linear.dtype)
    return inverse
