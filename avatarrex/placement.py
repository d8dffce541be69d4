"""Where networks run: on any device that torch has; everything else stays on the CPU.

A frame and a training step find their points, pairs and neighbours in compiled loops on the CPU (ops/native.py). What is
asked of a network is brought to its device and its answer back, so that whoever asks need not know: three coordinates of a
point go there, some features come back. Gradients take the same way.

    place(avatar.body, "cuda")

This has run on a stand-in for a GPU only (tests/pretend_device.py).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils._pytree import tree_map_only

from avatarrex.errors import InputError
from avatarrex.fields.local_networks import LocalNetworks
from avatarrex.fields.patches import PatchNetwork
from avatarrex.fields.unet import UNet
from avatarrex.metrics.perceptual import Lpips
from avatarrex.ops.encoding import Encoding

NETWORKS = (LocalNetworks, PatchNetwork, UNet, nn.Sequential, nn.Linear, Lpips)
"""What is placed as a whole; numbers beside these (nodes, bounds, eight harmonics of light) stay on the CPU."""


def device_named(name: str) -> torch.device:
    """`cpu`, `cuda`, `cuda:1`, … Raises `InputError` for one that this torch cannot use here."""
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        said = str(error).splitlines()[0]
        raise InputError("--device", "", "a device that torch can use here, as cpu", f"{name}: {said}") from None
    return device


def place(module: nn.Module, device: torch.device | str) -> None:
    """Bring the module's networks to `device`, once; they go on taking and giving tensors of the CPU."""
    device = torch.device(device)
    for network in networks(module) if device.type != "cpu" else ():
        network.to(device)
        network.register_forward_pre_hook(_Bring(device), with_kwargs=True)
        network.register_forward_hook(_take_back)


def networks(module: nn.Module) -> list[nn.Module]:
    """The networks within a module, none of them within another."""
    if isinstance(module, NETWORKS):
        return [module]
    return [network for child in module.children() for network in networks(child)]


class _Bring:
    """What a network is asked, on its device."""

    def __init__(self, device: torch.device) -> None:
        self.device = device

    def __call__(self, _: nn.Module, arguments: Any, named: Any) -> tuple[Any, Any]:
        return _moved((arguments, named), self.device)


def _take_back(_: nn.Module, arguments: Any, answer: Any) -> Any:
    return _moved(answer, torch.device("cpu"))


def _moved(tree: Any, device: torch.device) -> Any:
    """Every tensor in nested tuples, lists and dicts, and of encodings."""
    tree = tree_map_only(Encoding, lambda encoding: replace(encoding, x=encoding.x.to(device)), tree)
    return tree_map_only(Tensor, lambda tensor: tensor.to(device), tree)
