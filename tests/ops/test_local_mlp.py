import itertools

import pytest
import torch

from avatarrex.ops.encoding import Encoding, encode_reference
from avatarrex.ops.local_mlp import DIFFERENTIABLE, available, fold, local_mlp
from avatarrex.ops.local_mlp_loops import ROWS, chunks, padded

COUNTS = {
    "mixed": [3, 0, 1, 700],
    "no rows": [0, 0, 0, 0],
    "one chunk": [256, 256, 256, 256],
    "first empty": [0, 5, 0, 0],
}


def case(counts, dtype=torch.float32, seed=0):
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape):
        return torch.randn(*shape, generator=generator, dtype=dtype)

    n, k = len(counts), sum(counts)
    offsets = torch.tensor([0, *torch.tensor(counts).cumsum(0).tolist()])
    blocks = [draw(k, 5), draw(k, 2)]
    weights = [draw(n, 7, 4) * 0.3, draw(n, 4, 4) * 0.3, draw(n, 4, 3) * 0.3]
    biases = [draw(n, 4), draw(n, 4), draw(n, 3)]
    return blocks, offsets, weights, biases


@pytest.mark.parametrize("activation", ["elu", "relu"])
@pytest.mark.parametrize("counts", COUNTS.values(), ids=COUNTS.keys())
@pytest.mark.parametrize("impl", DIFFERENTIABLE[1:])
def test_values_and_gradients_follow_the_reference(impl, counts, activation):
    blocks, offsets, weights, biases = case(counts, torch.float64)
    leaves = [t.requires_grad_() for t in (*blocks, *weights, *biases)]
    expected = local_mlp(blocks, offsets, weights, biases, activation, "reference")
    found = local_mlp(blocks, offsets, weights, biases, activation, impl)
    torch.testing.assert_close(found, expected, atol=1e-12, rtol=1e-12)
    cotangent = torch.randn(expected.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    for got, want in zip(
        torch.autograd.grad(found, leaves, cotangent), torch.autograd.grad(expected, leaves, cotangent)
    ):
        torch.testing.assert_close(got, want, atol=1e-11, rtol=1e-11)
    with torch.no_grad():
        inference = local_mlp(blocks, offsets, weights, biases, activation, impl)
    torch.testing.assert_close(inference, expected.detach(), atol=1e-12, rtol=1e-12)


@pytest.mark.parametrize("activation", ["elu", "relu"])
@pytest.mark.parametrize("counts", COUNTS.values(), ids=COUNTS.keys())
def test_compiled_loops_follow_the_reference(counts, activation, monkeypatch):
    """To float32's last digits, and to the bit however many threads share the work."""
    blocks, offsets, weights, biases = case(counts)
    exact = [[part.double() for part in parts] for parts in (blocks, weights, biases)]
    found = []
    for threads in (1, 2, 3):
        monkeypatch.setattr(torch, "get_num_threads", lambda threads=threads: threads)
        monkeypatch.setattr("avatarrex.ops.local_mlp.FEW_CHUNKS", 1)
        found.append(local_mlp(blocks, offsets, weights, biases, activation, "native"))
    want = local_mlp(exact[0], offsets, *exact[1:], activation, "reference")
    torch.testing.assert_close(found[0].double(), want, atol=1e-5, rtol=1e-5)
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])


@pytest.mark.parametrize("octaves", [0, 1, 6])
@pytest.mark.parametrize("limit", [2.0, 3.2])
def test_coordinates_are_encoded_on_the_way(octaves, limit):
    """Alone, and before other channels; to the encoding's own accuracy, and NaN stays."""
    counts, generator = [0, 130, 1, 300], torch.Generator().manual_seed(octaves)
    offsets = torch.tensor([0, *torch.tensor(counts).cumsum(0).tolist()])
    x, more = 2.5 * torch.randn(sum(counts), 3, generator=generator), torch.randn(sum(counts), 2, generator=generator)
    for blocks in ([Encoding(x, octaves, limit)], [Encoding(x, octaves, limit), more], [more[:, :1], more[:, 1:]]):
        width = sum((block.values() if isinstance(block, Encoding) else block).shape[1] for block in blocks)
        weights, biases = [torch.eye(width).expand(4, -1, -1)], [torch.zeros(4, width)]
        found = local_mlp(blocks, offsets, weights, biases, "elu", "native")
        parts = [encode_reference(x.double(), octaves, limit).float(), more][: len(blocks)] if width > 2 else [more]
        torch.testing.assert_close(found, torch.cat(parts, -1), atol=4e-6, rtol=0)
        for impl in DIFFERENTIABLE:
            other = local_mlp(blocks, offsets, weights, biases, "elu", impl)
            torch.testing.assert_close(found, other, atol=6e-6, rtol=0)
    x[5, 1] = torch.nan
    assert (
        local_mlp([Encoding(x, octaves)], offsets, [torch.ones(4, 3 + 6 * octaves, 1)], [torch.zeros(4, 1)], "elu")
        .isnan()[5]
        .all()
    )


def test_compiled_activations_agree_over_all_numbers():
    """ELU to 6e-8 from −1e30 to 1e30; what is not a number stays so."""
    x = torch.cat([torch.linspace(-95, 20, 20_001), torch.tensor([-1e30, -1e-30, 0, 1e-30, 1e30])])
    one, none = torch.ones(1, 1, 1), torch.zeros(1, 1)
    offsets = torch.tensor([0, len(x)])
    for activation, exact in (("elu", torch.nn.functional.elu), ("relu", torch.relu)):
        y = local_mlp([x[:, None]], offsets, [one, one], [none, none], activation, "native")[:, 0]
        torch.testing.assert_close(y.double(), exact(x.double()), atol=1.2e-7, rtol=1e-7)
        lost = local_mlp(
            [torch.tensor([[torch.nan]])], torch.tensor([0, 1]), [one, one], [none, none], activation, "native"
        )
        assert lost.isnan().all()


