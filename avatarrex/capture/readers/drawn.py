"""What the manifest of a capture says that `capture make` drew."""

from __future__ import annotations

from typing import Any

from avatarrex.capture.readers.rigs import Capture

MAKER = "avatarrex-studio capture make"
"""The `maker` of its provenance."""


def drawn(capture: Capture) -> bool:
    """Whether the studio drew it."""
    return bool((capture.manifest.get("provenance") or {}).get("maker") == MAKER)


def variation(capture: Capture) -> dict[str, Any]:
    """Subject, conditions and noise that it was drawn with; empty where it says nothing."""
    found: dict[str, Any] = capture.manifest.get("variation") or {}
    return found


def light_frame(capture: Capture) -> str:
    """The frame in which the light is fixed (`fields/light.py`): lamps stand still; a drawn light may turn with the person."""
    return "root" if drawn(capture) and "light" not in variation(capture).get("conditions", ()) else "world"
