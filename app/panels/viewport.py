"""The viewport: the picture, and the mouse that moves the camera.

Left drag orbits, right or middle or Shift+left drag pans, the wheel zooms, a double click centres on the surface under
the cursor. A drag that began here goes on outside.
"""

from __future__ import annotations

from dataclasses import dataclass

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels import theme
from avatarrex_studio.session.commands import Command, OrbitBy, PanBy, SetCamera, ZoomBy
from avatarrex_studio.session.state import OrbitView, Vector
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

DEGREES_PER_POINT = 0.4
ZOOM_PER_NOTCH = 0.88
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


class ViewportPanel:
    """The picture with its camera mouse."""

    def __init__(self) -> None:
        self.size = (640, 480)
        """Pixels that the picture may fill."""

    def draw(self, studio: Studio, picture: Shown | None) -> list[Command]:
        """Draw the picture; the commands of this frame."""
        origin, room = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail()
        room = imgui.ImVec2(max(room.x, 16), max(room.y, 16))
        scale = imgui.get_io().display_framebuffer_scale
        self.size = (max(16, int(room.x * scale.x)), max(16, int(room.y * scale.y)))
        imgui.invisible_button("picture", room, _BUTTONS)
        low, high = _fit(origin, room, picture)
        canvas = imgui.get_window_draw_list()
        red, green, blue, alpha = studio.state.background
        corner = origin + room
        if alpha < 1:
            _checkers(canvas, origin, room)
        elif picture is None or (low, high) != (origin, corner):  # in software a layer over all of it takes 2 ms
            canvas.add_rect_filled(origin, corner, theme.colour((red, green, blue)))
        if picture:
            canvas.add_image(imgui.ImTextureRef(picture.texture), low, high)
        if studio.pictures.error:
            _message(canvas, origin, room, studio.pictures.error)
        elif picture is None:
            _centred(canvas, origin, room, "Preparing the avatar…")
        return self._mouse(studio, low, high)

    def _mouse(self, studio: Studio, low: imgui.ImVec2, high: imgui.ImVec2) -> list[Command]:
        io = imgui.get_io()
        commands: list[Command] = []
        height = max(high.y - low.y, 1)
        hovered = imgui.is_item_hovered()
        if hovered:
            imgui.set_item_key_owner(imgui.Key.mouse_wheel_y)
            if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
                commands.append(SetCamera(target=_target(studio, io.mouse_pos, low, high)))
            if io.mouse_wheel:
                commands.append(ZoomBy(ZOOM_PER_NOTCH**io.mouse_wheel))
        dragged = imgui.is_item_active() and not imgui.is_item_activated()  # a press brings the way to it with it
        if dragged and (io.mouse_delta.x or io.mouse_delta.y):
            x, y = io.mouse_delta.x, io.mouse_delta.y
            if imgui.is_mouse_down(imgui.MouseButton_.left) and not io.key_shift:
                commands.append(OrbitBy(-DEGREES_PER_POINT * x, DEGREES_PER_POINT * y))
            else:
                commands.append(PanBy(-x / height, y / height))
        return commands


def _fit(origin: imgui.ImVec2, room: imgui.ImVec2, picture: Shown | None) -> tuple[imgui.ImVec2, imgui.ImVec2]:
    """Corners of the largest rectangle of the picture's shape in the room; the room where they nearly agree."""
    shape = picture.width / picture.height if picture else room.x / room.y
    width, height = (room.x, room.x / shape) if shape > room.x / room.y else (room.y * shape, room.y)
    if abs(width - room.x) < 3 and abs(height - room.y) < 3:
        width, height = room.x, room.y
    size = imgui.ImVec2(width, height)
    low = origin + (room - size) / 2
    return low, low + size


def _target(studio: Studio, mouse: imgui.ImVec2, low: imgui.ImVec2, high: imgui.ImVec2) -> Vector:
    """The surface point under the cursor in the world, else the person's middle."""
    x, y = (mouse.x - low.x) / (high.x - low.x), (mouse.y - low.y) / (high.y - low.y)
    point = studio.point(x, y) if 0 <= x < 1 and 0 <= y < 1 else None
    return point or OrbitView().moved(studio.state.signals.translation).target


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
    canvas.add_rect_filled(low, high, theme.colour((0.16, 0.09, 0.09), 0.94), 6)
    canvas.add_rect(low, high, theme.colour(theme.ERROR, 0.8), 6)
    canvas.add_text((low.x + 10, low.y + 10), theme.colour(theme.ERROR), icons.ICON_FA_TRIANGLE_EXCLAMATION)
    font, points = imgui.get_font(), imgui.get_font_size()
    canvas.add_text(font, points, (low.x + 34, low.y + 10), theme.colour(theme.TEXT), text, wrap_width=wrap)


def _centred(canvas: imgui.ImDrawList, origin: imgui.ImVec2, room: imgui.ImVec2, text: str) -> None:
    canvas.add_text(origin + (room - imgui.calc_text_size(text)) / 2, theme.colour(theme.MUTED), text)
