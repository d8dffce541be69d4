"""The viewport: the picture, the mouse that moves the camera, and what can be grabbed in it.

What a drag does to the camera is a matter of the preset (mouse.py); the wheel zooms, a double click centres on the surface under
the cursor. A drag that began here goes on outside. A left drag that begins on a handle, or on the skin of a hand, foot or head
whose handle shows, pulls it; a click selects what is under the mouse, a right click opens its menu. What is selected has rings
that turn it (gizmo.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from avatarrex_studio.engine.request import Seen
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels import mouse as buttons
from avatarrex_studio.panels import overlay, theme, units
from avatarrex_studio.panels.gizmo import Rings, Turn, rings
from avatarrex_studio.panels.part_menu import PartMenu
from avatarrex_studio.panels.projection import Projection
from avatarrex_studio.session import posing
from avatarrex_studio.session.commands import Command, OrbitBy, PanBy, Select, SelectFigure, SetCamera, ZoomBy
from avatarrex_studio.session.grip import EXTREMITIES, LOOK, Grip, handle_of, places
from avatarrex_studio.session.state import OrbitView, Vector
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.signals.handles import HANDLES
from avatarrex.signals.joints import JOINT_NAMES, axis_names
from avatarrex.templates.figure import Figure

DEGREES_PER_POINT = 0.4
ZOOM_PER_NOTCH, ZOOM_PER_POINT = 0.88, 0.994
CLICK = 4.0
"""Points: a press that moves less is a click."""
ON_JOINT = 8.0
"""Points from a joint of the overlay at which a click selects it instead of the skin."""
_BUTTONS = (
    imgui.ButtonFlags_.mouse_button_left
    | imgui.ButtonFlags_.mouse_button_right
    | imgui.ButtonFlags_.mouse_button_middle
)


@dataclass(frozen=True)
class Shown:
    """What is on screen: a texture and its raster."""

    texture: int
    width: int
    height: int


@dataclass
class Press:
    """A mouse button that went down in the viewport."""

    button: int
    at: tuple[float, float]
    last: tuple[float, float]
    """Where it was when it was last acted upon."""
    motion: str = ""
    """What a drag does to the camera, where it has grabbed nothing."""
    turn: Turn | None = None
    """The ring that it turns."""
    grip: Grip | None = None
    """What else it has grabbed."""
    by_skin: bool = False
    """Whether that was by the skin beside a handle, where a click selects the skin's part."""
    offset: tuple[float, float] = (0.0, 0.0)
    """From the mouse to that."""
    depth: float = 0.0
    """Of the plane it is dragged in, metres from the camera's."""
    moved: bool = False
    """Whether it is no click any more."""


