"""Vertex colours of the face template: what conditions the face networks besides the surface (paper sec. 3.3).

Skin, lips, brows, eye white, iris, pupil, teeth and tongue, placed by the model's own groups and joints; a fitted person has those of
the template's vertices (`labelled_as`). They tell the networks which part of the face a pixel shows; they are not the look. sRGB in [0, 1];
metres, head frame.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float
from torch import Tensor

SKIN, LIPS, BROW = (0.78, 0.60, 0.50), (0.66, 0.34, 0.32), (0.30, 0.21, 0.17)
EYE_WHITE, IRIS, PUPIL = (0.93, 0.92, 0.90), (0.27, 0.38, 0.42), (0.05, 0.05, 0.05)
TEETH, TONGUE, MOUTH = (0.90, 0.88, 0.80), (0.68, 0.36, 0.36), (0.30, 0.12, 0.11)
IRIS_ANGLE, PUPIL_ANGLE = 0.45, 0.2
"""Radians from the gaze: an iris is 12 mm wide on a ball of 24 mm."""
BROW_ARCH = (0.021, 0.004, 0.021)
"""Metres: height above the eye's centre, half thickness, half length."""
LIP_SIZE, LIP_DROP = (0.025, 0.0105), 0.003
"""Metres: half width and half height of both lips, and how far their middle lies below the teeth's."""


def paint_albedo(
    vertices: Float[Tensor, "v 3"], eyes: Float[Tensor, "2 3"], groups: Mapping[str, Tensor]
) -> Float[Tensor, "v 3"]:
    """Colours of head-frame `vertices`, by the `eyes`' centres (left, right) and the vertex `groups`."""
    colour = vertices.new_tensor(SKIN).repeat(len(vertices), 1)
    x, y, z = vertices.unbind(-1)
    front = z > eyes[:, 2].mean()
    height, thickness, length = BROW_ARCH
    for eye in eyes:
        along = (x - eye[0]) / length
        over = y - (eye[1] + height - 0.004 * along**2)
        _dab(colour, front & (along.abs() < 1) & (over.abs() < thickness), BROW)
    if "upper_teeth" in groups and "lower_teeth" in groups:
        meet = (vertices[groups["upper_teeth"], 1].amin() + vertices[groups["lower_teeth"], 1].amax()) / 2
        _dab(colour, front & ((x / LIP_SIZE[0]) ** 2 + ((y - meet + LIP_DROP) / LIP_SIZE[1]) ** 2 < 1), LIPS)
        _dab(colour, inside_mouth(vertices, groups), MOUTH)
    for name, value in (("tongue", TONGUE), ("upper_teeth", TEETH), ("lower_teeth", TEETH)):
        if name in groups:
            _dab(colour, groups[name], value)
    for name in ("left_eye", "right_eye"):
        if name in groups:
            ball = vertices[groups[name]]
            gaze = ball - (ball.amin(0) + ball.amax(0)) / 2
            angle = torch.atan2(gaze[:, :2].norm(dim=-1), gaze[:, 2])
            _dab(colour, groups[name], EYE_WHITE)
            _dab(colour, groups[name][angle < IRIS_ANGLE], IRIS)
            _dab(colour, groups[name][angle < PUPIL_ANGLE], PUPIL)
    return colour


def inside_mouth(vertices: Float[Tensor, "v 3"], groups: Mapping[str, Tensor]) -> Bool[Tensor, " v"]:
    """Teeth, tongue and the skin of the mouth's cavity between them: the box of all three, no wider than the tongue
    (wider, it would reach the cheeks). Nothing where the groups are not named."""
    parts = [groups[name] for name in ("tongue", "upper_teeth", "lower_teeth") if name in groups]
    inside = torch.zeros(len(vertices), dtype=torch.bool, device=vertices.device)
    if len(parts) == 3:
        tongue, box = vertices[parts[0]], vertices[torch.cat(parts)]
        low = torch.cat([tongue.amin(0)[:1], box.amin(0)[1:]])
        high = torch.cat([tongue.amax(0)[:1], box.amax(0)[1:]])
        inside = ((vertices >= low) & (vertices <= high)).all(-1)
        inside[torch.cat(parts)] = True
    return inside


def _dab(colour: Tensor, where: Tensor, value: tuple[float, float, float]) -> None:
    colour[where] = colour.new_tensor(value)
