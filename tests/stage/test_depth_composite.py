"""Several pictures become one by depth: against a sort of each pixel by hand."""

from __future__ import annotations

import numpy as np
import torch

from avatarrex.stage.depth_composite import depth_composite


def by_hand(images: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """Every pixel of its own: who covers it, nearest first, each seen through those before it."""
    _, height, width, _ = images.shape
    made = np.zeros((height, width, 4))
    for row in range(height):
        for column in range(width):
            covering = [k for k in range(len(images)) if images[k, row, column, 3] > 0]
            free = 1.0
            for k in sorted(covering, key=lambda k: depths[k, row, column]):
                made[row, column] += free * images[k, row, column]
                free *= 1 - images[k, row, column, 3]
    return made


def layers(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Premultiplied pictures with holes and edges, and depths that are meaningless in the holes."""
    alpha = rng.choice([0.0, 0.3, 0.8, 1.0], (count, 11, 13, 1))
    return np.concatenate([alpha * rng.random((count, 11, 13, 3)), alpha], -1), rng.uniform(0.5, 3, (count, 11, 13))


def test_it_is_what_a_sort_of_each_pixel_gives():
    rng = np.random.default_rng(0)
    for count in (1, 2, 3, 5):
        images, depths = layers(rng, count)
        made = depth_composite(list(torch.from_numpy(images)), list(torch.from_numpy(depths)))
        np.testing.assert_allclose(made.numpy(), by_hand(images, depths), atol=1e-12)


def test_the_order_of_the_figures_is_none_of_the_picture_s():
    images, depths = (torch.from_numpy(values) for values in layers(np.random.default_rng(1), 3))
    made = depth_composite(list(images), list(depths))
    for order in ((1, 0, 2), (2, 1, 0)):
        turned = depth_composite([images[k] for k in order], [depths[k] for k in order])
        assert torch.allclose(turned, made, atol=1e-12)


def test_what_is_nearer_hides_what_is_farther():
    red, blue = torch.tensor([[[1.0, 0, 0, 1]]]), torch.tensor([[[0, 0, 0.5, 0.5]]])
    near, far = torch.tensor([[1.0]]), torch.tensor([[2.0]])
    assert depth_composite([red, blue], [near, far]).flatten().tolist() == [1, 0, 0, 1]
    assert depth_composite([red, blue], [far, near]).flatten().tolist() == [0.5, 0, 0.5, 1]
