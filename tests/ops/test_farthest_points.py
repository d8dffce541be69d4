"""Farthest point sampling: what it promises, and the same as in torch."""

import pytest
import torch

from avatarrex.fields.nodes import covering_radius
from avatarrex.ops.farthest_points import farthest_points
from avatarrex.templates.person import load_person


def in_torch(points: torch.Tensor, count: int, first: int) -> torch.Tensor:
    """The reference."""
    chosen, nearest = [first], torch.full((len(points),), torch.inf, dtype=torch.float64)
    while len(chosen) < count:
        squared = (points.double() - points[chosen[-1]].double()).square()
        nearest = torch.minimum(nearest, squared.cumsum(1)[:, -1])
        chosen.append(int(nearest.argmax()))
    return torch.tensor(chosen)


def test_it_chooses_what_torch_chooses():
    """In three dimensions, and in six, where the last three count."""
    rest = load_person().body.v_template
    for points in (rest, torch.cat([0.1 * rest, rest.roll(1, 1) ** 2], 1)):
        found = farthest_points(points, 300, seed=2)
        assert torch.equal(found, in_torch(points, 300, int(found[0])))


def test_farthest_points_on_a_line():
    line = torch.zeros(9, 3)
    line[:, 0] = torch.arange(9.0)
    chosen = farthest_points(line, 9, seed=4).tolist()
    assert sorted(chosen) == list(range(9))
    assert chosen[1] in (0, 8), "the second point is the end farther from the first"
    assert farthest_points(line, 3, seed=4).tolist() == chosen[:3], "a shorter sample is a prefix"


def test_sampling_is_greedy_and_covers():
    """Every sample is at least as far from its predecessors as any vertex is from all samples."""
    points = torch.rand(400, 3, generator=torch.Generator().manual_seed(0))
    chosen = points[farthest_points(points, 40, seed=1)]
    distance = torch.cdist(chosen, chosen) + 1e9 * torch.eye(40)
    assert covering_radius(points, chosen) <= distance.min() + 1e-6


def test_seed_decides():
    points = torch.rand(400, 3, generator=torch.Generator().manual_seed(0))
    first, again, other = (farthest_points(points, 20, seed=s) for s in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("count", [1, 500])
def test_counts_at_the_ends(count):
    points = torch.rand(30, 3)
    assert len(farthest_points(points, count, seed=0)) == min(count, 30)
