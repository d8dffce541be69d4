"""Metres: a person stands within 20 m of every camera, or the file is in millimetres (docs/capture.md)."""

from __future__ import annotations

import numpy as np

from avatarrex.capture.readers.calibration import Lens
from avatarrex.errors import InputError

DISTANCE = (0.1, 20.0)
"""Metres from a camera to the pelvis."""
SURELY_NOT_METRES = 100.0
"""A distance that no lens photographs a person from: only then may a number be millimetres."""
_SCALES = ((1.0, 1.0), (1e-3, 1.0), (1.0, 1e-3), (1e-3, 1e-3))
"""Factors for (cameras, person), the first that fits is taken."""


def metres(
    lenses: tuple[Lens, ...],
    translation: np.ndarray,
    pelvis: np.ndarray,
    source: str,
    notes: list[str],
    known: bool = False,
) -> tuple[tuple[Lens, ...], float]:
    """Cameras in metres and the factor for the person's `translation` (t, 3), whose pelvis is at `pelvis` + translation.

    `known`: the cameras are in metres already, as somebody has said. A conversion is said in `notes`. Raises `InputError` naming the
    camera where no unit fits.
    """
    place = np.median(translation, axis=0)
    centres = np.stack([lens.camera.centre for lens in lenses])
    given = np.linalg.norm(centres - (place + pelvis), axis=1)
    scales = _SCALES if given.max() > SURELY_NOT_METRES else _SCALES[:1]
    for camera_scale, person_scale in (pair for pair in scales if pair[0] == 1 or not known):
        distance = np.linalg.norm(centres * camera_scale - (place * person_scale + pelvis), axis=1)
        if ((distance > DISTANCE[0]) & (distance < DISTANCE[1])).all():
            for scale, what in ((camera_scale, "camera positions"), (person_scale, "the person's translation")):
                if scale != 1:
                    notes.append(f"{what} in millimetres, converted to metres")
            return tuple(lens.scaled(camera_scale) for lens in lenses), person_scale
    worst = next(k for k, metres in enumerate(given) if not DISTANCE[0] < metres < DISTANCE[1])
    unit = "in the unit that was said" if known else "metres or millimetres"
    expected = f"a camera {DISTANCE[0]:g} to {DISTANCE[1]:g} m from the person ({unit})"
    raise InputError(source, f"{lenses[worst].name}.T", expected, f"{given[worst]:.4g} m")
