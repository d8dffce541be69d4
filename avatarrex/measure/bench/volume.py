"""Stage `volume`: what the volume of every level stores, and whether the paper's dense ×4 grid would say anything else.

The paper upsamples the body's grid four times before rays are cast. On a nested lattice (every fourth fine voxel is a coarse
one) the trilinear function of the fine grid is that of the coarse grid: the difference is measured, in stored precision.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.levels import DEFERRED_LEVELS
from avatarrex.measure.bench.report import Metric
from avatarrex.measure.bench.session import SEED, Bench
from avatarrex.ops.halving import between
from avatarrex.ops.trilinear import trilinear
from avatarrex.volume.build import build_volume
from avatarrex.volume.sdf_volume import SdfVolume

LIMITS = {"fast": 8.0, "balanced": 10.0, "fine": 16.0, "quality": 16.0}
"""MiB: 2 cm with boxes of 5 mm, of 2.5 mm, and with bricks."""
FINER = 4
"""The paper's upsampling."""


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    volumes = bench.once(of_levels)
    stored = {name: megabytes(volume) for name, volume in volumes.items()}
    difference, points = dense_difference(next(iter(volumes.values())), bench.count(400_000, 100_000))
    within = [Metric(f"volume.{name}.mib", size, "MiB", target=LIMITS.get(name)) for name, size in stored.items()]
    return [
        Metric("volume.mib", stored["balanced"], "MiB", target=LIMITS["balanced"], error={"by_level": stored}),
        *within,
        Metric("volume.dense_difference_m", difference, "m", target=1e-7, error={"points": points}),
    ]


def of_levels(bench: Bench) -> dict[str, SdfVolume]:
    """Of the avatar as it stands, by level."""
    avatar, posed = bench.avatar, bench.standing
    return {name: build_volume(avatar, posed, level, Counters(), None).sdf for name, level in DEFERRED_LEVELS.items()}


def megabytes(stored: Any) -> float:
    """MiB of every tensor in a dataclass, however deep."""
    return _bytes(stored) / 2**20


def dense_difference(volume: SdfVolume, count: int) -> tuple[float, int]:
    """Largest difference (metres) of the body's grid and the same `FINER` times finer, and at how many points.

    Points are uniform in the cells that the surface crosses.
    """
    coarse = volume.body.sdf
    fine = coarse.numpy()
    for _ in range(FINER.bit_length() - 1):
        fine = between(fine)
    inside = torch.nn.functional.avg_pool3d((coarse < 0)[None, None].float(), 2, 1)[0, 0]
    cells = torch.nonzero((inside > 0) & (inside < 1)).flip(1).numpy()
    rng = np.random.default_rng(SEED)
    place = torch.as_tensor(cells[rng.integers(len(cells), size=count)] + rng.random((count, 3)))
    found = [trilinear(torch.as_tensor(grid)[..., None], place * scale) for grid, scale in ((coarse, 1), (fine, FINER))]
    return float((found[0] - found[1]).abs().max()), count


def _bytes(stored: Any) -> int:
    if isinstance(stored, Tensor):
        return stored.element_size() * stored.numel()
    if isinstance(stored, np.ndarray):
        return 0 if stored.dtype == bool else int(stored.nbytes)  # a mask of the builder, which no ray reads
    if is_dataclass(stored):
        return sum(_bytes(getattr(stored, item.name)) for item in fields(stored))
    if isinstance(stored, tuple | list):
        return sum(map(_bytes, stored))
    return 0
