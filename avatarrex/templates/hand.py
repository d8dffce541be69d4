"""Hand templates: MANO-order submeshes of the body, closed by a cap, in the wrist frame (paper sec. 3.2).

The mesh takes some forearm with it and is capped where ω is long zero. It is rigid with the wrist there, while the real
forearm follows the elbow: so ω ramps over the heel of the hand, where the body's own skinning is already the wrist's, and
the forearm stub only closes the solid. Letters: v vertices, f faces. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.templates.model import TemplateModel, pose_template

WRIST = {"left": 20, "right": 21}
FIRST_FINGER = {"left": 25, "right": 40}
FOREARM = 0.06
"""Metres of forearm in the mesh."""
RAMP = (-0.01, 0.03)
"""Metres beyond the wrist joint, towards the fingers, where ω rises from 0 to 1."""


@dataclass(frozen=True)
class HandTemplate:
    """One hand."""

    side: str
    model: TemplateModel
    """16 joints: wrist, then index, middle, pinky, ring, thumb × 3. The wrist joint is the origin."""
    blend_weight: Float[Tensor, " v"]
    """ω: 1 on the hand, 0 on the forearm stub and its cap."""
    body_vertex_ids: Int[Tensor, " v"]
    """Index in the body template; −1 on the cap."""


def pose_hand(
    hand: HandTemplate, hand_pose: Float[Tensor, "15 3"], shape: Float[Tensor, " s"]
) -> Float[Tensor, "v 3"]:
    """Posed vertices in the wrist frame, metres; `hand_pose` φ as rotvecs."""
    pose = torch.cat([torch.zeros_like(hand_pose[:1]), hand_pose])
    posed = pose_template(hand.model, pose, shape, shape.new_zeros(0))
    return posed.vertices - posed.joints[0]


def cut_hand(body: TemplateModel, side: str) -> HandTemplate:
    """Cut the hand of `side` ("left" or "right") from a body template and close it."""
    wrist, first = WRIST[side], FIRST_FINGER[side]
    columns = [wrist, *range(first, first + 15)]
    along = (body.v_template[:, 0] - body.joint_template[wrist, 0]) * (1.0 if side == "left" else -1.0)
    arm = body.weights[:, [wrist - 2, *columns]].sum(-1) > 0.5
    inside = (arm & (along > -FOREARM)).numpy()
    faces = body.faces.numpy()
    kept = faces[inside[faces].all(1)]
    kept = _largest_component(kept)
    ids = np.unique(kept)
    local = np.full(len(inside), -1)
    local[ids] = np.arange(len(ids))
    kept = local[kept]
    loop = _boundary_loop(kept, side)
    centre = len(ids)
    cap = np.stack([loop, np.full(len(loop), centre), np.roll(loop, -1)], 1)
    rim = torch.as_tensor(ids[loop])
    weights = body.weights[ids][:, columns]
    weights = torch.cat([1 - weights[:, 1:].sum(-1, keepdim=True), weights[:, 1:]], 1)
    stub = torch.zeros(1, 16)
    stub[0, 0] = 1
    ramp = ((along[ids] - RAMP[0]) / (RAMP[1] - RAMP[0])).clamp(0, 1)
    omega = ramp * ramp * (3 - 2 * ramp)

    def closed(values: Tensor) -> Tensor:
        return torch.cat([values[ids], values[rim].mean(0, keepdim=True)])

    model = TemplateModel(
        v_template=closed(body.v_template),
        faces=torch.as_tensor(np.concatenate([kept, cap])),
        shapedirs=closed(body.shapedirs),
        expression_dirs=torch.zeros(len(ids) + 1, 3, 0),
        weights=torch.cat([weights, stub]),
        joint_template=body.joint_template[columns],
        joint_shapedirs=body.joint_shapedirs[columns],
        parents=(-1, *(0 if k % 3 == 0 else k for k in range(15))),
        joint_names=tuple(body.joint_names[c] for c in columns),
    )
    body_ids = torch.cat([torch.as_tensor(ids), torch.tensor([-1])])
    return HandTemplate(side, model, torch.cat([omega, torch.zeros(1)]), body_ids)


def _largest_component(faces: np.ndarray) -> np.ndarray:
    """The faces of the largest edge-connected piece."""
    label = np.arange(faces.max() + 1)
    while True:
        lowest = label[faces].min(1)
        new = label.copy()
        np.minimum.at(new, faces, lowest[:, None])
        if (new == label).all():
            break
        label = new
    best = np.bincount(label[faces[:, 0]]).argmax()
    return faces[label[faces[:, 0]] == best]


def _boundary_loop(faces: np.ndarray, side: str) -> np.ndarray:
    """The single open loop of vertex indices, in the order of the open half-edges."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    have = set(map(tuple, edges.tolist()))
    step = {a: b for a, b in have if (b, a) not in have}
    if not step:
        raise InputError("template", f"{side} hand", "one open loop at the wrist", "none")
    loop = [next(iter(step))]
    while step[loop[-1]] != loop[0]:
        loop.append(step[loop[-1]])
    if len(loop) != len(step):
        raise InputError("template", f"{side} hand", "one open loop at the wrist", f"{len(step)} open edges, {len(loop)} in a loop")
    return np.array(loop)
