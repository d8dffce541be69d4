"""How far a frame is from its oracle: depth, normals, silhouettes and colours (reference/oracle.py makes the exact frame).

Letters: h w image, p pixels that both hit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from avatarrex.frame import Frame
from avatarrex.reference.oracle import Oracle


@dataclass(frozen=True)
class PixelErrors:
    """What one frame does wrong, pixel by pixel."""

    depth: np.ndarray
    """(p,) millimetres, ≥ 0."""
    normal: np.ndarray
    """(p,) degrees."""
    colour: np.ndarray
    """(p, 3) sRGB differences."""
    either: int
    """Pixels that the frame or the oracle hits."""


@dataclass(frozen=True)
class Accuracy:
    """Errors over the pixels that both hit; NaN where there are none."""

    pixels: int
    depth_mean_mm: float
    depth_median_mm: float
    depth_p99_mm: float
    depth_max_mm: float
    normal_mean_deg: float
    normal_p95_deg: float
    flips: float
    """Pixels that one hits and the other does not, as a share of those that either hits."""
    colour_psnr_db: float

    @classmethod
    def of(cls, frames: Sequence[PixelErrors]) -> Accuracy:
        """All pixels of several frames together."""
        depth, normal = (np.concatenate([getattr(frame, name) for frame in frames]) for name in ("depth", "normal"))
        either, nan = sum(frame.either for frame in frames), float("nan")
        if not len(depth):
            return cls(0, nan, nan, nan, nan, nan, nan, 1.0 if either else 0.0, nan)
        colour = np.concatenate([frame.colour for frame in frames])
        return cls(
            len(depth),
            float(depth.mean()),
            float(np.median(depth)),
            float(np.quantile(depth, 0.99)),
            float(depth.max()),
            float(normal.mean()),
            float(np.quantile(normal, 0.95)),
            1 - len(depth) / either,
            float(-10 * np.log10(np.maximum(np.square(colour).mean(), np.finfo(float).tiny))),
        )


def pixel_errors(frame: Frame, oracle: Oracle, among: Bool[Tensor, "h w"] | None = None) -> PixelErrors:
    """Errors of `frame` in the pixels `among`, all unless told; colours of pixel centres, as the oracle's are, without the
    coverage that multiplies them."""
    exact, seen = oracle.pointmap, frame.pointmap
    among = torch.ones_like(exact.hit) if among is None else among
    both = exact.hit & seen.hit & among
    cosine = (seen.normal[both].double() * exact.normal[both].double()).sum(-1).clamp(-1, 1)
    image = frame.unmixed[both].double()
    return PixelErrors(
        1e3 * (seen.depth[both].double() - exact.depth[both].double()).abs().numpy(),
        torch.rad2deg(torch.arccos(cosine)).numpy(),
        (image[:, :3] / image[:, 3:] - oracle.image[both][:, :3]).numpy(),
        int(((exact.hit | seen.hit) & among).sum()),
    )


def depth_report(frame: Frame, oracle: Oracle, among: Bool[Tensor, "h w"] | None = None) -> Accuracy:
    """The errors of one frame, in the pixels `among` (all unless told)."""
    return Accuracy.of([pixel_errors(frame, oracle, among)])
