"""Where a user's own network weights lie, and their arrays: never downloaded, never unpickled beyond tensors.

A file is looked for by an explicit path, then by an environment variable (a file, or a folder that holds it), then by
its torch-hub name in torch hub's `checkpoints` folder. `.safetensors`, and `.pth` files (`torch.load(weights_only=True)`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from avatarrex.errors import InputError, check
from avatarrex.files.gate import what_is
from avatarrex.files.tensors import read_safetensors, read_torch

LARGEST_WEIGHT = 1e9
"""No weight of a trained network comes near; its square is still finite in single precision."""


def find_weights(name: str, variable: str, path: Path | None = None) -> Path | None:
    """The file called `name`, or None where there is none.

    A `path` or variable that names nothing is an `InputError`: who named a file wants that file.
    """
    given, source = (path, str(path)) if path else (os.environ.get(variable), variable)
    if given:
        file = Path(given)
        file = file / name if file.is_dir() else file
        if (there := what_is(file)) != "a file":
            found = f"nothing at {file}" if there == "nothing there" else f"{there}: {file}"
            raise InputError(source, "", f"a weights file such as {name}", found)
        return file
    file = Path(torch.hub.get_dir()) / "checkpoints" / name
    return file if file.is_file() else None


def read_weights(file: Path, member: str | None = None) -> dict[str, Tensor]:
    """Tensors by name; with `member`, of that file inside a `.whl` or `.zip`. Raises `InputError`."""
    if file.suffix == ".safetensors":
        return read_safetensors(file, "a weights file")[0]
    values = read_torch(file, "a weights file", member)
    if not isinstance(values, Mapping) or not all(isinstance(value, Tensor) for value in values.values()):
        raise InputError(file, member or "", "tensors by name", type(values).__name__)
    return dict(values)


def fill(network: nn.Module, tensors: Mapping[str, Tensor], source: Path) -> None:
    """Copy into `network` what it names; what else the file holds is left. Raises `InputError`."""
    own = network.state_dict()
    for name, value in own.items():
        if name.endswith("num_batches_tracked"):
            continue
        check(name in tensors, source, name, f"shape {tuple(value.shape)}", "no such tensor")
        found, shape = tensors[name], tuple(value.shape)
        fits = found.shape == shape and torch.isfinite(found).all()
        check(fits, source, name, f"{shape} finite numbers", tuple(found.shape))
        largest = float(found.abs().max()) if found.numel() else 0.0
        check(largest <= LARGEST_WEIGHT, source, name, f"numbers up to {LARGEST_WEIGHT:g}", f"{largest:.4g}")
        own[name] = found.to(value.dtype)
    network.load_state_dict(own)
    network.requires_grad_(False).eval()
