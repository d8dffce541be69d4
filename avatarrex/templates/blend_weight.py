"""Painted blend weights ω: how much each part's own field, and how much the body's, makes the surface (paper eq. 13).

Letters: v vertices.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxtyping import Float
from torch import Tensor

if TYPE_CHECKING:
    from avatarrex.templates.face import FaceTemplate
    from avatarrex.templates.hand import HandTemplate


def smooth_ramp(value: Float[Tensor, "*v"], low: float, high: float) -> Float[Tensor, "*v"]:
    """3t² − 2t³ of t = (value − low)/(high − low): exactly 0 up to `low`, exactly 1 from `high`."""
    t = ((value - low) / (high - low)).clamp(0, 1)
    return t * t * (3 - 2 * t)


def scatter_to_body(
    vertices: int, left_hand: HandTemplate, right_hand: HandTemplate, face: FaceTemplate
) -> Float[Tensor, "v 3"]:
    """ω of left hand, right hand and face on a body template of `vertices` vertices; zero where a part has none."""
    painted = face.blend_weight.new_zeros(vertices, 3)
    parts: tuple[HandTemplate | FaceTemplate, ...] = (left_hand, right_hand, face)
    for column, part in enumerate(parts):
        on_body = part.body_vertex_ids >= 0
        painted[part.body_vertex_ids[on_body], column] = part.blend_weight[on_body]
    return painted
