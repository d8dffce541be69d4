"""The rotation gizmo: three rings about a joint's own axes, in the colours of its sliders.

A ring follows the mouse along its tangent at the place where it was taken, at one radian a radius; the angle counts from there, so
that a joint at its limit follows again as soon as the mouse is back where it got there. imguizmo's rings were tried: their colours
cannot be set from Python, they take no press where an item is, and past a limit they lose their angle.

Letters: k points of a ring. Points of the screen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from avatarrex_studio.panels import theme
from avatarrex_studio.panels.projection import Projection
from avatarrex_studio.session import posing
from avatarrex_studio.session.commands import SetJoint
from avatarrex_studio.session.state import Vector, vector
from imgui_bundle import imgui
from jaxtyping import Bool, Float64
from scipy.spatial.transform import Rotation

from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.figure import Figure

RADIUS, WIDTH = 54.0, 2.5
"""Points: of a ring seen from the front, and of its line."""
ON_RING = 6.0
"""Points from a ring at which it is taken."""
ANGLES = np.linspace(0, 2 * np.pi, 65)
"""Round a ring, the first point again at the end."""
BEHIND = 0.22
"""Opacity of the half that is turned away."""


@dataclass(frozen=True, eq=False)
class Rings:
    """The rings of a joint on the screen."""

    joint: str
    places: Float64[np.ndarray, "3 k 2"]
    front: Bool[np.ndarray, "3 k"]
    """Which points are on the half that faces the camera."""

    def at(self, mouse: tuple[float, float]) -> tuple[int, Float64[np.ndarray, "2"]] | None:
        """The ring under the mouse, and its tangent there, points a radian; None where there is none."""
        distance = np.where(self.front, np.hypot(*np.moveaxis(self.places - mouse, 2, 0)), np.inf)
        axis, k = np.unravel_index(int(distance.argmin()), distance.shape)
        if not distance[axis, k] < ON_RING:
            return None
        before, after = self.places[axis, (k - 1) % 64], self.places[axis, (k + 1) % 64]
        return int(axis), (after - before) / (2 * ANGLES[1])

    def draw(self, pen: imgui.ImDrawList, lit: int | None) -> None:
        """Draw them, the one that is `lit` bright and the others fainter beside it."""
        for axis, colour in enumerate(theme.AXES):
            alpha = 0.95 if lit in (None, axis) else 0.35
            for start in range(64):
                front = self.front[axis, start]
                width = WIDTH + (axis == lit) if front else 1.5
                one, other = self.places[axis, start].tolist(), self.places[axis, start + 1].tolist()
                pen.add_line(one, other, theme.colour(colour, alpha if front else alpha * BEHIND), width)


@dataclass(frozen=True, eq=False)
class Turn:
    """A ring that is being turned."""

    joint: str
    axis: int
    start: Vector
    """The joint's rotation vector when it was taken."""
    tangent: Float64[np.ndarray, "2"]
    at: tuple[float, float]

    def to(self, mouse: tuple[float, float]) -> SetJoint:
        """The command for a place of the mouse."""
        length = max(float(np.hypot(*self.tangent)), 0.25 * RADIUS)
        angle = float(np.subtract(mouse, self.at) @ self.tangent) / length**2
        by = angle * np.eye(3)[self.axis]
        turn = Rotation.from_rotvec(self.start) * Rotation.from_rotvec(by)
        return SetJoint(self.joint, nearest_rotvec(turn, vector(self.start + by)))


def rings(projection: Projection, figure: Figure, joint: str | None) -> Rings | None:
    """The rings of a joint; None for what is no joint, and behind the camera."""
    if joint not in JOINT_NAMES:
        return None
    index = posing.joint_index(joint)
    centre, axes = figure.posed.position[index], figure.posed.rotation[index]
    depth = projection.depth(centre)
    if np.isnan(projection.screen(centre)).any():
        return None
    radius = RADIUS / projection.scale * depth / projection.camera.intrinsics[0, 0]
    circle = np.stack([np.cos(ANGLES), np.sin(ANGLES)])
    points = np.stack([axes[:, [(axis + 1) % 3, (axis + 2) % 3]] @ circle for axis in range(3)]).swapaxes(1, 2)
    front = points @ (projection.camera.centre - centre) > -0.15 * np.linalg.norm(projection.camera.centre - centre)
    return Rings(joint, projection.screen(centre + radius * points), front)


def nearest_rotvec(turn: Rotation, near: Vector) -> Vector:
    """The rotation vector of a rotation that is nearest to another one: those that differ by 360° turn alike."""
    shortest = turn.as_rotvec()
    angle = float(np.linalg.norm(shortest))
    if angle < 1e-9:
        return vector(shortest)
    others = [shortest * (1 + k * 2 * np.pi / angle) for k in (-1, 0, 1)]
    return vector(min(others, key=lambda other: float(np.linalg.norm(other - np.array(near)))))
