"""A cheap guess at the distance to an avatar's surface: the height over the nearest vertex of the posed template.

Letters: p points, v vertices. Metres, negative inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

FLAT = 0.012
"""Metres around a vertex in which the skin counts as its tangent plane: about the spacing of the body's vertices."""


@dataclass(frozen=True)
class Probe:
    """What the nearest vertex says about points, each (p,)."""

    distance: np.ndarray
    """Metres to the vertex."""
    inside: np.ndarray
    """Whether the point is behind the vertex' tangent plane."""
    weight: np.ndarray
    guess: np.ndarray
    """Metres: signed height over the skin around the vertex, less what is worn there."""


@dataclass(frozen=True)
class VertexProbe:
    """Nearest-vertex queries on a posed template."""

    vertices: np.ndarray
    normals: np.ndarray
    weight: np.ndarray
    worn: np.ndarray
    """(v,) metres that the surface stands off each vertex."""
    tree: cKDTree

    @staticmethod
    def of(vertices: np.ndarray, normals: np.ndarray, weight: np.ndarray, worn: np.ndarray) -> VertexProbe:
        """(v, 3) vertices and normals, (v,) painted weight ω, (v,) metres of cloth."""
        return VertexProbe(vertices, normals, weight, worn, cKDTree(vertices))

    def query(self, position: np.ndarray) -> Probe:
        """`position` (p, 3)."""
        distance, nearest = self.tree.query(position, workers=torch.get_num_threads())
        height = np.einsum("pc,pc->p", position - self.vertices[nearest], self.normals[nearest])
        inside = height < 0
        aside = np.maximum(np.sqrt(np.maximum(distance**2 - height**2, 0)) - FLAT, 0)
        signed = np.where(inside, -1.0, 1.0) * np.hypot(height, aside)
        return Probe(distance, inside, self.weight[nearest], signed - self.worn[nearest])
