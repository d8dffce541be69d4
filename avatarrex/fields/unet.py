"""A U-Net from a rendered view of the face to one feature plane (paper sec. 3.3, appendix).

Two 3×3 convolutions per level, average pooling down, nearest upsampling and skips up, a 1×1 layer out. A `stem` of 2
halves the resolution with the first convolution, so that the plane has 128² texels. Maps are kept channels-last: twice
as fast on a CPU, and a texel's channels lie side by side for the look-ups. Letters: b batch, c channels.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn


class UNet(nn.Module):
    """Channels per level in `levels`, finest first; `channels` in, `planes` out."""

    def __init__(self, channels: int, levels: tuple[int, ...], planes: int, stem: int = 1) -> None:
        super().__init__()
        widths = (channels, *levels)
        self.down = nn.ModuleList(_Level(a, b, 1 if k else stem) for k, (a, b) in enumerate(zip(widths, levels)))
        self.up = nn.ModuleList(_Level(a + b, b) for a, b in zip(levels[:0:-1], levels[-2::-1]))
        self.out = nn.Conv2d(levels[0], planes, 1)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b planes y x"]:
        """h and w divisible by stem · 2^(levels − 1)."""
        skips: list[Tensor] = []
        x = image.contiguous(memory_format=torch.channels_last)
        for level in self.down:
            x = level(nn.functional.avg_pool2d(x, 2) if skips else x)
            skips.append(x)
        for level, skip in zip(self.up, skips[-2::-1]):
            x = level(torch.cat([nn.functional.interpolate(x, scale_factor=2.0, mode="nearest"), skip], 1))
        planes: Tensor = self.out(x)
        return planes


class _Level(nn.Sequential):
    def __init__(self, a: int, b: int, stride: int = 1) -> None:
        super().__init__(nn.Conv2d(a, b, 3, stride, 1), nn.ReLU(), nn.Conv2d(b, b, 3, 1, 1), nn.ReLU())
