"""What the viewport shows of a frame besides its image: normals, depth, parts, and the steps that its rays took."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from avatarrex_studio.session.state import IMAGE, SLICE, OrbitView
from jaxtyping import Float32

from avatarrex.frame import Frame
from avatarrex.surface.look import KINDS, Look, shaded

SPAN = 0.12
"""Of the camera's distance: half the range of depths that is shown about the target."""
MOST_SPAN = 0.4
"""Metres: a person with an arm stretched out."""
MOST_STEPS = 20.0
"""Steps of a ray that are the hottest colour."""
COLD, HOT = np.array([0.10, 0.14, 0.30]), np.array([0.98, 0.86, 0.36])
OwnColours = Callable[[np.ndarray], np.ndarray]
"""Colours of points (p, 3) of the root frame."""


def look_of(shows: str, view: OrbitView) -> Look | None:
    """The view mode of a surface; None where its colours are shown."""
    span, distance = min(MOST_SPAN, SPAN * view.distance), view.lens[0]
    return next((Look(kind, distance - span, distance + span) for kind in KINDS if kind == shows), None)


def shown(frame: Frame, shows: str, view: OrbitView, own: OwnColours | None = None) -> Float32[np.ndarray, "h w 4"]:
    """The frame's image, which a slice lies over, or one of `state.PICTURES` of it; premultiplied. `own`: influences at points."""
    if shows in (IMAGE, SLICE):
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
        forward = frame.view.camera_from_world[2, :3]
        if look.kind == "influence":
            assert own is not None
            colour = shaded(own(found.position.double().cpu().numpy()[seen]), normal, forward)
        else:
            colour = look.colours(normal, depth, part, forward)
    picture[seen] = alpha[seen][:, None] * np.concatenate([colour, np.ones((len(colour), 1))], 1)
    return picture
