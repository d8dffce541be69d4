"""What is drawn over the picture: joints and bones, the template's wire, the part under the mouse, handles, pins and names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from avatarrex_studio.panels import theme
from avatarrex_studio.panels.joints import SPINE
from avatarrex_studio.panels.projection import Projection
from avatarrex_studio.session import posing
from avatarrex_studio.session.actions import words
from avatarrex_studio.session.grip import LOOK
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui
from jaxtyping import Float64

from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.figure import Figure, Wire

BONE, JOINT, FINE_JOINT, HANDLE = 1.5, 3.5, 2.0, 7.0
"""Points: width of a bone, radius of a joint, of a finger's joint and of a handle."""
NEAR_HANDLE, SEEN_HANDLE = 12.0, 90.0
"""Points from a handle at which it is taken, and at which it begins to show."""
BRIGHT = (0.96, 0.97, 0.98)
DARK = (0.05, 0.06, 0.08)
KNUCKLES = {"1": "knuckle", "2": "middle", "3": "tip"}
WIRE = 0.11
"""Opacity of the template's edges."""
MOST_LINES = 1500
"""Of the wire: as many take 8 ms of one core."""


def draw_joints(pen: imgui.ImDrawList, projection: Projection, figure: Figure, alpha: float = 1.0) -> None:
    """Every joint, and the bones between them."""
    places = projection.screen(figure.posed.position)
    for joint, parent in enumerate(figure.skeleton.parents):
        if parent > 0 and _seen(places[[joint, parent]]):
            _line(pen, places[parent], places[joint], theme.colour(DARK, 0.35 * alpha), BONE + 2)
            _line(pen, places[parent], places[joint], theme.colour(BRIGHT, 0.55 * alpha), BONE)
    for joint, place in enumerate(places):
        if _seen(place):
            radius = FINE_JOINT if joint > 22 else JOINT
            pen.add_circle_filled(_pair(place), radius + 1, theme.colour(DARK, 0.5 * alpha))
            pen.add_circle_filled(_pair(place), radius, theme.colour(BRIGHT, 0.9 * alpha))


def draw_wire(pen: imgui.ImDrawList, projection: Projection, figure: Figure) -> None:
    """The template's edges that face the camera, the longest of them: those of fingers and face show from near."""
    wire, places = Wire.of(figure.body), projection.screen(figure.vertices.astype(np.float64))
    a, b, c = (places[wire.faces[:, k]] for k in range(3))
    front = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    lines = places[wire.edges[front[wire.beside].any(1)]]
    low = np.array(projection.low)
    high = low + projection.scale * np.array([projection.camera.width, projection.camera.height])
    lines = lines[((lines > low) & (lines < high)).all((1, 2))]
    length = np.hypot(*(lines[:, 1] - lines[:, 0]).T)
    lines = lines[np.argsort(-length)[:MOST_LINES]]
    colour = theme.colour(BRIGHT, WIRE)
    for one, other in lines.tolist():
        pen.add_line(one, other, colour, 1.0)


def draw_limb(pen: imgui.ImDrawList, projection: Projection, figure: Figure, part: str, strong: bool) -> None:
    """The bones that a joint turns, and the joint; of a region of the face its outline."""
    colour = theme.ACCENT
    if part not in JOINT_NAMES:
        _region(pen, projection, figure, part, strong)
        return
    joint = posing.joint_index(part)
    places = projection.screen(figure.posed.position)
    for child, parent in enumerate(figure.skeleton.parents):
        if parent == joint and _seen(places[[joint, child]]):
            _line(pen, places[joint], places[child], theme.colour(colour, 0.55 if strong else 0.30), 7)
    if _seen(places[joint]):
        pen.add_circle_filled(_pair(places[joint]), 5.5, theme.colour(DARK, 0.6))
        pen.add_circle_filled(_pair(places[joint]), 4.5, theme.colour(colour))


