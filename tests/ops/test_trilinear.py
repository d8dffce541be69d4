"""Trilinear interpolation against its definition, scipy and finite differences."""

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates

from avatarrex.ops.trilinear import trilinear


def random_grid(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def random_places(count: int, size: list[int], beyond: float = 0.0) -> torch.Tensor:
    unit = torch.rand(count, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    return unit * (torch.tensor(size) - 1 + 2 * beyond) - beyond


def test_a_multilinear_function_is_reproduced():
    z, y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (4, 5, 6)), indexing="ij")
    grid = (1 + 2 * x - y + 3 * z + x * y - 0.5 * x * y * z)[..., None]
    place = random_places(200, [6, 5, 4])
    x, y, z = place.unbind(1)
    expected = 1 + 2 * x - y + 3 * z + x * y - 0.5 * x * y * z
    torch.testing.assert_close(trilinear(grid, place)[:, 0], expected)
    # Axes in the wrong order are seen.
    assert (trilinear(grid, place.flip(1).clamp(max=3))[:, 0] - expected).abs().max() > 1


@pytest.mark.parametrize("shape", [(4, 5, 6), (2, 2, 2), (1, 3, 2), (1, 1, 1)])
def test_agrees_with_scipy_and_clamps_at_the_border(shape):
    grid = random_grid(*shape, 2)
    place = random_places(300, list(shape[::-1]), beyond=1.5)
    expected = [
        map_coordinates(grid[..., c].numpy(), place.flip(1).T.numpy(), order=1, mode="nearest") for c in range(2)
    ]
    torch.testing.assert_close(trilinear(grid, place), torch.as_tensor(np.stack(expected, 1)))


def test_gradients():
    grid, place = random_grid(3, 4, 5, 2), random_places(10, [5, 4, 3])
    assert torch.autograd.gradcheck(trilinear, (grid.requires_grad_(), place.requires_grad_()))


def test_no_points_and_half_storage():
    assert trilinear(random_grid(2, 2, 2, 3), torch.zeros(0, 3)).shape == (0, 3)
    grid = random_grid(3, 3, 3, 1)
    place = random_places(20, [3, 3, 3]).float()
    assert trilinear(grid.half(), place).dtype == torch.float32
    torch.testing.assert_close(trilinear(grid.half(), place), trilinear(grid.float(), place), atol=2e-3, rtol=0)
