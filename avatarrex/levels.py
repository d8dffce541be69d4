"""Levels: named trades of run time against error in one pipeline. A level is data, a `RenderSettings`, and what `ABOUT` says.

`live` draws the surface that was distilled from the avatar (surface/), for whatever moves; the others draw its field.

But for `paper` (sec. 4: every voxel that a node reaches), voxels are evaluated around the surface alone. `fast` is for
previews (`dragged`: a limb), `balanced` what is rendered unless told, `fine` for close views that move, `quality` for stills.
The paper's ×4 upsampling of a trilinear grid is the same function as the grid: nothing is upsampled here.
"""

from __future__ import annotations

from dataclasses import replace

from avatarrex.errors import InputError
from avatarrex.settings import RenderSettings

DEFERRED_LEVELS: dict[str, RenderSettings] = {
    "paper": RenderSettings(everywhere=True, part_voxel=0.005, march="fixed", antialias=False, thin=0, prefilter=False),
    "fast": RenderSettings(part_voxel=0.005, antialias=False, thin=0),
    "balanced": RenderSettings(),
    "fine": RenderSettings(bricks=2),
    "quality": RenderSettings(bricks=4, polish=1),
}
"""Of the deferred pipeline: the paper's, then from the quickest to the most exact."""
LEVELS: dict[str, RenderSettings] = {"live": RenderSettings(surface=True), **DEFERRED_LEVELS}
"""All that can be chosen."""
DEFAULT_LEVEL = "balanced"
"""What is rendered and measured unless told."""
ABOUT = {
    "live": "the textured mesh distilled from the avatar",
    "paper": "2 cm body, 5 mm parts, every voxel, steps of 5 mm: to compare with",
    "fast": "2 cm body, 5 mm hands and face, no antialiasing; a drag may lag by 2 mm",
    "balanced": "2 cm body, 1 cm forearms, 2.5 mm hands and face, antialiased",
    "fine": "as balanced, the body at 1 cm where it is seen",
    "quality": "as balanced, the body at 5 mm where it is seen, every hit put onto the exact field",
}
"""What each level trades, in words."""

REUSE_TOLERANCE = 2e-3
"""Metres of `RenderSettings.reuse_tolerance` while somebody drags at `fast`; a picture that stays is exact at every level."""
DRAGGED_VOXEL = 0.03
"""Side of a body voxel meanwhile, metres."""
COLOUR_TOLERANCE = 0.008
"""sRGB of `RenderSettings.colour_tolerance` while the view turns, at any level: pictures are 50 dB and more from those without."""


def moving(settings: RenderSettings) -> RenderSettings:
    """What a picture is made with that the next one follows at once: colours that earlier views tell are interpolated."""
    return replace(settings, colour_tolerance=COLOUR_TOLERANCE)


def dragged(settings: RenderSettings) -> RenderSettings:
    """What a limb is dragged with: the surface errs by 2 mm in the mean, where a pixel of such a picture covers 10."""
    return replace(settings, reuse_tolerance=REUSE_TOLERANCE, voxel=DRAGGED_VOXEL)


def level(name: str) -> RenderSettings:
    """The `RenderSettings` of a level: `live`, `paper`, `fast`, `balanced` (what `render` takes unless told), `fine` or `quality`.

    From `fast` to `quality` errors of depth fall and times grow (docs/accuracy.md). Raises `InputError` for a name that is none.
    """
    if name not in LEVELS:
        raise InputError("level", "name", " or ".join(LEVELS), name)
    return LEVELS[name]
