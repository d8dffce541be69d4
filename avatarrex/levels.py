"""Levels: named trades of run time against error in one pipeline. A level is data, a `RenderSettings`.

| level    | body voxels | part voxels | what it is for                                |
|----------|-------------|-------------|-----------------------------------------------|
| fast     | 2 cm        | 5 mm        | dragging a limb, previews                     |
| balanced | 2 cm        | 2.5 mm      | everyday use; what is rendered unless told    |
"""

from __future__ import annotations

from avatarrex.errors import InputError
from avatarrex.pipeline import RenderSettings

LEVELS: dict[str, RenderSettings] = {
    "fast": RenderSettings(part_voxel=0.005, antialias=False),
    "balanced": RenderSettings(),
}
"""From the quickest to the most exact."""


def level(name: str) -> RenderSettings:
    """The settings of a level. Raises `InputError` for a name that is none."""
    if name not in LEVELS:
        raise InputError("level", "name", " or ".join(LEVELS), name)
    return LEVELS[name]
