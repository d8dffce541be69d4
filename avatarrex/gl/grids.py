"""Tensors as 3D textures, uploaded when they change and not before.

A name (`body`, `left_hand`, …) has one texture; it is written again only when another tensor is bound under that name.
No side is a power of two (the last texel is repeated there): Mesa's llvmpipe compiles a shader anew, in half a second and
more, whenever a texture it reads changes from such a size to another.
"""

from __future__ import annotations

import weakref

import moderngl
import numpy as np
import torch
from torch import Tensor

_TYPES = {torch.float32: "f4", torch.float16: "f2"}


class GridTextures:
    """Textures of one context, by name."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._textures: dict[str, tuple[weakref.ref[Tensor], moderngl.Texture3D]] = {}
        self._blank = context.texture3d((3, 3, 3), 2, np.zeros(54, "f4").tobytes(), dtype="f4")

    def bind(self, name: str, grid: Tensor | None, unit: int) -> int:
        """Bind the grid (z, y, x) or (z, y, x, c), float32 or half, to a texture unit; the bytes that were uploaded."""
        if grid is None:
            self._blank.use(unit)
            return 0
        reference, texture = self._textures.get(name, (None, None))
        if texture is not None and reference is not None and reference() is grid:
            texture.use(unit)
            return 0
        extra = [(0, 2 if side == 1 else int(side & (side - 1) == 0)) for side in grid.shape[:3]]
        data = np.pad(grid.detach().cpu().numpy(), extra + [(0, 0)] * (grid.ndim - 3), mode="edge")
        size, channels = data.shape[2::-1], 1 if grid.ndim == 3 else data.shape[3]
        kind = _TYPES[grid.dtype]
        if texture is None or (texture.size, texture.components, texture.dtype) != (size, channels, kind):
            if texture is not None:
                texture.release()
            texture = self._context.texture3d(size, channels, alignment=1, dtype=kind)
            texture.repeat_x = texture.repeat_y = texture.repeat_z = False
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        texture.write(data.tobytes(), alignment=1)
        self._textures[name] = (weakref.ref(grid), texture)
        texture.use(unit)
        return data.nbytes
