"""Files of tensors: those of `torch.save`, of which nothing but tensors and plain containers is unpickled, and safetensors."""

from __future__ import annotations

import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import safetensors
import torch
from torch import Tensor

from avatarrex.files.gate import check_bytes, check_file
from avatarrex.files.zips import open_zip, refusing, unpack

TENSOR_BYTES = 2**31
"""Bytes of a file and of what it unpacks to; the largest that is read, Inception-v3, has 95 MB."""

ANYTHING = (Exception,)
"""What `torch.load` raises over strange bytes has no common name."""


def read_torch(path: Path, expected: str, member: str | None = None) -> Any:
    """What `torch.save` wrote, on the CPU; with `member`, of that file inside a `.whl` or `.zip`. Raises `InputError`."""
    check_file(path, expected, TENSOR_BYTES)
    with refusing(path, member or "", "a file of tensors (.pth or .safetensors)", ANYTHING):
        return torch.load(_content(path, expected, member), map_location="cpu", weights_only=True)


def read_safetensors(path: Path, expected: str) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors by name, and the file's own description. Raises `InputError`."""
    check_file(path, expected, TENSOR_BYTES)
    with refusing(path, "", "a complete .safetensors file", ANYTHING), safetensors.safe_open(path, "pt") as file:
        return {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata() or {})  # noqa: SIM118


def _content(path: Path, expected: str, member: str | None) -> Path | BytesIO:
    """What torch is to read: the file, or that member of it, once what it unpacks to is judged."""
    if not zipfile.is_zipfile(path):
        return path
    with open_zip(path, expected) as archive:
        if member and path.suffix in (".whl", ".zip"):
            return BytesIO(unpack(archive, member, TENSOR_BYTES, path, member))
        check_bytes(sum(info.file_size for info in archive.infolist()), path, "", "tensors", TENSOR_BYTES)
    return path
