"""Whether hands are written flat or against a mean hand as their file says: the flag `flat_hand_mean`.

Hands are cut out of the pictures in which they lie before the background, and the template's are drawn as read, with the relaxed hand's bend
added and taken away. Shapes are compared, not places: a person's size that was fitted to wrong hands has them beside the pictures' ones.
The relaxed hand stands for the model's own mean, which belongs to a file that is not here. Training's split alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import FOREGROUND, shown_frames, silhouette, template_surface
from avatarrex.capture.fit.overlay import cut, resized
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Splits
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.library import named_hand

FRAMES, VIEWS, PIXELS = 4, 8, 64
"""Frames and cameras that are compared, and pixels of a hand's tile."""
MARGIN = 0.15
"""Of a hand's size, free about it."""
BESIDE = 4
"""Pixels of a tile by which a hand may lie beside the picture's, in each direction; three times as many change nothing."""
SHARE = (0.08, 0.6)
"""Of a tile that a matte covers where the hand lies before the background."""
SMALLEST = 12
"""Pixels of the picture that a hand is large, at least."""
BETTER, TIMES = 0.03, 3.0
"""IoU that the other reading has to win in the mean, and how many standard errors that has to be."""
LEAST = 6
"""Hands that have to be seen."""
SAID = {
    1: "the fingers are more bent in the pictures than in the parameters: they seem to be written against a mean hand; "
    "write flat_hand_mean=False with hands_meanl and hands_meanr, or add the mean",
    -1: "the fingers are straighter in the pictures than in the parameters: a mean hand seems to be added to poses that contain it; "
    "write flat_hand_mean=True",
}
"""By the sign with which the mean is counted in the better reading."""


@dataclass(frozen=True)
class HandReading:
    """How another reading of the hands compares."""

    sign: int
    """1: the mean added; −1: taken away."""
    better: float
    """IoU won in the mean; may be below 0."""
    error: float
    """Its standard error."""
    hands: int

    @property
    def certain(self) -> bool:
        """Whether it is the right one."""
        return self.hands >= LEAST and self.better > max(BETTER, TIMES * self.error)


def hand_readings(capture: Capture, rig: Rig) -> tuple[HandReading, ...]:
    """Both other readings; none where no hand is seen large enough."""
    won: dict[int, list[float]] = {1: [], -1: []}
    views = Splits.of(rig).train.views
    chosen = views[:: max(1, -(-len(views) // VIEWS))]
    for frame in shown_frames(rig, FRAMES):
        as_read = rig.signals[frame]
        surfaces = {sign: template_surface(capture.person, bent(as_read, sign))[0] for sign in (0, 1, -1)}
        for view in (view for view in chosen if rig.available(view, frame)):
            for side in ("left", "right"):
                found = _compared(capture, rig.views[view].camera, rig.matte(view, frame), surfaces, side)
                if found is not None:
                    for sign in won:
                        won[sign].append(found[sign] - found[0])
    count = len(won[1])
    if count < 2:
        return ()
    return tuple(
        HandReading(sign, float(np.mean(each)), float(np.std(each) / np.sqrt(count - 1)), count)
        for sign, each in won.items()
    )


def bent(signals: Signals, sign: int) -> Signals:
    """Hands with the relaxed hand's rotations added `sign` times."""
    return signals.replace(
        left_hand_pose=signals.left_hand_pose + sign * named_hand("relaxed", "left"),
        right_hand_pose=signals.right_hand_pose + sign * named_hand("relaxed", "right"),
    )


def _compared(
    capture: Capture, camera: Camera, matte: np.ndarray, surfaces: dict[int, np.ndarray], side: str
) -> dict[int, float] | None:
    """IoU about a hand where it lies best, by reading; None where it is too small, cut off or not before the background."""
    body = capture.person.body
    first = JOINT_NAMES.index(f"{side}_index1")
    owned = np.flatnonzero(np.isin(body.weights.numpy().argmax(1), range(first, first + 15)))
    pixels, depth = camera.pixels(surfaces[0][owned])
    low, high = pixels.min(0), pixels.max(0)
    large = float((high - low).max())
    if depth.min() <= 0 or large < SMALLEST or (low < 0).any() or (high > (camera.width, camera.height)).any():
        return None
    half, middle = large * (0.5 + MARGIN), (low + high) / 2
    inside = resized(matte, _square(middle, half), PIXELS) > FOREGROUND
    if not SHARE[0] < inside.mean() < SHARE[1]:
        return None
    wide = PIXELS + 2 * BESIDE
    tile, faces = cut(camera, _square(middle, half * wide / PIXELS), wide), body.faces.numpy()
    return {sign: _best_iou(silhouette(vertices, faces, tile), inside) for sign, vertices in surfaces.items()}


def _square(middle: np.ndarray, half: float) -> tuple[float, float, float, float]:
    """Left, top, right, bottom."""
    x, y = middle.tolist()
    return x - half, y - half, x + half, y + half


def _best_iou(drawn: np.ndarray, inside: np.ndarray) -> float:
    """IoU of the mask `inside` (h, w), not empty, with the part of the larger mask `drawn` that it is most like."""
    parts = sliding_window_view(drawn, inside.shape)
    return float(((parts & inside).sum((2, 3)) / (parts | inside).sum((2, 3))).max())
