"""Densities, quadratures and weights against closed forms: a slab, a sphere, opaque and empty rays."""

from __future__ import annotations

import math

import pytest
import torch

from avatarrex.training.core.losses import NEARBY, mask_loss, silhouette_loss
from avatarrex.training.core.volume_rendering import Gamma, interval_depth, laplace_density, render_weights


def cdf(value: float, scale: float) -> float:
    """Laplace CDF as printed in every textbook."""
    return 0.5 * math.exp(value / scale) if value < 0 else 1 - 0.5 * math.exp(-value / scale)


def test_the_density_is_the_laplace_cdf_over_its_scale():
    sdf = torch.tensor([-0.05, -1e-3, -1e-5, 0.0, 1e-5, 1e-3, 0.05], dtype=torch.float64)
    for gamma in (5e-4, 0.02):
        expected = torch.tensor([cdf(-s, gamma) / gamma for s in sdf.tolist()], dtype=torch.float64)
        torch.testing.assert_close(laplace_density(sdf, gamma), expected, rtol=1e-12, atol=1e-9)


def test_density_and_slope_are_finite_far_from_the_surface():
    sdf = torch.tensor([-3.0, -0.5, 0.5, 3.0], requires_grad=True)
    density = laplace_density(sdf, 5e-4)
    (slope,) = torch.autograd.grad(density.sum(), sdf)
    torch.testing.assert_close(density.detach(), torch.tensor([2000.0, 2000.0, 0.0, 0.0]))
    assert torch.equal(slope, torch.zeros(4))


@pytest.mark.parametrize("gamma", [5e-4, 5e-3, 0.02])
def test_an_interval_is_the_integral_of_the_density(gamma):
    torch.manual_seed(0)
    start, end = (0.03 * torch.randn(200, dtype=torch.float64) for _ in range(2))
    length = (end - start).abs() * (1 + torch.rand(200, dtype=torch.float64))
    place = (torch.arange(200_000, dtype=torch.float64) + 0.5) / 200_000
    for s0, s1, way in list(zip(start, end, length))[:20]:
        exact = laplace_density(s0 + (s1 - s0) * place, gamma).mean() * way
        assert float((interval_depth(s0, s1, way, gamma) - exact).abs()) <= 2e-3 * float(exact) + 1e-9


def test_a_slab_absorbs_what_the_formula_says():
    """A ray straight through s = t₀ − t: τ up to t is γ-independent algebra, so opacity is known in closed form."""
    gamma, surface = 0.004, 0.31
    t = torch.linspace(0, 0.6, 13, dtype=torch.float64)[None]
    sdf = surface - t
    _, opacity = render_weights(sdf, t, gamma)

    def antiderivative(s: float) -> float:
        return min(s, 0) - gamma / 2 * math.exp(-abs(s) / gamma)

    last = surface - 0.6
    depth = -(antiderivative(last) - antiderivative(surface)) / gamma + 2.0 * -last / gamma
    assert opacity.item() == pytest.approx(-math.expm1(-depth), rel=1e-12)


def test_a_whiff_of_fog_keeps_its_digits():
    """Optical depths of 1e-7 in float32: 1 − exp(−τ) is wrong by up to a fifth there."""
    depth = torch.logspace(-8, -5, 50)
    gamma = 0.01
    sdf = torch.full((50, 2), 0.5 * gamma)
    length = depth / laplace_density(sdf[:, 0], gamma)
    t = torch.stack([torch.zeros(50), length], 1)
    _, opacity = render_weights(sdf, t, gamma)
    torch.testing.assert_close(opacity, depth, rtol=1e-5, atol=0)


def test_six_samples_find_the_depth_of_a_sphere():
    """Expected depth along rays at a sphere of 0.3 m: with γ → 0 it is where the ray meets it."""
    x = torch.linspace(-0.25, 0.25, 41, dtype=torch.float64)
    meets = 1 - (0.09 - x.square()).sqrt()
    t = meets[:, None] + torch.tensor([-0.009, -0.004, -0.001, 0.0005, 0.003, 0.008], dtype=torch.float64)
    sdf = (x[:, None].square() + (1 - t).square()).sqrt() - 0.3
    weight, opacity = render_weights(sdf, t, 5e-4)
    depth = (weight * t).sum(-1)
    assert float((opacity - 1).abs().max()) < 1e-3
    assert float((depth - meets).abs().max()) < 2.5e-3


