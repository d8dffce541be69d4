"""Where a user's own network weights lie, and their arrays: never downloaded, never unpickled beyond tensors.

A file is looked for by an explicit path, then by an environment variable (a file, or a folder that holds it), then by
its torch-hub name in torch hub's `checkpoints` folder. `.safetensors`, and `.pth` files (`torch.load(weights_only=True)`).
"""

from __future__ import annotations

import os
import pickle
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from avatarrex.errors import InputError


def find_weights(name: str, variable: str, path: Path | None = None) -> Path | None:
    """The file called `name`, or None where there is none.

    A `path` or variable that names nothing is an `InputError`: who named a file wants that file.
    """
    given, source = (path, str(path)) if path else (os.environ.get(variable), variable)
    if given:
        file = Path(given)
        file = file / name if file.is_dir() else file
        if not file.is_file():
            raise InputError(source, "", f"a weights file such as {name}", f"nothing at {file}")
        return file
    file = Path(torch.hub.get_dir()) / "checkpoints" / name
    return file if file.is_file() else None


def read_weights(file: Path, member: str | None = None) -> dict[str, Tensor]:
    """Tensors by name; with `member`, of that file inside a `.whl` or `.zip`. Raises `InputError`."""
    try:
        if file.suffix == ".safetensors":
            return safetensors.torch.load_file(file)
        source: Path | BytesIO = file
        if member and file.suffix in (".whl", ".zip"):
            with zipfile.ZipFile(file) as archive:
                source = BytesIO(archive.read(member))
        values = torch.load(source, map_location="cpu", weights_only=True)
    except (OSError, EOFError, KeyError, RuntimeError, zipfile.BadZipFile, pickle.UnpicklingError) as error:
        raise InputError(file, member or "", "a file of tensors (.pth or .safetensors)", _line(error)) from None
    except safetensors.SafetensorError as error:
        raise InputError(file, "", "a complete .safetensors file", _line(error)) from None
    if not isinstance(values, Mapping) or not all(isinstance(value, Tensor) for value in values.values()):
        raise InputError(file, member or "", "tensors by name", type(values).__name__)
    return dict(values)


def fill(network: nn.Module, tensors: Mapping[str, Tensor], source: Path) -> None:
    """Copy into `network` what it names; what else the file holds is left. Raises `InputError`."""
    own = network.state_dict()
    for name, value in own.items():
        if name.endswith("num_batches_tracked"):
            continue
        if name not in tensors:
            raise InputError(source, name, f"shape {tuple(value.shape)}", "no such tensor")
        found = tensors[name]
        if found.shape != value.shape or not torch.isfinite(found).all():
            raise InputError(source, name, f"{tuple(value.shape)} finite numbers", tuple(found.shape))
        own[name] = found.to(value.dtype)
    network.load_state_dict(own)
    network.requires_grad_(False).eval()


def _line(error: Exception) -> str:
    text = str(error).strip()
    return text.splitlines()[0][:160] if text else type(error).__name__
