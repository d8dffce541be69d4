"""What a detector of joints would say of a rig's pictures: `keypoints.npz` (`capture/readers/keypoints.py`).

The exact joints as the lenses see them, off by independent Gaussian noise: σ is `NOISE` of the picture's longer side over the
confidence, which is drawn evenly from `SURE` to 1. A share `LOST` is not found (confidence 0); a share `WRONG` is somewhere else,
with a confidence like the others'. Joints outside of the picture are not found; those behind the person's own body are, as
detectors guess them. Letters: t frames, c cameras, k joints.
"""

from __future__ import annotations

import json
from collections.abc import Iterable

import numpy as np

from avatarrex.capture.readers.calibration import Lens, read_calibration
from avatarrex.capture.readers.undistort import bend
from avatarrex.capture.synthetic.cameras import calibration
from avatarrex.capture.synthetic.plan import RigPlan
from avatarrex.capture.synthetic.tracking import joints
from avatarrex.signals.joints import JOINT_NAMES

NOISE = 0.006
"""3 pixels of 512, 13 mm on a body: detectors of whole bodies are within one to two hundredths of a person's height."""
SURE, LOST, WRONG, WRONG_BY = 0.5, 0.05, 0.02, 0.1
"""Shares; what is wrong is off by a tenth of the picture."""


def keypoints(rig: RigPlan, seed: int) -> dict[str, np.ndarray]:
    """`keypoints.npz` of a planned rig: its exact joints, whatever its parameters are written as."""
    lenses = read_calibration(json.dumps(calibration(rig.cameras, rig.imaging.distortion)), "calibration")
    return detected(joints(rig), lenses, [seed, 5, len(rig.name)])


def detected(places: np.ndarray, lenses: Iterable[Lens], seed: Iterable[int]) -> dict[str, np.ndarray]:
    """`keypoints.npz` of exact joints `places` (t, 55, 3), world metres; the same for the same seed."""
    lenses = tuple(lenses)
    rng = np.random.default_rng([*seed])
    shape = (len(places), len(lenses), len(JOINT_NAMES))
    points, confidence = np.zeros((*shape, 2)), rng.uniform(SURE, 1, shape)
    for view, lens in enumerate(lenses):
        size = max(lens.camera.width, lens.camera.height)
        pixels, depth = lens.camera.pixels(places)
        wrong = rng.random(shape[::2]) < WRONG
        spread = size * np.where(wrong, WRONG_BY, NOISE / confidence[:, view])
        points[:, view] = bend(lens, pixels) + spread[..., None] * rng.standard_normal((*shape[::2], 2))
        inside = ((points[:, view] > 0) & (points[:, view] < (lens.camera.width, lens.camera.height))).all(-1)
        confidence[:, view] *= inside & (depth > 0) & (rng.random(shape[::2]) >= LOST)
    return {
        "names": np.array(JOINT_NAMES),
        "cameras": np.array([lens.name for lens in lenses]),
        "points": points.astype(np.float32),
        "confidence": confidence.astype(np.float32),
    }
