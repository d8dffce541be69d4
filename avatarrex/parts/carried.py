"""A face outside of what it was trained on: the template carries what was learnt of the nearest expression that was. Ours.

The networks are evaluated at the nearest known expression ψ' (`known_expressions.py`). A point p of the face ψ has its place
there at q = p − u, where u is the way of the closest point of the mesh from ψ' to ψ. A mouth that opens has air where q lies in
flesh: the learnt surface lies off the mesh by s_F(q; ψ') − d(q; ψ'), with d the signed distance to the mesh, and that is carried:

    s(p; ψ) = d(p; ψ) + s_F(q; ψ') − d(q; ψ')

and, where the mesh has parted, no less than d(p; ψ) − `OFF`: a mouth that was only seen closed may have been learnt as a solid
block. Mouths open, lids close and eyes turn as the template's do. Where the mesh does not move, s = s_F. The sign of d is the winding
number's: what the closest triangle says is wrong where closed pieces overlap, between a lid and the eyeball in its socket.
Head frame, metres. Letters: v vertices, f faces, p points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.ops.closest_triangle import closest_triangle
from avatarrex.ops.crossings import winding
from avatarrex.ops.outer_triangle import outer_triangle
from avatarrex.ops.search_tree import SearchTree
from avatarrex.templates.mesh import pieces

REACH = (0.003, 0.004)
"""Metres before and behind a point of the surface in which the mesh's outer sheet is searched. A closed lid is 2.5 mm off the eyeball, and
the learnt surface up to 1.5 mm beneath it."""
OFF = 0.004
"""Metres off the mesh at which there is no more flesh where lips have parted."""
MOVED = 1e-4
"""Metres: what moves less between both expressions stays."""


@dataclass(frozen=True, eq=False)
class PosedMesh:
    """A mesh that is searched several times."""

    vertices: Float[Tensor, "v 3"]
    """float64."""
    faces: Int[Tensor, "f 3"]
    closed: Bool[Tensor, " f"]
    """Triangles of pieces that enclose something, the neck's end aside; of teeth there are strips."""

    @cached_property
    def tree(self) -> SearchTree:
        """Of all triangles."""
        return SearchTree.of_triangles(self.vertices.numpy(), self.faces.numpy())

    @cached_property
    def _closed_tree(self) -> SearchTree:
        return SearchTree.of_triangles(self.vertices.numpy(), self.faces[self.closed].numpy())

    def closest(self, points: Float[Tensor, "p 3"]) -> tuple[Int[Tensor, " p"], Float[Tensor, "p 3"]]:
        """Closest face and barycentrics."""
        face, weight = closest_triangle(self.tree, points.numpy())
        return torch.from_numpy(face), torch.from_numpy(weight)

    def distance(
        self, points: Float[Tensor, "p 3"], face: Int[Tensor, " p"], weight: Float[Tensor, "p 3"]
    ) -> Float[Tensor, " p"]:
        """Signed distance of points with their `closest`."""
        place = (weight[..., None] * self.vertices[self.faces[face]]).sum(1)
        inside = torch.from_numpy(winding(self._closed_tree, points.numpy()) > 0)
        distance: Tensor = (points - place).norm(dim=-1)
        return torch.where(inside, -distance, distance)


@dataclass(frozen=True, eq=False)
class Way:
    """Points' places in the known face, and how its distances become those here."""

    place: Float[Tensor, "p 3"]
    """q."""
    lift: Float[Tensor, " p"]
    """d(p; ψ) − d(q; ψ')."""
    least: Float[Tensor, " p"]
    """d(p; ψ) − `OFF` where something moved away; −∞ elsewhere."""

    def distance(self, known: Float[Tensor, " p"]) -> Float[Tensor, " p"]:
        """s(p; ψ) of the known face's s_F(q; ψ')."""
        return torch.maximum(known + self.lift, self.least)


@dataclass(frozen=True, eq=False)
class Seen:
    """Triangles that are seen at points of the surface."""

    place: Float[Tensor, "p 3"]
    """q."""
    face: Int[Tensor, " p"]
    weight: Float[Tensor, "p 3"]
    """Barycentrics."""


@dataclass(frozen=True, eq=False)
class Carried:
    """The meshes of an expression and of the nearest known one."""

    now: PosedMesh
    known: PosedMesh
    reach: float = 0.01
    """Metres around what moves in which points are carried: farther off no surface depends on them."""

    @cached_property
    def way(self) -> Float[Tensor, "v 3"]:
        """u of each vertex."""
        return self.now.vertices - self.known.vertices

    @cached_property
    def _boxes(self) -> tuple[tuple[Tensor, Tensor], ...]:
        """Corners of the boxes around the pieces that move, wherever they are."""
        moved = (self.way.norm(dim=-1) > MOVED)[self.now.faces].any(1)
        piece = pieces(self.now.faces[moved], len(self.way))
        boxes = []
        for label in piece.unique():
            rows = self.now.faces[moved][piece == label].flatten()
            places = torch.cat([self.now.vertices[rows], self.known.vertices[rows]])
            boxes.append((places.amin(0) - self.reach, places.amax(0) + self.reach))
        return tuple(boxes)

    def _near(self, points: Float[Tensor, "p 3"]) -> Int[Tensor, " r"]:
        """Rows of the points in reach of what moves."""
        near = torch.zeros(len(points), dtype=torch.bool)
        for low, high in self._boxes:
            near |= ((points > low) & (points < high)).all(-1)
        return torch.nonzero(near)[:, 0]

    @torch.no_grad()
    def seen(self, position: Float[Tensor, "p 3"], normal: Float[Tensor, "p 3"]) -> Seen:
        """What is seen at points of the surface with its unit normals: the outermost triangle about each.

        The closest one of a closed lid is often the eyeball's.
        """
        points, normals = (found.detach().double().cpu().numpy() for found in (position, normal))
        face, weight = map(torch.from_numpy, outer_triangle(self.now.tree, points, normals, REACH))
        return Seen(position - self._way_at(face, weight).to(position), face, weight)

    def _way_at(self, face: Int[Tensor, " p"], weight: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        return (weight[..., None] * self.way[self.now.faces[face]]).sum(1)

    @torch.no_grad()
    def back(self, position: Float[Tensor, "p 3"]) -> Way:
        """From `position` to the known face; of the points' type."""
        points = position.detach().double().cpu()
        place, lift, least = points.clone(), points.new_zeros(len(points)), points.new_full((len(points),), -torch.inf)
        rows = self._near(points)
        if len(rows):
            face, weight = self.now.closest(points[rows])
            place[rows] = points[rows] - self._way_at(face, weight)
            here = self.now.distance(points[rows], face, weight)
            known = self.known.distance(place[rows], *self.known.closest(place[rows]))
            lift[rows] = here - known
            least[rows] = torch.where(here - known > MOVED, here - OFF, -torch.inf)
        return Way(place.to(position), lift.to(position), least.to(position))