def test_a_chunk_holds_rows_of_one_node():
    offsets = torch.tensor([0, 300, 300, 301, 1000]).numpy()
    node, first, last = chunks(offsets).T
    rows = last - first
    assert rows.min() >= 1
    assert rows.max() <= ROWS
    assert len(rows) == 3 + 1 + 6
    assert (first >= offsets[node]).all()
    assert (last <= offsets[node + 1]).all()
    assert (first[1:] == last[:-1]).all()
    assert (first[0], last[-1]) == (0, 1000)


@pytest.mark.parametrize("widths", [(7, 5, 3), (8, 8, 8), (9, 17, 11, 1), (40, 64, 2)])
def test_widths_of_any_number(widths):
    """Whatever is added to whole passes of a product adds nothing; a chunk that is not a number spoils no other."""
    generator, counts = torch.Generator().manual_seed(0), [150, 7]
    offsets = torch.tensor([0, 150, 157])
    x = torch.randn(157, widths[0], generator=generator)
    weights = [torch.randn(2, a, b, generator=generator) for a, b in itertools.pairwise(widths)]
    biases = [torch.randn(2, b, generator=generator) for b in widths[1:]]
    want = local_mlp([x], offsets, weights, biases, "elu", "reference")
    torch.testing.assert_close(local_mlp([x], offsets, weights, biases, "elu", "native"), want, atol=1e-4, rtol=1e-4)
    x[: counts[0]] = torch.nan
    found = local_mlp([x], offsets, weights, biases, "elu", "native")
    torch.testing.assert_close(found[150:], want[150:], atol=1e-4, rtol=1e-4)
    assert found[:150].isnan().all()


def test_padding_adds_zeros_and_copies_nothing_that_needs_none():
    values = torch.arange(24.0).reshape(2, 3, 4).numpy()
    assert padded(values, 3, 2) is values
    wide = padded(values, 8, 3)
    assert wide.shape == (2, 8, 6)
    assert (wide[:, :3, :4] == values).all()
    assert wide.sum() == values.sum()


def test_compiled_loops_refuse_what_they_cannot_do():
    with pytest.raises(ValueError, match="native: float32"):
        local_mlp(*case([2], torch.float64), "relu", "native")
    blocks, offsets, weights, biases = case([2])
    for wrong in (([blocks[0]], offsets), (blocks, offsets + 1), ([*blocks, Encoding(blocks[0][:, :3], 1)], offsets)):
        with pytest.raises(ValueError, match=r"rows for weights|not the first"):
            local_mlp(*wrong, weights, biases, "relu", "native")
    coded = Encoding(blocks[0][:1, :3], 1)
    with pytest.raises(ValueError, match="of 2 rows for weights"):
        local_mlp([coded, blocks[1]], offsets, [torch.zeros(1, 11, 4), *weights[1:]], biases, "relu", "native")
    with pytest.raises(ValueError, match=r"above 4 channels"):
        local_mlp(blocks, offsets, [*weights[:2], weights[2][:, :2]], biases, "relu", "native")
    blocks, _, weights, biases = case([2, 3])
    with pytest.raises(ValueError, match="of 5 rows for weights"):
        local_mlp(blocks, torch.tensor([0, 6, 5]), weights, biases, "relu", "native")
    weights[0].requires_grad_()
    offsets = torch.tensor([0, 2, 5])
    with pytest.raises(ValueError, match="no gradients"):
        local_mlp(blocks, offsets, weights, biases, "relu", "native")


def test_each_row_uses_its_own_node():
    """One linear layer, one input: y = w_i x + b_i."""
    offsets = torch.tensor([0, 2, 3])
    x = torch.tensor([[1.0], [2.0], [3.0]])
    weight, bias = torch.tensor([[[10.0]], [[100.0]]]), torch.tensor([[0.5], [0.25]])
    for impl in available():
        y = local_mlp([x], offsets, [weight], [bias], "elu", impl)
        assert y[:, 0].tolist() == [10.5, 20.5, 300.25]


def test_folding_equals_joining():
    blocks, offsets, weights, biases = case([4, 2, 0, 3], torch.float64)
    constant = torch.randn(4, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    node = torch.repeat_interleave(torch.arange(4), offsets.diff())
    joined = local_mlp([blocks[0], constant[node]], offsets, weights, biases, "elu", "reference")
    first, bias = fold(weights[0], biases[0], constant)
    folded = local_mlp(blocks[:1], offsets, [first, *weights[1:]], [bias, *biases[1:]], "elu")
    torch.testing.assert_close(folded, joined)


def test_second_derivatives_for_the_eikonal_term():
    blocks, offsets, weights, biases = case([2, 1], torch.float64)
    x = blocks[0].requires_grad_()
    for impl in DIFFERENTIABLE:
        assert torch.autograd.gradgradcheck(
            lambda v, impl=impl: local_mlp([v, blocks[1]], offsets, weights, biases, "elu", impl), x
        )


def test_unknown_implementation_is_named():
    with pytest.raises(ValueError, match="'cuda'"):
        local_mlp(*case([1]), "relu", "cuda")
