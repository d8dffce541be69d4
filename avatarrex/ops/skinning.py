"""Linear blend skinning (SMPL-X): joints to matrices to vertices.

    G_i = G_parent(i) [R_i | J_i − J_parent(i)]        A_i = G_i − [0 | G_i J_i]        v = Σ_i w_i A_i v_rest

Letters: b batch, j joints, v vertices. Metres; rotations as matrices.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

DETERMINANT_FLOOR = 0.05
"""Below this determinant a blended matrix is replaced by a rotation: opposed twists of 170° at equal weights leave 0.0076 and
amplify an inverse 11 times, of 180° leave zero (performance.md, hazards)."""


def joint_transforms(
    rotation: Float[Tensor, "j 3 3"], joints: Float[Tensor, "j 3"], parents: list[int]
) -> Float[Tensor, "j 4 4"]:
    """Global transform G of every joint, `parents` with −1 at the root and every parent before its child."""
    transforms: list[Tensor] = []
    bottom = rotation.new_tensor([[0.0, 0.0, 0.0, 1.0]])
    for j, parent in enumerate(parents):
        offset = joints[j] if parent < 0 else joints[j] - joints[parent]
        local = torch.cat([torch.cat([rotation[j], offset[:, None]], 1), bottom], 0)
        transforms.append(local if parent < 0 else transforms[parent] @ local)
    return torch.stack(transforms)


def skinning_matrices(transforms: Float[Tensor, "j 4 4"], joints: Float[Tensor, "j 3"]) -> Float[Tensor, "j 4 4"]:
    """A_i = G_i − [0 | G_i J_i]: rest positions to posed positions."""
    moved = transforms[:, :3, :3] @ joints[:, :, None]
    skinning = transforms.clone()
    skinning[:, :3, 3] = transforms[:, :3, 3] - moved[:, :, 0]
    return skinning


def blend(skinning: Float[Tensor, "j 4 4"], weights: Float[Tensor, "v j"]) -> Float[Tensor, "v 3 4"]:
    """Σ_i w_i A_i, the upper three rows."""
    return (weights @ skinning[:, :3].reshape(len(skinning), 12)).reshape(-1, 3, 4)


def skin(matrices: Float[Tensor, "v 3 4"], rest: Float[Tensor, "v 3"]) -> Float[Tensor, "v 3"]:
    """Apply blended matrices to rest positions."""
    return (matrices[:, :, :3] @ rest[:, :, None])[:, :, 0] + matrices[:, :, 3]


def skin_reference(
    rotation: Tensor, joints: Tensor, parents: list[int], weights: Tensor, rest: Tensor
) -> Float[Tensor, "v 3"]:
    """The three equations of the module, vertex by vertex and joint by joint."""
    transforms = joint_transforms(rotation, joints, parents)
    posed = torch.zeros_like(rest)
    for v in range(len(rest)):
        for j in range(len(parents)):
            if weights[v, j] == 0:
                continue
            turned = transforms[j, :3, :3] @ (rest[v] - joints[j]) + transforms[j, :3, 3]
            posed[v] = posed[v] + weights[v, j] * turned
    return posed


def invert_affine(matrices: Float[Tensor, "*b 3 4"]) -> Float[Tensor, "*b 3 4"]:
    """Inverse of blended skinning matrices by adjugate, finite for every input.

    Where the determinant is below `DETERMINANT_FLOOR` (opposed twists) the inverse of the nearest rotation is returned
    instead, so that a distance is never amplified without bound.
    """
    linear, offset = matrices[..., :3], matrices[..., 3]
    a, b, c = linear.unbind(-2)
    rows = torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], -1)
    determinant = (a * rows[..., 0]).sum(-1)
    safe = torch.where(determinant < DETERMINANT_FLOOR, torch.ones_like(determinant), determinant)
    inverse = rows / safe[..., None, None]
    weak = determinant < DETERMINANT_FLOOR
    if weak.any():
        inverse = inverse.clone()
        inverse[weak] = _nearest_rotation(linear[weak]).mT
    return torch.cat([inverse, -(inverse @ offset[..., None])], -1)


def _nearest_rotation(linear: Float[Tensor, "b 3 3"]) -> Float[Tensor, "b 3 3"]:
    """Polar factor with determinant +1; the identity's neighbour where the matrix is zero."""
    u, _, vh = torch.linalg.svd(linear.double() + 1e-9 * torch.eye(3, dtype=torch.float64))
    sign = torch.det(u @ vh).sign()
    u = torch.cat([u[..., :2], u[..., 2:] * sign[:, None, None]], -1)
    return (u @ vh).to(linear.dtype)
