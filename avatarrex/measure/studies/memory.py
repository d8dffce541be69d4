"""Memory over many frames: the process' resident MiB and the OpenGL objects that live, after a warm-up.

Small changes of pose (every third frame), hand, expression and view at 64², coarse voxels, bricks in every other view.
Printed once per 50 frames; growth is the median of the last quarter less that of the first quarter after the warm-up.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import statistics
from pathlib import Path
from typing import Any

import numpy as np

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.files.json_text import write_json
from avatarrex.gl.context import gl_context, gl_unavailable
from avatarrex.pipeline import render_frame
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.limits import random_signals

SETTINGS = tuple(RenderSettings(voxel=0.04, part_voxel=0.0125, bricks=bricks) for bricks in (0, 2))
"""Of every other frame."""
PAGE = 4096
"""Bytes of a page: Linux on x86-64, the machine of the figures."""


def measure(frames: int, warm_up: int) -> dict[str, Any]:
    """What `frames` frames after `warm_up` others leave in memory; textures and buffers of OpenGL, None without."""
    rng, avatar, frame = np.random.default_rng(0), load_avatar(), None
    signals, resident, objects = Signals.rest(), [], None
    for number in range(warm_up + frames):
        signals = changed(signals, rng, number)
        camera = Camera.orbit(rng.uniform(-180, 180), rng.uniform(-30, 30), 3.2, 45, (0, 0, 0), 64, 64)
        frame = render_frame(avatar, signals, camera, SETTINGS[number % 2], frame)
        if number == warm_up:
            objects = gl_objects()
        if number >= warm_up:
            resident.append(resident_mib())
        if number % 50 == 0:
            print(f"{number:6d} frames  {resident_mib():8.1f} MiB  textures, buffers {gl_objects()}", flush=True)
    quarter = max(frames // 4, 1)
    growth = statistics.median(resident[-quarter:]) - statistics.median(resident[:quarter])
    return {
        "frames": frames, "resident_mib": resident[-1], "growth_mib": growth,
        "first_objects": objects, "last_objects": gl_objects(),
    }  # fmt: skip


def changed(signals: Signals, rng: np.random.Generator, number: int) -> Signals:
    """The signals of the next frame: pose, hand or expression now and then, else the same."""
    drawn = random_signals(rng, 0.3)
    if number % 3 == 0:
        return signals.replace(body_pose=drawn.body_pose)
    if number % 12 == 1:
        return signals.replace(left_hand_pose=drawn.left_hand_pose)
    return signals.replace(expression=drawn.expression) if number % 12 == 4 else signals


def resident_mib() -> float:
    """Resident memory of this process, after the allocator has given back what is free."""
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 2**20


def gl_objects() -> tuple[int, int] | None:
    """Living textures and buffers of OpenGL, counted over every name given so far; None without OpenGL."""
    if gl_unavailable() is not None:
        return None
    context, library = gl_context(), ctypes.CDLL("libGL.so.1")
    texture, buffer = context.texture((1, 1), 1), context.buffer(reserve=4)
    given = texture.glo, buffer.glo
    texture.release()
    buffer.release()
    library.glIsTexture.restype = library.glIsBuffer.restype = ctypes.c_ubyte  # GLboolean
    textures, buffers = (range(1, last) for last in given)
    return sum(map(library.glIsTexture, textures)), sum(map(library.glIsBuffer, buffers))


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many frames, and where to."""
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--warm-up", type=int, default=100)
    parser.add_argument("--json")


def run(options: argparse.Namespace) -> None:
    """Measure and print."""
    growth = measure(options.frames, options.warm_up)
    print(json.dumps(growth))
    if options.json:
        write_json(options.json, growth)
