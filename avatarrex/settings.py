"""What a render may trade: voxel sizes, march, antialiasing, parts drawn. Needs no torch; part of the stages' keys."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from avatarrex.signals.driving import Signals

DEVICE = re.compile(r"cpu|(cuda|mps|xpu)(:\d{1,2})?")
"""Words for a device of networks; whether this torch has it is seen once it is loaded (fields/placement.py)."""


@dataclass(frozen=True)
class RenderSettings:
    """One trade of run time against error; levels.py names the useful ones."""

    surface: bool = False
    """Draw the avatar's surface (surface/) instead of its field: what follows, but `antialias` and `hidden`, says nothing then."""
    voxel: float = 0.02
    """Side of a body voxel, metres; it grows where 128 of them would cut the person off."""
    part_voxel: float = 0.0025
    """Side of a voxel of the hand and face boxes, metres."""
    reuse_tolerance: float = 0.0
    """Metres by which the body may lag: what moved by less since the previous frame is reused (temporal_reuse.py)."""
    colour_tolerance: float = 0.0
    """sRGB by which colours of the body may be off a plane and yet be interpolated between those of earlier views of the pose."""
    shading_tolerance: float = 0.0
    """sRGB of the estimated error up to which three pixels of four are interpolated between neighbours of the same picture, not evaluated."""
    everywhere: bool = False
    """Evaluate every voxel within reach of the fields, not only the narrow band around the surface."""
    bricks: int = 0
    """Body voxels that a view meets are cut into this many along each side; 0: none is."""
    thin: int = 2
    """Body voxels about forearms and wrists are cut into this many along each side, whatever a view meets (volume/thin_limbs.py), where
    `bricks` is 0; 0: none is."""
    prefilter: bool = True
    """Whether body voxels are stored so that interpolation between them is right on average (volume/prefilter.py)."""
    raycast: str = "auto"
    """`auto`, `gl`, `torch` or `reference`."""
    march: str = "exact"
    """`exact`, or `fixed`: steps of a quarter of a body voxel and one linear interpolation, without antialiasing."""
    antialias: bool = True
    polish: int = 0
    """Steps, 0 to 2, that take each hit point onto the exact composed field."""
    hidden: frozenset[str] = field(default_factory=frozenset)
    """Parts not drawn with their own fields: `left_hand`, `right_hand`, `face`."""
    detail_from: Signals | None = None
    """Feature patches are decoded from this body pose instead of the one that is drawn (the paper's patch figure)."""
