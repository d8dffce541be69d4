"""Compiled loops of the body's colour beside the torch operations that they replace: median milliseconds in turns.

    python avatarrex/measure/studies/loops.py [--size 512] [--threads 1]

The packaged avatar from the front; torch and compiled take turns, and the largest difference of their results stands beside.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import torch
from torch import Tensor

from avatarrex.avatar import load_avatar
from avatarrex.camera import Camera
from avatarrex.fields.influence import RADIUS, find_pairs, weighted_mean
from avatarrex.fields.patches import patch_features
from avatarrex.fields.presets import COORDINATE_OCTAVES
from avatarrex.ops.encoding import Encoding
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals

TURNS = 9
WAYS = ("torch", "auto")


def in_turns(name: str, work: Callable[[str], Tensor]) -> None:
    """Print both medians, their ratio and the largest difference."""
    results = {way: work(way) for way in WAYS}
    took: dict[str, list[float]] = {way: [] for way in WAYS}
    for _ in range(TURNS):
        for way in WAYS:
            start = time.perf_counter()
            work(way)
            took[way].append(1e3 * (time.perf_counter() - start))
    torch_ms, ours = (statistics.median(took[way]) for way in WAYS)
    off = float((results["torch"] - results["auto"]).abs().max())
    print(f"{name:22} {torch_ms:7.1f} {ours:7.1f} ms {torch_ms / ours:5.1f} x   off by {off:.1e}", flush=True)


@torch.no_grad()
def main() -> None:
    """Measure one view."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--threads", type=int, default=1)
    asked = parser.parse_args()
    torch.set_num_threads(asked.threads)
    avatar = load_avatar()
    camera = Camera.orbit(20, 5, 2.6, 40, (0, 0, 0), asked.size, asked.size)
    frame = render_frame(avatar, Signals.rest(), camera)
    body, posed, seen = avatar.body, frame.volume.body_frame, frame.pointmap
    point = seen.position[(seen.coverage > 0) & (seen.part_weight.sum(-1) < 0.999)]
    samples, pairs = posed.samples, body.pairs(posed, point)
    assert samples is not None, "an avatar without anchors"
    assert frame.shading.patches is not None, "nothing of the body in sight"
    patches, cutoff = frame.shading.patches.value, body.widths.colour_cutoff
    beside = samples.neighbours_of(point)
    heard, local, weight = body.localise(posed, point, pairs, None, cutoff, beside)
    value = torch.randn(len(weight), 16)
    print(f"{len(point)} points, {len(pairs.point)} pairs, {len(weight)} heard; torch, compiled, ratio, difference")
    in_turns("nearest anchors", lambda way: samples.nearest(point, way))
    in_turns("anchors and weights", lambda way: samples.neighbours_of(point, way).weight)
    in_turns("pairs", lambda way: find_pairs(point, posed.node_position, impl=way).point)
    in_turns("places and weights", lambda way: body.localise(posed, point, pairs, None, cutoff, beside, way)[2])
    in_turns("means", lambda way: weighted_mean(value, weight, heard, len(point), way)[0])
    in_turns("patch features", lambda way: patch_features(patches, heard.node, body.node_axes, local, way))
    networks, coordinate = body.geometry_local, Encoding(local / RADIUS, COORDINATE_OCTAVES)
    for name, other in (("networks, loop", "loop"), ("networks, bucket", "bucket")):
        for rows in (len(local), len(local) // 16):
            few = heard.take(torch.arange(rows) * (len(local) // rows))
            part = [Encoding(coordinate.x[:: len(local) // rows][:rows], COORDINATE_OCTAVES)]
            embedding, offsets = posed.code.embedding, few.offsets

            def run(way: str) -> Tensor:
                return networks(part, embedding, offsets, "native" if way == "auto" else other)  # noqa: B023

            in_turns(f"{name}, {rows // 1000}k", run)


if __name__ == "__main__":
    main()
