"""The rotation gizmo: rings about a joint's own axes, which turn as its sliders do.

What a ring was turned by is summed up from where the drag began, so that a joint at its limit follows again as soon as the mouse is
back where it got there.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from avatarrex_studio.panels.projection import Projection
from avatarrex_studio.session import posing
from avatarrex_studio.session.commands import Command, SetJoint
from avatarrex_studio.session.state import StudioState, Vector, vector
from imgui_bundle import imguizmo
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.figure import Figure

gizmo = imguizmo.im_guizmo
SIZE = 0.13
"""Of the rings, in clip space."""
THICK = 2.5
"""Points."""
RINGS = (gizmo.MOVETYPE.mt_rotate_x, gizmo.MOVETYPE.mt_rotate_y, gizmo.MOVETYPE.mt_rotate_z)


class Gizmo:
    """The rings on the selected joint."""

    def __init__(self) -> None:
        self.over = self.used = False
        """Whether the mouse is over the rings, and whether it turns one: the viewport then leaves it alone."""
        self._start = self._by_axis = self._by_view = np.eye(3)
        """World rotation that the drag began with; what it was turned by since, in the joint's axes and in the world's."""

    def draw(self, projection: Projection, figure: Figure, state: StudioState) -> Iterator[Command]:
        """Draw the rings of the selected joint; the command of this frame."""
        joint = state.tools.selected
        if joint not in JOINT_NAMES:
            self.hide()
            return
        gizmo.begin_frame()
        index, before = posing.joint_index(joint), posing.joint(state.signals, joint)
        above = figure.posed.parent_rotation(index, figure.skeleton)
        wanted = self._rings(projection, figure.posed.position[index], figure.posed.rotation[index])
        if wanted is not None:
            yield SetJoint(joint, nearest_rotvec(above.T @ wanted, before))

    def hide(self) -> None:
        """There are no rings in this frame."""
        self.over = self.used = False

    @property
    def axis(self) -> int | None:
        """The ring under the mouse, or the one that is turned: 0 x, 1 y, 2 z."""
        ring = gizmo.get_active_handle_type() if self.used else gizmo.get_hovered_handle_type()
        return RINGS.index(ring) if (self.over or self.used) and ring in RINGS else None

    def _rings(
        self, projection: Projection, place: Float64[np.ndarray, "3"], rotation: Float64[np.ndarray, "3 3"]
    ) -> Float64[np.ndarray, "3 3"] | None:
        """Draw rings at a place of the world along the axes of `rotation`; the rotation that a turned one asks for."""
        camera, (x, y), scale = projection.camera, projection.low, projection.scale
        gizmo.set_drawlist()
        gizmo.set_rect(x, y, scale * camera.width, scale * camera.height)
        gizmo.set_gizmo_size_clip_space(SIZE)
        gizmo.get_style().rotation_line_thickness = gizmo.get_style().rotation_outer_line_thickness = THICK
        model = np.eye(4)
        model[:3, :3], model[:3, 3] = rotation, place
        matrix = _columns(model)
        view, clip = _columns(projection.view_matrix), _columns(projection.clip_matrix)
        turned = gizmo.manipulate(view, clip, gizmo.OPERATION.rotate, gizmo.MODE.local, matrix)
        began, self.used = not self.used, gizmo.is_using()
        self.over = gizmo.is_over()
        if began:
            self._start, self._by_axis, self._by_view = rotation, np.eye(3), np.eye(3)
        if not turned:
            return None
        after = np.asarray(matrix.values, np.float64).reshape(4, 4).T[:3, :3]
        if gizmo.get_active_handle_type() in RINGS:
            self._by_axis = self._by_axis @ rotation.T @ after
        else:
            self._by_view = after @ rotation.T @ self._by_view
        return np.asarray(self._by_view @ self._start @ self._by_axis)


def nearest_rotvec(matrix: Float64[np.ndarray, "3 3"], near: Vector) -> Vector:
    """The rotation vector of a rotation matrix (made orthonormal) that is nearest to another one: turns of 360° apart are equal."""
    turn = Rotation.from_matrix(matrix).as_rotvec()
    angle = float(np.linalg.norm(turn))
    if angle < 1e-9:
        return vector(turn)
    others = [turn * (1 + k * 2 * np.pi / angle) for k in (-1, 0, 1)]
    return vector(min(others, key=lambda other: float(np.linalg.norm(other - np.array(near)))))


def _columns(matrix: Float64[np.ndarray, "4 4"]) -> gizmo.Matrix16:
    """Column by column, as OpenGL has it."""
    return gizmo.Matrix16(matrix.T.ravel().tolist())
