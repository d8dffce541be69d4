"""Expressions of a prepared capture from the landmarks of its face: fitted, said in lines, and drawn for somebody to look at.

Letters: t frames, c cameras, l landmarks.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from avatarrex.capture.fit.check import posed_in_world
from avatarrex.capture.fit.expression_fit import SOUGHT, Expressions, fit_expressions
from avatarrex.capture.fit.face_marks import face_marks
from avatarrex.capture.importers.step_pictures import fitted_face
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.rigs import Capture
from avatarrex.capture.readers.undistort import straighten
from avatarrex.templates.face import HEAD

SHOWN_FRAMES, SHOWN_CAMERAS = 4, 3
"""Frames of the picture, those with the strongest expressions, and cameras of each, those that see the face best."""

COARSE = 2.0
"""Millimetres of a pixel on the face above which brows and lids are lost in a detector's noise (docs/import.md)."""


def find_expressions(
    capture: Capture, lenses: tuple[Lens, ...], points: np.ndarray, confidence: np.ndarray
) -> tuple[Expressions, list[str], list[tuple[str, np.ndarray]]]:
    """From `FACE_NAMES` (t, c, l, 2) in the pictures of `lenses` as taken, with confidence (t, c, l); what is to be said, and tiles."""
    rig = capture.rigs["body"]
    numbers = [[lens.name for lens in lenses].index(view.name) for view in rig.views]
    ideal = np.stack([straighten(lenses[number], points[:, number]) for number in numbers], 1)
    seen = np.isfinite(ideal).all(-1)
    ideal, sure = np.where(seen[..., None], ideal, 0), confidence[:, numbers] * seen
    heads = []
    for frame in range(len(points)):
        posed, world = posed_in_world(capture.person, rig.signals[frame])
        heads.append(world @ posed.joint_transforms[HEAD].double().numpy())
    cameras = tuple(view.camera for view in rig.views)
    marks = face_marks(capture.person)
    found = fit_expressions(cameras, ideal, sure, np.array(heads), marks)
    still = [] if marks.directions.any() else ["the person's face has no expressions (no Faceverse): they stay at rest"]
    return found, [*_said(capture, found, ideal, sure), *still], list(_shown(capture, found, ideal, sure))


def _said(capture: Capture, found: Expressions, points: np.ndarray, sure: np.ndarray) -> list[str]:
    """How much was seen and how well it fits."""
    by_camera = found.believed.any(2).sum(1)
    seen = by_camera > 0
    if not seen.any():
        return ["landmarks of a face in no camera that it is turned to: expressions and jaw stay at rest"]
    cameras = [view.camera for view in capture.rigs["body"].views]
    away = points - np.stack([camera.pixels(found.places)[0] for camera in cameras], 1)
    pixels = float(np.median(np.linalg.norm(away[found.believed], axis=-1)))
    sizes = np.stack([camera.seen(found.places)[..., 2] / camera.intrinsics[0, 0] for camera in cameras], 1)
    size = 1000 * float(np.median(sizes[found.believed]))
    small = f"a pixel is {size:.1f} mm on the face: jaw and lips may be told, lids and brows hardly"
    return [
        f"expressions of {seen.sum()} of {len(seen)} frames, by {by_camera[seen].mean():.1f} cameras in the mean",
        f"landmarks {pixels:.1f} px from the fitted face in the median, {found.believed.sum() / (sure > 0).sum():.0%} of them believed",
        f"{len(SOUGHT)} of 52 coefficients are sought; gaze, squint, cheeks, nose, tongue and the like stay at rest",
        *([small] if size > COARSE else []),
    ]


def _shown(
    capture: Capture, found: Expressions, points: np.ndarray, sure: np.ndarray
) -> Iterator[tuple[str, np.ndarray]]:
    """Pictures with a line of text: the frames with the strongest expressions."""
    rig = capture.rigs["body"]
    for frame in sorted(np.argsort(-found.weights.sum(1), kind="stable")[:SHOWN_FRAMES].tolist()):
        views = np.argsort(-found.believed[frame].sum(1), kind="stable")[:SHOWN_CAMERAS].tolist()
        for view in views:
            if rig.available(view, frame) and found.believed[frame, view].any():
                fitted = rig.views[view].camera.pixels(found.places[frame])[0]
                detected = (
                    points[frame, view][sure[frame, view] > 0],
                    found.believed[frame, view][sure[frame, view] > 0],
                )
                yield f"{rig.views[view].name}  frame {frame}", fitted_face(rig.image(view, frame), fitted, *detected)
