"""Levels: named trades of run time against error in one pipeline. A level is data, a `RenderSettings`.

`live` draws the surface that was distilled from the avatar (surface/), for whatever moves; the others draw its field:

| level    | body voxels                     | part voxels | rays                | what it is for              |
|----------|---------------------------------|-------------|---------------------|-----------------------------|
| paper    | 2 cm, all that a node reaches   | 5 mm, all   | steps of 5 mm       | comparing; paper sec. 4     |
| fast     | 2 cm, around the surface        | 5 mm        | exact, one a pixel  | previews; `dragged`: a limb |
| balanced | 2 cm, around the surface        | 2.5 mm      | exact, antialiased  | what is rendered unless told|
| fine     | 2 cm, 1 cm where they are seen  | 2.5 mm      | exact, antialiased  | close views that move       |
| quality  | 2 cm, 5 mm where they are seen  | 2.5 mm      | exact, antialiased  | stills                      |

The paper's ×4 upsampling of a trilinear grid is the same function as the grid: nothing is upsampled here.
"""

from __future__ import annotations

from dataclasses import replace

from avatarrex.errors import InputError
from avatarrex.settings import RenderSettings

DEFERRED_LEVELS: dict[str, RenderSettings] = {
    "paper": RenderSettings(everywhere=True, part_voxel=0.005, march="fixed", antialias=False),
    "fast": RenderSettings(part_voxel=0.005, antialias=False),
    "balanced": RenderSettings(),
    "fine": RenderSettings(bricks=2),
    "quality": RenderSettings(bricks=4, polish=1),
}
"""Of the deferred pipeline: the paper's, then from the quickest to the most exact."""
LEVELS: dict[str, RenderSettings] = {"live": RenderSettings(surface=True), **DEFERRED_LEVELS}
"""All that can be chosen."""


REUSE_TOLERANCE = 2e-3
"""Metres of `RenderSettings.reuse_tolerance` while somebody drags at `fast`; a picture that stays is exact at every level."""
DRAGGED_VOXEL = 0.03
"""Side of a body voxel meanwhile, metres."""


def dragged(settings: RenderSettings) -> RenderSettings:
    """What a limb is dragged with: the surface errs by 2 mm in the mean, where a pixel of such a picture covers 10."""
    return replace(settings, reuse_tolerance=REUSE_TOLERANCE, voxel=DRAGGED_VOXEL)


def level(name: str) -> RenderSettings:
    """The `RenderSettings` of a level: `live`, `paper`, `fast`, `balanced` (what `render` takes unless told), `fine` or `quality`.

    From `fast` to `quality` errors fall and times grow (docs/accuracy.md). Raises `InputError` for a name that is none.
    """
    if name not in LEVELS:
        raise InputError("level", "name", " or ".join(LEVELS), name)
    return LEVELS[name]
