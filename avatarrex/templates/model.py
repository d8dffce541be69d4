"""Parametric templates in the SMPL-X layout (formats.md): shape, expression, pose blend shapes, skinning.

    v_shaped = v_template + shapedirs·[β, ψ]      v_posed = v_shaped + posedirs·vec(R_1.. − I)      v = LBS(v_posed)

Letters: v vertices, f faces, j joints, s shape and e expression coefficients, q pose directions. Metres, root frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.skinning import blend, joint_transforms, skin, skinning_matrices


@dataclass(frozen=True)
class TemplateModel:
    """A template's arrays, as its file gives them."""

    v_template: Float[Tensor, "v 3"]
    faces: Int[Tensor, "f 3"]
    shapedirs: Float[Tensor, "v 3 s"]
    expression_dirs: Float[Tensor, "v 3 e"]
    weights: Float[Tensor, "v j"]
    joint_template: Float[Tensor, "j 3"]
    joint_shapedirs: Float[Tensor, "j 3 s"]
    parents: tuple[int, ...]
    joint_names: tuple[str, ...] = ()
    expression_names: tuple[str, ...] = ()
    posedirs: Float[Tensor, "v 3 q"] | None = None
    pose_columns: Int[Tensor, " q"] | None = None
    """Which of the 9·(j−1) entries of vec(R_1.. − I) each pose direction multiplies."""
    groups: dict[str, Tensor] = field(default_factory=dict)
    """Vertex indices by group name, where the file names groups."""

    def double(self) -> TemplateModel:
        """The same model in float64."""
        values = {
            name: value.double() if isinstance(value, Tensor) and value.is_floating_point() else value
            for name, value in vars(self).items()
        }
        return TemplateModel(**values)


@dataclass(frozen=True)
class PosedTemplate:
    """A posed template, root frame."""

    vertices: Float[Tensor, "v 3"]
    joints: Float[Tensor, "j 3"]
    joint_transforms: Float[Tensor, "j 4 4"]
    """G_i."""
    skinning: Float[Tensor, "j 4 4"]
    """A_i: rest to posed."""


def shape_template(
    model: TemplateModel, shape: Float[Tensor, " s"], expression: Float[Tensor, " e"]
) -> tuple[Float[Tensor, "v 3"], Float[Tensor, "j 3"]]:
    """Rest vertices and joints of a body shape with an expression."""
    used = min(len(shape), model.shapedirs.shape[2])
    vertices = model.v_template + model.shapedirs[..., :used] @ shape[:used]
    if bool(expression.any()) or expression.requires_grad:
        vertices = vertices + model.expression_dirs @ expression
    return vertices, model.joint_template + model.joint_shapedirs[..., :used] @ shape[:used]


def pose_template(
    model: TemplateModel, pose: Float[Tensor, "j 3"], shape: Float[Tensor, " s"], expression: Float[Tensor, " e"]
) -> PosedTemplate:
    """Pose `model`: `pose` rotvecs (radians) in joint order, the root's usually zero (root frame)."""
    rest, joints = shape_template(model, shape, expression)
    rotation = matrix_from_rotvec(pose)
    if model.posedirs is not None and model.pose_columns is not None:
        feature = (rotation[1:] - torch.eye(3, dtype=rotation.dtype)).reshape(-1)
        rest = rest + model.posedirs @ feature[model.pose_columns]
    transforms = joint_transforms(rotation, joints, list(model.parents))
    skinning = skinning_matrices(transforms, joints)
    vertices = skin(blend(skinning, model.weights), rest)
    return PosedTemplate(vertices, transforms[:, :3, 3], transforms, skinning)
