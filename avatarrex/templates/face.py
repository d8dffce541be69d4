"""The face template: head, eyes, teeth and tongue in the head frame, driven by 52 coefficients (paper sec. 3.3).

The mesh is the whole head with some neck, open below: rigid with the head joint but for jaw and eyes. ω covers eyes,
brows, nose, mouth and chin, and falls to 0 over 4 cm at the hair line, in front of the ears and under the jaw; ears,
scalp and throat belong to the body's field, and are here only for the orthographic views to show. `albedo` colours
those views; it is not the look. Letters: v vertices, f faces, e expression coefficients. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.templates.albedo import inside_mouth, paint_albedo
from avatarrex.templates.blend_weight import smooth_ramp
from avatarrex.templates.mesh import pieces
from avatarrex.templates.model import EYES, TEETH, TemplateModel, pose_template
from avatarrex.templates.submodel import submodel

NECK, HEAD, JAW, LEFT_EYE, RIGHT_EYE = 12, 15, 22, 23, 24
HAIR_LINE = (0.068, 0.028)
"""Metres above the eyes where ω is 0, and below which it is 1: the brows reach 2.4 cm above them."""
EARS = (-0.07, -0.03)
"""Metres in front of the eyes where ω is 0, and beyond which it is 1: the ears' front is at −6 cm."""
THROAT = (-0.055, -0.015)
"""Metres above the jaw line's plane (`above_jaw_line`) where ω is 0, and beyond which it is 1. Lower, the neck's bend
parts the head's rigid mesh from the body; higher, the open jaw does. Measured on the default person, min(ω, 1−ω) times
the distance between the two is at most 7 mm with neck and head bent 29° each, or the jaw fully open."""
JAW_PLANE = (0.0, 0.8, 0.6)
"""The plane's normal, up and to the front: it sinks 37° towards the front, as the jaw does from ear to chin."""
THROAT_MARGIN = 0.03
"""Metres of throat in the mesh beyond the place where ω has reached 0."""

BEFORE = 0.001
"""Metres by which what covers a vertex lies before it."""


@dataclass(frozen=True, eq=False)
class FaceTemplate:
    """The head's template; the head joint is the origin, whatever the shape."""

    model: TemplateModel
    """4 joints: head (with all that is not jaw or eye), jaw, left eye, right eye."""
    blend_weight: Float[Tensor, " v"]
    """ω: 1 on the face, 0 towards hair, ears and throat."""
    albedo: Float[Tensor, "v 3"]
    """sRGB in [0, 1]."""
    body_vertex_ids: Int[Tensor, " v"]
    inside: Bool[Tensor, " v"]
    """Teeth, tongue and the skin of the mouth's cavity about them (`inside_mouth`)."""

    def coefficients(self, signals: Signals) -> np.ndarray:
        """(61,): ψ, then jaw and both eyes as rotation vectors."""
        return np.concatenate([signals.expression, signals.jaw_pose, signals.eye_pose.ravel()])

    def posed(self, coefficients: Float[Tensor, " c"], shape: Float[Tensor, " _s"]) -> Float[Tensor, "v 3"]:
        """`pose_face` of ψ, jaw and eyes in one vector (61,)."""
        expression, jaw, eyes = coefficients.split([len(coefficients) - 9, 3, 6])
        return pose_face(self, expression, jaw, eyes.view(2, 3), shape)

    @property
    def v_template(self) -> Float[Tensor, "v 3"]:
        """Rest vertices, head frame."""
        return self.model.v_template

    @cached_property
    def skin(self) -> Int[Tensor, "f 3"]:
        """Its triangles: the largest of the connected pieces, without eyes, teeth and tongue."""
        piece = pieces(self.faces, len(self.v_template))
        return self.faces[piece == piece.mode().values]

    @property
    def teeth(self) -> Bool[Tensor, " v"]:
        """Vertices of the teeth: open strips, while all else encloses something but for the neck's end."""
        return self.model.of_groups(TEETH)

    @cached_property
    def mouth(self) -> Bool[Tensor, " v"]:
        """What lips enclose: teeth, tongue and, of the skin `inside`, what is covered from the front of this face: where labels do not stay,
        a fitted chin may lie there, too."""
        inside = self.inside.clone()
        named = [
            self.model.groups[name] for name in ("tongue", "upper_teeth", "lower_teeth") if name in self.model.groups
        ]
        skin = inside.clone()
        for rows in named:
            skin[rows] = False
        rows = torch.nonzero(skin)[:, 0]
        inside[rows] = covered(self.v_template[rows], self.v_template, self.faces)
        return inside

    @property
    def faces(self) -> Int[Tensor, "f 3"]:
        """Triangles."""
        return self.model.faces


def pose_face(
    face: FaceTemplate,
    expression: Float[Tensor, " _e"],
    jaw_pose: Float[Tensor, " 3"],
    eye_pose: Float[Tensor, "2 3"],
    shape: Float[Tensor, " _s"],
) -> Float[Tensor, "v 3"]:
    """Vertices in the head frame, metres: expression offsets, then jaw and eye joints turn (they add).

    Raises `InputError` for too many coefficients, NaN or Inf.
    """
    pose = torch.cat([torch.zeros_like(jaw_pose[None]), jaw_pose[None], eye_pose])
    return pose_template(face.model, pose, shape, expression).vertices


