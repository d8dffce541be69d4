"""The nodes n̄_i on the rest template (paper sec. 3.1): position, orientation and body part.

Farthest point sampling over all template vertices, hands and head included: without them 5.5 % of the hand vertices lie
outside every influence sphere. The anchors that carry the local frames are sampled likewise, in two poses at once.

Letters: n nodes, v vertices, j joints. Rest pose, root frame, metres.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.ops.farthest_points import farthest_points
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.model import TemplateModel, pose_template

PARTS = ("trunk", "left_arm", "right_arm", "left_leg", "right_leg", "head")
"""Part labels; an arm includes its hand, a leg its foot, the collars and the neck belong to the trunk."""
_FINGERS = ("index", "middle", "pinky", "ring", "thumb")
_LIMB = {"arm": ("shoulder", "elbow", "wrist", *_FINGERS), "leg": ("hip", "knee", "ankle", "foot")}
_HEAD = ("head", "jaw", "eye")
NORMAL_SPREAD = 0.03
"""σ of the Gaussian that averages vertex normals around a node, metres: the patch must not follow one fold."""
BENT = {
    **{f"{side}_elbow": (0.0, turn * 2.3, 0.0) for side, turn in (("left", -1), ("right", 1))},
    **{f"{side}_knee": (2.1, 0.0, 0.0) for side in ("left", "right")},
    **{f"{side}_hip": (-1.4, 0.0, 0.0) for side in ("left", "right")},
}
"""Rotvecs in radians of the pose besides the rest pose that anchors are spread over."""


def anchors(model: TemplateModel, count: int, seed: int) -> Int[Tensor, " n"]:
    """Indices of `count` vertices spread over the rest pose and over one with `BENT` joints at once: skin that a bend
    stretches has more of them, and no place is far from one in either pose."""
    pose = model.v_template.new_zeros(len(model.parents), 3)
    for row, name in enumerate(model.joint_names):
        pose[row] = pose.new_tensor(BENT.get(name, (0.0, 0.0, 0.0)))
    shape, expression = (pose.new_zeros(dirs.shape[2]) for dirs in (model.shapedirs, model.expression_dirs))
    bent = pose_template(model, pose, shape, expression).vertices
    return farthest_points(torch.cat([model.v_template, bent], 1), count, seed)


def node_normals(model: TemplateModel, vertex: Int[Tensor, " n"]) -> Float[Tensor, "n 3"]:
    """Unit mean template normal around each listed vertex."""
    normals = vertex_normals(model.v_template, model.faces)
    own = normals[vertex]
    weight = torch.exp(-torch.cdist(model.v_template[vertex], model.v_template).square() / (2 * NORMAL_SPREAD**2))
    weight = weight * (own @ normals.T > 0)  # the far side of a hand faces away: it must not cancel the mean
    return F.normalize(weight @ normals + 1e-6 * own, dim=-1, eps=1e-20)


def plane_axes(normal: Float[Tensor, "n 3"]) -> Float[Tensor, "n 2 3"]:
    """Π_i: rows u (horizontal where the normal is not vertical) and v, so that u × v is the normal."""
    up = normal.new_tensor([0.0, 1.0, 0.0]).expand_as(normal)
    ahead = normal.new_tensor([0.0, 0.0, 1.0]).expand_as(normal)
    reference = torch.where(normal[:, 1:2].abs() < 0.9, up, ahead)
    u = F.normalize(torch.linalg.cross(reference, normal), dim=-1)
    return torch.stack([u, torch.linalg.cross(normal, u)], 1)


def part_labels(joint_names: tuple[str, ...], weights: Float[Tensor, "n j"]) -> Int[Tensor, " n"]:
    """Index into `PARTS` of the part with the largest skinning weight; unnamed joints are trunk."""
    joint_part = torch.tensor([_part_of(name) for name in joint_names] or [0] * weights.shape[1])
    share = weights.new_zeros(len(weights), len(PARTS)).index_add(1, joint_part, weights)
    return share.argmax(1)


def covering_radius(vertices: Float[Tensor, "v 3"], nodes: Float[Tensor, "n 3"]) -> Float[Tensor, ""]:
    """Largest distance of a vertex from its nearest node."""
    return torch.cdist(vertices, nodes).amin(1).max()


def _part_of(joint_name: str) -> int:
    side, _, bone = joint_name.partition("_")
    if joint_name.startswith(_HEAD) or (side in ("left", "right") and bone.startswith("eye")):
        return PARTS.index("head")
    for limb, bones in _LIMB.items():
        if side in ("left", "right") and bone.startswith(bones):
            return PARTS.index(f"{side}_{limb}")
    return 0
