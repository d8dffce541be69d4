"""View modes: normals, depth, parts and influences of a surface as colours, beside its own.

`Look.colours` is the reference of `shaders/surface/look.frag`, and what pictures of the exact field are coloured with.
Letters: p points, k parts. Root frame, metres; sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

LookKind = Literal["normals", "depth", "parts", "influence"]
KINDS: tuple[LookKind, ...] = get_args(LookKind)
DEPTH_FADE = 0.85
"""How dark the farthest depth is."""
PART_COLOURS = np.array([(0.62, 0.66, 0.72), (0.36, 0.66, 0.94), (0.95, 0.62, 0.32), (0.72, 0.52, 0.92)])
"""Of the body, then of `PARTS`."""


@dataclass(frozen=True)
class Look:
    """A view mode."""

    kind: LookKind
    near: float = 0.0
    far: float = 1.0
    """Depths that are white and darkest, metres."""

    def colours(
        self,
        normal: Float[np.ndarray, "p 3"],
        depth: Float[np.ndarray, " p"],
        part: Float[np.ndarray, "p k"],
        forward: Float[np.ndarray, "3"],
    ) -> Float[np.ndarray, "p 3"]:
        """Of points with unit normals, camera z and shares of the parts; `forward`: the camera's direction, root frame.

        Raises `ValueError` for influences, which are the caller's own colours (`shaded`).
        """
        if self.kind == "influence":
            raise ValueError("influences have the caller's own colours")
        if self.kind == "normals":
            return np.asarray(0.5 + 0.5 * normal)
        if self.kind == "depth":
            share = np.clip((depth - self.near) / (self.far - self.near), 0, 1)
            return np.repeat(1 - DEPTH_FADE * share[:, None], 3, 1)
        flat = np.concatenate([1 - part.sum(1, keepdims=True), part], 1) @ PART_COLOURS
        return shaded(flat, normal, forward)


def shaded(
    flat: Float[np.ndarray, "p 3"], normal: Float[np.ndarray, "p 3"], forward: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "p 3"]:
    """Flat colours, darker where the surface turns away from the camera."""
    return np.asarray(flat * (0.55 + 0.45 * np.abs(normal @ forward))[:, None])
