"""Compiled loops against the torch operations that they replace."""

from __future__ import annotations

import pytest
import torch
from arm import arm_field, arm_frame

from avatarrex.fields.influence import find_pairs, weighted_mean
from avatarrex.fields.patches import EXTENT, patch_features
from avatarrex.ops import native


@pytest.fixture(scope="module")
def posed():
    field = arm_field()
    with torch.no_grad():
        yield field, arm_frame(field)


def around(frame, spread: float, count: int = 3000) -> torch.Tensor:
    """Points about the skin, in no order."""
    generator = torch.Generator().manual_seed(1)
    start = frame.samples.position[torch.randint(len(frame.samples.position), (count,), generator=generator)]
    return start + spread * torch.randn(count, 3, generator=generator)


@pytest.fixture(autouse=True)
def without_gradients():
    with torch.no_grad():
        yield


@pytest.mark.parametrize("spread", [0.005, 0.05, 0.5, 50.0])
def test_the_nearest_anchors_are_those_of_the_tree(posed, spread):
    samples = posed[1].samples
    points = around(posed[1], spread)
    mine, theirs = samples.nearest(points), samples.nearest(points, "torch")
    distance = [(points[:, None] - samples.position[index]).norm(dim=-1) for index in (mine, theirs)]
    torch.testing.assert_close(*distance, atol=1e-6, rtol=1e-6)
    assert float((mine == theirs).float().mean()) > 0.999, "all but ties"


def test_neighbours_weigh_the_same(posed):
    samples = posed[1].samples
    points = around(posed[1], 0.02)
    mine, theirs = samples.neighbours_of(points), samples.neighbours_of(points, "torch")
    same = (mine.index == theirs.index).all(1)
    assert float(same.float().mean()) > 0.999
    torch.testing.assert_close(mine.weight[same], theirs.weight[same], atol=3e-6, rtol=0)


@pytest.mark.parametrize("spread", [0.005, 0.3])
@pytest.mark.parametrize("restricted", [False, True])
def test_pairs_are_listed_in_the_same_order(posed, spread, restricted):
    node = posed[1].node_position
    points = around(posed[1], spread)
    nodes = torch.arange(len(node)) % 2 == 0 if restricted else None
    mine, theirs = find_pairs(points, node, nodes), find_pairs(points, node, nodes, "torch")
    assert len(mine.point) > 300
    assert torch.equal(mine.offsets, theirs.offsets)
    assert torch.equal(mine.point, theirs.point)
    assert torch.equal(mine.node, theirs.node)


@pytest.mark.parametrize("cutoff", [0.0, 0.01])
def test_places_and_weights_of_pairs_are_the_same(posed, cutoff):
    field, frame = posed
    points = around(frame, 0.03)
    pairs = field.pairs(frame, points)
    (mine, local, weight), (theirs, place, share) = (
        field.localise(frame, points, pairs, cutoff=cutoff, impl=impl) for impl in ("auto", "torch")
    )
    assert 1000 < len(theirs.point) <= len(pairs.point) - (100 if cutoff else 0)
    assert torch.equal(mine.point, theirs.point)
    assert torch.equal(mine.offsets, theirs.offsets)
    torch.testing.assert_close(local, place, atol=2e-6, rtol=0)
    torch.testing.assert_close(weight, share, atol=1e-9, rtol=2e-4)


def test_means_are_the_same_and_zero_where_no_node_reaches(posed):
    field, frame = posed
    points = torch.cat([around(frame, 0.01), torch.full((5, 3), 9.0)])
    pairs, _, weight = field.localise(frame, points, field.pairs(frame, points))
    value = torch.randn(len(weight), 7)
    (mine, total), (theirs, whole) = (
        weighted_mean(value, weight, pairs, len(points), impl) for impl in ("auto", "torch")
    )
    torch.testing.assert_close(mine, theirs, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(total, whole)
    assert not mine[-5:].any()


def test_patch_features_are_the_same_beyond_the_border_too(posed):
    field, _ = posed
    patches = torch.randn(len(field.node_axes), 4, 32, 32)
    node = torch.randint(len(field.node_axes), (4000,)).sort().values
    local = EXTENT * torch.randn(4000, 3)
    mine, theirs = (patch_features(patches, node, field.node_axes, local, impl) for impl in ("auto", "torch"))
    torch.testing.assert_close(mine, theirs, atol=2e-4, rtol=0)
    assert float(theirs.std()) > 0.3


def test_threads_change_no_bit(posed, monkeypatch):
    field, frame = posed
    points = around(frame, 0.03)
    monkeypatch.setattr(native, "FEW", 10)
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            pairs, local, weight = field.localise(frame, points, field.pairs(frame, points))
            found.append([local, weight, *weighted_mean(local, weight, pairs, len(points))])
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(one, three) for one, three in zip(*found))


def test_nothing_to_do_is_done(posed):
    field, frame = posed
    nothing = torch.zeros(0, 3)
    pairs, local, _ = field.localise(frame, nothing, field.pairs(frame, nothing))
    assert pairs.offsets.tolist() == [0] * (len(frame.node_position) + 1)
    assert local.shape == (0, 3)
    assert frame.samples.nearest(nothing).shape == (0, 5)


def test_gradients_and_float64_take_torch():
    assert native.serves(torch.zeros(2))
    assert not native.serves(torch.zeros(2, dtype=torch.float64))
    with torch.enable_grad():
        assert not native.serves(torch.zeros(2, requires_grad=True))
    assert native.serves(torch.zeros(2, requires_grad=True)), "no_grad"
