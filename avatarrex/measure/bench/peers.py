"""Stage `peers`: everything installed that does a piece of our work, in one table; what is missing is named.

Nothing is measured twice: the contests of the other stages are taken where they ran, and run where they did not.
"""

from __future__ import annotations

from avatarrex.measure.bench import mlp, raycast, sdf, skinning
from avatarrex.measure.bench.contest import Contest
from avatarrex.measure.bench.report import Metric
from avatarrex.measure.bench.session import Bench


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    return [metric for contest in contests(bench) for metric in contest.comparison()]


def contests(bench: Bench) -> list[Contest]:
    """All of them."""
    networks = [contest for _, contest in bench.once(mlp.contests)[0]]
    return [*bench.once(sdf.contests), *networks, *bench.once(raycast.contests), bench.once(skinning.contests)]
