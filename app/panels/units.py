"""Units that angles and lengths are shown and typed in; what is kept is radians and metres, whatever is shown."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Unit:
    """How a number is shown."""

    factor: float
    """What a degree or a metre is multiplied by."""
    form: str
    """Of the product, for a slider."""

    def text(self, value: float) -> str:
        """Degrees or metres as text."""
        return self.form % (self.factor * value)


ANGLES = {"degrees": Unit(1.0, "%.0f°"), "radians": Unit(0.017453292519943295, "%.2f")}
LENGTHS = {"m": Unit(1.0, "%.2f m"), "cm": Unit(100.0, "%.0f cm")}


class _Present:
    """What is used."""

    angle, length = ANGLES["degrees"], LENGTHS["m"]


def use(angles: str, lengths: str) -> None:
    """Names of `ANGLES` and `LENGTHS`."""
    _Present.angle, _Present.length = ANGLES[angles], LENGTHS[lengths]


def angle() -> Unit:
    """Of what is kept in degrees, or is turned into them."""
    return _Present.angle


def length() -> Unit:
    """Of metres."""
    return _Present.length
