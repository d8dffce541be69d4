"""The view with a whole person in it: target and distance from points of the posed body, in closed form.

In camera axes (x right, y down, z forward) a camera at c sees a point p where |p_x − c_x| ≤ t (p_z − c_z), with t the tangent
of half the angle of view; y alike. So c_x is the middle of A = max(p_x − t p_z) and B = min(p_x + t p_z) at any depth, and
c_z ≤ (B − A) / 2t: the nearest camera that sees them all. Metres, world space; angles in degrees.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from avatarrex_studio.session.state import OrbitView, vector

from avatarrex.signals.driving import Signals
from avatarrex.templates.model import TemplateModel, pose_by_signals
from avatarrex.templates.transform import world_from_root

FREE_SHARE = 0.08
"""Share of the half picture that stays free at each side: hair and cloth are up to 4 cm off the template."""
EVERY = 8
"""Every eighth vertex, without pose blend shapes: within 3 cm of the body's extremes, and posed in 7 ms (one core)."""


class Outline:
    """A few vertices of a body, posed without its fields."""

    def __init__(self, body: TemplateModel) -> None:
        thin = {
            item.name: getattr(body, item.name)[::EVERY]
            for item in fields(body)
            if item.name in ("v_template", "shapedirs", "expression_dirs", "weights")
        }
        self.body = body
        self._thin = replace(body, **thin, faces=body.faces[:0], posedirs=None, pose_columns=None, groups={})

    def points(self, signals: Signals) -> np.ndarray:
        """(p, 3) world metres of the body under `signals`."""
        posed = pose_by_signals(self._thin, signals.replace(expression=np.zeros(52)))
        root = world_from_root(signals.global_orient, signals.translation, posed.joints[0].double().numpy())
        vertices = posed.vertices.double().numpy()
        return np.asarray(vertices @ root[:3, :3].T + root[:3, 3])


def framed(view: OrbitView, points: np.ndarray, size: tuple[int, int]) -> OrbitView:
    """`view` with the target and the least distance for which all `points` (p, 3) are on a (width, height) raster."""
    rotation, tangents, seen = _seen(view, points, size)
    if view.orthographic:
        low, high = seen.min(0), seen.max(0)
        middle = vector(rotation.T @ ((low + high) / 2))
        return replace(view, target=middle, distance=float(((high - low)[:2] / (2 * tangents)).max()))
    low, high = (seen[:, :2] - tangents * seen[:, 2:]).max(0), (seen[:, :2] + tangents * seen[:, 2:]).min(0)
    middle = (seen[:, 2].min() + seen[:, 2].max()) / 2
    target = vector(rotation.T @ np.array([*((low + high) / 2), middle]))
    nearest = ((high - low) / (2 * tangents)).min()
    return replace(view, target=target, distance=float(middle - nearest))


def backed_off(view: OrbitView, points: np.ndarray, size: tuple[int, int]) -> OrbitView:
    """`view` about its own target, at the least distance for which all `points` (p, 3) are in the picture."""
    _, tangents, seen = _seen(view, points - np.array(view.target), size)
    depth = 0 if view.orthographic else seen[:, 2:]
    distance = (np.abs(seen[:, :2]) / tangents - depth).max()
    return replace(view, distance=float(max(distance, 0.05)))


def _seen(view: OrbitView, points: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Camera axes (3, 3), usable tangents (2,) of x and y, of an orthographic view those of its lens with perspective, which has the same
    scale at the target; and the points (p, 3) in those axes.
    """
    camera = replace(view, orthographic=False).camera(*size)
    rotation = camera.camera_from_world[:3, :3]
    tangents = (1 - FREE_SHARE) * np.array(size) / (2 * np.diag(camera.intrinsics)[:2])
    return rotation, tangents, points @ rotation.T
