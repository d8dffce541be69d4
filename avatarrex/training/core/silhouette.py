"""How far the drawn silhouette of a picture is off the edge of its matte. Ours.

Where the body ends before the background a pixel of its border says how much higher the surface has to stand: the matte's edge is so many
pixels beyond. Parallax needs a pattern and a surface that faces the camera; the silhouette needs neither.

Letters: e pixels of the border, h w pixels. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import binary_erosion, distance_transform_edt
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.fields.local_frame import Neighbours, Samples
from avatarrex.pointmap.point_map import PointMap

FARTHEST = 0.02
"""Metres that a matte's edge may be off the silhouette; farther off it is another thing's."""
ALONG = 0.7
"""Cosine between the surface's normal and the way to the matte's edge, at least."""


@dataclass(frozen=True)
class Silhouette:
    """Of one picture."""

    beside: Neighbours
    """The samples of the body that carry the border's pixels."""
    miss: Float[Tensor, " e"]
    """By how much higher the surface has to stand."""

    @classmethod
    def of(
        cls, seen: PointMap, own: Bool[Tensor, "h w"], matte: Bool[np.ndarray, "h w"], camera: Camera, samples: Samples
    ) -> Silhouette:
        """Of what `camera` has `seen` (root frame); border pixels that are not of its `own` part do not count."""
        drawn = (seen.coverage > 0.5).numpy()
        border = drawn & ~binary_erosion(drawn, border_value=1) & own.numpy()
        beyond = signed_distance(matte)
        row, column = np.nonzero(border)
        away = camera.camera_from_world[:2, :3] @ seen.normal[row, column].numpy().T
        slope = np.stack(np.gradient(beyond), -1)[row, column]
        slope /= np.linalg.norm(slope, axis=1, keepdims=True).clip(1e-6)
        along = (away[::-1].T * slope).sum(1)
        miss = (-0.5 - beyond[row, column]) * seen.depth[row, column].numpy() / camera.intrinsics[0, 0]
        counts = torch.from_numpy((np.abs(miss) < FARTHEST) & (along > ALONG))
        return cls(samples.neighbours_of(seen.position[row, column][counts]), torch.from_numpy(miss).float()[counts])


def signed_distance(mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Pixels to the edge of `mask`, negative within."""
    found: np.ndarray = np.where(mask, 0.5 - distance_transform_edt(mask), distance_transform_edt(~mask) - 0.5)
    return found
