"""One exposure for two rigs: pictures of the face rig as if the body's cameras had taken them.

Body and face rig see hair, neck and collar, each with its own exposure and white balance. Per triangle of the posed template the
mean colour in some pictures of either is compared; the median ratio of each channel is what the one rig's pictures are multiplied
by. Letters: f triangles. sRGB-encoded, where a change of exposure is nearly a factor, too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from avatarrex.capture.fit.camera_gains import DARKEST, colour_sums, mean_of
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.readers.images_store import Pictures, times
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import sealed
from avatarrex.errors import InputError, check
from avatarrex.templates.person import Person
from avatarrex.training.core.pixels import training_pairs

PICTURES = 10
"""Of each rig, spread over frames and views."""
FEWEST = 100
"""Triangles that both rigs have to show; below, a training changes nothing."""
LARGEST = 2.0
"""Factor at most, either way."""


class ExposedPictures(Pictures):
    """Pictures of a rig, multiplied by a factor per channel; mattes stay."""

    def __init__(self, pictures: Pictures, gain: Float[np.ndarray, " 3"]) -> None:
        self._taken, self.gain = pictures, gain

    def get(self, kind: str, view: int, frame: int) -> np.ndarray:
        """See `Pictures`."""
        taken = self._taken.get(kind, view, frame)
        return taken if kind == "matte" else times(taken, self.gain)

    def check_size(self, view: int, frame: int) -> None:
        """See `Pictures`."""
        self._taken.check_size(view, frame)


def exposed_as(rig: Rig, other: Rig, person: Person) -> Rig:
    """`rig` as the cameras of `other` would have seen it, unchanged where they have no colours in common; both show `person`."""
    found = gain_to(rig, other, person)
    return exposed(rig, np.ones(3) if found is None else found)


def one_exposure(capture: Capture, name: str, person: Person) -> Capture:
    """`capture` with the pictures of every other rig as the cameras of rig `name` would have taken them, by what the training's pictures
    show of `person`. Raises `InputError` without a second rig, without this one, and where another has no colours in common with it."""
    check(
        len(capture.rigs) > 1,
        "--exposed-as",
        "",
        "a capture with two rigs",
        f"the {next(iter(capture.rigs))} rig alone",
    )
    check(name in capture.rigs, "--exposed-as", "", f"one of {', '.join(capture.rigs)}", name)
    known = sealed(capture, "train").rigs
    gains = {}
    for other in known.keys() - {name}:
        found = gain_to(known[other], known[name], person)
        if found is None:
            shown = f"{FEWEST} triangles or more whose colours the {other} and the {name} rig both show"
            raise InputError("--exposed-as", "", shown, "no colours in common")
        gains[other] = found
    return replace(
        capture,
        rigs={other: exposed(rig, gains[other]) if other in gains else rig for other, rig in capture.rigs.items()},
    )


def exposed(rig: Rig, gain: Float[np.ndarray, " 3"]) -> Rig:
    """`rig` with its pictures multiplied by `gain`."""
    return replace(rig, pictures=ExposedPictures(rig.pictures, gain))


def factors(rig: Rig) -> list[float]:
    """What a rig's pictures were multiplied by, per channel."""
    pictures = rig.pictures
    return [float(each) for each in pictures.gain] if isinstance(pictures, ExposedPictures) else [1.0] * 3


def gain_to(rig: Rig, other: Rig, person: Person) -> Float[np.ndarray, " 3"] | None:
    """What pictures of `rig` are multiplied by to look as those of `other`, by pictures of both that are not held out; see `gain`."""
    return gain(_colours(rig, person), _colours(other, person))


def gain(seen: Float[np.ndarray, "f 3"], other: Float[np.ndarray, "f 3"]) -> Float[np.ndarray, " 3"] | None:
    """Median ratio of `other` to `seen` per channel, of triangles with a colour (not NaN) in both; None of fewer than `FEWEST`."""
    ratio = other / seen
    known = np.isfinite(ratio).all(1) & (np.minimum(seen, other).min(1) > DARKEST)
    if known.sum() < FEWEST:
        return None
    middle: np.ndarray = np.clip(np.median(ratio[known], axis=0), 1 / LARGEST, LARGEST)
    return middle


def _colours(rig: Rig, person: Person) -> Float[np.ndarray, "f 3"]:
    """Mean colours of the triangles, bytes; NaN where none is seen."""
    faces, pairs = person.body.faces.numpy(), training_pairs(rig)
    total = np.zeros((len(faces), 4))
    for frame, view in (pairs[k] for k in np.unique(np.linspace(0, len(pairs) - 1, PICTURES).round().astype(int))):
        total += colour_sums(rig, view, frame, template_surface(person, rig.signals[frame])[0], faces)
    return mean_of(total)
