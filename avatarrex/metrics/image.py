"""How near is a picture to the truth: PSNR, SSIM, MS-SSIM, gradient energy. Differentiable.

    PSNR = −10 log₁₀ mean (a − b)²                                                         decibels, peak 1
    SSIM = mean of  l · cs,   l = (2 μ_a μ_b + C₁) / (μ_a² + μ_b² + C₁),   cs = (2 σ_ab + C₂) / (σ_a² + σ_b² + C₂)
    MS-SSIM = l_M^w_M · Π_j cs_j^w_j     over M scales, each half as wide as the one before (Wang et al. 2003)

μ, σ are taken in an 11 × 11 Gaussian window of σ = 1.5 pixels (Wang et al. 2004): scikit-image's
`structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1)`, per channel, then
averaged. Only windows that lie wholly inside the picture count: the map is 10 pixels smaller on each axis.

With a mask (1 inside the matte, 0 outside) the *measure* is averaged over the mask: PSNR over the squared errors of its
pixels, SSIM over the map at its pixels (a window there may reach outside, where both pictures show the background).
Letters: b images, h w pixels, c = 3 channels; sRGB-encoded values in [0, 1]. Each function returns one number per image.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as functional
from jaxtyping import Bool, Float
from torch import Tensor

from avatarrex.errors import check

WINDOW, SIGMA = 11, 1.5
"""Pixels: σ = 1.5 cut at 3.5 σ is a window of 11, in scikit-image as in Wang et al. 2004."""
C1, C2 = 0.01**2, 0.03**2
"""Wang et al. 2004, K = 0.01 and 0.03 at peak 1."""
SCALES = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""w_j of Wang et al. 2003, finest first: fitted to how people judged pictures at five scales."""
LUMA = (0.299, 0.587, 0.114)
"""Rec. 601 luma of encoded values, what sharpness is seen in."""
Images = Float[Tensor, "b 3 h w"]
Mask = Bool[Tensor, "b h w"] | Float[Tensor, "b h w"]


def psnr(a: Images, b: Images, mask: Mask | None = None) -> Float[Tensor, " b"]:
    """Peak signal to noise ratio in decibels; +inf for equal pictures, NaN where the mask is empty."""
    _agree(a, b, 1)
    return -10 * torch.log10(masked_mean((a - b).square().mean(1), mask))


def ssim(a: Images, b: Images, mask: Mask | None = None) -> Float[Tensor, " b"]:
    """Structural similarity, 1 for equal pictures; NaN where no pixel of the mask is 5 pixels from the border.

    Raises `InputError` below 11 pixels a side.
    """
    return Similarity.of(a, b, levels=1).ssim(mask)


def ms_ssim(a: Images, b: Images, mask: Mask | None = None) -> Float[Tensor, " b"]:
    """Multi-scale structural similarity, 1 for equal pictures.

    All five scales need 176 pixels a side. A smaller picture is compared on the scales that contain a window (128 pixels:
    four; at least 11 pixels: one), with their weights made to sum to one again. A negative mean cs counts as 10⁻⁶.
    The mask is averaged down with the pictures. Raises `InputError` below 11 pixels a side.
    """
    return Similarity.of(a, b).ms_ssim(mask)


@dataclass(frozen=True, eq=False)
class Similarity:
    """The maps that SSIM and MS-SSIM average, computed once for both and for any mask."""

    luminance: tuple[Tensor, ...]
    """l, (b, 3, h, w) at the finest and the coarsest scale."""
    structure: tuple[Tensor, ...]
    """cs, (b, 3, h, w) per scale, finest first."""

    @classmethod
    def of(cls, a: Images, b: Images, levels: int = len(SCALES)) -> Similarity:
        """On `levels` scales, or as many as fit. Raises `InputError` below 11 pixels a side."""
        _agree(a, b, WINDOW)
        pairs = []
        for scale in range(min(levels, scales(min(a.shape[-2:])))):
            if scale:
                a, b = functional.avg_pool2d(a, 2), functional.avg_pool2d(b, 2)
            pairs.append(_similarity(a, b))
        return cls((pairs[0][0], pairs[-1][0]), tuple(structure for _, structure in pairs))

    def ssim(self, mask: Mask | None = None) -> Float[Tensor, " b"]:
        """At the finest scale."""
        return masked_mean((self.luminance[0] * self.structure[0]).mean(1), _inner(mask))

    def ms_ssim(self, mask: Mask | None = None) -> Float[Tensor, " b"]:
        """Over all scales."""
        used = torch.tensor(SCALES[: len(self.structure)])
        mask = None if mask is None else mask.to(self.structure[0].dtype)
        product = torch.ones_like(self.structure[0][..., 0, 0])
        for scale, weight in enumerate((used / used.sum()).tolist()):
            if scale and mask is not None:
                mask = functional.avg_pool2d(mask[:, None], 2)[:, 0]
            last = scale == len(used) - 1
            values = self.luminance[-1] * self.structure[-1] if last else self.structure[scale]
            inner = _inner(mask)
            value = torch.stack([masked_mean(channel, inner) for channel in values.unbind(1)], 1)
            # torch.where keeps the NaN of an empty mask; the power has no slope at or below zero
            product = product * torch.where(value < 1e-6, 1e-6, value) ** weight
        return product.mean(1)


