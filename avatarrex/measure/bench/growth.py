"""Stage `growth`: how cost grows with the picture, the voxels, the nodes and the number of avatars; cost ∝ size^exponent.

A least-squares line through the logarithms; with it the largest relative deviation, and the points themselves.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch

from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.fields.body import BodyField
from avatarrex.fields.presets import PRESETS
from avatarrex.frame import Frame
from avatarrex.measure.bench.contest import interleaved
from avatarrex.measure.bench.report import Metric
from avatarrex.measure.bench.session import SEED, Bench
from avatarrex.pipeline import render_frame
from avatarrex.settings import RenderSettings
from avatarrex.templates.parts import PART_JOINT
from avatarrex.volume.build import build_volume

SIZES = (128, 256, 512, 1024)
VOXELS = (0.04, 0.03, 0.02, 0.015)
"""Metres. The finest is not finer than a grid of 128 voxels allows for a standing person."""
NODES = (32, 64, 128, 256, 512)
AVATARS = (1, 2, 4, 8)
BODY_ONLY = frozenset(PART_JOINT)


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    few = 3 if bench.quick else 5
    return [
        _fit(bench, "image", "pixels along a side", SIZES[:few], picture(bench)),
        _fit(bench, "voxels", "voxels per metre", [1 / voxel for voxel in VOXELS[:few]], grid(bench)),
        _fit(bench, "nodes", "nodes", NODES[:: 2 if bench.quick else 1], nodes(bench)),
        _fit(bench, "avatars", "avatars", AVATARS[:few], avatars(bench)),
    ]


def picture(bench: Bench) -> Callable[[float], object]:
    """A new view of somebody who stands, at a size."""
    signals, turn = bench.signals(), itertools.count()
    first = render_frame(bench.avatar, signals, bench.camera(8), RenderSettings())

    def work(size: float) -> Frame:
        camera = bench.camera(max(8, round(bench.scale * size)), 20.0 + 5 * next(turn))
        return render_frame(bench.avatar, signals, camera, RenderSettings(), first)

    return work


def grid(bench: Bench) -> Callable[[float], object]:
    """The body's grid with so many voxels to the metre."""
    avatar, posed, coarse = bench.avatar, bench.standing, RenderSettings(hidden=BODY_ONLY)
    return lambda density: build_volume(avatar, posed, replace(coarse, voxel=1 / density), Counters(), None)


def nodes(bench: Bench) -> Callable[[float], object]:
    """The body's grid by so many nodes, untrained, spread over the same template."""
    preset, settings, fields = PRESETS["compact"], RenderSettings(hidden=BODY_ONLY), {}
    for count in NODES:
        torch.manual_seed(SEED)
        body = BodyField(bench.avatar.person.body, replace(preset, body=replace(preset.body, nodes=count)), SEED)
        fields[count] = replace(bench.avatar, body=body.requires_grad_(False))
    return lambda count: build_volume(fields[int(count)], bench.standing, settings, Counters(), None)


def avatars(bench: Bench) -> Callable[[float], object]:
    """So many people, each in a new pose, nearest in front."""
    side, turn = bench.side(192, 128), itertools.count()

    def work(count: float) -> torch.Tensor:
        image, depth = torch.zeros(side, side, 4), torch.full((side, side), torch.inf)
        for k in range(int(count)):
            signals = bench.signals(next(turn) % 20)
            camera = Camera.orbit(20, 5, 2.6 + 0.2 * k, 40, (0.3 * k, -0.05, 0), side, side)
            frame = render_frame(bench.avatar, signals, camera, RenderSettings())
            seen = torch.where(frame.pointmap.hit, frame.pointmap.depth, torch.inf)
            nearer = seen < depth
            image[nearer], depth = frame.image[nearer], torch.minimum(depth, seen)
        return image

    return work


def fitted(sizes: Sequence[float], ms: Sequence[float]) -> tuple[float, float, float]:
    """Exponent, factor and largest relative deviation of ms ≈ factor · size^exponent."""
    exponent, offset = np.polyfit(np.log(sizes), np.log(ms), 1)
    deviation = np.abs(np.exp(exponent * np.log(sizes) + offset) / np.asarray(ms) - 1).max()
    return float(exponent), float(np.exp(offset)), float(deviation)


def _fit(bench: Bench, name: str, what: str, sizes: Sequence[float], work: Callable[[float], object]) -> Metric:
    times = interleaved({str(size): partial(work, size) for size in sizes}, bench.count(3, 1))
    ms = [times[str(size)].ms for size in sizes]
    exponent, factor, deviation = fitted(sizes, ms)
    error = {"of": what, "size": list(sizes), "ms": ms, "factor": factor, "largest_deviation": deviation}
    return Metric(f"growth.{name}.exponent", exponent, "exponent", error=error)
