"""The light that a person stands in, as far as it depends on the way its surface is turned.

    c = c_net · E(n),    E(n) = 1 + Σ_k h_k Y_k(n)

Ours. The paper's colours know pose and view alone: a limb that is turned as in no training picture keeps the light of where it
hung, a person who turns the light that was in front. Diffuse light is smooth in the normal: nine harmonics have 99 % of it
(Ramamoorthi and Hanrahan 2001), so that eight numbers a channel serve the whole person. n is where the body's anchors, or the
hand's mesh, face: it turns with the limb and is smooth; what is finer stays in c_net. A face that is trained has eight
harmonics of its own, of the light on its rig, and n of its surface; its tone mapping follows. E = 1 until it is trained.

Lamps stand still (`world`): a person who turns is lit from another side. A capture may have drawn a light that turns with the person
(`root`), as avatars of before have it. Colours are evaluated in the root frame, where the light of the world is turned (`Light.over`).

Letters: p points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

DARKEST = 0.1
"""Least E: beyond what was seen the harmonics may go below zero."""
LIGHT_FRAMES = ("root", "world")
"""Frames in which a light may be fixed."""
UNSAID = "root"
"""Of avatars and checkpoints that do not name one: from before there was a choice."""


@dataclass(frozen=True)
class Irradiance:
    """E in one frame."""

    harmonics: Float[Tensor, "8 3"]
    """On body and hands."""
    face: Float[Tensor, "8 3"] | None = None
    """On the face; None: E = 1 there."""

    def __call__(self, normal: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """E of unit normals of body and hands."""
        return _irradiance(self.harmonics, normal)

    def on_face(self, normal: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """E of unit normals of the face."""
        return torch.ones_like(normal) if self.face is None else _irradiance(self.face, normal)

    def mixed(self, normal: Float[Tensor, "p 3"], share: Float[Tensor, " p"]) -> Float[Tensor, "p 3"]:
        """E of unit normals of a surface of which `share` is body or hands, the rest the face."""
        body = share[:, None]
        return body * self(normal) + (1 - body) * self.on_face(normal)

    def turned(self, rotation: Float[Tensor, "3 3"]) -> Irradiance:
        """E'(n) = E(R n): as a frame sees it that R takes to this one."""
        face = None if self.face is None else _turned(self.face, rotation)
        return Irradiance(_turned(self.harmonics, rotation), face)

    def same(self, other: Irradiance) -> bool:
        """Whether both are the same light."""
        if (self.face is None) != (other.face is None):
            return False
        same_face = self.face is None or other.face is None or torch.equal(self.face, other.face)
        return same_face and torch.equal(self.harmonics, other.harmonics)


class Light(nn.Module):
    """Eight harmonics of three channels for body and hands, and as many for the face, in the frame in which the light is fixed."""

    def __init__(self, frame: str = UNSAID) -> None:
        """`frame`: one of `LIGHT_FRAMES`."""
        super().__init__()
        self.frame = frame
        self.harmonics = nn.Parameter(torch.zeros(8, 3))
        self.face: nn.Parameter | None
        self.register_parameter("face", None)
        module: Any = self  # its hooks are untyped in torch
        module.register_load_state_dict_pre_hook(_expect)

    def add_face(self) -> None:
        """Let the face have a light of its own, E = 1 until it is trained, unless it has one."""
        if self.face is None:
            self.face = nn.Parameter(torch.zeros_like(self.harmonics), requires_grad=self.harmonics.requires_grad)

    def expect(self, state: Mapping[str, Tensor]) -> None:
        """Have the light on the face that a state to be loaded has, or none."""
        self.face = None
        if "face" in state:
            self.add_face()

    def learnt_with(self, part: str) -> list[nn.Parameter]:
        """What the training of `body`, with the hands, or `face` learns of it."""
        if part == "body":
            return [self.harmonics]
        return [] if self.face is None else [self.face]

    def forward(self, normal: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """E of unit normals of body and hands in the root frame of a person who is not turned."""
        return Irradiance(self.harmonics)(normal)

    def over(self, world_from_root: Float[np.ndarray, "4 4"]) -> Irradiance:
        """E in the root frame of a person who stands so."""
        light = Irradiance(self.harmonics, self.face)
        if self.frame == "root":
            return light
        return light.turned(torch.as_tensor(world_from_root[:3, :3].copy()).to(self.harmonics))


def basis(normal: Float[Tensor, "p 3"]) -> Float[Tensor, "p 8"]:
    """Y of unit normals."""
    x, y, z = normal.unbind(-1)
    return torch.stack([x, y, z, x * y, y * z, z * x, (3 * z * z - 1) / 2, (x * x - y * y) / 2], -1)


def _expect(light: Light, state: dict[str, Tensor], prefix: str, *rest: Any) -> None:
    light.expect({name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)})


def _irradiance(harmonics: Float[Tensor, "8 3"], normal: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
    return (1 + basis(normal) @ harmonics).clamp_min(DARKEST)


def _turned(harmonics: Float[Tensor, "8 3"], rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "8 3"]:
    linear, quadratic = harmonics[:3], harmonics[3:]
    form = torch.einsum("ijk,kc->cij", _FORMS.to(quadratic), quadratic)  # Y_k(n) = nᵀ F_k n
    form = rotation.T @ form @ rotation
    xx, yy, zz = form.diagonal(dim1=1, dim2=2).unbind(-1)
    found = [2 * form[:, 0, 1], 2 * form[:, 1, 2], 2 * form[:, 2, 0], zz, xx - yy]
    return torch.cat([rotation.T @ linear, torch.stack(found)])


def _forms() -> Float[Tensor, "3 3 5"]:
    """F of the last five, symmetric and without a trace."""
    forms = torch.zeros(3, 3, 5)
    for k, (i, j) in enumerate([(0, 1), (1, 2), (2, 0)]):
        forms[i, j, k] = forms[j, i, k] = 0.5
    forms[range(3), range(3), 3] = torch.tensor([-0.5, -0.5, 1.0])
    forms[range(2), range(2), 4] = torch.tensor([0.5, -0.5])
    return forms


_FORMS = _forms()
