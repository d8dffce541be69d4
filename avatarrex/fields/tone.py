"""Tone mapping of the face's colours into the body capture's light (paper sec. 5.3).

A tiny MLP takes the directions from which both rigs see a point and gives a 3×3 matrix: c ← M(v_body, v_face) c. The body's
direction is in the pelvis frame, the face's in the head frame. M is the identity until it is trained.

Letters: p points. Colours sRGB-encoded in [0, 1].
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from avatarrex.fields.local_networks import mlp
from avatarrex.fields.presets import DIRECTION_OCTAVES, Preset
from avatarrex.ops.encoding import Encoding, channels, encode


class ToneMap(nn.Module):
    """54 → hidden → 9."""

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.network = mlp((2 * channels(DIRECTION_OCTAVES), *preset.face.tone, 9), "relu")
        with torch.no_grad():
            for parameter in self.network[-1].parameters():
                parameter.zero_()

    @property
    def learnt(self) -> bool:
        """Whether M has left the identity."""
        return any(bool(parameter.any()) for parameter in self.network[-1].parameters())

    def matrix(self, from_body: Float[Tensor, "p 3"], from_head: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3 3"]:
        """M of unit view directions in the pelvis and in the head frame."""
        seen: list[Encoding | Tensor] = [Encoding(from_body, DIRECTION_OCTAVES), encode(from_head, DIRECTION_OCTAVES)]
        matrix: Tensor = torch.eye(3).to(from_body) + self.network.of_blocks(seen).reshape(-1, 3, 3)
        return matrix

    def forward(
        self, colour: Float[Tensor, "p 3"], from_body: Float[Tensor, "p 3"], from_head: Float[Tensor, "p 3"]
    ) -> Float[Tensor, "p 3"]:
        """The colours mapped."""
        return (self.matrix(from_body, from_head) @ colour[:, :, None])[:, :, 0]

    def deviation(self) -> Float[Tensor, ""]:
        """Mean squared difference of M from the identity over fixed directions: keeps it from explaining the face."""
        directions = torch.nn.functional.normalize(_DIRECTIONS.to(next(self.parameters()).dtype), dim=-1)
        unit = torch.eye(3).to(directions)
        return (self.matrix(directions, directions.roll(1, 0)) - unit).square().mean()


_DIRECTIONS = torch.randn(64, 3, generator=torch.Generator().manual_seed(0))
