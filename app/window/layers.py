"""What is on screen without its background: two pictures, one faded in over the other."""

from __future__ import annotations

from dataclasses import dataclass

import moderngl


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
