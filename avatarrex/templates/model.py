"""Parametric templates in the SMPL-X layout (docs/person.md): shape, expression, pose blend shapes, skinning.

    v_shaped = v_template + shapedirs·[β, ψ]      v_posed = v_shaped + posedirs·vec(R_1.. − I)      v = LBS(v_posed)

Letters: v vertices, f faces, j joints, s shape and e expression coefficients, q pose directions. Metres, root frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.skinning import blend, joint_transforms, skin, skinning_matrices, tree_levels
from avatarrex.signals.driving import Signals
from avatarrex.templates.mesh import vertex_normals

EYES, TEETH = ("left_eye", "right_eye"), ("upper_teeth", "lower_teeth")
MOUTH = (*TEETH, "tongue")
"""Groups of vertices that a template may name."""


@dataclass(frozen=True, eq=False)
class TemplateModel:
    """A template's arrays, as its file gives them. Raises `InputError` where they do not fit each other."""

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
    """Which of the 9·(j−1) entries of vec(R_1.. − I), row by row, each pose direction multiplies; None means all."""
    groups: dict[str, Tensor] = field(default_factory=dict)
    """Vertex indices by group name, where the file names groups."""
    joint_expression_dirs: Float[Tensor, "j 3 e"] | None = None
    """How joints follow the expression where a regressor ties them to the skin (official SMPL-X); None: not at all."""

    def __post_init__(self) -> None:
        v, j, s, e = *self.weights.shape, self.shapedirs.shape[2], self.expression_dirs.shape[2]
        q = 0 if self.posedirs is None else self.posedirs.shape[2]
        wanted: dict[str, tuple[int, ...]] = {
            "v_template": (v, 3), "shapedirs": (v, 3, s), "expression_dirs": (v, 3, e), "posedirs": (v, 3, q),
            "joint_template": (j, 3), "joint_shapedirs": (j, 3, s), "joint_expression_dirs": (j, 3, e),
            "pose_columns": (q,),
        }  # fmt: skip
        for name, shape in wanted.items():
            value = getattr(self, name)
            if value is not None and tuple(value.shape) != shape:
                raise InputError("template", name, f"shape {shape}", tuple(value.shape))
        if len(self.parents) != j or len(tree_levels(self.parents)[0]) != 1:
            raise InputError("template", "parents", f"one tree of {j} joints", list(self.parents))
        if self.posedirs is not None and self.pose_columns is None and q != 9 * (j - 1):
            raise InputError("template", "posedirs", f"{9 * (j - 1)} directions, or pose_columns to name them", q)
        for name, indices, limit in (("faces", self.faces, v), ("pose_columns", self.pose_columns, 9 * (j - 1))):
            if indices is not None and indices.numel() and not (indices.min() >= 0 and indices.max() < limit):
                raise InputError("template", name, f"indices from 0 to {limit - 1}", int(indices.abs().max()))

    def of_groups(self, names: Sequence[str]) -> Bool[Tensor, " v"]:
        """Whether a vertex is of one of the groups; of those that the template has not no vertex is."""
        found = torch.zeros(len(self.v_template), dtype=torch.bool)
        for name in names:
            found[self.groups.get(name, [])] = True
        return found

    def to(self, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> TemplateModel:
        """The same model with its numbers in `dtype`, on `device`."""

        def moved(value: object) -> object:
            if isinstance(value, dict):
                return {name: moved(item) for name, item in value.items()}
            if not isinstance(value, Tensor):
                return value
            return value.to(device=device, dtype=dtype if value.is_floating_point() else None)

        return TemplateModel(**{item.name: moved(getattr(self, item.name)) for item in fields(self)})  # type: ignore[arg-type]

    def double(self) -> TemplateModel:
        """The same model in float64."""
        return self.to(torch.float64)

    @cached_property
    @torch.inference_mode(False)
    def expressive(self) -> tuple[Int[Tensor, " m"], Float[Tensor, "m 3 e"]]:
        """The vertices that any expression moves (a quarter of the default person's) and their directions."""
        rows = (self.expression_dirs != 0).any(-1).any(-1).nonzero()[:, 0]
        return rows, self.expression_dirs[rows]

    @cached_property
    @torch.inference_mode(False)
    def normals(self) -> Float[Tensor, "v 3"]:
        """Unit normals of the rest pose."""
        return vertex_normals(self.v_template.detach(), self.faces)

    def skin_faces(self) -> Int[Tensor, "g 3"]:
        """The faces of the outer skin, which is closed: no eyeballs, teeth, tongue."""
        inner = torch.zeros(len(self.v_template), dtype=torch.bool)
        for name, vertices in self.groups.items():
            inner[vertices] |= name != "body"
        return self.faces[~inner[self.faces].any(1)]

    @cached_property
    def _last_shape(self) -> dict[bytes, tuple[Tensor, Tensor]]:
        """The shaped vertices and joints of the last shape."""
        return {}


@dataclass(frozen=True, eq=False)
class PosedTemplate:
    """A posed template, root frame."""

    vertices: Float[Tensor, "v 3"]
    joints: Float[Tensor, "j 3"]
    joint_transforms: Float[Tensor, "j 4 4"]
    """G_i."""
    skinning: Float[Tensor, "j 4 4"]
    """A_i: rest to posed."""


def shape_template(
    model: TemplateModel, shape: Float[Tensor, " _s"], expression: Float[Tensor, " _e"]
) -> tuple[Float[Tensor, "v 3"], Float[Tensor, "j 3"]]:
    """Rest vertices and joints, metres, of a body shape with an expression.

    Fewer coefficients than the model has are its leading ones. Raises `InputError` for more, or for NaN.
    """
    vertices, joints = _shaped(model, shape)
    if not (expression.any() or expression.requires_grad):
        return vertices, joints
    joints, (rows, directions) = _expressed(model, joints, expression), model.expressive
    return vertices.index_add(0, rows, directions[..., : len(expression)] @ expression), joints


def shape_joints(
    model: TemplateModel, shape: Float[Tensor, " _s"], expression: Float[Tensor, " _e"]
) -> Float[Tensor, "j 3"]:
    """The joints of `shape_template` alone, which are found in a tenth of the time. Raises `InputError` as it does."""
    joints = _shaped(model, shape)[1]
    return _expressed(model, joints, expression) if expression.any() or expression.requires_grad else joints


def _expressed(model: TemplateModel, joints: Tensor, expression: Tensor) -> Tensor:
    used = _checked("expression", expression, model.expression_dirs.shape[2])
    if model.joint_expression_dirs is None:
        return joints
    return joints + model.joint_expression_dirs[..., :used] @ expression


def pose_template(
    model: TemplateModel, pose: Float[Tensor, "_j 3"], shape: Float[Tensor, " _s"], expression: Float[Tensor, " _e"]
) -> PosedTemplate:
    """Pose `model`: `pose` rotvecs (radians) in joint order, the root's zero (root frame) unless it shall turn.

    Raises `InputError` for a wrong length, NaN or Inf.
    """
    if tuple(pose.shape) != (len(model.parents), 3) or not pose.isfinite().all():
        raise InputError("template", "pose", f"({len(model.parents)}, 3) finite numbers", _found(pose))
    rest, joints = shape_template(model, shape, expression)
    rotation = matrix_from_rotvec(pose)
    if model.posedirs is not None:
        feature = (rotation[1:] - torch.eye(3, dtype=rotation.dtype, device=rotation.device)).reshape(-1)
        rest = rest + model.posedirs @ (feature if model.pose_columns is None else feature[model.pose_columns])
    transforms = joint_transforms(rotation, joints, model.parents)
    skinning = skinning_matrices(transforms, joints)
    vertices = skin(blend(skinning, model.weights), rest)
    return PosedTemplate(vertices, transforms[:, :3, 3], transforms, skinning)


def pose_by_signals(model: TemplateModel, signals: Signals) -> PosedTemplate:
    """A whole template in SMPL-X order with hands and face as `signals` say, root frame; single precision."""
    pose = signals.full_pose()
    pose[0] = 0
    values = (torch.from_numpy(value.astype(np.float32)) for value in (pose, signals.shape, signals.expression))
    return pose_template(model, *values)


def skinned_normals(model: TemplateModel, posed: PosedTemplate) -> Float[Tensor, "v 3"]:
    """Unit rest normals turned by the blended joints: where a bent limb folds its skin over, they still point outwards."""
    linear = blend(posed.skinning, model.weights)[:, :, :3]
    return torch.nn.functional.normalize((linear @ model.normals[:, :, None])[:, :, 0], dim=-1)


def _shaped(model: TemplateModel, shape: Tensor) -> tuple[Tensor, Tensor]:
    """v_template + shapedirs β and the joints, from the cache where β is the last one's and needs no gradient."""
    used = _checked("shape", shape, model.shapedirs.shape[2])

    def compute() -> tuple[Tensor, Tensor]:
        vertices = model.v_template + model.shapedirs[..., :used] @ shape
        return vertices, model.joint_template + model.joint_shapedirs[..., :used] @ shape

    if any(value.requires_grad for value in (shape, model.v_template, model.shapedirs, model.joint_template)):
        return compute()
    key, cache = shape.cpu().numpy().tobytes(), model._last_shape
    if key not in cache:
        cache.clear()
        with torch.inference_mode(False):  # the cached tensors may meet a gradient later
            cache[key] = compute()
    return cache[key]


def _checked(name: str, coefficients: Tensor, limit: int) -> int:
    if coefficients.dim() != 1 or len(coefficients) > limit or not coefficients.isfinite().all():
        raise InputError("template", name, f"at most {limit} finite numbers", _found(coefficients))
    return len(coefficients)


def _found(values: Tensor) -> str:
    return f"{tuple(values.shape)}" + ("" if values.isfinite().all() else " with NaN or Inf")
