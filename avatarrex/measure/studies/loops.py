"""Compiled loops of the body's colour beside the torch operations that they replace: median milliseconds in turns.

The packaged avatar from the front; torch and compiled take turns, and the largest difference of their results stands beside.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.fields.influence import RADIUS, find_pairs, weighted_mean
from avatarrex.fields.patches import patch_features
from avatarrex.fields.presets import COORDINATE_OCTAVES
from avatarrex.measure.bench.contest import interleaved
from avatarrex.metrics.table import printed
from avatarrex.ops.encoding import Encoding
from avatarrex.pipeline import render_deferred
from avatarrex.signals.driving import Signals

TURNS = 9
WAYS = ("torch", "auto")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of the picture, and of torch."""
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--threads", type=int, default=1)


def in_turns(row: Callable[..., None], name: str, work: Callable[[str], Tensor]) -> None:
    """Print both medians, their ratio and the largest difference."""
    results = {way: work(way) for way in WAYS}
    took = interleaved({way: partial(work, way) for way in WAYS}, TURNS, warm=False)
    torch_ms, ours = (took[way].ms for way in WAYS)
    off = float((results["torch"] - results["auto"]).abs().max())
    row(name, f"{torch_ms:.1f}", f"{ours:.1f}", f"{torch_ms / ours:.1f} x", f"{off:.1e}")


@torch.no_grad()
def run(options: argparse.Namespace) -> None:
    """Measure one view."""
    torch.set_num_threads(options.threads)
    avatar = load_avatar()
    camera = Camera.orbit(20, 5, 2.6, 40, (0, 0, 0), options.size, options.size)
    frame = render_deferred(avatar, Signals.rest(), camera)
    body, posed, seen = avatar.body, frame.volume.body_frame, frame.pointmap
    point = seen.position[(seen.coverage > 0) & (seen.part_weight.sum(-1) < 0.999)]
    samples, pairs = posed.samples, body.pairs(posed, point)
    assert samples is not None, "an avatar without anchors"
    assert frame.shading.patches is not None, "nothing of the body in sight"
    patches, cutoff = frame.shading.patches.value, body.widths.colour_cutoff
    beside = samples.neighbours_of(point)
    rest = samples.rest_position(point, beside)
    near, local, weight = body.localise(posed, point, pairs, cutoff, rest)
    value = torch.randn(len(weight), 16)
    print(f"{len(point)} points, {len(pairs.point)} pairs, {len(weight)} of them in the support")
    row = partial(in_turns, printed("milliseconds          ", "torch", "compiled", "ratio", "difference"))
    row("nearest anchors", lambda way: samples.nearest(point, way))
    row("anchors and weights", lambda way: samples.neighbours_of(point, way).weight)
    row("pairs", lambda way: find_pairs(point, posed.node_position, impl=way).point)
    row("places and weights", lambda way: body.localise(posed, point, pairs, cutoff, rest, way)[2])
    row("means", lambda way: weighted_mean(value, weight, near, len(point), way)[0])
    row("patch features", lambda way: patch_features(patches, near.node, body.node_axes, local, way))
    coordinate = Encoding(local / RADIUS, COORDINATE_OCTAVES)
    for other in ("loop", "bucket"):
        for rows in (len(local), len(local) // 16):
            few = near.take(torch.arange(rows) * (len(local) // rows))
            part = [Encoding(coordinate.x[:: len(local) // rows][:rows], COORDINATE_OCTAVES)]
            networks = partial(body.geometry_local, part, posed.code.embedding, few.offsets)

            def evaluated(way: str, networks: Callable[..., Tensor] = networks, other: str = other) -> Tensor:
                return networks("native" if way == "auto" else other)

            row(f"networks, {other}, {rows // 1000}k", evaluated)
