"""The template as a surface whose texture is cut: every seventh triangle has texture vertices of its own."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "surface"))
from template_surface import template_surface

from avatarrex.surface.surface import Surface


@lru_cache
def seamed_surface(amplitude: float = 0.002) -> Surface:
    """With corrections by the pose of some millimetres, and a `meta` as a distillation leaves one."""
    surface = template_surface(amplitude=amplitude, texture=128)
    cut = np.arange(0, len(surface.faces), 7)
    corners = surface.faces[cut].reshape(-1)
    faces = surface.uv_faces.copy()
    faces[cut] = len(surface.uv) + np.arange(len(corners)).reshape(-1, 3)
    return replace(
        surface,
        uv=np.concatenate([surface.uv, 0.5 * surface.uv[corners]]).astype(np.float32),
        uv_vertex=np.concatenate([surface.uv_vertex, corners]).astype(np.int32),
        uv_faces=faces.astype(np.int32),
        meta={"depth": {"mean_mm": 1.5}, "iou": 0.99},
    )
