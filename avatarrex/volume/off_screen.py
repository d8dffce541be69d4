"""Hands and face that a view cannot show: their boxes lie off screen and need not be built (docs/architecture.md, skip table).

A part changes the field in its box alone, and its box follows from the posed mesh. Parts that the body hides are built:
rays that pass beside the body come near nearly every part (docs/experiments.md, 'Parts hidden behind the body').
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.settings import RenderSettings
from avatarrex.templates.posed import PosedPerson
from avatarrex.volume.part_box import coarse_lattice

PIXELS_BESIDE = 1.0
"""Pixels around the picture: antialiasing samples half a pixel aside."""


def off_screen_parts(avatar: Avatar, posed: PosedPerson, view: Camera, settings: RenderSettings) -> frozenset[str]:
    """Parts whose box no ray of the root-frame camera `view` can enter; none where every voxel is evaluated."""
    if settings.everywhere:
        return frozenset()
    boxes = {
        name: coarse_lattice(part, posed.parts[name], settings.part_voxel).corners()
        for name, part in avatar.parts.items()
        if name not in settings.hidden
    }
    return frozenset(name for name, corners in boxes.items() if _outside(corners, posed.root_from_part(name), view))


def _outside(corners: Float[np.ndarray, "8 3"], root_from_part: Float[np.ndarray, "4 4"], view: Camera) -> bool:
    """Whether one side of the view frustum has all corners beyond it."""
    pose = view.camera_from_world @ root_from_part
    x, y, z = ((corners @ pose[:3, :3].T + pose[:3, 3]) @ view.intrinsics.T).T
    right, bottom = view.width + PIXELS_BESIDE, view.height + PIXELS_BESIDE
    sides = (z, x + PIXELS_BESIDE * z, right * z - x, y + PIXELS_BESIDE * z, bottom * z - y)
    return any(bool((side < 0).all()) for side in sides)
