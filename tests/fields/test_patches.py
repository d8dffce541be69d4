import pytest
import torch

from avatarrex.fields.patches import (
    EXTENT,
    PATCH_PIXELS,
    PatchNetwork,
    patches_reference,
    sample_patches,
    sample_patches_reference,
)


@pytest.fixture
def network():
    torch.manual_seed(0)
    return PatchNetwork(nodes=4, embedding=3, encoding=2, hidden=(5, 4), out=2).double()


def test_values_and_gradients_follow_the_reference(network):
    embedding = torch.randn(4, 3, dtype=torch.float64, requires_grad=True)
    fast, reference = network(embedding), patches_reference(network, embedding)
    assert fast.shape == (4, 2, PATCH_PIXELS, PATCH_PIXELS)
    torch.testing.assert_close(fast, reference, atol=1e-12, rtol=1e-12)
    leaves = [embedding, *network.parameters()]
    cotangent = torch.randn_like(fast)
    for got, want in zip(
        torch.autograd.grad(fast, leaves, cotangent), torch.autograd.grad(reference, leaves, cotangent)
    ):
        torch.testing.assert_close(got, want, atol=1e-10, rtol=1e-10)


@pytest.mark.parametrize("widths", [((5, 4), 2), ((), 3), ((1,), 1)])
def test_compiled_loops_follow_the_reference(widths):
    torch.manual_seed(1)
    network = PatchNetwork(nodes=4, embedding=3, encoding=2, hidden=widths[0], out=widths[1]).requires_grad_(False)
    for bias in network.biases:
        bias.normal_()
    embedding, nodes = torch.randn(4, 3), torch.tensor([3, 0, 1])
    found = network(embedding, nodes)
    assert found.is_contiguous(memory_format=torch.channels_last)
    assert found.dtype == torch.float32
    for want in (
        network(embedding, nodes, impl="torch"),
        patches_reference(network.double(), embedding.double())[nodes],
    ):
        torch.testing.assert_close(found.to(want), want, atol=2e-6, rtol=2e-6)


def test_some_nodes_only(network):
    embedding = torch.randn(4, 3, dtype=torch.float64)
    torch.testing.assert_close(network(embedding, torch.tensor([2, 0])), network(embedding)[[2, 0]])
    assert network(embedding, torch.zeros(0, dtype=torch.int64)).shape == (0, 2, PATCH_PIXELS, PATCH_PIXELS)


def test_patches_depend_on_the_embedding(network):
    changed = torch.zeros(4, 3, dtype=torch.float64)
    changed[1] = 1
    apart = (network(changed) - network(torch.zeros_like(changed))).abs().amax((1, 2, 3))
    assert apart[1] > 0.01
    assert apart[[0, 2, 3]].max() == 0


def test_bilinear_is_exact_on_a_linear_image_and_clamps():
    """A patch of its own texel centres returns the plane coordinate."""
    centre = ((torch.arange(PATCH_PIXELS) + 0.5) * (2 / PATCH_PIXELS) - 1) * EXTENT
    v, u = torch.meshgrid(centre, centre, indexing="ij")
    patches = torch.stack([torch.zeros(2, PATCH_PIXELS, PATCH_PIXELS), torch.stack([u, v])])
    plane = (torch.rand(100, 2) * 2 - 1) * centre[-1]
    node = torch.ones(100, dtype=torch.int64)
    torch.testing.assert_close(sample_patches(patches, node, plane), plane, atol=1e-7, rtol=0)
    far = sample_patches(patches, node[:1], torch.tensor([[9.0, -9.0]]))
    torch.testing.assert_close(far[0], torch.stack([centre[-1], centre[0]]), atol=1e-7, rtol=0)


def test_sampling_follows_the_grid_sampler():
    patches = torch.randn(3, 4, PATCH_PIXELS, PATCH_PIXELS, dtype=torch.float64, requires_grad=True)
    plane = ((torch.rand(200, 2, dtype=torch.float64) * 2.6 - 1.3) * EXTENT).requires_grad_()
    node = torch.randint(3, (200,))
    fast, reference = sample_patches(patches, node, plane), sample_patches_reference(patches, node, plane)
    torch.testing.assert_close(fast, reference, atol=1e-12, rtol=1e-12)
    cotangent = torch.randn_like(fast)
    got = torch.autograd.grad(fast, (patches, plane), cotangent)
    want = torch.autograd.grad(reference, (patches, plane), cotangent)
    torch.testing.assert_close(got[0], want[0], atol=1e-12, rtol=1e-12)
    torch.testing.assert_close(got[1], want[1], atol=1e-9, rtol=1e-9)


def test_no_points():
    patches = torch.randn(3, 4, PATCH_PIXELS, PATCH_PIXELS)
    assert sample_patches(patches, torch.zeros(0, dtype=torch.int64), torch.zeros(0, 2)).shape == (0, 4)
