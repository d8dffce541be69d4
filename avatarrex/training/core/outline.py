"""The silhouette term's rays: each is evaluated once, where it is closest to the surface.

Of the pixels that volume rendering draws one in ten or so lies on the matte's edge, so pass I draws more about it
(`pixels.draw_outline`). Such a ray costs a walk over the stored volume and one distance, where a rendered one costs five
distances and colours. Letters: r rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.pointmap.rays import RayPlane
from avatarrex.training.core.losses import PURE
from avatarrex.training.core.pixels import PixelBatch
from avatarrex.training.core.sampling import Walk
from avatarrex.training.core.trained_field import TrainedField
from avatarrex.volume.sdf_volume import SdfVolume

OUTLINE_BAND = 0.03
"""Metres: rays that get no closer to the stored surface, or go deeper into it, are not queried for the silhouette."""
SURE = 0.008
"""Metres: nor are rays on the right side of the stored surface by as much."""


@dataclass(frozen=True)
class Closest:
    """What silhouette_loss compares."""

    distance: Float[Tensor, " r"]
    """Of the ray's lowest point, metres; NaN where it is not queried: the stored one is right, or beyond `OUTLINE_BAND`."""
    width: Float[Tensor, " r"]
    """Metres a pixel spans there."""
    matte: Float[Tensor, " r"]
    """To be met; between 0 and 1 only where an edge is stored beside, elsewhere (hair, a soft segmentation) a side."""
    part_weight: Float[Tensor, "r 3"]
    """The parts' shares there."""


def closest(field: TrainedField, volume: SdfVolume, camera: Camera, pixels: PixelBatch) -> Closest:
    """The field's distance where the rays of `pixels` come closest to the stored surface or lie deepest in it.

    `camera` is in the root frame, as the volume is.
    """
    plane = RayPlane.of(camera, volume.middle)
    rays = plane.rays(pixels.place)
    t, stored = Walk(volume, rays).lowest
    matte = torch.where(stored.abs() < SURE, pixels.matte, (pixels.matte > 0.5).to(pixels.matte))
    right = ((matte > 1 - PURE) & (stored < -SURE)) | ((matte < PURE) & (stored > SURE))
    queried = torch.nonzero((stored.abs() < OUTLINE_BAND) & ~right)[:, 0]
    found = field.composed(rays.at(t)[queried])
    distance = torch.full_like(stored, torch.nan).index_put((queried,), found.sdf)
    part_weight = stored.new_zeros(len(stored), 3).index_put((queried,), found.part_weight.detach())
    return Closest(distance, plane.footprint * (1 - t / rays.camera), matte, part_weight)
