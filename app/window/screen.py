"""The window's OpenGL context, and the picture as a texture in it."""

from __future__ import annotations

import logging

import moderngl
from avatarrex_studio.panels.texture import uploaded
from avatarrex_studio.panels.viewport import Picture
from avatarrex_studio.session.state import Colour
from jaxtyping import Float
from torch import Tensor

from avatarrex.files.images import composite
from avatarrex.gl.context import REQUIRED, use_context

log = logging.getLogger(__name__)


class Screen:
    """Opened by the first frame, for the window makes its context in it."""

    def __init__(self) -> None:
        self.context: moderngl.Context | None = None
        self.picture: Picture | None = None
        self._texture: moderngl.Texture | None = None
        self._shown: tuple[object, Colour] | None = None

    def open(self) -> moderngl.Context:
        """The window's context, from the first call on lent to the compute shaders."""
        if self.context is None:
            self.context = _lend_context()
        return self.context

    def show(self, image: Float[Tensor, "h w 4"] | None, background: Colour) -> None:
        """The image over the background into the texture, where either is new."""
        if image is None or (self._shown and self._shown[0] is image and self._shown[1] == background):
            return
        self._texture = uploaded(self.open(), composite(image, background), self._texture)
        self.picture = Picture(self._texture.glo, *self._texture.size)
        self._shown = (image, background)

    def close(self) -> None:
        """Take the context back."""
        if self._texture:
            self._texture.release()
        use_context(None)


def _lend_context() -> moderngl.Context:
    """The window's context, lent to the compute shaders where it is new enough."""
    try:
        context = moderngl.create_context(require=REQUIRED)
    except ValueError as error:
        log.warning("no compute shaders in this window, the rays are cast elsewhere: %s", error)
        return moderngl.create_context(require=330)
    use_context(context)
    return context
