"""Pictures as textures of the window's OpenGL context."""

from __future__ import annotations

import moderngl
import numpy as np
from jaxtyping import UInt8


def uploaded(
    context: moderngl.Context, pixels: UInt8[np.ndarray, "h w c"], texture: moderngl.Texture | None = None
) -> moderngl.Texture:
    """`pixels` (sRGB bytes, row 0 at the top) in `texture` where it has that size, else in a new one in its place."""
    height, width, channels = pixels.shape
    if texture is None or texture.size != (width, height):
        if texture:
            texture.release()
        texture = context.texture((width, height), channels, alignment=1)
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    texture.write(np.ascontiguousarray(pixels))
    return texture
