"""The perceptual loss of pass II and its measure: LPIPS on VGG-16 (Zhang et al. 2018), else 1 − MS-SSIM.

    LPIPS(a, b) = Σ_l mean over pixels of  Σ_c w_lc (â_lc − b̂_lc)²        â: features of unit length over the channels

at the layers relu1_2, relu2_2, relu3_3, relu4_3, relu5_3. The network is defined here; its weights are the user's files:

- `vgg16-397923af.pth` (torch hub's name; 528 MB) by path, by AVATARREX_VGG, or in torch hub's `checkpoints` folder;
  a `.safetensors` with the same `features.*` names will do.
- the linear heads w: `vgg.pth` (7 KB) of the PyPI package `lpips`, by path (that file, or the package's wheel), by
  AVATARREX_LPIPS, or as installed. The package is never imported: it imports torchvision.

Letters: b images, h w pixels, c channels, l layers; sRGB-encoded values in [0, 1].
"""

from __future__ import annotations

import importlib.util
import logging
import os
from pathlib import Path

import torch
import torch.nn.functional as functional
from jaxtyping import Float
from torch import Tensor, nn

from avatarrex.errors import InputError
from avatarrex.fields.placement import place_network
from avatarrex.metrics.image import Images, Mask, masked_mean, ms_ssim
from avatarrex.metrics.weights import fill, find_weights, read_weights

log = logging.getLogger(__name__)
VGG_FILE, HEADS_FILE = "vgg16-397923af.pth", "lpips/weights/v0.1/vgg.pth"
BLOCKS = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
"""Channels of VGG-16's convolutions between its poolings (Simonyan & Zisserman 2015, configuration D)."""
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""LPIPS 0.1 normalises pictures in [−1, 1] by these (ImageNet's mean and deviation on that scale)."""
LEAST_PIXELS = 16
"""Pixels a side: four poolings leave one."""


class VggFeatures(nn.Module):
    """The convolutions of VGG-16 under torch hub's names; gives the five activations before each pooling and the last."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        before = 3
        for block in BLOCKS:
            for channels in block:
                layers += [nn.Conv2d(before, channels, 3, padding=1), nn.ReLU()]
                before = channels
            layers.append(nn.MaxPool2d(2))
        self.features = nn.Sequential(*layers[:-1])

    def forward(self, images: Images) -> list[Tensor]:
        """Activations (b, c, h, w) at relu1_2, relu2_2, relu3_3, relu4_3, relu5_3."""
        found = []
        for layer in self.features:
            if isinstance(layer, nn.MaxPool2d):
                found.append(images)
            images = layer(images)
        return [*found, images]


class Lpips(nn.Module):
    """LPIPS with VGG-16; untrained until filled."""

    shift: Tensor
    scale: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.network = VggFeatures()
        heads = (nn.Sequential(nn.Identity(), nn.Conv2d(block[-1], 1, 1, bias=False)) for block in BLOCKS)
        self.heads = nn.ModuleDict({f"lin{k}": nn.ModuleDict({"model": head}) for k, head in enumerate(heads)})
        self.register_buffer("shift", torch.tensor(SHIFT)[:, None, None])
        self.register_buffer("scale", torch.tensor(SCALE)[:, None, None])

    def forward(self, a: Images, b: Images, mask: Mask | None = None) -> Float[Tensor, " b"]:
        """Distance per image; with a mask each layer's average is weighted by the mask's share of its cells."""
        if a.shape != b.shape or min(a.shape[-2:]) < LEAST_PIXELS:
            found = f"{tuple(a.shape)} and {tuple(b.shape)}"
            raise InputError("lpips", "images", f"two of one size, at least {LEAST_PIXELS} pixels a side", found)
        both = self.network((2 * torch.cat([a, b]) - 1 - self.shift) / self.scale)
        total = a.new_zeros(len(a))
        for features, (head,) in zip(both, self.heads.parameters()):
            of_a, of_b = _unit(features).chunk(2)
            distance = ((of_a - of_b).square() * head).sum(1)
            cells = mask
            if mask is not None:
                cells = functional.adaptive_avg_pool2d(mask.to(distance.dtype)[:, None], distance.shape[-2:])[:, 0]
            total = total + masked_mean(distance, cells)
        return total


class Perceptual(nn.Module):
    """A perceptual loss: `perceptual(a, b)` is one number, 0 for equal pictures; `distance` gives one per image."""

    def __init__(self, lpips: Lpips | None, note: str) -> None:
        super().__init__()
        self.lpips = lpips
        self.name = "lpips-vgg" if lpips else "ms-ssim"
        self.note = note
        """Which files it uses, or which are missing."""

    @classmethod
    def load(cls, weights: Path | None = None, heads: Path | None = None) -> Perceptual:
        """LPIPS-VGG where both files are found, else 1 − MS-SSIM; the log and `note` say which and why.

        Raises `InputError` for a file that was named and is missing, and for any that is broken.
        """
        lpips, files = find_lpips(weights, heads)
        note = f"LPIPS-VGG ({files})" if lpips else f"1 − MS-SSIM (no weights: {files})"
        perceptual = cls(lpips, f"perceptual term: {note}")
        log.log(logging.INFO if lpips else logging.WARNING, perceptual.note)
        return perceptual

    def forward(self, a: Images, b: Images) -> Float[Tensor, ""]:
        """Mean over the batch; gradients flow into both pictures, never into the weights."""
        return self.distance(a, b).mean()

    def place(self, device: torch.device | str) -> None:
        """Run LPIPS on `device` (fields/placement.py); 1 − MS-SSIM has no network."""
        if self.lpips is not None:
            place_network(self.lpips, device)

    def distance(self, a: Images, b: Images, mask: Mask | None = None) -> Float[Tensor, " b"]:
        """Per image."""
        return self.lpips(a, b, mask) if self.lpips is not None else 1 - ms_ssim(a, b, mask)


def find_heads(path: Path | None = None) -> Path | None:
    """The file of the linear heads or the wheel that contains it; None where there is none. Raises `InputError`."""
    if path or os.environ.get("AVATARREX_LPIPS"):
        return find_weights(Path(HEADS_FILE).name, "AVATARREX_LPIPS", path)
    package = importlib.util.find_spec("lpips")  # finds, does not import
    if package is None or package.origin is None:
        return None
    file = Path(package.origin).parent.parent / HEADS_FILE
    return file if file.is_file() else None


def find_lpips(vgg: Path | None = None, heads: Path | None = None) -> tuple[Lpips | None, str]:
    """LPIPS and the names of its files; None and the names of those that are missing. Raises `InputError`."""
    found = {VGG_FILE: find_weights(VGG_FILE, "AVATARREX_VGG", vgg), HEADS_FILE: find_heads(heads)}
    vgg, heads = found.values()
    if vgg is None or heads is None:
        return None, ", ".join(name for name, file in found.items() if file is None)
    return load_lpips(vgg, heads), f"{vgg.name}, {heads.name}"


def load_lpips(vgg: Path, heads: Path) -> Lpips:
    """LPIPS from its two files. Raises `InputError`."""
    lpips = Lpips()
    fill(lpips.network, read_weights(vgg), vgg)
    fill(lpips.heads, read_weights(heads, HEADS_FILE), heads)
    return lpips.requires_grad_(False).eval()


def _unit(features: Tensor) -> Tensor:
    """Unit length over channels. 1e-20 under the root: silent cells have no slope instead of NaN."""
    return features / ((features.square().sum(1, keepdim=True) + 1e-20).sqrt() + 1e-10)