class ViewportPanel:
    """The picture with its mouse."""

    def __init__(self) -> None:
        self.size = (640, 480)
        """Pixels that the picture may fill."""
        self.menu = PartMenu()
        self.preset = "default"
        """Of the mouse: one of `mouse.PRESETS`."""
        self.handle: str | None = None
        """The handle under the mouse."""
        self.hovered: str | None = None
        """The part under the mouse."""
        self._press: Press | None = None
        self._looked: tuple[object, ...] = ()

    def draw(self, studio: Studio, picture: Shown | None) -> Iterator[Command]:
        """Draw the picture; the commands of this frame. What lies over it is drawn after the mouse's are done, and so of the same state."""
        origin, room = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail()
        room = imgui.ImVec2(max(room.x, 16), max(room.y, 16))
        scale = imgui.get_io().display_framebuffer_scale
        self.size = (max(16, int(room.x * scale.x)), max(16, int(room.y * scale.y)))
        imgui.invisible_button("picture", room, _BUTTONS)
        low, high = fit_picture(origin, room, picture)
        canvas = imgui.get_window_draw_list()
        red, green, blue, alpha = studio.state.background
        corner = origin + room
        if alpha < 1:
            _checkers(canvas, origin, room)
        elif picture is None or (low, high) != (origin, corner):  # in software a layer over all of it takes 2 ms
            canvas.add_rect_filled(origin, corner, theme.colour((red, green, blue)))
        if picture:
            canvas.add_image(imgui.ImTextureRef(picture.texture), low, high)
        if picture:  # nobody clicks on what is not there yet
            yield from self._mouse(studio, low, high)
        yield from self._over(canvas, studio, low, high)
        if studio.pictures.error:
            _message(canvas, origin, room, studio.pictures.error)
        elif picture is None:
            _centred(canvas, origin, room, preparing(studio))

    def _mouse(self, studio: Studio, low: imgui.ImVec2, high: imgui.ImVec2) -> Iterator[Command]:
        io = imgui.get_io()
        if imgui.is_item_hovered():
            imgui.set_item_key_owner(imgui.Key.mouse_wheel_y)
            if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
                yield SetCamera(target=_target(studio, io.mouse_pos, low, high))
            if io.mouse_wheel:
                yield ZoomBy(ZOOM_PER_NOTCH**io.mouse_wheel)
        mouse = (io.mouse_pos.x, io.mouse_pos.y)
        if imgui.is_item_activated():
            self._press = self._pressed(studio, mouse, low, high)
        elif self._press and imgui.is_item_active():
            yield from self._drag(studio, self._press, mouse, (low, high))
        elif self._press:
            press, self._press = self._press, None
            if not press.moved:
                yield from self._click(studio, press, low, high)

    def _pressed(self, studio: Studio, mouse: tuple[float, float], low: imgui.ImVec2, high: imgui.ImVec2) -> Press:
        """What a press begins."""
        button = next((b for b in range(3) if imgui.is_mouse_down(b)), 0)
        modifier, figure = buttons.modifier(), studio.figure
        press = Press(button, mouse, mouse, buttons.PRESETS[self.preset].get((button, modifier), ""))
        if button or modifier or figure is None:
            return press
        projection = Projection.of(studio.state.view, low, high, studio.world)
        seen = _on_screen(projection, figure, studio.state.tools.selected)
        near = {name: math.dist(mouse, place) for name, place in seen.items()}
        name = min(near, key=lambda each: near[each], default=None)
        ringed = rings(projection, figure, studio.state.tools.selected)
        found = ringed.at(mouse) if ringed else None
        if name is not None and near[name] >= overlay.NEAR_HANDLE:
            name = None if found else grasped(self._part(studio, mouse, low, high), near)
            press.by_skin = name is not None
        if name is not None:
            place = places(figure.skeleton, figure.posed, studio.state.tools.selected)[name]
            press.grip, press.depth = Grip(name, figure.skeleton, studio.state.signals), projection.depth(place)
            press.offset = (seen[name][0] - mouse[0], seen[name][1] - mouse[1])
        elif ringed and found:
            before = posing.joint(studio.state.signals, ringed.joint)
            press.turn = Turn(ringed.joint, found[0], before, found[1], mouse)
        return press

    def _drag(
        self, studio: Studio, press: Press, mouse: tuple[float, float], corners: tuple[imgui.ImVec2, imgui.ImVec2]
    ) -> Iterator[Command]:
        """What a pressed mouse does that has moved."""
        press.moved |= math.dist(mouse, press.at) >= CLICK
        x, y = mouse[0] - press.last[0], mouse[1] - press.last[1]
        if not press.moved or not (x or y):
            return
        press.last = mouse
        low, high = corners
        height = max(high.y - low.y, 1)
        if press.turn:
            yield press.turn.to(mouse)
        elif press.grip:
            place = (mouse[0] + press.offset[0], mouse[1] + press.offset[1])
            yield press.grip.to(
                studio.state, Projection.of(studio.state.view, low, high, studio.world).world(place, press.depth)
            )
        elif press.motion == buttons.ORBIT:
            yield OrbitBy(-DEGREES_PER_POINT * x, DEGREES_PER_POINT * y)
        elif press.motion == buttons.PAN:
            yield PanBy(-x / height, y / height)
        elif press.motion == buttons.ZOOM:
            yield ZoomBy(ZOOM_PER_POINT ** (x - y))

    def _click(self, studio: Studio, press: Press, low: imgui.ImVec2, high: imgui.ImVec2) -> Iterator[Command]:
        """Select what was clicked on, or open its menu."""
        if press.turn:
            return
        grip = None if press.by_skin else press.grip
        part = HANDLES[grip.name].joint if grip and grip.name != LOOK else None
        seen = _seen(studio, press.at, low, high)
        if press.button == 0 and part is None and seen and seen.figure != studio.state.slot:
            yield SelectFigure(seen.figure)
        part = part or self._part(studio, press.at, low, high)
        if press.button == 0 and not (grip and grip.name == LOOK):
            yield Select(part)
        elif press.button == 1:
            self.menu.open(part, studio.own(seen.point) if seen else None)

    def _part(self, studio: Studio, mouse: tuple[float, float], low: imgui.ImVec2, high: imgui.ImVec2) -> str | None:
        """The joint of the overlay, else the part of the surface, at a place of the screen."""
        figure = studio.figure
        if figure is None:
            return None
        if "joints" in studio.state.tools.overlays:
            seen = Projection.of(studio.state.view, low, high, studio.world).screen(figure.posed.position)
            distance = np.nan_to_num(np.hypot(*(seen - mouse).T), nan=np.inf)
            if distance.min() < ON_JOINT:
                return JOINT_NAMES[int(distance.argmin())]
        x, y = (mouse[0] - low.x) / (high.x - low.x), (mouse[1] - low.y) / (high.y - low.y)
        return studio.part_at(x, y) if 0 <= x < 1 and 0 <= y < 1 else None

    def _over(
        self, canvas: imgui.ImDrawList, studio: Studio, low: imgui.ImVec2, high: imgui.ImVec2
    ) -> Iterator[Command]:
        """What lies over the picture, and the commands of the menu."""
        figure, tools = studio.figure, studio.state.tools
        if figure is None:
            return
        projection = Projection.of(studio.state.view, low, high, studio.world)
        canvas.push_clip_rect(low, high, True)
        used = imgui.is_item_hovered() or self._press or tools.selected or tools.pins
        seen = _on_screen(projection, figure, tools.selected) if used else {}  # 2 ms where the person moves
        self._hover(studio, seen, (low, high))
        if "wire" in tools.overlays:
            overlay.draw_wire(canvas, projection, figure)
        if "joints" in tools.overlays:
            overlay.draw_joints(canvas, projection, figure)
        for part in {self.hovered, tools.selected} - {None}:
            overlay.draw_limb(canvas, projection, figure, str(part), part == tools.selected)
        if LOOK in seen:
            overlay.draw_gaze(canvas, projection, figure, seen[LOOK])
        self._handles(canvas, seen, studio)
        ringed = rings(projection, figure, tools.selected)
        axis = self._ring(ringed)
        if ringed and not (self._press and self._press.grip):
            ringed.draw(canvas, axis)
        self._names(canvas, studio, axis)
        canvas.pop_clip_rect()
        yield from self.menu.draw(studio)

    def _hover(
        self, studio: Studio, handles: Mapping[str, tuple[float, float]], corners: tuple[imgui.ImVec2, imgui.ImVec2]
    ) -> None:
        """Find the handle under the mouse, else the part, where mouse or person has moved; where a sender moves it, the mouse alone."""
        mouse = imgui.get_io().mouse_pos
        if not imgui.is_item_hovered() or self._press or studio.playback.playing:
            self.hovered, self.handle, self._looked = None, None, ()
            return
        stands = None if studio.listening.present else studio.state.figures
        looked = (mouse.x, mouse.y, stands, studio.state.view, self.size)
        if looked != self._looked:
            near = {name: math.dist((mouse.x, mouse.y), place) for name, place in handles.items()}
            nearest = min(near, key=lambda name: near[name], default=None)
            self._looked = looked
            self.handle = nearest if nearest and near[nearest] < overlay.NEAR_HANDLE else None
            self.hovered = None if self.handle else self._part(studio, (mouse.x, mouse.y), *corners)

    def _handles(self, canvas: imgui.ImDrawList, seen: Mapping[str, tuple[float, float]], studio: Studio) -> None:
        mouse, tools = imgui.get_io().mouse_pos, studio.state.tools
        grip = self._press.grip if self._press else None
        here = (mouse.x, mouse.y) if grip or (imgui.is_item_hovered() and not self._press) else None
        taken = grip.name if grip else None
        if here and not grip:
            near = {name: math.dist(here, place) for name, place in seen.items()}
            taken = grasped(self.hovered, near) if min(near.values(), default=0.0) >= overlay.NEAR_HANDLE else None
        overlay.draw_handles(canvas, seen, tools.pins, here, taken)

    def _ring(self, ringed: Rings | None) -> int | None:
        """The axis of the ring that is turned, or is under the mouse."""
        if self._press:
            return self._press.turn.axis if self._press.turn else None
        mouse = imgui.get_io().mouse_pos
        found = ringed.at((mouse.x, mouse.y)) if ringed and imgui.is_item_hovered() else None
        return found[0] if found else None

    def _names(self, canvas: imgui.ImDrawList, studio: Studio, axis: int | None) -> None:
        """What is under the mouse, or how far a ring has turned."""
        mouse, joint = imgui.get_io().mouse_pos, studio.state.tools.selected
        place = (mouse.x, mouse.y)
        if self._press and self._press.turn and joint:
            unit, turned = units.angle(), np.degrees(posing.joint(studio.state.signals, joint)) + 0.0
            text = "   ".join(f"{name} {unit.text(value)}" for name, value in zip(axis_names(joint), turned.tolist()))
            overlay.draw_name(canvas, text, place)
        elif self.handle:
            overlay.draw_name(canvas, f"{overlay.title(self.handle)}: drag", place)
        elif axis is not None and joint:
            overlay.draw_name(canvas, axis_names(joint)[axis].capitalize(), place)
        elif self.hovered:
            overlay.draw_name(canvas, overlay.title(self.hovered), place)


