"""A captured person's geometry: size, skin and face, each from what the ones before have left."""

from __future__ import annotations

from dataclasses import replace

from avatarrex.capture.fit.face_fit import fit_face
from avatarrex.capture.fit.size_fit import fit_size
from avatarrex.capture.fit.surface_fit import fit_surface
from avatarrex.capture.readers.rigs import Capture
from avatarrex.templates.person import Person


def fit_capture(capture: Capture) -> Capture:
    """With what its files do not say of the person: the size, where it is unknown, then skin and face; the studio's own person stays.

    Raises `InputError` for a picture that cannot be decoded, and for somebody who is not as tall as people are.
    """
    sized = capture if capture.sized else fit_size(capture)
    return sized if sized.person.packaged else replace(sized, person=fit_geometry(sized))


def fit_geometry(capture: Capture) -> Person:
    """`capture.person`, whose size is known, with the skin of the mattes and the face of the pictures, of the training's split alone.

    Raises `InputError` for a picture that cannot be decoded.
    """
    return fit_face(replace(capture, person=fit_surface(capture)))
