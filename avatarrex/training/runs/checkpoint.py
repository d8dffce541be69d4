"""Checkpoints: a run's whole state on disk, bit for bit, in a folder that is either complete or not there.

    checkpoints/step_00001200/  state.safetensors  every tensor and array
                                state.json         the nesting, and plain values
                                avatar.avatar      optional: the avatar as it stands
                                manifest.json      step, order, score, and size and CRC-32 of the files above

A checkpoint is written under a name that begins with a dot, flushed, and renamed: a process that is killed at any moment
leaves the ones before as they were. `saved` in the manifest counts the checkpoints of a run and gives their order, as
steps begin again with every part. Of a run the last `KEEP` stay, and the one with the best score of each part.
"""

from __future__ import annotations

import json
import logging
import math
import os
import shutil
import time
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.torch
import torch
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.files.gate import check_file, read_bytes
from avatarrex.files.json_text import SMALL, read_json
from avatarrex.files.zips import BROKEN
from avatarrex.training.runs.control import sync_folder

log = logging.getLogger(__name__)
FORMAT = 1
KEEP = 3
MANIFEST = "manifest.json"
STATE_FILES, AVATAR_FILE = ("state.json", "state.safetensors"), "avatar.avatar"
CHECKPOINT_BYTES = 2**33
"""Bytes of a checkpoint's file; the paper's preset with its optimiser takes 0.6 GB."""


@dataclass(frozen=True)
class Manifest:
    """What a checkpoint says of itself."""

    format: int
    step: int
    saved: int
    """Its place in the run's order of checkpoints, from 0."""
    time: float
    part: str
    score: float | None
    """Higher is better, among checkpoints of the same part."""
    files: dict[str, list[int]]
    """Size in bytes and CRC-32 of each file."""


@dataclass(frozen=True)
class Checkpoint:
    """A complete one on disk."""

    path: Path
    manifest: Manifest


def write(
    folder: Path, step: int, state: dict[str, Any], avatar: Callable[[Path], None] | None = None,
    part: str = "", score: float | None = None,
) -> Path:  # fmt: skip
    """Add `folder/step_%08d`, remove what is no longer kept; its path. OSError where the disk does not take it.

    `avatar(path)` writes the avatar's file. A checkpoint of the same step is replaced.
    """
    folder.mkdir(parents=True, exist_ok=True)
    clean(folder)
    final, temporary = folder / f"step_{step:08d}", folder / f".new_step_{step:08d}"
    before = found(folder)
    temporary.mkdir()
    try:
        tree, tensors = flatten(state)
        _put(temporary / "state.safetensors", safetensors.torch.save(tensors))
        _put(temporary / "state.json", json.dumps(tree, allow_nan=False).encode())
        if avatar is not None:
            avatar(temporary / AVATAR_FILE)
            _sync(temporary / AVATAR_FILE)
        files = {file.name: _fingerprint(file) for file in sorted(temporary.iterdir())}
        order = before[-1].manifest.saved + 1 if before else 0
        manifest = Manifest(FORMAT, step, order, time.time(), part, score, files)
        _put(temporary / MANIFEST, (json.dumps(asdict(manifest), indent=1) + "\n").encode())
        sync_folder(temporary)
        if final.exists():
            os.rename(final, folder / f".old_{final.name}")
        os.rename(temporary, final)
    except BaseException:
        clean(folder)
        raise
    sync_folder(folder)
    for name in _dropped([*(entry for entry in before if entry.path != final), Checkpoint(final, manifest)]):
        os.rename(folder / name, folder / f".old_{name}")
    clean(folder)
    return final


def newest(folder: Path) -> tuple[Checkpoint, dict[str, Any]] | None:
    """The last checkpoint that is whole, and its state; those that are not are named in the log and left alone."""
    for entry in reversed(found(folder)):
        try:
            return entry, read(entry.path)
        except InputError as error:
            log.warning("checkpoint skipped: %s", error)
    return None


def found(folder: Path) -> list[Checkpoint]:
    """The complete checkpoints in their order; their contents are not checked."""
    entries = []
    for path in folder.glob("step_*") if folder.is_dir() else ():
        try:
            entries.append(Checkpoint(path, _manifest(path)))
        except InputError as error:
            log.warning("checkpoint skipped: %s", error)
    return sorted(entries, key=lambda entry: entry.manifest.saved)


def read(path: Path) -> dict[str, Any]:
    """The state in a checkpoint's folder, tensors on the CPU. Raises `InputError` where any byte is not as written."""
    for name, expected in _manifest(path).files.items():
        check_file(path / name, "a file that can be read", CHECKPOINT_BYTES)
        size = (path / name).stat().st_size
        try:
            same = size == expected[0] and _fingerprint(path / name) == expected
        except OSError as error:
            raise InputError(path, name, "a file that can be read", error.strerror or error) from None
        if not same:
            raise InputError(path, name, f"{expected[0]} bytes as they were written", f"{size} that differ")
    try:
        tensors = safetensors.torch.load(read_bytes(path / "state.safetensors", "a state's tensors", CHECKPOINT_BYTES))
        state = restore(read_json(path / "state.json", "a state"), tensors)
    except InputError:
        raise
    except (*BROKEN, TypeError, AttributeError, RecursionError, safetensors.SafetensorError) as error:
        raise InputError(path, "", "a checkpoint of this program", error) from None
    if not isinstance(state, dict):
        raise InputError(path, "state.json", "an object", type(state).__name__)
    return state


