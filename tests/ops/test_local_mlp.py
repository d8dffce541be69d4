import pytest
import torch

from avatarrex.ops.local_mlp import available, fold, local_mlp

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
@pytest.mark.parametrize("impl", available()[1:])
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
    for impl in available():
        assert torch.autograd.gradgradcheck(
            lambda v, impl=impl: local_mlp([v, blocks[1]], offsets, weights, biases, "elu", impl), x
        )


def test_unknown_implementation_is_named():
    with pytest.raises(ValueError, match="'cuda'"):
        local_mlp(*case([1]), "relu", "cuda")
