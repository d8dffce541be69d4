"""Bilinear look-up: closed form, `grid_sample` as the oracle, derivatives of both orders."""

import pytest
import torch

from avatarrex.ops.bilinear import bilinear, bilinear_of_all, bilinear_reference


def maps(m: int = 3, c: int = 2, h: int = 5, w: int = 4) -> torch.Tensor:
    return torch.randn(m, c, h, w, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def samples(count: int, reach: float = 1.3) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    xy = (torch.rand(count, 2, generator=generator, dtype=torch.float64) * 2 - 1) * reach
    return torch.randint(3, (count,), generator=generator), xy


def test_a_linear_ramp_is_reproduced() -> None:
    """Texel centres sit at (2 i + 1)/w − 1: x right, y down."""
    x = (torch.arange(8, dtype=torch.float64) * 2 + 1) / 8 - 1
    ramp = torch.stack([x.expand(8, 8), x[:, None].expand(8, 8)])[None]
    _, xy = samples(50, 0.87)
    torch.testing.assert_close(bilinear(ramp, torch.zeros(50, dtype=torch.long), xy), xy)


@pytest.mark.parametrize("size", [(5, 4), (1, 1), (1, 6), (7, 1)])
@pytest.mark.parametrize("count", [0, 1, 200])
def test_agrees_with_grid_sample(size: tuple[int, int], count: int) -> None:
    """Inside, on the border and outside, where both clamp."""
    index, xy = samples(count)
    values = maps(h=size[0], w=size[1])
    torch.testing.assert_close(bilinear(values, index, xy), bilinear_reference(values, index, xy), atol=1e-12, rtol=0)


def test_gradients_of_both_orders() -> None:
    """The eikonal loss differentiates the slope by the maps: `grid_sample` cannot."""
    index, xy = samples(6, 0.9)
    leaves = maps().requires_grad_(), xy.requires_grad_()
    assert torch.autograd.gradcheck(lambda m, x: bilinear(m, index, x), leaves)
    assert torch.autograd.gradgradcheck(lambda m, x: bilinear(m, index, x), leaves)


@pytest.mark.parametrize("shape", [(3, 12, 40, 30), (1, 1, 2, 2), (2, 3, 1, 5)])
def test_all_maps_at_once_are_the_maps_one_by_one(shape: tuple[int, ...]) -> None:
    """In compiled loops, beyond the borders, too; and a map of one row, which they leave to torch."""
    torch.manual_seed(0)
    maps, xy = torch.randn(shape), 3 * torch.rand(shape[0], 9000, 2) - 1.5
    found = bilinear_of_all(maps, xy)
    torch.testing.assert_close(found, bilinear_of_all(maps, xy, "torch"), atol=2e-6, rtol=0)
    want = torch.cat([bilinear_reference(maps, torch.full((50,), m), xy[m, :50]) for m in range(shape[0])], 1)
    torch.testing.assert_close(found[:50], want, atol=2e-5, rtol=0)
    assert bilinear_of_all(maps, xy[:, :0]).shape == (0, shape[0] * shape[1])
