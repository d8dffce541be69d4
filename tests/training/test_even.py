"""Texels of a flattened fold agree with those around; others stay."""

import numpy as np
import pytest
import torch

from avatarrex.fields.detail_texture import DetailTexture, texel_count
from avatarrex.training.core.even import MOVED, even_folds


def sheet(count: int, size: float) -> tuple[torch.Tensor, torch.Tensor]:
    """A square of count² cells, `size` metres."""
    x, y = np.meshgrid(np.linspace(0, size, count + 1), np.linspace(0, size, count + 1), indexing="ij")
    a = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    faces = np.concatenate([np.stack([a, a + count + 1, a + 1], 1), np.stack([a + 1, a + count + 1, a + count + 2], 1)])
    return torch.from_numpy(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)), torch.from_numpy(faces)


def test_specks_where_a_fold_was_are_gone_and_a_slope_is_not() -> None:
    """Cells of 0.7 mm, of which one half stood 1 cm off: noise of 0.2 about a slope falls to less than 0.04 there, and stays beside."""
    flat, faces = sheet(40, 0.028)
    texture = DetailTexture.of(flat, faces, 0.002, torch.ones(len(faces), dtype=torch.bool))
    slope = 0.3 + 15 * texture.lattice.position[:, :1]
    noise = np.random.default_rng(0).choice([-0.2, 0.2], (len(slope), 3))
    texture.paint(torch.from_numpy(slope + noise).float())
    rest = flat + 0.01 * torch.tensor([0.0, 0.0, 1.0]) * (flat[:, :1] > 0.014)
    before = torch.sigmoid(texture.texel).detach().numpy()
    even_folds(texture, (rest - flat).norm(dim=1))
    found, place = torch.sigmoid(texture.texel).detach().numpy(), texture.lattice.position
    fold = (place[:, 0] > 0.019) & (place[:, 0] < 0.023) & (np.abs(place[:, 1] - 0.014) < 0.008)
    beside = place[:, 0] < 0.013
    assert np.abs(before - slope)[fold].mean() > 0.15
    assert np.abs(found - slope)[fold].mean() < 0.04
    np.testing.assert_allclose(found[beside], before[beside], atol=1e-5)


@pytest.mark.parametrize("moved", [0.5 * MOVED, MOVED, 3 * MOVED])
def test_at_the_border_of_a_fold_texels_go_as_far_as_their_corners_moved(moved: float) -> None:
    """Noise of 0.2 keeps 1 − s of itself on a triangle whose corners moved by s of `MOVED` in the mean, at most all of it."""
    flat, faces = sheet(40, 0.028)
    texture = DetailTexture.of(flat, faces, 0.002, torch.ones(len(faces), dtype=torch.bool))
    noise = np.random.default_rng(0).choice([-0.2, 0.2], (len(texture.lattice.position), 3))
    texture.paint(torch.from_numpy(0.5 + noise).float())
    beyond = (flat[:, :1] > 0.0105).double()
    even_folds(texture, moved * beyond[:, 0])
    left = np.abs(torch.sigmoid(texture.texel).detach().numpy() - 0.5).mean(1)
    count = texel_count(texture.lattice.edge)
    owner = np.repeat(np.arange(len(count)), count)
    corners = beyond[faces, 0].sum(1).long().numpy()[owner]
    for k in range(4):
        share = k / 3 * min(moved / MOVED, 1.0)
        assert abs(left[corners == k].mean() / 0.2 - (1 - share)) < 0.1 * (share > 0) + 1e-3, (k, share)


def test_without_folds_nothing_changes() -> None:
    flat, faces = sheet(4, 0.01)
    texture = DetailTexture.of(flat, faces, 0.002, torch.ones(len(faces), dtype=torch.bool))
    with torch.no_grad():
        texture.texel.copy_(torch.randn(texture.texel.shape, generator=torch.Generator().manual_seed(0)))
    before = texture.texel.detach().clone()
    even_folds(texture, torch.zeros(len(flat)))
    assert torch.equal(texture.texel, before)