def preparing(studio: Studio) -> str:
    """What is under way before the first picture."""
    name = Path(studio.state.avatar).name
    if studio.avatars.reading:
        return f"Reading the avatar {name}…"
    if studio.pictures.exact.busy:
        return f"Rendering the first picture of {name}…"
    return f"Preparing {name}…"


def grasped(part: str | None, near: Mapping[str, float]) -> str | None:
    """The hand, foot or head that a part of the skin belongs to, where its handle shows: `near` is the points to each handle."""
    name = handle_of(part)
    shown = name in EXTREMITIES and near.get(name, math.inf) < overlay.SEEN_HANDLE
    return name if shown else None


def _on_screen(projection: Projection, figure: Figure, selected: str | None) -> dict[str, tuple[float, float]]:
    """Where on the screen everything is that can be dragged."""
    found = places(figure.skeleton, figure.posed, selected)
    seen = projection.screen(np.array(list(found.values())))
    return {name: (float(x), float(y)) for name, (x, y) in zip(found, seen) if np.isfinite(x)}


def fit_picture(origin: imgui.ImVec2, room: imgui.ImVec2, picture: Shown | None) -> tuple[imgui.ImVec2, imgui.ImVec2]:
    """Corners of the largest rectangle of the picture's shape in the room; the room where they agree within the picture's pixels."""
    shape = picture.width / picture.height if picture else room.x / room.y
    width, height = (room.x, room.x / shape) if shape > room.x / room.y else (room.y * shape, room.y)
    near = max(3.0, max(room.x, room.y) / min(picture.width, picture.height)) if picture else 3.0
    if abs(width - room.x) < near and abs(height - room.y) < near:
        width, height = room.x, room.y
    size = imgui.ImVec2(width, height)
    low = origin + (room - size) / 2
    return low, low + size


