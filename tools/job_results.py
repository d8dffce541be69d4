"""What jobs have made, by name in bytes: equal where two of them have ended alike (kill_jobs.py)."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import safetensors.numpy

from avatarrex.surface.surface_file import FILE
from avatarrex.training.runs import checkpoint
from avatarrex.training.runs.events import EventReader
from avatarrex.training.runs.folder import read_about

Made = dict[str, bytes]
UNLIKE = ("/rate/", "/memory/")
"""Parts of the names of curves that no two trainings share."""
MOMENTS = ("at", "key")
"""Entries of JSON files that say when something was made, or are made of that."""


def files(folder: Path) -> Made:
    """Every file's digest, those that a killed process left behind as well; of JSON without moments."""
    return {str(path.relative_to(folder)): _digest(path) for path in sorted(folder.rglob("*")) if path.is_file()}


def training(folder: Path) -> Made:
    """Curves, the newest checkpoint, the names of all, and how the run in `folder/run` has ended."""
    run = folder / "run"
    reader = EventReader(run)
    while reader.poll():
        pass
    curves = {tag: reader.series(tag) for tag in reader.tags if not any(part in tag for part in UNLIKE)}
    found = {tag: one.steps.tobytes() + one.values.tobytes() for tag, one in curves.items()}
    newest = checkpoint.newest(run / "checkpoints")
    assert newest is not None, f"{run}: no checkpoint"
    tree, tensors = checkpoint.flatten({**newest[1], "seconds": 0.0})
    found["state"] = json.dumps(tree).encode()
    found |= {f"tensor {name}": value.numpy().tobytes() for name, value in tensors.items()}
    there = sorted(path.name for place in (run, run / "checkpoints") for path in place.iterdir() if _stays(path))
    return found | {"ended": str(read_about(run)["state"]).encode(), "names": " ".join(there).encode()}


def surface(folder: Path) -> Made:
    """The arrays of the surface in `folder/avatar`, and what lies beside it."""
    arrays = safetensors.numpy.load((folder / "avatar" / FILE).read_bytes())
    beside = sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))
    return {name: value.tobytes() for name, value in arrays.items()} | {"names": " ".join(beside).encode()}


def _stays(path: Path) -> bool:
    """Whether every training of that kind has a file of that name: events have the names of their processes."""
    return not path.name.startswith("events.")


def _digest(path: Path) -> bytes:
    content = path.read_bytes()
    if path.suffix == ".json":
        content = json.dumps(_timeless(json.loads(content))).encode()
    return hashlib.sha256(content).digest()


def _timeless(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _timeless(entry) for name, entry in value.items() if name not in MOMENTS}
    return [_timeless(entry) for entry in value] if isinstance(value, list) else value
