"""Where networks run: on any device that torch has; everything else stays on the CPU.

A frame and a training step find their points, pairs and neighbours in compiled loops on the CPU (ops/native.py). A network's
inputs are moved to its device and its outputs back, so that callers need not know: three coordinates of a point go there, some
features return. Gradients take the same way.

    place(avatar.body, "cuda")

It has run on an H100, an H200 and, in the tests, on a stand-in for a GPU (tests/elsewhere.py). What it wins: docs/performance.md.
"""

from __future__ import annotations

import logging
import warnings
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from avatarrex.errors import InputError
from avatarrex.fields.local_networks import LocalNetworks
from avatarrex.fields.patches import PatchNetwork
from avatarrex.fields.unet import UNet
from avatarrex.ops.encoding import Encoding

log = logging.getLogger(__name__)
NETWORKS = (LocalNetworks, PatchNetwork, UNet, nn.Sequential, nn.Linear)
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
    """Move the module's networks to `device`, once; they go on taking and returning tensors of the CPU."""
    for network in networks(module):
        place_network(network, device)


def place_network(network: nn.Module, device: torch.device | str) -> None:
    """Move one network to `device`, once, with all that it contains."""
    device = torch.device(device)
    if device.type != "cpu":
        network.to(device)
        network.register_forward_pre_hook(partial(_bring, device=device), with_kwargs=True)
        network.register_forward_hook(_take_back)


def networks(module: nn.Module) -> list[nn.Module]:
    """The networks within a module, none of them within another."""
    if isinstance(module, NETWORKS):
        return [module]
    return [network for child in module.children() for network in networks(child)]


def _bring(_: nn.Module, arguments: Any, named: Any, device: torch.device) -> Any:
    """A network's inputs, on its device."""
    return _moved((arguments, named), device)


def _take_back(_: nn.Module, arguments: Any, output: Any) -> Any:
    return _moved(output, torch.device("cpu"))


def _moved(tree: Any, device: torch.device) -> Any:
    """Every tensor in nested tuples, lists and dicts, and of encodings."""
    if isinstance(tree, Tensor):
        return tree.to(device)
    if isinstance(tree, Encoding):
        return replace(tree, x=tree.x.to(device))
    if isinstance(tree, dict):
        return {key: _moved(value, device) for key, value in tree.items()}
    if isinstance(tree, tuple | list):
        return type(tree)(_moved(value, device) for value in tree)
    return tree
