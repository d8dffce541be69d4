"""Whether cameras have each other's pictures: each matte is compared with the template as every camera would see it.

The assignment of pictures to cameras with the largest sum of IoU is the order that the pictures have. Letters: c cameras. Training's
split alone.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from avatarrex.capture.fit.check import iou, reduced, shown_frames, silhouette, template_surface
from avatarrex.capture.fit.conventions import inside_matte
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Splits

FRAMES, PIXELS = 4, 160
"""How many frames are compared, and pixels of the longer side."""
BETTER, CONVINCING = 0.08, 0.5
"""IoU that a camera's pictures win with another camera (sound captures: at most 0.02), and that all have then in the mean."""


def exchanged(capture: Capture, rig: Rig) -> dict[str, str]:
    """Camera whose pictures seem to be another's, and that other's name; empty where all are in order."""
    views = Splits.of(rig).train.views
    sizes = {view: (rig.views[view].camera.width, rig.views[view].camera.height) for view in views}
    found: dict[str, str] = {}
    for size in dict.fromkeys(sizes.values()):
        found |= _among(capture, rig, [view for view in views if sizes[view] == size])
    return found


def _among(capture: Capture, rig: Rig, views: list[int]) -> dict[str, str]:
    """Of cameras with pictures of one size."""
    total, count = np.zeros((len(views), len(views))), np.zeros(len(views))
    faces = capture.person.body.faces.numpy()
    for frame in shown_frames(rig, FRAMES):
        vertices = template_surface(capture.person, rig.signals[frame])[0]
        drawn = [silhouette(vertices, faces, reduced(rig.views[view].camera, PIXELS)) for view in views]
        for row, view in enumerate(views):
            if rig.available(view, frame):
                matte = inside_matte(rig.matte(view, frame), reduced(rig.views[view].camera, PIXELS))
                total[row] += [iou(mask, matte) for mask in drawn]
                count[row] += 1
    score = total / np.maximum(count, 1)[:, None]
    rows, columns = linear_sum_assignment(score, maximize=True)
    won = score[rows, columns] - score.diagonal()
    moved = [row for row in rows if columns[row] != row and won[row] > BETTER]
    if len(moved) < 2 or score[rows, columns].mean() < CONVINCING:
        return {}
    return {rig.views[views[row]].name: rig.views[views[columns[row]]].name for row in moved}
