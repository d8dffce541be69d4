"""Pixels of a rig to learn from: colours on black, mattes, and the rays that see them.

Colours are sRGB-encoded in [0, 1], multiplied by the matte. Letters: r rays, h w pixels.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from avatarrex.capture.readers.rigs import Rig
from avatarrex.errors import InputError
from avatarrex.training.core.process_group import WHOLE, Share

FOREGROUND, RIM_SHARE = 0.65, 0.2
"""Shares of the rays on the person and just beside it; the others are drawn from the box around it."""
BESIDE = 0.03
"""Of the person's height in the picture: how far beside it the rim reaches. What sticks out too far is seen there."""
TRIES = 8
"""Places looked at for each ray of the rim."""
ACROSS = 0.005
"""Of the person's height in the picture, and at least a pixel: how far pixels of the outline are drawn from the matte's edge
(standard deviation in each direction)."""
AROUND = 0.12
"""Of the box's size: how far around the person the background is drawn from."""


@dataclass(frozen=True)
class PixelBatch:
    """Pixels of one view of one frame."""

    place: Float[Tensor, "r 2"]
    """(x, y), centres at +0.5."""
    colour: Float[Tensor, "r 3"]
    matte: Float[Tensor, " r"]
    share: Share = WHOLE
    """Of them that this process evaluates."""

    def joined(self, other: PixelBatch) -> PixelBatch:
        """Both, of the same picture."""
        place, colour, matte = (
            torch.cat([getattr(self, name), getattr(other, name)]) for name in ("place", "colour", "matte")
        )
        return PixelBatch(place, colour, matte, self.share)

    @property
    def own(self) -> PixelBatch:
        """This process's share alone."""
        rows = self.share.rows(len(self.place))
        return PixelBatch(self.place[rows], self.colour[rows], self.matte[rows])


def pictures(rig: Rig, frames: Iterable[int], views: Sequence[int]) -> list[tuple[int, int]]:
    """(frame, view) that are there, frame by frame."""
    return [(frame, view) for frame in frames for view in views if rig.available(view, frame)]


def training_pairs(rig: Rig) -> list[tuple[int, int]]:
    """(frame, view) that are there and not held out, frame by frame. Raises `InputError` where there are none."""
    views = [view for view in range(len(rig.views)) if view not in rig.held_out_views]
    pairs = pictures(rig, (frame for frame in range(rig.frames) if frame not in rig.held_out_frames), views)
    if not pairs:
        raise InputError(f"{rig.name} rig", "pictures", "at least one that is not held out", "none")
    return pairs


Box = tuple[int, int, int, int]
"""x0, y0, x1, y1, pixels."""


def foreground(rig: Rig, view: int, frame: int, within: Box | None) -> tuple[Bool[np.ndarray, "h w"], Box]:
    """Pixels of the person, cut to the box `within` (the whole picture unless given), and that box."""
    matte = rig.matte(view, frame)
    x0, y0, x1, y1 = box = within or (0, 0, matte.shape[1], matte.shape[0])
    return matte[y0:y1, x0:x1] > 127, box


def draw_pixels(
    rig: Rig, view: int, frame: int, count: int, rng: np.random.Generator, within: Box | None
) -> PixelBatch:
    """`count` pixels, most of them on the person or beside it; `within` (x0, y0, x1, y1) restricts them to a box.

    A picture without foreground gives background alone.
    """
    matte = rig.matte(view, frame)
    height, width = matte.shape
    inside, (x0, y0, x1, y1) = foreground(rig, view, frame, within)
    ys, xs = np.nonzero(inside)
    xs, ys = xs + x0, ys + y0
    on = rng.integers(len(ys), size=round(count * FOREGROUND)) if len(ys) else np.zeros(0, int)
    places = [np.stack([xs[on], ys[on]], 1)]
    if len(ys):
        near = rng.integers(len(ys), size=TRIES * round(count * RIM_SHARE))
        reach = 1 + int(BESIDE * np.ptp(ys))
        beside = np.stack([xs[near], ys[near]], 1) + rng.integers(-reach, reach + 1, (len(near), 2))
        beside = beside[((beside >= (x0, y0)) & (beside < (x1, y1))).all(1)]
        places.append(beside[matte[beside[:, 1], beside[:, 0]] <= 127][: round(count * RIM_SHARE)])
    if len(ys) and within is None:
        margin = 1 + int(AROUND * max(np.ptp(ys), np.ptp(xs)))
        x0, x1 = max(int(xs.min()) - margin, 0), min(int(xs.max()) + margin + 1, width)
        y0, y1 = max(int(ys.min()) - margin, 0), min(int(ys.max()) + margin + 1, height)
    left = count - sum(len(place) for place in places)
    places.append(np.stack([rng.integers(x0, x1, left), rng.integers(y0, y1, left)], 1))
    return _pixels(rig, view, frame, *np.concatenate(places).T)


def draw_outline(
    rig: Rig, view: int, frame: int, count: int, rng: np.random.Generator, within: Box | None
) -> PixelBatch:
    """`count` pixels about the matte's edge; none of a picture without one."""
    on, (x0, y0, x1, y1) = foreground(rig, view, frame, within)
    ys, xs = np.nonzero(np.diff(on, axis=0, prepend=on[:1]) | np.diff(on, axis=1, prepend=on[:, :1]))
    if not len(ys):
        none = torch.zeros(0)
        return PixelBatch(none[:, None].expand(-1, 2), none[:, None].expand(-1, 3), none)
    edge = np.stack([xs + x0, ys + y0], 1)[rng.integers(len(ys), size=count)]
    across = rng.normal(0, max(1.0, ACROSS * np.ptp(ys)), edge.shape)
    x, y = np.clip(np.rint(edge + across).astype(int), (x0, y0), (x1 - 1, y1 - 1)).T
    return _pixels(rig, view, frame, x, y)


def _pixels(rig: Rig, view: int, frame: int, x: np.ndarray, y: np.ndarray) -> PixelBatch:
    """Pixels by column and row."""
    alpha = rig.matte(view, frame)[y, x].astype(np.float32) / 255
    colour = rig.image(view, frame)[y, x].astype(np.float32) / 255 * alpha[:, None]
    place = np.stack([x, y], 1).astype(np.float32) + 0.5
    return PixelBatch(torch.from_numpy(place), torch.from_numpy(colour), torch.from_numpy(alpha))
