"""Which convention a capture's files follow, where it is not ours: each known other one is tried on a few pictures.

A cause that puts the template onto the mattes is worth more than an IoU of 0.04. Matrices are world→camera, OpenCV axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import FOREGROUND, compared_frames, iou, reduced, silhouette, template_surface
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Splits

PICTURES, PIXELS = 6, 192
"""How many pictures are compared, and pixels of their longer side."""
CONVINCING, BETTER = 0.45, 0.2
"""IoU that another convention has to reach (a template that is off by 5 cm has 0.6), and by how much it has to be better."""
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Between OpenCV's and OpenGL's camera axes."""


@dataclass(frozen=True)
class Convention:
    """What a file may mean instead of what we read."""

    remedy: str
    """What it seems to be, and what to do, after `calibration: `."""
    camera: Callable[[Camera], Camera]


def _posed(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Camera], Camera]:
    return lambda camera: replace(camera, camera_from_world=change(camera.camera_from_world))


def _farther(scale: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda matrix: np.block([[matrix[:3, :3], scale * matrix[:3, 3:]], [matrix[3:]]])


def _centred(matrix: np.ndarray) -> np.ndarray:
    return np.block([[matrix[:3, :3], -matrix[:3, :3] @ matrix[:3, 3:]], [matrix[3:]]])


def _turned(matrix: np.ndarray) -> np.ndarray:
    return np.block([[matrix[:3, :3].T, matrix[:3, 3:]], [matrix[3:]]])


def _upright(sign: float) -> np.ndarray:
    """From our world's axes to those of a file with +Z (`sign` 1) or −Z (−1) up."""
    turn = np.eye(4)
    turn[1:3, 1:3] = [[0, -sign], [sign, 0]]
    return turn


def _level(quarters: int) -> np.ndarray:
    """A world turned by quarters about +Y."""
    turn = np.eye(4)
    turn[:3, :3] = np.linalg.matrix_power(np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]), quarters)
    return turn


def _times(world: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return np.asarray(matrix @ world)


def _sideways(sign: float) -> np.ndarray:
    """From our world's axes to those of a file with +X (`sign` 1) or −X (−1) up."""
    turn = np.eye(4)
    turn[:2, :2] = [[0, sign], [-sign, 0]]
    return turn


def _flipped(rows: bool) -> Callable[[Camera], Camera]:
    """The camera of pictures whose rows, else columns, run the other way."""

    def change(camera: Camera) -> Camera:
        mirror = np.diag([1.0, -1.0, 1.0]) if rows else np.diag([-1.0, 1.0, 1.0])
        mirror[:2, 2] = (0, camera.height) if rows else (camera.width, 0)
        return replace(camera, intrinsics=mirror @ camera.intrinsics)

    return change


def _enlarged(scale: float) -> Callable[[Camera], Camera]:
    return lambda camera: replace(camera, intrinsics=np.diag([scale, scale, 1.0]) @ camera.intrinsics)


CONVENTIONS = (
    Convention("R and T lead from the camera to the world: invert them", _posed(np.linalg.inv)),
    Convention("the axes are OpenGL's (y up, z backwards): negate rows 2 and 3 of R and T", _posed(lambda m: FLIP @ m)),
    Convention(
        "R and T lead from the camera to the world with OpenGL's axes: invert them, then negate rows 2 and 3",
        _posed(lambda m: FLIP @ np.linalg.inv(m)),
    ),
    Convention("T is the camera's place: write −R·T", _posed(_centred)),
    Convention("R is transposed", _posed(_turned)),
    Convention("its world has +Z up, the person's +Y: turn one into the other", _posed(lambda m: m @ _upright(1.0))),
    Convention("its world has −Z up, the person's +Y: turn one into the other", _posed(lambda m: m @ _upright(-1.0))),
    Convention("its world has −Y up, the person's +Y: turn one into the other", _posed(lambda m: m @ FLIP)),
    Convention("its world has +X up, the person's +Y: turn one into the other", _posed(lambda m: m @ _sideways(1.0))),
    Convention("its world has −X up, the person's +Y: turn one into the other", _posed(lambda m: m @ _sideways(-1.0))),
    *(
        Convention(
            f"its world is turned by {90 * quarters}° about +Y against the person's",
            _posed(partial(_times, _level(quarters))),
        )
        for quarters in (1, 2, 3)
    ),
    Convention("the pictures' rows run from the bottom to the top: flip them", _flipped(True)),
    Convention("the pictures are mirrored, left is right: flip their columns", _flipped(False)),
    Convention("T is too large by ten: write metres", _posed(_farther(0.1))),
    Convention("T is in centimetres: write metres", _posed(_farther(10.0))),
    Convention("K is of pictures twice as large: halve its first two rows", _enlarged(0.5)),
    Convention("K is of pictures half as large: double its first two rows", _enlarged(2.0)),
)


def likely_convention(capture: Capture, rig: Rig) -> str | None:
    """What the calibration of `rig` seems to mean instead; None where no other reading fits much better."""
    inverted = Convention("the mattes are inverted: white is the person", lambda camera: camera)
    own = _fit(capture, rig, Convention("", lambda camera: camera))
    found = {each.remedy: _fit(capture, rig, each) for each in CONVENTIONS}
    found[inverted.remedy] = _fit(capture, rig, inverted, flip=True)
    best = max(found, key=lambda remedy: found[remedy])
    return best if found[best] > max(CONVINCING, own + BETTER) else None


def _fit(capture: Capture, rig: Rig, convention: Convention, flip: bool = False) -> float:
    """Mean IoU over a few pictures of the training's from all around."""
    pairs = Splits.of(rig).train.pictures(rig)
    values = []
    for view, frame in (pairs[place] for place in compared_frames(len(pairs), PICTURES)):
        camera = reduced(convention.camera(rig.views[view].camera), PIXELS)
        inside = inside_matte(rig.matte(view, frame), camera)
        vertices = template_surface(capture.person, rig.signals[frame])[0]
        drawn = silhouette(vertices, capture.person.body.faces.numpy(), camera)
        # a template that fills the picture agrees with nearly all of what is about a person, and with nothing beside
        values.append(min(iou(drawn, ~inside), iou(~drawn, inside)) if flip else iou(drawn, inside))
    return float(np.mean(values))


def inside_matte(matte: np.ndarray, camera: Camera) -> np.ndarray:
    """(h, w) bool: pixels of a small `camera` whose centres are inside a matte of the whole picture."""
    rows = (np.arange(camera.height) + 0.5) * matte.shape[0] / camera.height
    columns = (np.arange(camera.width) + 0.5) * matte.shape[1] / camera.width
    return np.asarray(matte[rows.astype(int)][:, columns.astype(int)] > FOREGROUND)
