"""Hits that stay while a hand or the face changes: what their rays met is there, bit for bit, and nothing new is in their way.

A ray that meets neither a box as it was nor as it is reads the body and the other boxes alone. A pixel's coverage looks at the
pixels beside it, too, so that one more pixel around a box's window is cast anew. Polished hits move along their own rays.

Letters: h w pixels. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.rays import box_window
from avatarrex.volume.sdf_volume import SdfVolume

IMAGES = ("position", "normal", "depth", "hit", "coverage", "part_weight", "steps", "side")
"""What a point map holds of each pixel."""


@dataclass(frozen=True)
class KeptHits:
    """An earlier point map of the same view, and where it has to be made anew."""

    pointmap: PointMap
    anew: Bool[Tensor, "h w"]

    @staticmethod
    def of(pointmap: PointMap, then: SdfVolume, now: SdfVolume, camera: Camera) -> KeptHits | None:
        """What stays of the `pointmap` of `then` where the volume is `now`; None: the body is another one, and nothing does."""
        if now.body.sdf is not then.body.sdf or now.body.bricks is not then.body.bricks:
            return None
        anew = torch.zeros_like(pointmap.hit)
        for box in {*now.parts} ^ {*then.parts}:
            low, high = box_window(box, camera).reshape(2, 2)
            first = np.clip(np.floor(low) - 1, 0, (camera.width, camera.height)).astype(int)
            end = np.clip(np.ceil(high) + 1, 0, (camera.width, camera.height)).astype(int)
            anew[first[1] : end[1], first[0] : end[0]] = True
        return KeptHits(pointmap, anew)

    def joined(self, made: PointMap) -> PointMap:
        """The kept point map with what was `made` anew."""
        rows = torch.nonzero(self.anew.flatten())[:, 0]

        def join(name: str) -> Tensor | None:
            kept, new = getattr(self.pointmap, name), getattr(made, name)
            if kept is None or new is None:
                return None
            out: Tensor = kept.clone()
            out.flatten(0, 1)[rows] = new.flatten(0, 1)[rows]
            return out

        images: dict[str, Any] = {name: join(name) for name in IMAGES}
        edges = self.pointmap.edges.among(~self.anew).joined(made.edges.among(self.anew))
        return replace(made, **images, edges=edges)
