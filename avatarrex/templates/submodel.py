"""A part cut out of a body template: its own vertices and joints, about the part's first joint.

Letters: v vertices, j joints. Metres, in the frame of the part's first joint.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from avatarrex.templates.model import TemplateModel


def submodel(
    body: TemplateModel, joints: list[int], rows: Callable[[Tensor], Tensor], faces: Tensor, groups: dict[str, Tensor]
) -> TemplateModel:
    """The template of `joints`, the first its origin and root, the others (consecutive) with their own weight.

    What they do not move follows the root. `rows` takes the part's vertices from any array (v, …) of the body; `faces`
    and `groups` index them.
    """
    root, first = joints[0], joints[1]
    moving = body.weights[:, joints[1:]]
    posedirs, pose_columns = None, None
    if body.posedirs is not None:
        entry = torch.arange(body.posedirs.shape[2]) if body.pose_columns is None else body.pose_columns
        own = (entry >= 9 * (first - 1)) & (entry < 9 * joints[-1])
        posedirs, pose_columns = rows(body.posedirs[..., own]), entry[own] - 9 * (first - 1)
    follows = body.joint_expression_dirs
    expression_dirs = body.expression_dirs
    if follows is not None:
        expression_dirs, follows = expression_dirs - follows[root], follows[joints] - follows[root]
    return TemplateModel(
        v_template=rows(body.v_template - body.joint_template[root]),
        faces=faces,
        shapedirs=rows(body.shapedirs - body.joint_shapedirs[root]),
        expression_dirs=rows(expression_dirs),
        weights=rows(torch.cat([1 - moving.sum(-1, keepdim=True), moving], 1)),
        joint_template=body.joint_template[joints] - body.joint_template[root],
        joint_shapedirs=body.joint_shapedirs[joints] - body.joint_shapedirs[root],
        parents=(-1, *(joints.index(body.parents[j]) for j in joints[1:])),
        joint_names=tuple(body.joint_names[j] for j in joints) if body.joint_names else (),
        expression_names=body.expression_names,
        posedirs=posedirs,
        pose_columns=pose_columns,
        groups=groups,
        joint_expression_dirs=follows,
    )