def clean(folder: Path) -> None:
    """Remove what a killed process left behind; a checkpoint that was being replaced gets its name back."""
    for path in folder.glob(".old_*"):
        name = folder / path.name.removeprefix(".old_")
        unfinished = folder / f".new_{name.name}"
        if unfinished.exists() and not name.exists():
            os.rename(path, name)
        else:
            shutil.rmtree(path, ignore_errors=True)
    for path in folder.glob(".new_*"):
        shutil.rmtree(path, ignore_errors=True)


def flatten(value: Any) -> tuple[Any, dict[str, Tensor]]:
    """A nested value as JSON, and the tensors that it refers to. TypeError for what cannot be kept."""
    tensors: dict[str, Tensor] = {}
    return _flatten(value, "state", tensors), tensors


def restore(tree: Any, tensors: dict[str, Tensor]) -> Any:
    """The value of `flatten`."""
    if isinstance(tree, list):
        return [restore(entry, tensors) for entry in tree]
    if not isinstance(tree, dict):
        return tree
    if not any(name.startswith("$") for name in tree):
        return {name: restore(entry, tensors) for name, entry in tree.items()}
    (name, content), *rest = tree.items()
    if name == "$tensor":
        return tensors[content]
    if name == "$array":
        dtype, shape = np.dtype(tree["dtype"]), tree["shape"]
        return np.frombuffer(tensors[content].numpy().tobytes(), dtype).reshape(shape).copy()
    if name == "$tuple":
        return tuple(restore(entry, tensors) for entry in content)
    if name == "$dict":
        return {restore(key, tensors): restore(entry, tensors) for key, entry in content}
    if name == "$float":
        return float(content)
    if name == "$bytes":
        return tensors[content].numpy().tobytes()
    raise KeyError(f"{name} {rest}")


def _flatten(value: Any, place: str, tensors: dict[str, Tensor]) -> Any:
    if value is None or isinstance(value, str | bool) or type(value) is int:
        return value
    if type(value) is float:
        return value if math.isfinite(value) else {"$float": repr(value)}
    if isinstance(value, Tensor):
        return {"$tensor": _keep(value.detach().cpu().clone(memory_format=torch.contiguous_format), tensors)}
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.hasobject or array.dtype.fields:
            raise TypeError(f"{place}: an array of {array.dtype} cannot be kept in a checkpoint")
        return {"$array": _keep(_bytes(array.tobytes()), tensors), "dtype": array.dtype.str, "shape": [*array.shape]}
    if isinstance(value, bytes):
        return {"$bytes": _keep(_bytes(value), tensors)}
    if isinstance(value, tuple):
        return {"$tuple": [_flatten(entry, f"{place}[{k}]", tensors) for k, entry in enumerate(value)]}
    if isinstance(value, list):
        return [_flatten(entry, f"{place}[{k}]", tensors) for k, entry in enumerate(value)]
    if isinstance(value, dict):
        items = [(key, _flatten(entry, f"{place}.{key}", tensors)) for key, entry in value.items()]
        if all(isinstance(key, str) and not key.startswith("$") for key in value):
            return dict(items)
        return {"$dict": [[_flatten(key, f"{place}: key", tensors), entry] for key, entry in items]}
    raise TypeError(f"{place}: a {type(value).__name__} cannot be kept in a checkpoint")


def _keep(tensor: Tensor, tensors: dict[str, Tensor]) -> str:
    name = str(len(tensors))
    tensors[name] = tensor
    return name


def _bytes(content: bytes) -> Tensor:
    return torch.from_numpy(np.frombuffer(content, np.uint8).copy())


def _manifest(path: Path) -> Manifest:
    data = read_json(path / MANIFEST, "a checkpoint's manifest", SMALL)
    if not isinstance(data, dict):
        raise InputError(path, MANIFEST, "a JSON object", type(data).__name__)
    if type(data.get("format")) is not int or data["format"] > FORMAT:
        raise InputError(path, f"{MANIFEST}: format", f"at most {FORMAT} (update the studio)", data.get("format"))
    try:
        manifest = Manifest(**data)
    except TypeError as error:
        raise InputError(path, MANIFEST, "the fields of a checkpoint", error) from None
    numbers = (manifest.time, 0 if manifest.score is None else manifest.score)
    if not (
        all(type(count) is int and abs(count) < 2**31 for count in (manifest.step, manifest.saved))
        and all(type(number) in (int, float) for number in numbers)
        and isinstance(manifest.part, str)
    ):
        raise InputError(path, MANIFEST, "numbers and a part", f"step {manifest.step}, saved {manifest.saved}")
    files = manifest.files
    if not (isinstance(files, dict) and set(STATE_FILES) <= set(files) <= {*STATE_FILES, AVATAR_FILE}):
        raise InputError(path, f"{MANIFEST}: files", f"{' and '.join(STATE_FILES)}, perhaps {AVATAR_FILE}", files)
    for name, pair in files.items():
        if not (isinstance(pair, list) and len(pair) == 2 and all(type(number) is int for number in pair)):
            raise InputError(path, f"{MANIFEST}: files: {name}", "a size and a CRC-32", pair)
    return manifest


def _dropped(entries: list[Checkpoint]) -> list[str]:
    """Names of the checkpoints that are neither among the last nor the best of their part."""
    best: dict[str, tuple[float, str]] = {}
    for entry in entries:
        score, part = entry.manifest.score, entry.manifest.part
        if score is not None and (part not in best or score >= best[part][0]):
            best[part] = score, entry.path.name
    kept = {*(entry.path.name for entry in entries[-KEEP:]), *(name for _, name in best.values())}
    return [entry.path.name for entry in entries if entry.path.name not in kept]


def _put(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    _sync(path)


def _sync(path: Path) -> None:
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def _fingerprint(path: Path) -> list[int]:
    size, crc = 0, 0
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            size, crc = size + len(block), zlib.crc32(block, crc)
    return [size, crc]
