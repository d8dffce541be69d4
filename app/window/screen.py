"""The window's OpenGL context, and what is shown in it as one texture: the exact picture over the surface over a background."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import moderngl
from avatarrex_studio.engine.request import Picture
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels.texture import uploaded
from avatarrex_studio.panels.viewport import Shown
from avatarrex_studio.session.state import Colour

from avatarrex.gl.context import REQUIRED, use_context
from avatarrex.gl.shader import draw_program

log = logging.getLogger(__name__)
LEAST = 330
"""OpenGL that a window needs to show pictures; with less than `REQUIRED` it draws no surface."""


@dataclass(frozen=True)
class Layers:
    """Two premultiplied pictures, the exact one faded in over the surface."""

    surface: moderngl.Texture | None
    exact: moderngl.Texture | None
    weight: float

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the larger one."""
        width, height = max(layer.size for layer in (self.surface, self.exact) if layer)
        return width, height


class Screen:
    """Opened by the first frame, for the window makes its context in it."""

    def __init__(self) -> None:
        self.context: moderngl.Context | None = None
        self.shown: Shown | None = None
        self.layers: Layers | None = None
        """What is shown, without a background."""
        self._fade: Fade | None = None
        self._exact: moderngl.Texture | None = None
        self._uploaded: Picture | None = None
        self._background: Colour | None = None

    def open(self) -> moderngl.Context:
        """The window's context, from the first call on lent to what draws."""
        if self.context is None:
            self.context = _lend_context()
            self._fade = Fade(self.context)
        return self.context

    def show(self, studio: Studio, new: bool) -> None:
        """Draw what the studio has to show, where there is something `new` or another background."""
        background, picture, weight = studio.state.background, studio.pictures.picture, studio.weight
        if not new and background == self._background:
            return
        context = self.open()
        if picture is not None and weight > 0 and picture is not self._uploaded:
            self._exact, self._uploaded = uploaded(context, picture.image, self._exact), picture
        surface = studio.surface.texture if studio.surface and weight < 1 else None
        exact = self._exact if weight > 0 else None
        if surface is None and exact is None:
            return
        assert self._fade is not None
        self.layers = Layers(surface, exact, weight)
        texture = self._fade.draw(self.layers, background)
        self.shown, self._background = Shown(texture.glo, *texture.size), background

    def close(self) -> None:
        """Take the context back."""
        _release(self._exact)
        if self._fade:
            self._fade.release()
        use_context(None)


class Fade:
    """Draws two premultiplied pictures, one faded in over the other, over a background."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._program = draw_program(context, "window/whole.vert", "window/fade.frag")
        self._triangle = context.vertex_array(self._program, [])
        self._nothing = context.texture((1, 1), 4, bytes(4))
        self._texture: moderngl.Texture | None = None
        self._retired: moderngl.Texture | None = None
        """Of another size; the interface's present frame may show it yet."""
        self._target: moderngl.Framebuffer | None = None

    def draw(self, layers: Layers, background: Colour) -> moderngl.Texture:
        """Straight-alpha sRGB bytes, (width, height); the same texture as long as the size stays."""
        texture, size = self._texture, layers.size
        _release(self._retired)
        self._retired = None
        if texture is None or self._target is None or texture.size != size:
            _release(self._target)
            self._retired = texture
            texture = self._texture = self._context.texture(size, 4)
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
            self._target = self._context.framebuffer([texture])
        for unit, (name, layer) in enumerate({"u_surface": layers.surface, "u_exact": layers.exact}.items()):
            (layer or self._nothing).use(unit)
            self._program[name] = unit
        red, green, blue, alpha = background
        self._program["u_weight"] = layers.weight
        self._program["u_background"] = (alpha * red, alpha * green, alpha * blue, alpha)
        self._target.use()
        self._context.disable(moderngl.BLEND | moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self._triangle.render(moderngl.TRIANGLES, vertices=3)
        return texture

    def release(self) -> None:
        """Give everything back."""
        _release(self._target, self._texture, self._retired, self._triangle, self._program, self._nothing)


def _release(*things: moderngl.Texture | moderngl.Framebuffer | moderngl.VertexArray | moderngl.Program | None) -> None:
    for thing in things:
        if thing:
            thing.release()


def _lend_context() -> moderngl.Context:
    """The window's context, lent where it is new enough."""
    try:
        context = moderngl.create_context(require=REQUIRED)
    except ValueError as error:
        log.warning("this window draws no surface, exact pictures are shown alone: %s", error)
        return moderngl.create_context(require=LEAST)
    use_context(context)
    return context
