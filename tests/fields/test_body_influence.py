import math

import pytest
import torch

from avatarrex.fields.influence import (
    EPSILON,
    GATE,
    RADIUS,
    SIGMA,
    Pairs,
    find_pairs,
    gate,
    influence,
    influence_reference,
    weighted_mean,
)


def test_closed_form():
    assert math.isclose(RADIUS, 0.18585, abs_tol=1e-5)
    distance = torch.tensor([0.0, SIGMA, RADIUS, 2.0])
    expected = torch.tensor([1 - EPSILON, math.exp(-0.5) - EPSILON, 0.0, 0.0])
    torch.testing.assert_close(influence(distance.square()), expected, atol=1e-9, rtol=1e-6)


def test_follows_the_equation_in_double():
    squared = torch.linspace(0, 0.25, 1001, dtype=torch.float64).square()
    torch.testing.assert_close(influence(squared), influence_reference(squared), atol=1e-15, rtol=1e-9)


def test_rim_keeps_its_digits():
    """In float32 near the rim the equation as written loses digits: this is why expm1 is there."""
    squared = torch.linspace(0.98 * RADIUS, 0.9999 * RADIUS, 200).square()
    exact = influence_reference(squared.double())

    def worst(value):
        return float(((value.double() - exact) / exact).abs().max())

    assert worst(influence(squared)) < min(1.2e-4, 0.7 * worst(influence_reference(squared)))


def test_gate_is_monotone_between_its_ends():
    distance = torch.linspace(0, 2 * GATE[1], 500)
    value = gate(distance.square())
    assert (value.diff() <= 0).all()
    assert (value[distance <= GATE[0]] == 1).all()
    assert (value[distance >= GATE[1]] == 0).all()


@pytest.mark.parametrize("points", [0, 1, 400])
def test_pairs_are_all_and_sorted(points):
    generator = torch.Generator().manual_seed(points)
    position = torch.rand(points, 3, generator=generator) + 5
    nodes = torch.rand(9, 3, generator=generator) + 5
    pairs = find_pairs(position, nodes)
    reached = torch.cdist(nodes.double(), position.double()) < RADIUS
    node, point = torch.nonzero(reached, as_tuple=True)
    assert torch.equal(pairs.node, node)
    assert torch.equal(pairs.point, point)
    assert pairs.offsets.tolist() == [0, *reached.sum(1).cumsum(0).tolist()]


def test_pairs_among_some_nodes():
    position, nodes = torch.rand(50, 3) * 0.2, torch.rand(6, 3) * 0.2
    mask = torch.tensor([True, False, True, False, False, True])
    pairs = find_pairs(position, nodes, mask)
    everything = find_pairs(position, nodes)
    some = everything.keep(mask[everything.node])
    assert torch.equal(pairs.point, some.point)
    assert torch.equal(pairs.node, some.node)
    assert torch.equal(pairs.offsets, some.offsets)


@pytest.mark.parametrize("impl", ["auto", "torch"])
def test_weighted_mean_of_unreached_points_is_zero_and_flagged(impl):
    pairs = Pairs.of(torch.tensor([0, 2, 0]), torch.tensor([0, 0, 1]), 2)
    mean, total = weighted_mean(torch.tensor([[1.0], [5.0], [4.0]]), torch.tensor([1.0, 2.0, 3.0]), pairs, 3, impl)
    torch.testing.assert_close(mean[:, 0], torch.tensor([13 / 4, 0.0, 5.0]))
    assert total.tolist() == [4.0, 0.0, 2.0]
