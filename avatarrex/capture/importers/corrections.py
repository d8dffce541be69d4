"""What a person says of a capture of another layout instead of the import's guesses, and a few of its frames to look at first.

Letters: t frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from avatarrex.capture.importers.source import Reading, Source
from avatarrex.capture.readers.calibration import Lens
from avatarrex.errors import InputError
from avatarrex.signals.joints import JOINT_ROWS

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres of a unit of the cameras' places."""
UP = ("+X", "-X", "+Y", "-Y", "+Z", "-Z")
HANDS = ("flat", "mean")
"""What fingers at zero are, and those that the file does not have: flat, or the mean hand that the file has."""
SHOWN = {"": "relaxed", "flat": "flat", "mean": "the file's mean hand"}
"""What a hand without parameters is."""
HAND = 45
"""Numbers of a hand's pose."""
BY_FRAME = (*JOINT_ROWS, "transl", "expression", "arkit52", "betas")
"""Parameters that may have a row for each frame."""


@dataclass(frozen=True)
class Corrections:
    """Empty: as it is guessed."""

    unit: str = ""
    """One of `UNITS`."""
    up: str = ""
    """One of `UP`: the axis of the file's world that is up."""
    hands: str = ""
    """One of `HANDS`."""

    @property
    def metres(self) -> float | None:
        """Of a unit of the cameras' places, where that was said."""
        return UNITS.get(self.unit)

    def lenses(self, lenses: tuple[Lens, ...], notes: list[str]) -> tuple[Lens, ...]:
        """Cameras in metres, where their unit was said."""
        unit = self.metres
        if unit is None:
            return lenses
        notes.append(f"unit: camera positions in {self.unit}, as was said")
        return tuple(lens.scaled(unit) for lens in lenses)

    def hand_mean(self, source: Source, reading: Reading) -> dict[str, np.ndarray]:
        """The parameters with what was said of the hands, also of those that are not in them; it is noted what these become.

        Raises `InputError` where the file has no mean hand to be added.
        """
        values, place = source.parameters, reading.place()
        posed = np.ndim(values.get("body_pose", 0)) > 0
        free = [key for key in ("left_hand_pose", "right_hand_pose") if posed and key not in values]
        if free and (self.hands or source.rig == "body"):
            as_said = f"{SHOWN[self.hands]} in every frame{', as was said' if self.hands else ''}"
            reading.notes.append(f"hands: no {' and no '.join(free)} in the file: {as_said}")
        if self.hands and not posed:
            reading.notes.append(f"hands: no pose is in the file: --hands {self.hands} changes nothing")
        if not self.hands:
            return values
        for key in ("hands_meanl", "hands_meanr"):
            if self.hands == "mean" and key not in values:
                raise InputError(place, key, "the mean hand that --hands mean adds", "nothing; --hands flat adds none")
        still = {key: np.zeros((len(values["body_pose"]), HAND)) for key in free}
        return {**values, **still, "flat_hand_mean": np.array(self.hands == "flat")}


GUESSED = Corrections()


def few(source: Source, count: int) -> Source:
    """`count` frames alone, evenly spread over those with pictures and parameters, numbered from 0."""
    seen = {frame for view in source.views for frame in view.images if frame < source.frames}
    usable = sorted(seen - source.without_parameters)
    places = np.unique(np.linspace(0, len(usable) - 1, count).round().astype(int)) if usable else ()
    frames = [usable[place] for place in places]
    views = tuple(
        replace(view, images=_renumbered(view.images, frames), mattes=_renumbered(view.mattes, frames))
        for view in source.views
    )
    values = {
        name: value[frames] if name in BY_FRAME and value.ndim > 1 and len(value) == source.frames else value
        for name, value in source.parameters.items()
    }
    return replace(source, views=views, frames=len(frames), parameters=values, without_parameters=frozenset())


def _renumbered(names: dict[int, str], frames: Sequence[int]) -> dict[int, str]:
    return {number: names[frame] for number, frame in enumerate(frames) if frame in names}
