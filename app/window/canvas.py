"""A texture that is drawn into, of the size that is wanted; one of another size stays until the next drawing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, runtime_checkable

import moderngl

from avatarrex.surface.raster import target_kept


@runtime_checkable
class Released(Protocol):
    """What belongs to a context."""

    def release(self) -> None:
        """Give it back."""


class Canvas:
    """Of straight-alpha sRGB bytes."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._texture: moderngl.Texture | None = None
        self._retired: moderngl.Texture | None = None
        """Of another size; the interface's present frame may show it yet."""
        self._target: moderngl.Framebuffer | None = None

    @contextmanager
    def drawing(self, size: tuple[int, int]) -> Iterator[moderngl.Texture]:
        """The block draws into the texture, (width, height); the same one as long as the size stays."""
        texture = self._texture
        release(self._retired)
        self._retired = None
        if texture is None or self._target is None or texture.size != size:
            release(self._target)
            self._retired = texture
            texture = self._texture = self._context.texture(size, 4)
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
            self._target = self._context.framebuffer([texture])
        with target_kept(self._context):
            self._target.use()
            self._context.disable(moderngl.BLEND | moderngl.DEPTH_TEST | moderngl.CULL_FACE)
            yield texture

    def release(self) -> None:
        """Give everything back."""
        release(self._target, self._texture, self._retired)


def release(*things: Released | None) -> None:
    """Give back those that there are."""
    for thing in things:
        if thing:
            thing.release()
