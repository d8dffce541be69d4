"""The frame path: no trimesh, no dense 512³, and memory that stays flat over many frames."""

from __future__ import annotations

import json
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.levels import LEVELS
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose

ROOT = Path(__file__).parents[1]
DENSE = 512**3
"""Entries of the paper's upsampled grid; one byte each at least."""
GROWTH = 4.0
"""MiB from the first to the last quarter of 60 frames: seen, less than 2; volumes that stayed behind would be tens."""
TINY = """
import sys
import avatarrex.pipeline as pipeline
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.signals.driving import Signals
settings = pipeline.RenderSettings(voxel=0.04, part_voxel=0.0125)
camera = Camera.orbit(0, 0, 3, 40, (0, 0, 0), 16, 16)
frame = pipeline.render_frame(load_avatar(), Signals.rest(), camera, settings)
assert frame.counters["pixels_shaded"]
print(*(name for name in sys.modules if name.partition(".")[0] == "trimesh"))
"""


class Largest(TorchDispatchMode):
    """Notes the most entries of any tensor that an operation gives."""

    entries = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        result = func(*args, **(kwargs or {}))
        for value in result if isinstance(result, tuple | list) else (result,):
            if isinstance(value, torch.Tensor):
                self.entries = max(self.entries, value.numel())
        return result


def test_a_frame_needs_no_trimesh():
    done = subprocess.run([sys.executable, "-c", TINY], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ""


def test_the_watch_sees_a_dense_grid():
    with Largest() as largest:
        torch.empty(512, 512, 512, dtype=torch.bool)
    assert largest.entries == DENSE


def test_a_frame_makes_no_dense_grid():
    avatar, camera = load_avatar(), Camera.orbit(0, 0, 2.8, 40, (0, 0, 0), 32, 32)
    signals = Signals.rest().replace(body_pose=named_pose("wave"))
    tracemalloc.start()
    with Largest() as largest:
        frame = render_frame(avatar, signals, camera, LEVELS["quality"])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert frame.volume.grid.sdf.numel() <= largest.entries < DENSE // 8
    assert peak < DENSE, "NumPy's arrays all together"


@pytest.mark.slow
def test_memory_is_flat(tmp_path):
    out = tmp_path / "memory.json"
    words = ["-m", "avatarrex.measure", "memory", "--frames", "60", "--warm-up", "40", "--json", str(out)]
    done = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    growth = json.loads(out.read_text())
    assert growth["growth_mib"] < GROWTH, done.stdout
    assert growth["last_objects"] == growth["first_objects"], done.stdout
