"""The template distance: height over the nearest vertex of the posed template, a cheap estimate of the avatar's distance.

Letters: p points, v vertices. Metres, negative inside.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from avatarrex.fields.composition import emptied
from avatarrex.fields.outgrowth import DEVIATION, PosedOutgrowth
from avatarrex.ops.closest_vertex import closest_vertex, closest_vertices
from avatarrex.ops.search_tree import SearchTree

FLAT = 0.012
"""Metres around a vertex in which the skin counts as its tangent plane: about the spacing of the body's vertices."""
STEEP = 0.5
"""A point this much less below a vertex' tangent plane than aside of it is outside: past the rim of a part of the skin."""
RIM_WIDTH = 0.04
"""Metres: of a whole skin, whose cloth may bridge folds."""
BLENDED = 8
"""Vertices that ω is blended of where it changes; one vertex' alone cuts the wrist into steps of several millimetres."""
MAX_DEVIATION = 0.05
"""Metres that a fitted field may differ from the guess: farther out it has seen no samples and may have any value."""
AIR = 0.4
"""Share of it towards air: cloth may stand off farther than the guess says, but flesh 2 cm below it has no void."""


@dataclass(frozen=True)
class NearestSkin:
    """What the nearest vertex says about points, each (p,)."""

    nearest: np.ndarray
    """That vertex' number."""
    distance: np.ndarray
    """Metres to the vertex."""
    weight: np.ndarray
    """Painted ω, continuous in the point."""
    guess: np.ndarray
    """Metres: signed height over the skin around the vertex, less the clothing offset there; of an outgrowth where that is nearer."""
    deviation: np.ndarray
    """Metres that a field may lie below the guess."""

    def at(self, chosen: np.ndarray) -> NearestSkin:
        """The points of a mask (p,) or of indices."""
        return NearestSkin(*(getattr(self, column.name)[chosen] for column in fields(self)))

    def clamped(self, sdf: Tensor, share: float = 1.0) -> Tensor:
        """`sdf` (p,) no farther from the guess than this share of its deviation, and `AIR` of that towards the outside."""
        low, high = (torch.as_tensor(self.guess + side * share * self.deviation).to(sdf) for side in (-1, AIR))
        return sdf.clamp(low, high)

    def without_hands(self, sdf: Tensor, share: float = 1.0) -> Tensor:
        """The body field `sdf` (p,) clamped, and emptied where the template's hands are (composition.py)."""
        return emptied(self.clamped(sdf, share), torch.as_tensor(self.weight).to(sdf))


@dataclass(frozen=True)
class TemplateDistance:
    """Nearest-vertex queries on a posed template."""

    vertices: np.ndarray
    normals: np.ndarray
    weight: np.ndarray
    clothing_offset: np.ndarray
    """(v,) metres that the surface stands off each vertex."""
    rim: float
    """Metres aside of a vertex, beyond `FLAT`, over which its cloth and the field's deviation fade out."""
    closed: bool
    """Whether the skin has no rim that a point could be past: then the core of a chest is inside, too."""
    closest: SearchTree
    changing: np.ndarray
    """(v,) whether ω is not the same at all the vertices around."""
    outgrowth: PosedOutgrowth | None = None
    """What stands off the skin farther than cloth."""

    @property
    def extent(self) -> np.ndarray:
        """(k, 3) places about which the surface is."""
        return self.vertices if self.outgrowth is None else np.concatenate([self.vertices, self.outgrowth.points])

    @staticmethod
    def of(
        vertices: np.ndarray,
        normals: np.ndarray,
        weight: np.ndarray,
        clothing_offset: np.ndarray,
        rim: float = RIM_WIDTH,
        closed: bool = False,
        tree: SearchTree | None = None,
        outgrowth: PosedOutgrowth | None = None,
    ) -> TemplateDistance:
        """(v, 3) vertices and normals, (v,) painted weight ω, (v,) metres of cloth; `tree`: of the same vertices in another pose."""
        tree = SearchTree.of_vertices(vertices) if tree is None else tree.moved(vertices)
        changing = (weight > 0) & (weight < 1)
        if changing.any():
            ring = closest_vertices(tree, vertices[changing], min(4 * BLENDED, len(vertices)))[1]
            changing[ring] = True
        return TemplateDistance(vertices, normals, weight, clothing_offset, rim, closed, tree, changing, outgrowth)

    def of_vertices(self, chosen: np.ndarray, rim: float) -> TemplateDistance:
        """The skin of some vertices alone, a mask (v,), with a rim of so many metres."""
        vertices, normals = self.vertices[chosen], self.normals[chosen]
        outgrowth = None if self.outgrowth is None else self.outgrowth.of_vertices(chosen)
        painted = self.weight[chosen], self.clothing_offset[chosen]
        return TemplateDistance.of(vertices, normals, *painted, rim, outgrowth=outgrowth)

    def query(self, position: np.ndarray) -> NearestSkin:
        """`position` (p, 3)."""
        return self.of_nearest(position, *closest_vertex(self.closest, position))

    def of_nearest(self, position: np.ndarray, distance: np.ndarray, nearest: np.ndarray) -> NearestSkin:
        """The same where the nearest vertices (p,) and their distances are known."""
        height = np.einsum("pc,pc->p", position - self.vertices[nearest], self.normals[nearest])
        aside = np.maximum(np.sqrt(np.maximum(distance**2 - height**2, 0)) - FLAT, 0)
        inside = (-height > STEEP * aside) & (self.closed | (aside < self.rim))
        signed = np.where(inside, -1.0, 1.0) * np.hypot(height, aside)
        here = np.clip(1 - aside / self.rim, 0, 1)
        guess = signed - here * self.clothing_offset[nearest]
        deviation = here * MAX_DEVIATION
        if self.outgrowth is not None:
            off = self.outgrowth.distance(position, nearest)
            deviation = np.where(off < guess, DEVIATION, deviation)
            guess = np.minimum(off, guess)
        return NearestSkin(nearest, distance, self._weight(position, nearest), guess, deviation)

    def _weight(self, position: np.ndarray, nearest: np.ndarray) -> np.ndarray:
        """ω (p,) of the nearest vertex or, where it changes, of the `BLENDED` nearest: the farthest enters with weight 0."""
        weight: np.ndarray = self.weight[nearest]
        rows = np.flatnonzero(self.changing[nearest])
        if len(rows):
            count = min(BLENDED + 1, len(self.vertices))
            distance, around = closest_vertices(self.closest, position[rows], count)
            share = np.square(distance[:, -1:] ** 2 - distance**2) + np.finfo(float).tiny
            weight[rows] = (share * self.weight[around]).sum(1) / share.sum(1)
        return weight
