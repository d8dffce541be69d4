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

BOX_ROUNDING = 4.0
"""Part voxels by which a box may exceed the part's bounds: boxes begin on a coarse lattice (part_box.py)."""
PIXELS_BESIDE = 1.0
"""Pixels around the picture: antialiasing samples half a pixel aside."""


def off_screen_parts(avatar: Avatar, posed: PosedPerson, view: Camera, settings: RenderSettings) -> frozenset[str]:
    """Parts whose box no ray of the root-frame camera `view` can enter; none where every voxel is evaluated."""
    if settings.everywhere:
        return frozenset()
    boxes = {name: _corners(part.bounds(posed.parts[name]), settings) for name, part in avatar.parts.items()}
    return frozenset(name for name, corners in boxes.items() if _outside(corners, posed.root_from_part(name), view))


def _corners(bounds: tuple[np.ndarray, np.ndarray], settings: RenderSettings) -> Float[np.ndarray, "8 3"]:
    """Corners of the largest box that a part with these bounds may have, part frame."""
    rounding = BOX_ROUNDING * settings.part_voxel
    return np.stack(np.meshgrid(*zip(bounds[0] - rounding, bounds[1] + rounding), indexing="ij"), -1).reshape(-1, 3)


def _outside(corners: Float[np.ndarray, "8 3"], root_from_part: Float[np.ndarray, "4 4"], view: Camera) -> bool:
    """Whether one side of the view frustum has all corners beyond it."""
    pose = view.camera_from_world @ root_from_part
    x, y, z = ((corners @ pose[:3, :3].T + pose[:3, 3]) @ view.intrinsics.T).T
    right, bottom = view.width + PIXELS_BESIDE, view.height + PIXELS_BESIDE
    sides = (z, x + PIXELS_BESIDE * z, right * z - x, y + PIXELS_BESIDE * z, bottom * z - y)
    return any(bool((side < 0).all()) for side in sides)
