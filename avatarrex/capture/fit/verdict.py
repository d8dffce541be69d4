"""Whether a capture can be trained on: good, doubtful or unusable, with the reasons and what to do about each.

A training needs the person where the mattes are. The limits are far from what sound captures have: a template without clothes
has an IoU of 0.76 to 0.95 with a clothed person's mattes (`docs/capture.md`), one 5 cm beside it 0.6, one in wrong axes
less than 0.3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from avatarrex.capture.fit.camera_gains import camera_gains, largest
from avatarrex.capture.fit.camera_order import exchanged
from avatarrex.capture.fit.check import CaptureReport, RigReport, check_capture
from avatarrex.capture.fit.conventions import likely_convention
from avatarrex.capture.fit.hand_mean import SAID, hand_readings
from avatarrex.capture.fit.pixel_shift import pixel_shift
from avatarrex.capture.fit.size_fit import NoSize, fit_size
from avatarrex.capture.readers.rigs import Capture
from avatarrex.capture.readers.splits import sealed

STATES = ("good", "doubtful", "unusable")
"""From best to worst."""
DOUBTFUL_IOU, UNUSABLE_IOU = 0.7, 0.5
"""IoU of the template below which a rig or a camera is doubtful, and unusable."""
BEHIND = 0.15
"""IoU by which one camera is worse than its rig's median: not clothes, which all cameras see."""
LEAN_DEG, SHIFT = 4.0, 0.1
"""What a camera's outlines may lean, and lie off in units of the square root of the matte's area: a pony tail shifts by 0.05."""
COVERAGE = (0.002, 0.8)
"""Share of a picture that a matte covers: a person fills at most two thirds of a face's picture."""
UNEVEN, LOOKED_AT = 0.06, 3
"""How far a camera's brightness may be from the others' (one exposure leaves up to 0.03 by gloss, 0.04 with noisy tracking), and by how many
frames that is read."""
MISSING = 0.5
"""Share of missing pictures from which a camera is doubtful."""

HALF_PIXEL = {
    True: "pixel centres are at integers there: add 0.5 to the principal points",
    False: "pixel centres are moved twice: take 0.5 from the principal points",
}
"""What to do, by whether the pictures lie to the right."""


@dataclass(frozen=True)
class Reason:
    """One thing that is wrong."""

    state: str
    """What it makes of the capture, of `STATES`."""
    where: str
    """A rig, with a camera where it is about one."""
    what: str
    """What was found, and what to do."""


@dataclass(frozen=True)
class Verdict:
    """What to think of a capture."""

    reasons: tuple[Reason, ...]

    @property
    def state(self) -> str:
        """The worst of the reasons' states; good without any."""
        return max((reason.state for reason in self.reasons), key=STATES.index, default=STATES[0])

    def lines(self) -> list[str]:
        """To be read."""
        return [f"verdict: {self.state}", *(f"  {each.where}: {each.what} ({each.state})" for each in self.reasons)]

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"state": self.state, "reasons": [vars(reason) for reason in self.reasons]}


def judge(
    capture: Capture, rigs: tuple[str, ...] | None = None, frames: int = 2, exact: bool = False
) -> tuple[Capture, CaptureReport, Verdict]:
    """The capture with its person's size where the file did not say it, what was found in `frames` frames, and the verdict.

    Only the training's split is looked at; the report, not the verdict, has the capture's own meshes and joints of all frames
    where `exact`. Raises `InputError` for a picture that cannot be decoded.
    """
    reasons = []
    sized = capture
    if not capture.sized:
        try:
            sized = fit_size(capture)
        except NoSize as error:
            reasons.append(
                Reason("unusable", "person", f"no size fits the mattes: expected {error.expected}, found {error.found}")
            )
    training = sealed(sized, "train")
    report = check_capture(sized if exact else training, rigs, frames)
    for rig in report.rigs:
        reasons += _of_rig(training, rig, training if capture.sized else sealed(capture, "train"))
    return sized, report, Verdict(tuple(reasons))


