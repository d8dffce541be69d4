"""Bilinear look-up in feature maps: f = Bilinear(F, Π(p)) (paper sec. 3.1 and 3.3).

Letters: m maps, c channels, h w texels, p samples. Coordinates are in [−1, 1] over the outer texel borders (x right,
y down), clamped outside. Written as four gathers of whole texels: differentiable any number of times in maps and
coordinates, which the eikonal loss needs and `torch.nn.functional.grid_sample` does not offer.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from avatarrex.ops.native import native, serves, spread

Array = Shaped[np.ndarray, "..."]


def bilinear(
    maps: Float[Tensor, "m c h w"], index: Int[Tensor, " p"], xy: Float[Tensor, "p 2"]
) -> Float[Tensor, "p c"]:
    """Feature of map `index` at `xy` for every sample."""
    return TexelTable.of(maps).at(index, xy)


def bilinear_of_all(
    maps: Float[Tensor, "m c h w"], xy: Float[Tensor, "m p 2"], impl: str = "auto"
) -> Float[Tensor, "p _"]:
    """Features (p, m·c) of every map side by side, each at its own coordinates; `impl`: `auto`, or `torch`, which is differentiable."""
    count, channels, height, width = maps.shape
    points = xy.shape[1]
    if impl == "torch" or not (serves(maps, xy) and width > 1 and height > 1):
        index = torch.arange(count, device=xy.device).repeat_interleave(points)
        found = bilinear(maps, index, xy.reshape(-1, 2)).reshape(count, points, channels)
        return found.transpose(0, 1).reshape(points, count * channels)
    out = np.empty((points, count * channels), np.float32)
    texel = maps.permute(0, 2, 3, 1).contiguous().detach().numpy()
    spread(_sample, points, texel, xy.detach().contiguous().numpy(), out)
    return torch.from_numpy(out)


def bilinear_reference(
    maps: Float[Tensor, "m c h w"], index: Int[Tensor, " p"], xy: Float[Tensor, "p 2"]
) -> Float[Tensor, "p c"]:
    """The same through `grid_sample`, one sample at a time."""
    rows = [
        torch.nn.functional.grid_sample(
            maps[m][None], at.clamp(-1, 1)[None, None, None], "bilinear", "border", align_corners=False
        )[0, :, 0, 0]
        for m, at in zip(index.tolist(), xy)
    ]
    return torch.stack(rows) if rows else maps.new_zeros(0, maps.shape[1])


class TexelTable:
    """Feature maps with the channels of a texel side by side, made once and sampled many times."""

    def __init__(self, texel: Tensor, width: int, height: int) -> None:
        self.texel, self.width, self.height = texel, width, height

    @classmethod
    def of(cls, maps: Float[Tensor, "m c h w"]) -> TexelTable:
        _, c, height, width = maps.shape
        return cls(maps.permute(0, 2, 3, 1).reshape(-1, c), width, height)

    def at(self, index: Int[Tensor, " p"], xy: Float[Tensor, "p 2"]) -> Float[Tensor, "p c"]:
        """Feature of map `index` at `xy` for every sample."""
        x, i, right = _texel(xy[:, 0], self.width)
        y, j, down = _texel(xy[:, 1], self.height)
        corner = (index * self.height + j) * self.width + i
        upper = torch.lerp(self._take(corner), self._take(corner + right), x)
        corner = corner + down * self.width
        return torch.lerp(upper, torch.lerp(self._take(corner), self._take(corner + right), x), y)

    def _take(self, row: Tensor) -> Tensor:
        return self.texel.index_select(0, row)


def _texel(at: Tensor, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """Fraction (p, 1), lower texel and step to the upper one (0 in a map of one texel)."""
    place = ((at + 1) * (size / 2) - 0.5).clamp(0, size - 1)
    lower = place.detach().floor().long().clamp(max=max(size - 2, 0))
    return (place - lower)[:, None], lower, (lower + 1).clamp(max=size - 1) - lower


@native
def _sample(begin: int, end: int, texel: Array, xy: Array, out: Array) -> None:
    """out (p, m·c) of the points from `begin` to `end`: texel (m, h, w, c) at xy (m, p, 2)."""
    maps, height, width, channels = texel.shape
    half_x, half_y, half, one = np.float32(width / 2), np.float32(height / 2), np.float32(0.5), np.float32(1)
    for p in range(begin, end):
        for m in range(maps):
            x = min(max((xy[m, p, 0] + one) * half_x - half, np.float32(0)), np.float32(width - 1))
            y = min(max((xy[m, p, 1] + one) * half_y - half, np.float32(0)), np.float32(height - 1))
            i, j = min(math.floor(x), width - 2), min(math.floor(y), height - 2)
            u, v = np.float32(x - np.float32(i)), np.float32(y - np.float32(j))
            for c in range(channels):
                a, b = texel[m, j, i, c], texel[m, j, i + 1, c]
                upper = a + u * (b - a)
                a, b = texel[m, j + 1, i, c], texel[m, j + 1, i + 1, c]
                lower = a + u * (b - a)
                out[p, m * channels + c] = upper + v * (lower - upper)
