"""Where the lips of a template touch at rest: skin that the jaw carries beside skin that it does not. Ours.

Letters: p points, c pairs of vertices. Metres, root frame at rest.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from avatarrex.capture.fit.paint import Points, Seen, only
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.face_offsets import mesh_edges
from avatarrex.templates.model import EYES, MOUTH, TemplateModel

TOUCH = 0.004
"""Between two vertices that touch, at most: vertices of lips lie 2 to 5 mm apart."""
AROUND = 0.01
"""Along the mesh between them, at least: the shortest way leads around a corner of the mouth, or through its cavity."""


BESIDE = 2.0
"""Within so many σ of the blur of where lips touch, measured at rest, points do not count: it mixes the mouth's inside, or the other lip,
into their colours."""


def touching(body: TemplateModel) -> np.ndarray:
    """(c, 2) vertices of the upper lip, each with the nearest vertex of the lower lip: skin whose skinning weight of the jaw is above a
    half. None where the mouth of a template is open by more than `TOUCH` at rest."""
    rest, skin = body.v_template.double().numpy(), ~body.of_groups((*EYES, *MOUTH)).numpy()
    carried = body.weights[:, JOINT_NAMES.index("jaw")].numpy() > 0.5
    upper, lower = np.flatnonzero(skin & ~carried), np.flatnonzero(skin & carried)
    if not len(lower):
        return np.zeros((0, 2), int)
    away, nearest = cKDTree(rest[lower]).query(rest[upper], distance_upper_bound=TOUCH)
    pairs = np.stack([upper[away < TOUCH], lower[nearest[away < TOUCH]]], 1)
    ways = dijkstra(mesh_edges(body), indices=pairs[:, 0], limit=AROUND)[np.arange(len(pairs)), pairs[:, 1]]
    found: np.ndarray = pairs[np.isinf(ways)]
    return found


def away_from_lips(body: TemplateModel, points: Points) -> np.ndarray:
    """(p,) to the nearest vertex of lips that touch; infinite where none do."""
    rest = body.v_template.double().numpy()
    line = rest[np.unique(touching(body))]
    if not len(line):
        return np.full(len(points.face), np.inf)
    found: np.ndarray = cKDTree(line).query(points.between(rest, body.faces.numpy()))[0]
    return found


def clear_of_lips(sight: Seen, away: np.ndarray, blur: float) -> Seen:
    """`sight`, blurred by `blur` metres, without the points `BESIDE` the line where lips touch, whatever the mouth does; `away` (p,): their
    metres from it at rest."""
    return only(sight, away[sight[0]] >= BESIDE * blur)
