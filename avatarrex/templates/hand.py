"""Hand templates: MANO-order submeshes of the body, closed by a cap, in the wrist frame (paper sec. 3.2).

The mesh takes 6 cm of forearm with it, so that its cap lies where ω is long zero. The stub is rigid with the wrist
while the real forearm follows the elbow, and the thumb moves with φ while the body keeps it flat: ω must rise where
both differences are small, along a line tilted towards the thumb, 1 to 5 cm beyond the wrist joint (see `RAMP`).
Letters: v vertices, f faces, j joints. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.templates.blend_weight import smooth_ramp
from avatarrex.templates.model import TemplateModel, pose_template
from avatarrex.templates.submodel import submodel

ELBOW = {"left": 18, "right": 19}
WRIST = {"left": 20, "right": 21}
FIRST_FINGER = {"left": 25, "right": 40}
MIDDLE1, THUMB1 = 3, 12
"""Offsets from the first finger joint."""
FOREARM = 0.06
"""Metres of forearm in the mesh."""
RAMP = (0.013, 0.053)
"""Metres from the wrist joint, along `TILT`, where ω rises from 0 to 1. Measured on the default person, wrist bent 60°
about an axis or fist closed: where ω is mixed, min(ω, 1−ω) times the distance between hand and body mesh is at most
2.7 mm; for an upright ramp from −1 to 3 cm it is 7.6 mm, from 0 to 4 cm 3.9 mm."""
TILT = 0.6
"""The ramp rises along the hand's axis + TILT × the thumb's side: its root moves with φ, the other side with θ."""


@dataclass(frozen=True, eq=False)
class HandTemplate:
    """One hand."""

    side: str
    model: TemplateModel
    """16 joints: wrist, then index, middle, pinky, ring, thumb × 3. The wrist is the origin, whatever the shape."""
    blend_weight: Float[Tensor, " v"]
    """ω: 1 on the hand, 0 on the forearm stub and its cap."""
    body_vertex_ids: Int[Tensor, " v"]
    """Index in the body template; −1 on the cap."""

    def coefficients(self, signals: Signals) -> np.ndarray:
        """φ of this hand, (15, 3) rotation vectors."""
        return signals.left_hand_pose if self.side == "left" else signals.right_hand_pose

    def posed(self, coefficients: Float[Tensor, "15 3"], shape: Float[Tensor, " _s"]) -> Float[Tensor, "v 3"]:
        """`pose_hand`."""
        return pose_hand(self, coefficients, shape)


def pose_hand(
    hand: HandTemplate, hand_pose: Float[Tensor, "15 3"], shape: Float[Tensor, " _s"]
) -> Float[Tensor, "v 3"]:
    """Posed vertices in the wrist frame, metres; `hand_pose` φ as rotvecs. Raises `InputError` for NaN."""
    pose = torch.cat([torch.zeros_like(hand_pose[:1]), hand_pose])
    return pose_template(hand.model, pose, shape, shape.new_zeros(0)).vertices


def cut_hand(body: TemplateModel, side: str) -> HandTemplate:
    """Cut the hand of `side` ("left" or "right") from a body template and close it.

    Raises `InputError` where the forearm's cut is not one loop.
    """
    wrist, elbow, first = WRIST[side], ELBOW[side], FIRST_FINGER[side]
    columns = [wrist, *range(first, first + 15)]
    forearm = body.joint_template[wrist] - body.joint_template[elbow]
    local = body.v_template - body.joint_template[wrist]
    beyond = local @ torch.nn.functional.normalize(forearm, dim=0) > -FOREARM
    on_arm = body.weights[:, [elbow, *columns]].sum(-1) > 0.5
    faces = body.faces.cpu().numpy()
    faces = _largest_component(faces[(on_arm & beyond).cpu().numpy()[faces].all(1)])
    ids, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    rim = open_loop(faces, f"template: {side} hand")
    cap = np.stack([rim, np.full(len(rim), len(ids)), np.roll(rim, -1)], 1)
    kept = torch.from_numpy(ids)

    def closed(values: Tensor) -> Tensor:
        """Of the kept vertices, and of one more: the middle of the rim."""
        return torch.cat([values[kept], values[kept[rim]].mean(0, keepdim=True)])

    still = replace(
        body, expression_dirs=body.expression_dirs[..., :0], expression_names=(), joint_expression_dirs=None
    )
    model = submodel(still, columns, closed, torch.from_numpy(np.concatenate([faces, cap])), {})
    blend_weight = torch.cat([paint_hand(body, side)[kept], torch.zeros(1)])
    return HandTemplate(side, model, blend_weight, torch.cat([kept, torch.tensor([-1])]))


def paint_hand(body: TemplateModel, side: str) -> Float[Tensor, " v"]:
    """ω of one hand on the body's vertices: 0 up to the wrist, 1 from the middle of the palm."""
    wrist, first = WRIST[side], FIRST_FINGER[side]
    joints = body.joint_template - body.joint_template[wrist]
    axis = torch.nn.functional.normalize(joints[first + MIDDLE1], dim=0)
    thumb = joints[first + THUMB1]
    thumb_side = torch.nn.functional.normalize(thumb - (thumb @ axis) * axis, dim=0)
    uphill = torch.nn.functional.normalize(axis + TILT * thumb_side, dim=0)
    omega = smooth_ramp((body.v_template - body.joint_template[wrist]) @ uphill, *RAMP)
    on_hand = body.weights[:, [ELBOW[side], wrist, *range(first, first + 15)]].sum(-1) > 0.5
    return torch.where(on_hand, omega, torch.zeros_like(omega))


def _largest_component(faces: np.ndarray) -> np.ndarray:
    """The faces of the largest connected piece."""
    if not len(faces):
        return faces
    ends = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    count = faces.max() + 1
    _, label = connected_components(coo_array((np.ones(len(ends)), ends.T), (count, count)), directed=False)
    return np.asarray(faces[label[faces[:, 0]] == np.bincount(label[faces[:, 0]]).argmax()])


def open_loop(faces: np.ndarray, source: str) -> np.ndarray:
    """The vertices of the single open loop, in the order of its half-edges. Raises `InputError` naming `source`."""
    edges = {(int(a), int(b)) for a, b in faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)}
    following = {a: b for a, b in edges if (b, a) not in edges}
    loop = [min(following)] if following else []
    while loop and following.get(loop[-1], loop[0]) != loop[0] and len(loop) <= len(following):
        loop.append(following[loop[-1]])
    if not loop or len(loop) != len(following):
        raise InputError(source, "", "one open loop across the forearm", f"{len(following)} open edges in several")
    return np.array(loop)
