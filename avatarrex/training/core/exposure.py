"""One exposure for two rigs: pictures of the face rig as if the body's cameras had taken them.

Body and face rig see hair, neck and collar, each with its own exposure and white balance. Per triangle of the posed template the
mean colour in some pictures of either is compared; the median ratio of each channel is what the one rig's pictures are multiplied
by. Letters: f triangles. sRGB-encoded, where a change of exposure is nearly a factor, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.readers.rigs import Rig
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.templates.person import Person
from avatarrex.training.core.pixels import training_pairs

PICTURES = 10
"""Of each rig, spread over frames and views."""
OPAQUE = 250
"""Matte byte from which a pixel has the person's colour alone."""
DARKEST = 24.0
"""Bytes: of darker means a ratio says little."""
FEWEST = 100
"""Triangles that both rigs have to show; below, nothing is changed."""
LARGEST = 2.0
"""Factor at most, either way."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ExposedRig(Rig):
    """A rig, the pictures of which are multiplied by a factor per channel."""

    gain: Float[np.ndarray, " 3"]

    def image(self, view: int, frame: int) -> UInt8[np.ndarray, "h w 3"]:
        """See `Rig`."""
        image: np.ndarray = np.rint(np.clip(super().image(view, frame) * self.gain, 0, 255)).astype(np.uint8)
        return image


def exposed_as(rig: Rig, other: Rig, person: Person) -> ExposedRig:
    """`rig` as the cameras of `other` would have seen it; both show `person`."""
    return ExposedRig(**vars(rig), gain=gain(_colours(rig, person), _colours(other, person)))


def gain(seen: Float[np.ndarray, "f 3"], other: Float[np.ndarray, "f 3"]) -> Float[np.ndarray, " 3"]:
    """Median ratio of `other` to `seen` per channel, of triangles with a colour (not NaN) in both."""
    ratio = other / seen
    known = np.isfinite(ratio).all(1) & (np.minimum(seen, other).min(1) > DARKEST)
    if known.sum() < FEWEST:
        return np.ones(3)
    middle: np.ndarray = np.clip(np.median(ratio[known], axis=0), 1 / LARGEST, LARGEST)
    return middle


def _colours(rig: Rig, person: Person) -> Float[np.ndarray, "f 3"]:
    """Mean colours of the triangles, bytes; NaN where none is seen."""
    faces, pairs = person.body.faces.numpy(), training_pairs(rig)
    total = np.zeros((len(faces), 4))
    for frame, view in (pairs[k] for k in np.unique(np.linspace(0, len(pairs) - 1, PICTURES).round().astype(int))):
        vertices = template_surface(person, rig.signals[frame])[0]
        face = visible_faces(vertices, faces, rig.views[view].camera)[0]
        counts = (face >= 0) & (rig.matte(view, frame) >= OPAQUE)
        values = np.concatenate([rig.image(view, frame)[counts].T, np.ones((1, counts.sum()))])
        for column, value in enumerate(values):
            total[:, column] += np.bincount(face[counts], value, len(faces))
    with np.errstate(invalid="ignore"):
        mean: np.ndarray = total[:, :3] / total[:, 3:]
    return mean