def _of_rig(capture: Capture, rig: RigReport, given: Capture) -> Iterator[Reason]:
    """`given`: before its person's size was fitted, which under another convention leads anywhere."""
    value = rig.mean("template")
    if value is None:
        yield Reason("unusable", rig.rig, "no picture with its matte in the compared frames; add pictures or --frames")
        return
    covered = rig.mean("coverage") or 0.0
    if not COVERAGE[0] < covered < COVERAGE[1]:
        yield Reason(
            "unusable", rig.rig, f"mattes cover {covered:.1%} of the pictures; white (255) has to be the person"
        )
    moved = exchanged(capture, capture.rigs[rig.rig])
    if moved:
        named = ", ".join(f"{camera}'s pictures are {other}'s" for camera, other in moved.items())
        yield Reason("unusable", rig.rig, f"camera order: {named}; exchange folders or entries of the calibration")
        return
    if value < DOUBTFUL_IOU:
        cause = likely_convention(given, given.rigs[rig.rig])
        advice = (
            f"calibration: {cause}"
            if cause
            else (
                "look at the overlay of `capture check --out`: outlines beside the person mean other axes, units or frame numbers"
            )
        )
        yield Reason(_state(value), rig.rig, f"IoU {value:.3f} of the template with the mattes; {advice}")
    if len(rig.cameras) == 1:
        yield Reason("doubtful", rig.rig, "one camera alone: sides that it does not see follow the template")
    if value >= UNUSABLE_IOU:
        yield from _of_cameras(rig)
        yield from _fine(capture, rig.rig)


def _fine(capture: Capture, name: str) -> Iterator[Reason]:
    """What a rig that is usable may have slightly wrong."""
    rig = capture.rigs[name]
    shift = pixel_shift(capture, rig)
    if shift is not None and shift.half:
        right = shift.pixels[0] > 0
        way = (
            f"{abs(shift.pixels[0]):.2f} ± {shift.uncertainty[0]:.2f} px {'right' if right else 'left'} of the template"
        )
        yield Reason("doubtful", name, f"half a pixel: all pictures lie {way}; {HALF_PIXEL[right]}")
    off = largest(camera_gains(rig, capture.person, LOOKED_AT))
    if off > UNEVEN:
        what = f"exposure: cameras differ from their mean by up to {off:.0%}; `capture match-exposure` evens them out"
        yield Reason("doubtful", name, what)
    for reading in hand_readings(capture, rig):
        if reading.certain:
            yield Reason(
                "doubtful",
                name,
                f"flat_hand_mean: {SAID[reading.sign]} (IoU of {reading.hands} hands {reading.better:+.2f})",
            )


def _of_cameras(rig: RigReport) -> Iterator[Reason]:
    """Cameras that differ from a rig that is usable as a whole."""
    values = [rig.mean("template", view) for view in rig.views]
    median = float(np.median([value for value in values if value is not None]))
    advice = f"mend its calibration or mattes, or leave it out (--{rig.rig}-views)"
    for view, name, value, missing in zip(rig.views, rig.cameras, values, rig.missing):
        where, (right, down), lean = f"{rig.rig} {name}", rig.shift(view), rig.lean(view)
        if value is not None and value < median - BEHIND:
            yield Reason("doubtful", where, f"IoU {value:.3f} where half of the cameras have {median:.3f}; {advice}")
        if abs(lean) > LEAN_DEG:
            yield Reason(
                "doubtful", where, f"the template leans {abs(lean):.0f}° {'right' if lean > 0 else 'left'}; R is off"
            )
        if max(abs(right), abs(down)) > SHIFT:
            way = " and ".join(_way(right, "right", "left") + _way(down, "down", "up"))
            yield Reason("doubtful", where, f"the template lies too far {way}; the principal point or T is off")
        if missing > MISSING * rig.trained:
            yield Reason("doubtful", where, f"{missing} of {rig.trained} pictures are missing")


def _state(value: float) -> str:
    return STATES[(value < DOUBTFUL_IOU) + (value < UNUSABLE_IOU)]


def _way(off: float, positive: str, negative: str) -> list[str]:
    return [positive if off > 0 else negative] if abs(off) > SHIFT else []
