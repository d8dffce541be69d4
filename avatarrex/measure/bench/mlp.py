"""Stage `mlp`: the local networks at the widths of `paper`, 2000 rows to a node, on one core.

    geometry  39 → 48 → 48 → 16, ELU        colour  55 → 64 → 64 → 32, ReLU        (embeddings folded into the first bias)

The peak is the best that a large float32 matrix product of the same torch reaches on the same core in the same run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from avatarrex.fields.presets import COORDINATE_OCTAVES, PAPER
from avatarrex.measure.bench.contest import Contest, Contestant, Goal, installed, interleaved, one_core
from avatarrex.measure.bench.mlp_peers import PEERS, Networks
from avatarrex.measure.bench.report import FASTER, Metric
from avatarrex.measure.bench.session import SEED, Bench
from avatarrex.ops.encoding import channels
from avatarrex.ops.local_mlp import local_mlp

PEAK_SIDE = 1024
"""Rows and columns of the matrices that show the peak: 12 MB, beyond the caches, and still the fastest size here."""
GOAL = Goal("mlp.vs_vmap", "vmap", FASTER, 3.5)


@dataclass(frozen=True)
class Case:
    """Networks of one kind and a batch."""

    name: str
    networks: Networks
    target: float
    """Of the fraction of the peak (shown with ReLU, not yet with ELU)."""


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    found, peak = bench.once(contests)
    metrics = []
    for case, contest in found:
        fraction = case.networks.flops / (1e-3 * contest.best.times.cpu_ms) / peak
        name = "mlp.fraction_of_peak" + ("" if case.name == "colour" else f".{case.name}")
        how = {"peak_gflops": peak / 1e9, "activation": case.networks.activation, "cores": 1}
        metrics.append(Metric(name, fraction, "of the peak", "higher", {**contest.best.error, **how}, case.target))
    each = [contest for _, contest in found]
    bound = {contest.case: _advantage_at_peak(case, contest, peak) for case, contest in found}
    worst = max(contest.best.error["max_error"] for contest in each)
    ahead = GOAL.metrics(each, "by_kind", at_the_peak_it_would_be=bound, max_error=worst, cores=1)
    return [*metrics, *ahead, *(metric for contest in each for metric in contest.metrics())]


def _advantage_at_peak(case: Case, contest: Contest, peak: float) -> float:
    """How many times as long `vmap` takes as the bare products would at the peak: no program here can be ahead by more."""
    return 1e-3 * contest.named["vmap"].times.cpu_ms * peak / case.networks.flops


def contests(bench: Bench) -> tuple[list[tuple[Case, Contest]], float]:
    """Geometry and colour, and the peak in operations per second."""
    with one_core(), torch.inference_mode():
        square = torch.randn(PEAK_SIDE, PEAK_SIDE)
        peak = 0.0
        found = []
        for case in cases(bench):
            best = interleaved({"peak": lambda: square @ square}, bench.count(5, 3))["peak"]
            peak = max(peak, 2 * PEAK_SIDE**3 / (1e-3 * min(best.cpu)))
            found.append((case, _contest(bench, case)))
        return found, peak


def cases(bench: Bench) -> list[Case]:
    """The networks of the body's two fields with random weights."""
    body, rows = PAPER.body, bench.count(2000, 500)
    coordinate = channels(COORDINATE_OCTAVES)
    if body.colour_local is None:
        raise ValueError("the paper preset has colour networks of its own")
    geometry = (coordinate, *body.geometry_local, body.geometry_feature)
    colour = (coordinate + body.patch_feature, *body.colour_local, body.colour_feature)
    return [
        Case("geometry", _networks(body.nodes, rows, geometry, "elu"), 0.35),
        Case("colour", _networks(body.nodes, rows, colour, "relu"), 0.40),
    ]


def _networks(nodes: int, rows: int, widths: tuple[int, ...], activation: str) -> Networks:
    generator = torch.Generator().manual_seed(SEED)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator)

    weights = [normal(nodes, a, b) * (3 / a) ** 0.5 for a, b in pairwise(widths)]
    biases = [0.1 * normal(nodes, b) for b in widths[1:]]
    return Networks(normal(nodes, rows, widths[0]).clamp(-1, 1), weights, biases, activation)


def _contest(bench: Bench, case: Case) -> Contest:
    net = case.networks
    x, offsets = net.rows.flatten(0, 1), torch.arange(len(net.rows) + 1) * net.rows.shape[1]

    def run(impl: str) -> Callable[[], Tensor]:
        given = [x], offsets, net.weights, net.biases, net.activation, impl
        return lambda: local_mlp(*given).reshape(*net.rows.shape[:2], -1)

    ready = installed(PEERS, bench.absent, f"mlp.{case.name}", net)
    runners = {"ours": run("auto"), "ours_bucket": run("bucket"), **ready}
    times = interleaved(runners, bench.count(5, 3))
    truth = _truth(net)
    entries = []
    for name, work in runners.items():
        difference = np.abs(np.asarray(work())[:, : truth.shape[1]] - truth)
        error = {"max_error": float(difference.max()), "of_outputs_to": float(np.abs(truth).max())}
        entries.append(Contestant(name, times[name], error, ours=name == "ours"))
    return Contest(f"mlp.{case.name}", tuple(entries), cpu=True)


def _truth(net: Networks) -> np.ndarray:
    """The equation in float64, of the first 16 rows of every node: (n, 16, o)."""
    rows = net.rows[:, :16].double()
    offsets = torch.arange(len(rows) + 1) * rows.shape[1]
    weights, biases = [w.double() for w in net.weights], [b.double() for b in net.biases]
    y = local_mlp([rows.flatten(0, 1)], offsets, weights, biases, net.activation, "reference")
    return np.asarray(y.reshape(*rows.shape[:2], -1))
