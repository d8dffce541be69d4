"""Picture measures against scikit-image, closed forms and finite differences."""

import math

import numpy as np
import pytest
import torch
from jaxtyping import TypeCheckError
from scipy.ndimage import gaussian_filter
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from avatarrex.errors import InputError
from avatarrex.metrics.image import C1, SCALES, gradient_energy, ms_ssim, psnr, scales, ssim


def pictures(height=48, width=40, seed=0, count=2):
    """Smooth noise and a disturbed copy, (b, 3, h, w) float64."""
    rng = np.random.default_rng(seed)
    a = gaussian_filter(rng.random((count, 3, height, width)), (0, 0, 1.5, 1.5))
    a = (a - a.min()) / (a.max() - a.min())
    b = np.clip(0.9 * a + 0.1 * rng.random(a.shape), 0, 1)
    return torch.from_numpy(a), torch.from_numpy(b)


def test_psnr_and_ssim_are_scikit_images():
    a, b = pictures()
    for k in range(len(a)):
        x, y = (image[k].permute(1, 2, 0).numpy() for image in (a, b))
        assert psnr(a, b)[k].item() == pytest.approx(peak_signal_noise_ratio(x, y, data_range=1), abs=1e-10)
        theirs = structural_similarity(
            x, y, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1, channel_axis=2
        )
        assert ssim(a, b)[k].item() == pytest.approx(theirs, abs=1e-10)


def test_masked_ssim_averages_scikit_images_map():
    a, b = pictures()
    x, y = (image[0].permute(1, 2, 0).numpy() for image in (a, b))
    _, full = structural_similarity(
        x, y, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1, channel_axis=2, full=True
    )
    mask = torch.zeros(2, 48, 40, dtype=torch.bool)
    mask[:, 10:30, 12:25] = True
    assert ssim(a, b, mask)[0].item() == pytest.approx(full[10:30, 12:25].mean(), abs=1e-10)


def test_psnr_of_a_known_error_inside_the_mask():
    a = torch.zeros(1, 3, 20, 20, dtype=torch.float64)
    b = a.clone()
    b[..., :10] = 0.1
    left = torch.zeros(1, 20, 20, dtype=torch.bool)
    left[..., :10] = True
    assert psnr(a, b, left).item() == pytest.approx(20.0)
    assert psnr(a, b).item() == pytest.approx(20.0 + 10 * math.log10(2))
    assert psnr(a, b, ~left).item() == math.inf
    assert math.isnan(psnr(a, b, left & ~left).item())


def test_a_mask_of_everything_changes_nothing():
    a, b = pictures(96, 64)
    whole = torch.ones(2, 96, 64)
    for measure in (psnr, ssim, ms_ssim):
        torch.testing.assert_close(measure(a, b, whole), measure(a, b))


def test_ms_ssim_of_flat_pictures_is_the_coarsest_luminance():
    a, b = (
        torch.full((1, 3, 200, 180), 0.3, dtype=torch.float64),
        torch.full((1, 3, 200, 180), 0.5, dtype=torch.float64),
    )
    luminance = (2 * 0.3 * 0.5 + C1) / (0.3**2 + 0.5**2 + C1)
    assert ms_ssim(a, b).item() == pytest.approx(luminance ** (SCALES[-1] / sum(SCALES)), abs=1e-9)


def test_ms_ssim_on_one_scale_is_ssim():
    a, b = pictures(21, 17)
    assert scales(17) == 1
    torch.testing.assert_close(ms_ssim(a, b).mean(), ssim(a, b).mean(), atol=2e-4, rtol=0)
    gray_a, gray_b = (image[:, :1].expand(-1, 3, -1, -1) for image in (a, b))
    torch.testing.assert_close(ms_ssim(gray_a, gray_b), ssim(gray_a, gray_b))


def test_ms_ssim_against_scipys_filters():
    a, b = pictures(192, 176, seed=3, count=1)
    x, y = a[0].numpy(), b[0].numpy()
    product = np.ones(3)
    for scale, weight in enumerate(np.array(SCALES) / sum(SCALES)):
        if scale:
            x, y = (image.reshape(3, image.shape[1] // 2, 2, -1, 2).mean((2, 4)) for image in (x, y))

        def blur(image):
            return gaussian_filter(image, (0, 1.5, 1.5), truncate=3.5)[:, 5:-5, 5:-5]

        cs = (2 * (blur(x * y) - blur(x) * blur(y)) + 0.0009) / (
            blur(x * x) - blur(x) ** 2 + blur(y * y) - blur(y) ** 2 + 0.0009
        )
        light = (2 * blur(x) * blur(y) + C1) / (blur(x) ** 2 + blur(y) ** 2 + C1)
        product *= (light * cs if scale == 4 else cs).mean((1, 2)) ** weight
    assert ms_ssim(a, b).item() == pytest.approx(product.mean(), abs=1e-10)


@pytest.mark.parametrize(
    ("side", "count"), [(11, 1), (22, 2), (87, 3), (88, 4), (128, 4), (175, 4), (176, 5), (2048, 5)]
)
def test_scales_that_fit(side, count):
    assert scales(side) == count


def test_measures_have_true_gradients():
    a, b = pictures(24, 23, count=1)
    mask = torch.rand(1, 24, 23, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    for measure in (psnr, ssim, ms_ssim):
        for given in (None, mask):
            torch.autograd.gradcheck(
                lambda x, m=measure, g=given: m(x[None], b, g), a[0].clone().requires_grad_(), fast_mode=True
            )


def test_ms_ssim_of_opposite_pictures_is_finite_with_its_slope():
    a, _ = pictures(128, 128, count=1)
    a.requires_grad_()
    value = ms_ssim(a, (1 - a).detach()).sum()
    value.backward()
    assert 0 <= value.item() < 0.2
    assert torch.isfinite(a.grad).all()


def test_gradient_energy_of_a_ramp_and_of_a_blur():
    ramp = torch.arange(32, dtype=torch.float64).mul(0.02).expand(1, 3, 16, 32)
    assert gradient_energy(ramp).item() == pytest.approx(0.02**2)
    a, _ = pictures()
    blurred = torch.from_numpy(gaussian_filter(a.numpy(), (0, 0, 1, 1)))
    assert (gradient_energy(blurred) < 0.8 * gradient_energy(a)).all()


def test_gradient_energy_inside_a_mask_does_not_see_its_border():
    a = torch.zeros(1, 3, 20, 20, dtype=torch.float64)
    a[..., 5:15, 5:15] = 1
    inside = a[:, 0] > 0
    assert gradient_energy(a, inside).item() == 0
    assert gradient_energy(a).item() > 0


def test_sizes_that_do_not_fit_are_refused():
    a, b = pictures(10, 40)
    with pytest.raises(InputError, match="at least 11 pixels"):
        ssim(a, b)
    with pytest.raises((InputError, TypeCheckError)):  # whichever looks first
        psnr(a, b[..., :-1])
