"""Work counters of a frame: how skipping is proved, by counting and not by timing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

NAMES = (
    "templates_posed",
    "voxels_evaluated",
    "local_mlp_evaluations",
    "hand_distances",
    "face_evaluations",
    "unet_runs",
    "rays",
    "ray_steps",
    "hits_polished",
    "patches_decoded",
    "pixels_shaded",
    "body_pixels",
    "hand_pixels",
    "face_pixels",
    "surface_vertices",
    "surface_triangles",
    "bytes_uploaded",
    "bytes_read_back",
)


class Counters:
    """Sums of work, zero until counted. Unknown names are programming errors and raise `KeyError`."""

    def __init__(self) -> None:
        self._counts = dict.fromkeys(NAMES, 0)
        self._lock = threading.Lock()  # pieces of a volume are built side by side

    def add(self, name: str, amount: int) -> None:
        with self._lock:
            self._counts[name] += int(amount)

    def update(self, counts: Mapping[str, int]) -> None:
        for name, amount in counts.items():
            self.add(name, amount)

    def __getitem__(self, name: str) -> int:
        return self._counts[name]

    def as_dict(self) -> dict[str, int]:
        return dict(self._counts)


class StageClock:
    """Wall-clock milliseconds per stage: `with clock("volume"): …`. `between` is called before each."""

    def __init__(self, between: Callable[[], None] | None = None) -> None:
        self._stages: dict[str, float] = {}
        self._between = between

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        if self._between:
            self._between()
        start = time.perf_counter()
        yield
        self._stages[stage] = self._stages.get(stage, 0.0) + (time.perf_counter() - start) * 1e3

    def milliseconds(self) -> dict[str, float]:
        """By stage, and `total`."""
        return {**self._stages, "total": sum(self._stages.values())}