def test_point_quadrature_converges_to_the_interval_one():
    t = torch.linspace(0, 1, 4001, dtype=torch.float64)[None]
    sdf = 0.2 - 0.5 * t
    for mine, other in zip(render_weights(sdf, t, 0.02, "point"), render_weights(sdf, t, 0.02, "interval")):
        torch.testing.assert_close(mine.sum(-1), other.sum(-1), rtol=0, atol=1e-3)


def test_repeated_samples_weigh_nothing_and_empty_rays_see_nothing():
    t = torch.tensor([[0.1, 0.2, 0.3, 0.3, 0.3], [0.1, 0.2, 0.3, 0.4, 0.5]])
    sdf = torch.tensor([[0.02, 0.001, 0.05, 0.05, 0.05], [0.5] * 5])
    weight, opacity = render_weights(sdf, t, 0.005)
    short, short_opacity = render_weights(sdf[:1, :3], t[:1, :3], 0.005)
    torch.testing.assert_close(weight[0, :2], short[0, :2])
    torch.testing.assert_close(weight[0, 2:].sum(), short[0, 2])
    torch.testing.assert_close(opacity[:1], short_opacity)
    assert opacity[1] < 1e-12


@pytest.mark.parametrize("quadrature", ["interval", "point"])
def test_gradients_of_colour_and_opacity(quadrature):
    torch.manual_seed(1)
    t = torch.rand(3, 6, dtype=torch.float64).sort(-1).values
    sdf = (0.02 * torch.randn(3, 6, dtype=torch.float64)).requires_grad_(True)
    assert torch.autograd.gradcheck(lambda s: render_weights(s, t, 0.01, quadrature), sdf, eps=1e-7, atol=1e-4)


def test_gamma_falls_to_its_last_value():
    gamma = Gamma(steps=100)
    assert gamma.at(0) == pytest.approx(0.0205)
    assert gamma.at(50) == pytest.approx(0.0105)
    assert gamma.at(100) == gamma.at(5000) == 5e-4


def test_a_ray_that_misses_by_far_moves_the_silhouette_alone():
    """A sphere of 10 cm is seen as large as one of 12 cm: fog of half a millimetre says nothing at the rim's rays."""
    radius = torch.tensor(0.10, requires_grad=True)
    beside = torch.linspace(0.112, 0.118, 7)
    t = torch.linspace(-0.2, 0.2, 81).expand(7, -1)
    sdf = (t.square() + beside[:, None].square()).sqrt() - radius
    one, width = torch.ones(7), torch.full((7,), 0.002)
    _, opacity = render_weights(sdf, t, 5e-4)
    (silent,) = torch.autograd.grad(mask_loss(opacity, one, one).value, radius, retain_graph=True)
    off = silhouette_loss(sdf.amin(1), width, one, one).value
    (slope,) = torch.autograd.grad(off, radius)
    assert abs(float(silent)) < 1e-6
    assert float(slope) == pytest.approx(-1 / NEARBY)
    assert float(off.detach()) == pytest.approx((0.015 + 0.001) / NEARBY, rel=1e-4)  # each pixel is to be covered whole


def test_a_silhouette_is_right_within_its_pixels():
    """Of rays on the right side only the edge's own pixels say where it is."""
    width = torch.full((4,), 0.004)
    one = torch.ones(4)
    matte = torch.tensor([1.0, 0.0, 0.75, 0.25])
    right = torch.tensor([-0.01, 0.01, -0.001, 0.001])
    assert float(silhouette_loss(right, width, matte, one).value) == pytest.approx(0, abs=1e-6)
    wrong = torch.tensor([0.01, -0.01, 0.001, -0.001], requires_grad=True)
    (slope,) = torch.autograd.grad(silhouette_loss(wrong, width, matte, one).value, wrong)
    torch.testing.assert_close(slope, torch.tensor([1.0, -1, 1, -1]) / (4 * NEARBY))
    silent = silhouette_loss(torch.tensor([torch.nan, -0.01, torch.nan, 0.001]), width, matte, one).value
    assert float(silent) == pytest.approx(0.012 / (4 * NEARBY))