def scales(side: int) -> int:
    """How many scales of MS-SSIM contain a whole window in a picture of that smaller side, in pixels."""
    return max(k + 1 for k in range(len(SCALES)) if side >> k >= WINDOW)


def gradient_energy(a: Images, mask: Mask | None = None) -> Float[Tensor, " b"]:
    """Mean |∇ luma|² per pixel², forward differences; with a mask only where all three pixels of ∇ are inside it.

    A blurred picture has less than a sharp one: `gradient_energy(render) / gradient_energy(truth)` is its sharpness.
    """
    luma = (a * torch.tensor(LUMA, dtype=a.dtype, device=a.device)[:, None, None]).sum(1)
    here, right, below = luma[:, :-1, :-1], luma[:, :-1, 1:], luma[:, 1:, :-1]
    energy = (right - here).square() + (below - here).square()
    if mask is not None:
        inside = mask.to(a.dtype)
        mask = inside[:, :-1, :-1] * inside[:, :-1, 1:] * inside[:, 1:, :-1]
    return masked_mean(energy, mask)


def _similarity(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Luminance l and contrast-structure cs, (b, c, h − 10, w − 10)."""
    mean_a, mean_b, square_a, square_b, cross = _blur(torch.cat([a, b, a * a, b * b, a * b], 1)).chunk(5, 1)
    variance_a, variance_b, covariance = square_a - mean_a**2, square_b - mean_b**2, cross - mean_a * mean_b
    luminance = (2 * mean_a * mean_b + C1) / (mean_a**2 + mean_b**2 + C1)
    return luminance, (2 * covariance + C2) / (variance_a + variance_b + C2)


def _blur(values: Tensor) -> Tensor:
    """Gaussian means in whole windows, (b, c, h − 10, w − 10)."""
    place = torch.arange(WINDOW, dtype=values.dtype, device=values.device) - WINDOW // 2
    kernel = torch.exp(-0.5 * (place / SIGMA) ** 2)
    kernel = kernel / kernel.sum()
    count = values.shape[1]  # a group per channel: six times as fast on a CPU as a channel per picture, 30 backwards
    down, across = (kernel.view(shape).expand(count, 1, -1, -1) for shape in ((1, 1, -1, 1), (1, 1, 1, -1)))
    return functional.conv2d(functional.conv2d(values, down, groups=count), across, groups=count)


def _inner(mask: Tensor | None) -> Tensor | None:
    """The mask at the centres of whole windows."""
    edge = WINDOW // 2
    return None if mask is None else mask[:, edge:-edge, edge:-edge]


def masked_mean(values: Float[Tensor, "b h w"], mask: Tensor | None) -> Float[Tensor, " b"]:
    """Per image: mean of `values` (b, h, w), weighted by the mask (b, h, w)."""
    if mask is None:
        return values.mean((-2, -1))
    weight = mask.to(values.dtype)
    return (values * weight).sum((-2, -1)) / weight.sum((-2, -1))


def _agree(a: Tensor, b: Tensor, least: int) -> None:
    check(a.shape == b.shape, "metrics", "images", f"two of one size, {tuple(a.shape)}", tuple(b.shape))
    height, width = a.shape[-2:]
    check(min(height, width) >= least, "metrics", "images", f"at least {least} pixels a side", f"{width}x{height}")
