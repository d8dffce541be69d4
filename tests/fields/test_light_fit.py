"""The light on a face from pictures of it as it turns."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from avatarrex.fields.light import Irradiance
from avatarrex.fields.light_fit import LitPixels, fit_light

TEXELS, PICTURES = 400, 20


def seen(turn: float, light: Tensor, noise: float = 0.02, spots: float = 0.0) -> tuple[list[LitPixels], Tensor]:
    """Pictures of half a ball of random albedo that turns by up to so many degrees about the upright, and a quarter of it nods, of which
    a share has another colour in each; and the albedo."""
    rng, drawn = np.random.default_rng(1), torch.Generator().manual_seed(0)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=drawn)

    rest = torch.nn.functional.normalize(
        normal(TEXELS, 3) * torch.tensor([1.0, 1.0, 0.5]) + torch.tensor([0.0, 0.0, 1.0]), dim=-1
    )
    albedo = 0.2 + 0.5 * torch.rand(TEXELS, 3, generator=drawn)
    pictures = []
    for _ in range(PICTURES):
        angles = turn * rng.uniform(-1, 1, 2) * [1, 0.25]
        facing = rest @ torch.from_numpy(Rotation.from_euler("yx", angles, degrees=True).as_matrix()).float().T
        colour = albedo * Irradiance(light)(facing) + noise * normal(TEXELS, 3)
        spotted = torch.rand(TEXELS, generator=drawn) < spots
        colour[spotted] = 1.0
        pictures.append(
            LitPixels(torch.arange(TEXELS)[:, None].repeat(1, 3), torch.full((TEXELS, 3), 0.3), colour, facing)
        )
    return pictures, albedo


def lamps() -> Tensor:
    return 0.15 * torch.randn(8, 3, generator=torch.Generator().manual_seed(7))


@pytest.mark.parametrize("spots", [0.0, 0.1])
def test_a_head_that_turns_tells_its_light(spots: float) -> None:
    """By a hundredth of the albedo in what any turn shows; tilt, of which these pictures have little, by less."""
    light = lamps()
    pictures, albedo = seen(50.0, light, spots=spots)
    found = fit_light(torch.zeros(8, 3), pictures, TEXELS)

    def off(harmonics: Tensor) -> float:
        """Of colours between the first picture and the others, whatever the albedo is."""
        first, others = (Irradiance(harmonics), Irradiance(light)), pictures[1:]
        gains = [[one(p.normal) / one(pictures[0].normal) for one in first] for p in others]
        return float(torch.stack([(albedo * (a - b)).abs().mean() for a, b in gains]).mean())

    assert off(torch.zeros(8, 3)) > 0.03
    assert off(found) < 0.004, off(found)
    again = fit_light(found, pictures, TEXELS)
    assert (again - found).abs().max() < 0.02, "it has converged"


def test_a_head_that_stands_still_tells_nothing() -> None:
    """Its light stays in its albedo."""
    pictures, _ = seen(0.2, lamps())
    assert fit_light(torch.zeros(8, 3), pictures, TEXELS).abs().max() < 0.03


def test_pictures_that_show_nothing_tell_nothing() -> None:
    """Painting says so then."""
    none = LitPixels(torch.zeros(0, 3, dtype=torch.long), torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0, 3))
    assert torch.equal(fit_light(torch.zeros(8, 3), [none], 9), torch.zeros(8, 3))
    pictures, _ = seen(50.0, lamps())
    for one in pictures:
        one.colour[:, 2] = 0.0
    found = fit_light(torch.zeros(8, 3), pictures, TEXELS)
    assert found[:, 2].abs().max() < 1e-6
    assert found[:, :2].abs().max() > 0.1
