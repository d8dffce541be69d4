"""The stages of `bench` by name, loaded when they run. Each module has `measure(bench) -> list[Metric]`."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING

from avatarrex.errors import check

if TYPE_CHECKING:
    from avatarrex.measure.bench.report import Metric
    from avatarrex.measure.bench.session import Bench

STAGES = {
    "sdf": "signed distance to a mesh",
    "mlp": "local networks at the paper's widths",
    "geometry": "the body's grid: the narrow band against the whole union of influence",
    "raycast": "rays against the stored volume",
    "volume": "what a volume stores",
    "skinning": "posing the templates",
    "frame": "whole frames: every level, volume rendering, a textured mesh",
    "training": "samples that a training step evaluates",
    "growth": "cost against resolution, voxels, nodes, avatars",
    "peers": "everything installed that does the same, in one table",
}
"""In the order of measuring: `peers` reuses what the others found."""


def chosen(names: Sequence[str]) -> list[str]:
    """The named stages in their order, all where none is named. Raises `InputError` for a name that is none."""
    for name in names:
        check(name in STAGES, "bench", "stage", ", ".join(STAGES) + ", or ablation alone", name)
    return [name for name in STAGES if name in names or not names]


def measure(name: str, bench: Bench) -> list[Metric]:
    """The metrics of one stage."""
    found: list[Metric] = import_module(f"avatarrex.measure.bench.{name}").measure(bench)
    return found