def _seen(studio: Studio, mouse: tuple[float, float], low: imgui.ImVec2, high: imgui.ImVec2) -> Seen | None:
    """What is under a place of the screen; None for the background."""
    x, y = (mouse[0] - low.x) / (high.x - low.x), (mouse[1] - low.y) / (high.y - low.y)
    return studio.seen(x, y) if 0 <= x < 1 and 0 <= y < 1 else None


def _target(studio: Studio, mouse: imgui.ImVec2, low: imgui.ImVec2, high: imgui.ImVec2) -> Vector:
    """The surface point under the cursor in the world, else the person's middle."""
    seen, state = _seen(studio, (mouse.x, mouse.y), low, high), studio.state
    return seen.point if seen else OrbitView().moved(state.place.signals(state.signals).translation).target


def _checkers(canvas: imgui.ImDrawList, origin: imgui.ImVec2, room: imgui.ImVec2, side: float = 16) -> None:
    end = origin + room
    canvas.add_rect_filled(origin, end, theme.colour((0.24, 0.25, 0.27)))
    for row in range(int(room.y / side) + 1):
        for column in range(row % 2, int(room.x / side) + 1, 2):
            x, y = origin.x + column * side, origin.y + row * side
            canvas.add_rect_filled(
                (x, y), (min(x + side, end.x), min(y + side, end.y)), theme.colour((0.29, 0.30, 0.32))
            )


def _message(canvas: imgui.ImDrawList, origin: imgui.ImVec2, room: imgui.ImVec2, text: str) -> None:
    """An error over the picture, wrapped, on a dark band."""
    wrap = max(room.x - 64, 80)
    size = imgui.calc_text_size(text, wrap_width=wrap)
    low = origin + imgui.ImVec2(16, 16)
    high = low + size + imgui.ImVec2(44, 20)
    canvas.add_rect_filled(low, high, theme.colour(theme.ALARM, 0.94), 6)
    canvas.add_rect(low, high, theme.colour(theme.ERROR, 0.8), 6)
    canvas.add_text((low.x + 10, low.y + 10), theme.colour(theme.ERROR), icons.ICON_FA_TRIANGLE_EXCLAMATION)
    font, points = imgui.get_font(), imgui.get_font_size()
    canvas.add_text(font, points, (low.x + 34, low.y + 10), theme.colour(theme.TEXT), text, wrap_width=wrap)


def _centred(canvas: imgui.ImDrawList, origin: imgui.ImVec2, room: imgui.ImVec2, text: str) -> None:
    canvas.add_text(origin + (room - imgui.calc_text_size(text)) / 2, theme.colour(overlay.BRIGHT, 0.6), text)
