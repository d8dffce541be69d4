"""What the viewport shows of a frame besides its image: normals, depth, parts, and the steps that its rays took."""

from __future__ import annotations

import numpy as np
from avatarrex_studio.session.state import IMAGE, OrbitView
from jaxtyping import Float32

from avatarrex.frame import Frame
from avatarrex.surface.look import KINDS, Look

SPAN = 0.12
"""Of the camera's distance: half the range of depths that is shown about the target."""
MOST_SPAN = 0.4
"""Metres: a person with an arm stretched out."""
MOST_STEPS = 20.0
"""Steps of a ray that are the hottest colour."""
COLD, HOT = np.array([0.10, 0.14, 0.30]), np.array([0.98, 0.86, 0.36])


def look_of(shows: str, view: OrbitView) -> Look | None:
    """The view mode of a surface; None where its colours are shown."""
    span, distance = min(MOST_SPAN, SPAN * view.distance), view.lens[0]
    return next((Look(kind, distance - span, distance + span) for kind in KINDS if kind == shows), None)


def shown(frame: Frame, shows: str, view: OrbitView) -> Float32[np.ndarray, "h w 4"]:
    """The frame's image, or one of `state.PICTURES` of it; premultiplied."""
    if shows == IMAGE:
        return frame.image.float().cpu().numpy()
    found = frame.pointmap
    alpha = found.coverage.float().cpu().numpy()
    seen = alpha > 0
    picture = np.zeros((*alpha.shape, 4), np.float32)
    look = look_of(shows, view)
    if look is None:
        share = np.clip(found.steps.float().cpu().numpy()[seen] / MOST_STEPS, 0, 1)[:, None]
        colour = COLD + (HOT - COLD) * share
    else:
        normal, depth, part = (
            values.double().cpu().numpy()[seen] for values in (found.normal, found.depth, found.part_weight)
        )
        colour = look.colours(normal, depth, part, frame.view.camera_from_world[2, :3])
    picture[seen] = alpha[seen][:, None] * np.concatenate([colour, np.ones((len(colour), 1))], 1)
    return picture