def covered(
    points: Float[Tensor, "p 3"], vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]
) -> Bool[Tensor, " p"]:
    """Whether a triangle lies before each point, as it is seen from +Z, by more than `BEFORE`."""
    a, b, c = vertices[faces].double().unbind(1)
    to = points.double()[:, None]
    areas = [_area(q, r, to) for q, r in ((b, c), (c, a), (a, b))]
    whole = torch.stack(areas).sum(0)
    within = torch.stack([part * whole >= 0 for part in areas]).all(0) & (whole.abs() > 0)
    depth = (areas[0] * a[:, 2] + areas[1] * b[:, 2] + areas[2] * c[:, 2]) / torch.where(within, whole, 1.0)
    return (within & (depth > to[..., 2] + BEFORE)).any(1)


def _area(q: Float[Tensor, "f 3"], r: Float[Tensor, "f 3"], to: Float[Tensor, "p 1 3"]) -> Float[Tensor, "p f"]:
    """Twice the signed area of q, r and each point in the plane of x and y."""
    return (q[:, 0] - to[..., 0]) * (r[:, 1] - to[..., 1]) - (q[:, 1] - to[..., 1]) * (r[:, 0] - to[..., 0])


def cut_face(body: TemplateModel) -> FaceTemplate:
    """Cut the head from a body template in SMPL-X joint order. Raises `InputError` where there is no head."""
    kept = _on_head(body) & (above_jaw_line(body) > THROAT[0] - THROAT_MARGIN)
    faces = body.faces[kept[body.faces].all(1)]
    if not len(faces):
        raise InputError("template", "weights", "vertices skinned to the head", "none")
    ids, faces = torch.unique(faces, return_inverse=True)
    index = torch.full((len(kept),), -1)
    index[ids] = torch.arange(len(ids))
    groups = {name: index[rows][index[rows] >= 0] for name, rows in body.groups.items()}
    model = submodel(body, [HEAD, JAW, LEFT_EYE, RIGHT_EYE], lambda values: values[ids], faces, groups)
    albedo = paint_albedo(model.v_template, model.joint_template[2:], groups)
    return FaceTemplate(model, paint_face(body)[ids], albedo, ids, inside_mouth(model.v_template, groups))


def labelled_as(face: FaceTemplate, body: TemplateModel, sized: TemplateModel) -> FaceTemplate:
    """`face`, cut from `sized`, which is `body` in another size, with the lips, brows and mouth that the vertices of `body` have: where a
    fitted face has its teeth and eyes says less of where its lips and brows are. Irises are where its eyeballs look ahead."""
    ids, groups = face.body_vertex_ids, face.model.groups
    rest, eyes = (
        each - body.joint_template[HEAD] for each in (body.v_template[ids], body.joint_template[[LEFT_EYE, RIGHT_EYE]])
    )
    ball = face.model.of_groups(EYES)[:, None]
    albedo = torch.where(ball, face.albedo, paint_albedo(rest, eyes, groups))
    omega = paint_face(sized, inside_mouth(body.v_template, body.groups))[ids]
    return replace(face, blend_weight=omega, albedo=albedo, inside=inside_mouth(rest, groups))


def paint_face(body: TemplateModel, inside: Bool[Tensor, " v"] | None = None) -> Float[Tensor, " v"]:
    """ω of the face on the body's vertices, at rest: a product of three ramps; what is `inside` the mouth (by where its teeth are, unless
    told) and eyeballs belong to the face."""
    eyes = body.joint_template[[LEFT_EYE, RIGHT_EYE]]
    _, up, front = (body.v_template - eyes.mean(0)).unbind(-1)
    jaw = above_jaw_line(body)
    omega = smooth_ramp(-up, -HAIR_LINE[0], -HAIR_LINE[1]) * smooth_ramp(front, *EARS) * smooth_ramp(jaw, *THROAT)
    omega = torch.where(_on_head(body), omega, torch.zeros_like(omega))
    omega[inside_mouth(body.v_template, body.groups) if inside is None else inside] = 1
    for name in ("left_eye", "right_eye"):
        if name in body.groups:
            omega[body.groups[name]] = 1
    return omega


def above_jaw_line(body: TemplateModel) -> Float[Tensor, " v"]:
    """Metres of the body's vertices above the plane under the jaw: through the chin's tip, rising to the back.

    The tip is the furthest forward and down of the vertices on the midline that the jaw moves most.
    """
    local = body.v_template - body.joint_template[HEAD]
    midline = local[:, 0].abs() < (body.joint_template[LEFT_EYE, 0] - body.joint_template[RIGHT_EYE, 0]).abs() / 4
    reach = local[:, 2] - local[:, 1]
    on_chin = midline & (body.weights[:, JAW] > 0.5) & (local[:, 2] > 0)
    if not on_chin.any():
        raise InputError("template", "weights", "a chin skinned to the jaw joint", "none")
    chin = local[torch.where(on_chin, reach, reach.new_tensor(-torch.inf)).argmax()]
    return (local - chin) @ local.new_tensor(JAW_PLANE)


def _on_head(body: TemplateModel) -> Bool[Tensor, " v"]:
    """What neck, head, jaw and eyes move more than the rest of the body does."""
    return body.weights[:, [NECK, HEAD, JAW, LEFT_EYE, RIGHT_EYE]].sum(-1) > 0.5
