"""The measures of one picture against the truth, what each means, and their means over pictures.

| key | measure | better |
|---|---|---|
| psnr, psnr_matte | dB, peak 1 | higher |
| ssim, ssim_matte | 11 x 11 Gaussian window, σ 1.5 | higher |
| ms_ssim, ms_ssim_matte | up to 5 scales | higher |
| lpips, lpips_matte | LPIPS-VGG, where its weights are | lower |
| fid, fid_matte | over all pictures of a group, where the weights are; within the matte: the render is cut by it | lower |
| iou | silhouettes: coverage and matte at a half | higher |
| sharpness | gradient energy inside the matte over the truth's | 1 |

`_matte` means inside the matte (pixels of at least a half), the rest over the whole picture, both over black.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from avatarrex.metrics.drawing import Drawing, Truth
from avatarrex.metrics.fid import INCEPTION_FILE, Inception, frechet_distance, load_inception
from avatarrex.metrics.image import Similarity, gradient_energy, psnr
from avatarrex.metrics.mesh import silhouette_iou
from avatarrex.metrics.perceptual import Lpips, find_lpips

KEYS = (
    "psnr", "psnr_matte", "ssim", "ssim_matte", "ms_ssim", "ms_ssim_matte", "lpips", "lpips_matte", "iou", "sharpness",
)  # fmt: skip
"""What every picture has; `fid` and `fid_matte` belong to groups."""


@dataclass(frozen=True, eq=False)
class Networks:
    """The networks for which weights were found."""

    lpips: Lpips | None
    inception: Inception | None
    missing: dict[str, str]
    """By measure: the files that are not there."""

    @classmethod
    def load(cls, vgg: Path | None = None, heads: Path | None = None, inception: Path | None = None) -> Networks:
        """Raises `InputError` for a named file that is missing, and for a broken one."""
        lpips, files = find_lpips(vgg, heads)
        network = load_inception(inception)
        missing = {**({} if lpips else {"lpips": files}), **({} if network else {"fid": INCEPTION_FILE})}
        return cls(lpips, network, missing)


@dataclass(frozen=True, eq=False)
class Measured:
    """One picture of one subject."""

    subject: str
    view: str
    frame: int
    split: str
    values: dict[str, float]
    """By `KEYS`; NaN where a measure has no value (no weights, an empty matte)."""
    features: np.ndarray | None
    """(4, 2048): of the render, the truth, and both inside the matte, where there is an Inception network."""


@torch.no_grad()
def measure(drawing: Drawing, truth: Truth, networks: Networks) -> tuple[dict[str, float], np.ndarray | None]:
    """Values by `KEYS`, and Inception features."""
    render, real = (_batch(image) for image in (drawing.image[..., :3], truth.image))
    inside = (truth.matte >= 0.5)[None]
    values: dict[str, float] = {}
    similarity = Similarity.of(render, real)
    for where, mask in (("", None), ("_matte", inside)):
        values[f"psnr{where}"] = psnr(render, real, mask).item()
        values[f"ssim{where}"] = similarity.ssim(mask).item()
        values[f"ms_ssim{where}"] = similarity.ms_ssim(mask).item()
        values[f"lpips{where}"] = math.nan if networks.lpips is None else networks.lpips(render, real, mask).item()
    values["iou"] = silhouette_iou((drawing.image[..., 3] >= 0.5).numpy(), inside[0].numpy())
    values["sharpness"] = (gradient_energy(render, inside) / gradient_energy(real, inside)).item()
    features = None
    if networks.inception is not None:
        cut = inside[:, None].float()
        features = networks.inception(torch.cat([render, real, render * cut, real * cut])).numpy()
    return {key: values[key] for key in KEYS}, features


def means(pictures: Iterable[Measured]) -> dict[str, float | None]:
    """Mean of each measure over the pictures that have a finite value, FID over all; None where none has."""
    pictures = list(pictures)
    found: dict[str, float | None] = {"pictures": len(pictures)}
    for key in KEYS:
        finite = [value for picture in pictures if math.isfinite(value := picture.values[key])]
        found[key] = float(np.mean(finite)) if finite else None
    features = [picture.features for picture in pictures if picture.features is not None]
    stacked = np.stack(features, 1) if len(features) > 1 else None
    for key, first in (("fid", 0), ("fid_matte", 2)):
        found[key] = None if stacked is None else frechet_distance(*stacked[first : first + 2])
    return found


def _batch(image: Tensor) -> Tensor:
    return image.permute(2, 0, 1)[None].clamp(0, 1).contiguous()
