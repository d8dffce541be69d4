"""Fréchet inception distance between two sets of pictures (Heusel et al. 2017), and the network that it looks through.

    FID = |μ₁ − μ₂|² + tr(Σ₁ + Σ₂ − 2 (Σ₁^½ Σ₂ Σ₁^½)^½)

over the features of Inception v3, in float64. With Σ₁ = AᵀA and Σ₂ = BᵀB, the rows of A and B being the centred features
over √(n − 1), the last trace is the sum of the singular values of ABᵀ: small, and exact where Σ is singular.

With fewer pictures than features Σ is singular and the value is biased upwards: compare only values over the same pictures.

The network is the 2015 TensorFlow graph, 2048 features of a picture. Its layers (Szegedy et al. 2016, fig. 5, 6, 7, 10) are a
table, under the names of the weights: the user's file `pt_inception-2015-12-05-6726825d.pth`, by path, by
AVATARREX_INCEPTION, or in torch hub's `checkpoints` folder. Where this graph is not the published one: means do not count
padding, and the last block takes a maximum where the paper has a mean. Letters: b images, c channels, n pictures, d features.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as functional
from jaxtyping import Float
from torch import Tensor, nn

from avatarrex.errors import check
from avatarrex.metrics.image import Images
from avatarrex.metrics.weights import fill, find_weights, read_weights


def frechet_distance(a: Float[np.ndarray, "n d"], b: Float[np.ndarray, "m d"]) -> float:
    """Between the normal distributions with the means and (unbiased) covariances of two sets of features.

    Raises `InputError` for fewer than two in a set.
    """
    check(min(len(a), len(b)) >= 2, "fid", "pictures", "at least two in each set", min(len(a), len(b)))
    a, b = a.astype(np.float64), b.astype(np.float64)
    root_a, root_b = (_root(features) for features in (a, b))
    shared = np.linalg.svd(root_a @ root_b.T, compute_uv=False).sum()
    spread = (root_a**2).sum() + (root_b**2).sum() - 2 * shared
    return float(((a.mean(0) - b.mean(0)) ** 2).sum() + max(spread, 0.0))


def _root(features: np.ndarray) -> np.ndarray:
    """A with AᵀA the covariance, at most d rows."""
    centred = (features - features.mean(0)) / np.sqrt(len(features) - 1)
    return np.asarray(np.linalg.qr(centred, mode="r")) if len(centred) > centred.shape[1] else centred


INCEPTION_FILE = "pt_inception-2015-12-05-6726825d.pth"
INPUT_PIXELS = 299
"""A side: what the network was trained on; pictures are resized to it, bilinearly, whatever their shape."""
ONE, THREE, FIVE, WIDE, TALL = (1, 1), (3, 3), (5, 5), (1, 7), (7, 1)


@dataclass(frozen=True)
class Step:
    """One convolution: its name, output channels and kernel."""

    name: str
    channels: int
    kernel: tuple[int, int] = ONE
    stride: int = 1
    padded: bool = True
    """To keep the size; never where it strides."""


Branch = tuple[str | Step | tuple[Step, ...], ...]
"""One after another: poolings by name, convolutions, and last, maybe, convolutions side by side."""
POOLS = {
    "mean": partial(functional.avg_pool2d, kernel_size=3, stride=1, padding=1, count_include_pad=False),
    "max": partial(functional.max_pool2d, kernel_size=3, stride=1, padding=1),
    "half": partial(functional.max_pool2d, kernel_size=3, stride=2),
}


def _named(name: str, *steps: tuple[int, tuple[int, int]], last_stride: int = 1) -> Branch:
    """`name_1`, `name_2`, … of (channels, kernel); only the last may stride."""
    strides = [1] * (len(steps) - 1) + [last_stride]
    return tuple(Step(f"{name}_{k + 1}", *step, stride) for k, (step, stride) in enumerate(zip(steps, strides)))


def _block_a(pooled: int) -> tuple[Branch, ...]:
    return (
        (Step("branch1x1", 64),),
        _named("branch5x5", (48, ONE), (64, FIVE)),
        _named("branch3x3dbl", (64, ONE), (96, THREE), (96, THREE)),
        ("mean", Step("branch_pool", pooled)),
    )


def _block_c(inner: int) -> tuple[Branch, ...]:
    return (
        (Step("branch1x1", 192),),
        _named("branch7x7", (inner, ONE), (inner, WIDE), (192, TALL)),
        _named("branch7x7dbl", (inner, ONE), (inner, TALL), (inner, WIDE), (inner, TALL), (192, WIDE)),
        ("mean", Step("branch_pool", 192)),
    )


def _block_e(pool: str) -> tuple[Branch, ...]:
    def fork(name: str) -> tuple[Step, ...]:
        return (Step(f"{name}a", 384, (1, 3)), Step(f"{name}b", 384, (3, 1)))

    return (
        (Step("branch1x1", 320),),
        (Step("branch3x3_1", 384), fork("branch3x3_2")),
        (*_named("branch3x3dbl", (448, ONE), (384, THREE)), fork("branch3x3dbl_3")),
        (pool, Step("branch_pool", 192)),
    )


STEM = (
    Step("Conv2d_1a_3x3", 32, THREE, 2), Step("Conv2d_2a_3x3", 32, THREE, padded=False), Step("Conv2d_2b_3x3", 64, THREE),
    "half", Step("Conv2d_3b_1x1", 80), Step("Conv2d_4a_3x3", 192, THREE, padded=False), "half",
)  # fmt: skip
BLOCKS: dict[str, tuple[Branch, ...]] = {
    "Mixed_5b": _block_a(32),
    "Mixed_5c": _block_a(64),
    "Mixed_5d": _block_a(64),
    "Mixed_6a": (
        (Step("branch3x3", 384, THREE, 2),),
        _named("branch3x3dbl", (64, ONE), (96, THREE), (96, THREE), last_stride=2),
        ("half",),
    ),
    "Mixed_6b": _block_c(128),
    "Mixed_6c": _block_c(160),
    "Mixed_6d": _block_c(160),
    "Mixed_6e": _block_c(192),
    "Mixed_7a": (
        _named("branch3x3", (192, ONE), (320, THREE), last_stride=2),
        _named("branch7x7x3", (192, ONE), (192, WIDE), (192, TALL), (192, THREE), last_stride=2),
        ("half",),
    ),
    "Mixed_7b": _block_e("mean"),
    "Mixed_7c": _block_e("max"),
}


def _convolution(before: int, step: Step) -> nn.Sequential:
    """Convolution, batch normalisation (frozen), ReLU."""
    padding = "same" if step.padded and step.stride == 1 else "valid"
    conv = nn.Conv2d(before, step.channels, step.kernel, step.stride, padding, bias=False)
    bn = nn.BatchNorm2d(step.channels, eps=1e-3)  # as in the TensorFlow graph
    return nn.Sequential(OrderedDict(conv=conv, bn=bn, relu=nn.ReLU()))


class Block(nn.Module):
    """Branches side by side, joined along the channels."""

    def __init__(self, before: int, branches: tuple[Branch, ...]) -> None:
        super().__init__()
        self.branches = branches
        self.channels = 0
        for branch in branches:
            channels = before
            for steps in (_side_by_side(element) for element in branch if not isinstance(element, str)):
                for step in steps:
                    self.add_module(step.name, _convolution(channels, step))
                channels = sum(step.channels for step in steps)
            self.channels += channels

    def forward(self, values: Tensor) -> Tensor:
        """(b, c, h, w) to (b, channels, h', w')."""
        return torch.cat([self._along(branch, values) for branch in self.branches], 1)

    def _along(self, branch: Branch, values: Tensor) -> Tensor:
        for element in branch:
            if isinstance(element, str):
                values = POOLS[element](values)
            else:
                values = torch.cat([self.get_submodule(step.name)(values) for step in _side_by_side(element)], 1)
        return values


class Inception(Block):
    """The 2048 features before the classifier."""

    def __init__(self) -> None:
        super().__init__(3, (STEM,))
        for name, branches in BLOCKS.items():
            block = Block(self.channels, branches)
            self.add_module(name, block)
            self.channels = block.channels

    def forward(self, images: Images) -> Float[Tensor, "b 2048"]:
        """Features of pictures in [0, 1], of any size."""
        size = (INPUT_PIXELS, INPUT_PIXELS)
        values = super().forward(2 * functional.interpolate(images, size, mode="bilinear", align_corners=False) - 1)
        for name in BLOCKS:
            values = self.get_submodule(name)(values)
        return values.mean((-2, -1))


def _side_by_side(element: Step | tuple[Step, ...]) -> tuple[Step, ...]:
    return (element,) if isinstance(element, Step) else element


def load_inception(weights: Path | None = None) -> Inception | None:
    """The network, or None where no weights are found. Raises `InputError` for a named file that is not one."""
    file = find_weights(INCEPTION_FILE, "AVATARREX_INCEPTION", weights)
    if file is None:
        return None
    network = Inception()
    fill(network, read_weights(file), file)
    return network
