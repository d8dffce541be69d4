"""The window's OpenGL context, and what is shown in it as one texture: the exact picture over the surface over a background."""

from __future__ import annotations

import logging

import moderngl
from avatarrex_studio.engine.request import Picture
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels.texture import uploaded
from avatarrex_studio.panels.viewport import Shown
from avatarrex_studio.session.state import IMAGE, Colour
from avatarrex_studio.window.canvas import Canvas, release
from avatarrex_studio.window.layers import Layers
from avatarrex_studio.window.staging import Scene, Staging

from avatarrex.gl.context import REQUIRED, use_context
from avatarrex.gl.shader import draw_program

log = logging.getLogger(__name__)
LEAST = 330
"""OpenGL that a window needs to show pictures; with less than `REQUIRED` it draws no surface."""


class Screen:
    """Opened by the first frame, for the window makes its context in it."""

    def __init__(self) -> None:
        self.context: moderngl.Context | None = None
        self.shown: Shown | None = None
        self.layers: Layers | None = None
        """What is shown, without a background."""
        self._fade: Fade | None = None
        self._staging: Staging | None = None
        self._exact: moderngl.Texture | None = None
        self._uploaded: Picture | None = None
        self._behind: tuple[object, ...] = ()

    def open(self) -> moderngl.Context:
        """The window's context, from the first call on lent to what draws."""
        if self.context is None:
            self.context = _lend_context()
            self._fade, self._staging = Fade(self.context), Staging(self.context)
        return self.context

    def show(self, studio: Studio, new: bool) -> None:
        """Draw what the studio has to show, where there is something `new`, another background or another stage."""
        state, picture, weight = studio.state, studio.pictures.picture, studio.weight
        behind = state.background, state.stage
        if not new and behind == self._behind:
            return
        context = self.open()
        if picture is not None and weight > 0 and picture is not self._uploaded:
            self._exact, self._uploaded = uploaded(context, picture.image, self._exact), picture
        surface = studio.surface.texture if studio.surface and weight < 1 else None
        exact = self._exact if weight > 0 else None
        if surface is None and exact is None:
            return
        assert self._fade is not None
        assert self._staging is not None
        self.layers = Layers(surface, exact, weight)
        if state.stage.shown and state.tools.shows == IMAGE:
            texture = self._staging.draw(self.layers, _scene(studio, self.layers))
        else:
            texture = self._fade.draw(self.layers, state.background)
        self.shown, self._behind = Shown(texture.glo, *texture.size), behind

    def close(self) -> None:
        """Take the context back, and be as before the first frame."""
        release(self._exact, self._fade, self._staging)
        use_context(None)
        self.context = self.shown = self.layers = None
        self._fade = self._staging = self._exact = self._uploaded = None
        self._behind = ()


class Fade:
    """Draws two premultiplied pictures, one faded in over the other, over a background."""

    def __init__(self, context: moderngl.Context) -> None:
        self._program = draw_program(context, "window/whole.vert", "window/fade.frag")
        self._triangle = context.vertex_array(self._program, [])
        self._nothing = context.texture((1, 1), 4, bytes(4))
        self._canvas = Canvas(context)

    def draw(self, layers: Layers, background: Colour) -> moderngl.Texture:
        """Straight-alpha sRGB bytes, (width, height); the same texture as long as the size stays."""
        for unit, (name, layer) in enumerate({"u_surface": layers.surface, "u_exact": layers.exact}.items()):
            (layer or self._nothing).use(unit)
            self._program[name] = unit
        red, green, blue, alpha = background
        self._program["u_weight"] = layers.weight
        self._program["u_background"] = (alpha * red, alpha * green, alpha * blue, alpha)
        with self._canvas.drawing(layers.size) as texture:
            self._triangle.render(moderngl.TRIANGLES, vertices=3)
        return texture

    def release(self) -> None:
        """Give everything back."""
        self._canvas.release()
        release(self._triangle, self._program, self._nothing)


def _scene(studio: Studio, layers: Layers) -> Scene:
    """What the layers stand in; an exact picture alone may be of the view before."""
    shown, picture = studio.pictures.shown, studio.pictures.picture
    view = shown.subject.view if shown and not layers.surface else studio.state.view
    floor = picture.floor if picture and layers.exact else None
    shadow = studio.live.shadow if studio.live and layers.surface else None
    return Scene(studio.state, view.camera(*layers.size), shadow, floor)


def _lend_context() -> moderngl.Context:
    """The window's context, lent where it is new enough."""
    try:
        context = moderngl.create_context(require=REQUIRED)
    except ValueError as error:
        log.warning("this window draws no surface, exact pictures are shown alone: %s", error)
        return moderngl.create_context(require=LEAST)
    use_context(context)
    return context
