"""What a rig's cameras frame: the whole person, or the head. A folder that is not called by its rig is known by it.

Letters: t frames. Metres.
"""

from __future__ import annotations

import numpy as np

from avatarrex.capture.readers.calibration import read_calibration
from avatarrex.capture.readers.layout import RigFiles
from avatarrex.capture.readers.units import metres

CLOSE_UP = 1.0
"""Metres that a face's picture shows at most at the person's distance over the ground, which does not depend on where a model
has its pelvis: 0.4 to 0.8 on the rigs that we know, where a body's shows 2.0 to 2.8."""


def bare(rigs: dict[str, RigFiles], root: str) -> bool:
    """Whether a capture is the one folder of a rig, whose name says nothing."""
    return "body" in rigs and rigs["body"].folder == root


def shows_a_face(files: RigFiles, pelvis: np.ndarray, unit: float | None = None) -> bool:
    """Whether cameras are as near to the person, whose `pelvis` (t, 3) is there, as those of a face's rig.

    `unit`: metres of a unit of the cameras' places, where somebody has said it.
    """
    place = files.archive.place(files.calibration)
    lenses = tuple(lens.scaled(unit or 1.0) for lens in read_calibration(files.archive.text(files.calibration), place))
    lenses, scale = metres(lenses, pelvis, np.zeros(3), place, [], known=unit is not None)
    middle = np.median(pelvis, axis=0) * scale
    shown = []
    for camera in (lens.camera for lens in lenses):
        across = max(camera.width / camera.intrinsics[0, 0], camera.height / camera.intrinsics[1, 1])
        shown.append(across * float(np.linalg.norm((camera.centre - middle)[[0, 2]])))
    return float(np.median(shown)) < CLOSE_UP
