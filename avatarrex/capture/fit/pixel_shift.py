"""Half a pixel: whether principal points say where pixels have their centres as this project does, at +0.5.

Along the template's outlines n in each picture, the way s to the matte's edge is explained by what differs from frame to frame, from
picture to picture, and by one shift of all pictures:

    s = n · (P t_f + d) + b_fc        t_f where the person is (3), d the shift (2), b_fc how far clothes stand off

Cameras all around cannot have one d from a person who stands elsewhere. Its uncertainty is by leaving out each camera in turn (jackknife).
Letters: f frames, c cameras, k constraints, m unknowns. Metres; pixels. Training's split alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from avatarrex.capture.fit.check import shown_frames
from avatarrex.capture.fit.outlines import Seen, measured
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Splits

FRAMES, PICTURES = 4, 40
"""Of a rig, at most."""
SEARCH, OUTLIER = 0.06, 0.02
"""Metres within which the matte's edge is looked for, and at which a constraint's weight has fallen to ¼."""
PLACE_SIGMA, OFF_SIGMA = 0.03, 0.03
"""Metres that the person may be off, and that clothes stand off."""
SHIFT = (0.3, 0.7)
"""Pixels that are half a one."""
CERTAIN = 0.12
"""Pixels of uncertainty up to which a shift is believed."""
LEAST_CAMERAS = 3
ROUNDS = 5


@dataclass(frozen=True)
class PixelShift:
    """Of all pictures of a rig."""

    pixels: tuple[float, float]
    """Right and down, from the template to the mattes."""
    uncertainty: tuple[float, float]
    """Standard errors."""

    @property
    def half(self) -> bool:
        """Whether it is half a pixel, to the left or right, for certain; up and down people stand lower as well."""
        return SHIFT[0] < abs(self.pixels[0]) < SHIFT[1] and self.uncertainty[0] < CERTAIN


def pixel_shift(capture: Capture, rig: Rig) -> PixelShift | None:
    """The shift; None where fewer than `LEAST_CAMERAS` cameras show outlines."""
    rows = [row for row in _pictures(capture, rig) if len(row[1])]
    cameras = sorted({view for (_, view), _, _ in rows})
    if len(cameras) < LEAST_CAMERAS:
        return None
    whole = _solved(rows)
    without = np.array([_solved([row for row in rows if row[0][1] != view]) for view in cameras])
    error = np.sqrt((len(cameras) - 1) / len(cameras) * ((without - without.mean(0)) ** 2).sum(0))
    return PixelShift((float(whole[0]), float(whole[1])), (float(error[0]), float(error[1])))


Row = tuple[tuple[int, int], np.ndarray, np.ndarray]
"""Frame and camera, (k, 5) derivatives by t and d, (k,) ways."""


def _pictures(capture: Capture, rig: Rig) -> list[Row]:
    """Of some pictures."""
    frames = shown_frames(rig, FRAMES)
    views = Splits.of(rig).train.views
    stride = max(1, -(-len(frames) * len(views) // PICTURES))
    found = []
    for place, frame in enumerate(frames):
        for view in views[place % stride :: stride]:
            if not rig.available(view, frame):
                continue
            camera = rig.views[view].camera
            seen = Seen(rig.signals[frame], ((camera, partial(rig.matte, view, frame)),))
            outline = measured(capture.person, seen, SEARCH)
            vertices = capture.person.body.v_template.double().numpy()
            length = np.linalg.norm(vertices[outline.vertices[:, 0]] - vertices[outline.vertices[:, 1]], axis=1)
            depth = float(np.linalg.norm(camera.centre - rig.signals[frame].translation))
            across = outline.outward @ camera.camera_from_world[:2, :3].T * depth / np.diag(camera.intrinsics)[:2]
            rows = np.concatenate([outline.outward, across], 1) * np.sqrt(length)[:, None]
            found.append(((frame, view), np.column_stack([rows, np.sqrt(length)]), outline.distance))
    return found


def _solved(rows: list[Row]) -> np.ndarray:
    """(2,) pixels."""
    frames = sorted({frame for (frame, _), _, _ in rows})
    size = 2 + 3 * len(frames) + len(rows)
    prior = np.zeros(size)
    prior[2 : 2 + 3 * len(frames)], prior[2 + 3 * len(frames) :] = PLACE_SIGMA**-2.0, OFF_SIGMA**-2.0
    solved: np.ndarray = np.zeros(size)
    for _ in range(ROUNDS):
        matrix, right = np.diag(prior + 1e-9), np.zeros(size)
        for number, ((frame, _), values, way) in enumerate(rows):
            place = 2 + 3 * frames.index(frame)
            columns = [0, 1, *range(place, place + 3), 2 + 3 * len(frames) + number]
            root = values[:, 5]
            design = np.column_stack([values[:, 3:5], values[:, :3], root])
            off = way - design @ solved[columns] / root
            weight = (1 + (off / OUTLIER) ** 2) ** -2 / OUTLIER**2 / 0.05
            matrix[np.ix_(columns, columns)] += design.T @ (design * weight[:, None])
            right[columns] += design.T @ (weight * root * way)
        solved = np.linalg.solve(matrix, right)
    return solved[:2]