def draw_handles(
    pen: imgui.ImDrawList,
    places: Mapping[str, tuple[float, float]],
    pins: Iterable[str],
    mouse: tuple[float, float] | None,
    taken: str | None,
) -> None:
    """Rings where something can be dragged, the nearer the mouse the clearer; pins always."""
    pinned = set(pins)
    for name, place in places.items():
        distance = math.dist(mouse, place) if mouse else math.inf
        strong = name == taken or (taken is None and distance < NEAR_HANDLE)
        alpha = 1.0 if strong or name == LOOK else max(0.0, 1 - distance / SEEN_HANDLE) * 0.8
        colour = theme.WARNING if name in pinned else theme.ACCENT if strong or name == LOOK else BRIGHT
        if name in pinned:
            _pin(pen, place)
        elif alpha > 0:
            radius = HANDLE + 1.5 * strong
            pen.add_circle(place, radius, theme.colour(DARK, 0.5 * alpha), 0, 4)
            pen.add_circle(place, radius, theme.colour(colour, alpha), 0, 2)


def draw_gaze(pen: imgui.ImDrawList, projection: Projection, figure: Figure, place: tuple[float, float]) -> None:
    """Thin lines from the eyes to where they look."""
    eyes = projection.screen(figure.posed.position[[posing.joint_index(f"{side}_eye") for side in ("left", "right")]])
    for eye in eyes:
        if _seen(eye):
            pen.add_line(_pair(eye), place, theme.colour(theme.ACCENT, 0.45), 1.2)


def draw_name(pen: imgui.ImDrawList, text: str, place: tuple[float, float]) -> None:
    """A small label beside a place of the screen."""
    size = imgui.calc_text_size(text)
    low = (place[0] + 14, place[1] + 8)
    pen.add_rect_filled(low, (low[0] + size.x + 12, low[1] + size.y + 6), theme.colour(DARK, 0.72), 4)
    pen.add_text((low[0] + 6, low[1] + 3), theme.colour(BRIGHT), text)


def title(part: str) -> str:
    """A joint or region as a person writes it: `left_index3` is the left index tip."""
    if part in SPINE:
        return SPINE[part]
    place = KNUCKLES.get(part[-1], "") if part[-1:].isdigit() and not part.startswith("spine") else ""
    return f"{words(part.rstrip('123') if place else part)} {place}".strip().capitalize()


def _region(pen: imgui.ImDrawList, projection: Projection, figure: Figure, region: str, strong: bool) -> None:
    """The region's vertices that face the camera, as small dots."""
    rows = figure.region(region)
    seen = figure.vertices[rows].astype(np.float64)
    outward = seen - figure.posed.position[posing.joint_index("head")]
    facing = ((projection.camera.centre - seen) * outward).sum(1) > 0
    colour = theme.colour(theme.ACCENT, 0.75 if strong else 0.4)
    for place in projection.screen(seen[facing]).tolist():
        pen.add_circle_filled(place, 1.6, colour)


def _pin(pen: imgui.ImDrawList, place: tuple[float, float]) -> None:
    size = imgui.calc_text_size(icons.ICON_FA_THUMBTACK)
    pen.add_circle_filled(place, HANDLE + 2, theme.colour(DARK, 0.7))
    corner = (place[0] - size.x / 2, place[1] - size.y / 2)
    pen.add_text(corner, theme.colour(theme.WARNING), icons.ICON_FA_THUMBTACK)


def _line(
    pen: imgui.ImDrawList, one: Float64[np.ndarray, "2"], other: Float64[np.ndarray, "2"], colour: int, width: float
) -> None:
    pen.add_line(_pair(one), _pair(other), colour, width)


def _pair(place: Float64[np.ndarray, "2"]) -> tuple[float, float]:
    return float(place[0]), float(place[1])


def _seen(places: Float64[np.ndarray, "... 2"]) -> bool:
    return bool(np.isfinite(places).all())
