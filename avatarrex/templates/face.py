"""The face template: head, eyes, teeth and tongue in the head frame, driven by 52 coefficients (paper sec. 3.3).

Everything that an expression moves, and enough of the head around it. `albedo` colours only condition the orthographic
views; they are not the look. Letters: v vertices, f faces. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.templates.model import TemplateModel

HEAD, JAW, LEFT_EYE, RIGHT_EYE = 15, 22, 23, 24
SKIN, EYE_WHITE, IRIS, TEETH, TONGUE = (0.78, 0.6, 0.5), (0.95, 0.95, 0.95), (0.2, 0.3, 0.4), (0.9, 0.88, 0.8), (0.7, 0.35, 0.35)


@dataclass(frozen=True)
class FaceTemplate:
    """The head's template; the head joint is the origin."""

    v_template: Float[Tensor, "v 3"]
    faces: Int[Tensor, "f 3"]
    shapedirs: Float[Tensor, "v 3 s"]
    expression_dirs: Float[Tensor, "v 3 e"]
    weights: Float[Tensor, "v 4"]
    """Skinning weights of head (all that is not jaw or eye), jaw, left eye, right eye."""
    joints: Float[Tensor, "4 3"]
    blend_weight: Float[Tensor, " v"]
    """ω: 1 on the face, 0 towards hair and throat."""
    albedo: Float[Tensor, "v 3"]
    body_vertex_ids: Int[Tensor, " v"]


def pose_face(
    face: FaceTemplate,
    expression: Float[Tensor, " e"],
    jaw_pose: Float[Tensor, " 3"],
    eye_pose: Float[Tensor, "2 3"],
    shape: Float[Tensor, " s"],
) -> Float[Tensor, "v 3"]:
    """Vertices in the head frame, metres: expression offsets, then jaw and eye joints turn (they add)."""
    used = min(len(shape), face.shapedirs.shape[2])
    rest = face.v_template + face.shapedirs[..., :used] @ shape[:used] + face.expression_dirs @ expression
    rotation = matrix_from_rotvec(torch.cat([jaw_pose[None], eye_pose]))
    moved = face.weights[:, :1] * rest
    for k in range(3):
        joint = face.joints[k + 1]
        moved = moved + face.weights[:, k + 1, None] * ((rest - joint) @ rotation[k].T + joint)
    return moved


def cut_face(body: TemplateModel) -> FaceTemplate:
    """Cut the head from a body template whose file names its groups (body, eyes, teeth, tongue)."""
    head = body.joint_template[HEAD]
    on_head = body.weights[:, [HEAD, JAW, LEFT_EYE, RIGHT_EYE]].sum(-1) > 0.5
    local = body.v_template - head
    faces = body.faces[on_head[body.faces].all(1)]
    ids = torch.unique(faces)
    index = torch.full((len(on_head),), -1)
    index[ids] = torch.arange(len(ids))
    head_weights = body.weights[ids][:, [JAW, LEFT_EYE, RIGHT_EYE]]
    weights = torch.cat([1 - head_weights.sum(-1, keepdim=True), head_weights], 1)
    joints = body.joint_template[[HEAD, JAW, LEFT_EYE, RIGHT_EYE]] - head
    return FaceTemplate(
        v_template=local[ids],
        faces=index[faces],
        shapedirs=body.shapedirs[ids] - body.joint_shapedirs[HEAD],
        expression_dirs=body.expression_dirs[ids],
        weights=weights,
        joints=joints,
        blend_weight=paint_face(body, local)[ids],
        albedo=_albedo(body)[ids],
        body_vertex_ids=ids,
    )


def paint_face(body: TemplateModel, local: Float[Tensor, "v 3"]) -> Float[Tensor, " v"]:
    """ω on the body's vertices (head frame positions `local`): 1 around the middle of the face, 0 from 4 cm beyond.

    The face is what the expressions move: an ellipsoid about the mean of the moved vertices, from brow to chin and ear
    to ear; inner parts (eyes, teeth, tongue) belong to it.
    """
    moved = body.expression_dirs.norm(dim=1).amax(-1) > 2e-3
    centre = (local[moved].amin(0) + local[moved].amax(0)) / 2
    half = (local[moved].amax(0) - local[moved].amin(0)) / 2
    centre[2] = centre[2] - 0.02
    half = half * torch.tensor([0.95, 1.0, 1.2])
    distance = (((local - centre) / half).norm(dim=-1) - 1) * half.mean()
    ramp = (1 - distance / 0.04).clamp(0, 1)
    omega = ramp * ramp * (3 - 2 * ramp)
    omega[body.weights[:, [HEAD, JAW, LEFT_EYE, RIGHT_EYE]].sum(-1) < 0.5] = 0
    for name in ("tongue", "left_eye", "right_eye", "upper_teeth", "lower_teeth"):
        if name in body.groups:
            omega[body.groups[name]] = 1
    return omega


def _albedo(body: TemplateModel) -> Float[Tensor, "v 3"]:
    colour = torch.tensor(SKIN).repeat(len(body.v_template), 1)
    for name, value in (("tongue", TONGUE), ("upper_teeth", TEETH), ("lower_teeth", TEETH)):
        if name in body.groups:
            colour[body.groups[name]] = torch.tensor(value)
    for name in ("left_eye", "right_eye"):
        if name in body.groups:
            ids = body.groups[name]
            ball = body.v_template[ids]
            direction = torch.nn.functional.normalize(ball - (ball.amin(0) + ball.amax(0)) / 2, dim=-1)
            colour[ids] = torch.where(direction[:, 2:] > 0.87, torch.tensor(IRIS), torch.tensor(EYE_WHITE))
    return colour
