"""What a figure stands on and before: a floor with shadows, a key light, a background, exposure.

Metres, world frame; degrees; colours sRGB-encoded in [0, 1].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from avatarrex.errors import InputError
from avatarrex.signals.ground import floor_height

COLOUR, GRADIENT, PICTURE = "colour", "gradient", "picture"
BACKDROPS = (COLOUR, GRADIENT, PICTURE)
LIMITS = {
    "height": (-1e3, 1e3), "azimuth": (-360.0, 360.0), "elevation": (20.0, 90.0), "softness": (1.0, 20.0),
    "shadow": (0.0, 1.0), "exposure": (-4.0, 4.0),
}  # fmt: skip
"""Smallest and largest value. A key light below 20° throws a shadow of five metres."""
GAMMA = 2.2
"""Of the display, nearly: a stop is a factor of 2^(1/2.2) of an encoded colour."""
Rgb = tuple[float, float, float]


@dataclass(frozen=True)
class KeyLight:
    """What the light on figure and floor depends on."""

    azimuth: float
    elevation: float
    softness: float
    shadow: float
    height: float
    floor: bool

    @property
    def direction(self) -> np.ndarray:
        """(3,), unit, towards the light, world frame."""
        azimuth, elevation = np.radians([self.azimuth, self.elevation])
        level = np.cos(elevation)
        return np.array([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level])

    @property
    def width(self) -> float:
        """Tangent of the light's angular radius."""
        return math.tan(math.radians(self.softness))


@dataclass(frozen=True)
class Stage:
    """All that can be set of it. Raises `InputError`."""

    shown: bool = False
    """Without it, nothing else has an effect."""
    floor: bool = True
    """Whether there is one for shadows to lie on."""
    height: float | None = None
    """y of the floor; None: under the soles of the T-pose."""
    azimuth: float = 40.0
    """Where the key light is: 0 before the person, 90 at the person's left."""
    elevation: float = 52.0
    softness: float = 4.0
    """The key light's angular radius: large is a soft edge."""
    shadow: float = 0.8
    """How dark: 0 not at all, 1 black where no light comes."""
    backdrop: str = GRADIENT
    """One of `BACKDROPS`; `colour` is the background that is chosen without a stage, too."""
    top: Rgb = (0.40, 0.42, 0.45)
    bottom: Rgb = (0.66, 0.67, 0.68)
    """Of the gradient."""
    picture: str = ""
    """A PNG or JPEG, which fills the raster."""
    exposure: float = 0.0
    """Stops of the whole picture."""

    def __post_init__(self) -> None:
        for name in ("shown", "floor"):
            if not isinstance(getattr(self, name), bool):
                raise InputError("stage", name, "true or false", getattr(self, name))
        for name, (low, high) in LIMITS.items():
            value = getattr(self, name)
            if not ((_number(value) and low <= value <= high) or (name == "height" and value is None)):
                raise InputError("stage", name, f"a number from {low:g} to {high:g}", value)
        if self.backdrop not in BACKDROPS:
            raise InputError("stage", "backdrop", " or ".join(BACKDROPS), self.backdrop)
        for name in ("top", "bottom"):
            value = getattr(self, name)
            if not (isinstance(value, tuple) and len(value) == 3 and all(_number(c) and 0 <= c <= 1 for c in value)):
                raise InputError("stage", name, "red, green, blue from 0 to 1", value)
        if not isinstance(self.picture, str) or (self.backdrop == PICTURE and not self.picture):
            raise InputError("stage", "picture", "the path of a PNG or JPEG", self.picture or "nothing")

    @property
    def light(self) -> KeyLight | None:
        """What acts on figure and floor; None where the stage is off."""
        if not self.shown:
            return None
        height = floor_height() if self.height is None else self.height
        return KeyLight(self.azimuth, self.elevation, self.softness, self.shadow, height, self.floor)

    @property
    def gain(self) -> float:
        """What `exposure` multiplies encoded colours by."""
        return float(2 ** (self.exposure / GAMMA))


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
