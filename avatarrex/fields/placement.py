"""Where networks run: on any device that torch has; everything else stays on the CPU.

A frame and a training step find their points, pairs and neighbours in compiled loops on the CPU (ops/native.py). What is
asked of a network is brought to its device and its answer back, so that whoever asks need not know: three coordinates of a
point go there, some features come back. Gradients take the same way.

    place(avatar.body, "cuda")

This has run on a stand-in for a GPU only (tests/elsewhere.py).
"""

from __future__ import annotations

import logging
import warnings
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

log = logging.getLogger(__name__)
NETWORKS = (LocalNetworks, PatchNetwork, UNet, nn.Sequential, nn.Linear, Lpips)
"""What is placed as a whole; numbers beside these (nodes, bounds, eight harmonics of light) stay on the CPU."""


def device_named(name: str) -> torch.device:
    """`cpu`, `cuda`, `cuda:1`, … Raises `InputError` for one from which this torch brings no number back here."""
    try:
        with warnings.catch_warnings(action="ignore"):
            device = torch.device(name)
            if device.type == "cpu" and name != "cpu":
                raise RuntimeError("one processor")
            torch.zeros(1, device=device).cpu()
    except (RuntimeError, AssertionError, NotImplementedError, ImportError, AttributeError) as error:
        log.debug("device %s: %s", name, error)
        raise InputError("--device", "", "what this torch can use here: " + ", ".join(usable()), name) from None
    return device


def usable() -> tuple[str, ...]:
    """The devices that torch finds here."""
    found = torch.accelerator.current_accelerator(check_available=True)
    if found is None:
        return ("cpu (no accelerator was found; a GPU of NVIDIA needs torch's CUDA build and a driver)",)
    return ("cpu", *(f"{found.type}:{k}" for k in range(torch.accelerator.device_count())))


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
