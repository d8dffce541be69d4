"""Mixed precision: while gradients are wanted, the colour networks compute in bfloat16 (torch's autocast).

Distances, positions and weights stay float32: a bfloat16 number has three digits, and a surface needs five. Of use where the
processor has units for bfloat16; without them a step takes longer (docs/training.md).
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor, nn

from avatarrex.avatar import Avatar


def in_bfloat16(avatar: Avatar) -> None:
    """From now on, wherever gradients are wanted."""
    for module in _colour_networks(avatar):
        _Cast(module)


def _colour_networks(avatar: Avatar) -> Iterator[nn.Module]:
    """Those that take features, not positions from which something is looked up."""
    body, face = avatar.body, avatar.face.colour_net
    yield from (body.patch_network, body.colour_blend, avatar.left_hand.head, avatar.right_hand.head, face.mlp)
    if body.colour_local is not None:
        yield body.colour_local
    yield from getattr(face, "unets", ())


class _Cast:
    """Autocast about one module's forward; what comes out is float32."""

    def __init__(self, module: nn.Module) -> None:
        device = next((parameter.device.type for parameter in module.parameters()), "cpu")
        self.context = torch.autocast(device, torch.bfloat16)
        self.entered: list[bool] = []
        module.register_forward_pre_hook(self.enter)
        module.register_forward_hook(self.leave, always_call=True)

    def enter(self, module: nn.Module, arguments: object) -> None:
        """Before the forward."""
        self.entered.append(torch.is_grad_enabled() and any(p.requires_grad for p in module.parameters()))
        if self.entered[-1]:
            self.context.__enter__()

    def leave(self, module: nn.Module, arguments: object, result: Tensor | None) -> Tensor | None:
        """After it, also where it has failed."""
        if self.entered.pop():
            self.context.__exit__(None, None, None)
            return None if result is None else result.float()
        return None
