"""Signed distance from points to a triangle mesh, with the closest face and barycentrics (paper sec. 3.2, eq. 8 and 9).

Letters: p points, v vertices, f faces. Metres; negative inside a closed, outward-wound mesh. The sign comes from the
angle-weighted pseudonormal of the closest *feature* (face, edge or vertex; Bærentzen & Aanæs 2005), which is exact,
where the paper's interpolated vertex normal fails at sharp edges.

The search runs without gradient; the distance is then recomputed in torch from (face, barycentric), so its first
derivatives by points and vertices are exact.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.ops.closest_triangle import closest_triangle, signed_closest
from avatarrex.ops.pseudonormal import Pseudonormals, pseudonormals, winding_number
from avatarrex.ops.search_tree import SearchTree
from avatarrex.ops.triangle import closest_on_triangle

Impl = Literal["auto", "tree", "reference", "igl"]


@dataclass(frozen=True)
class ClosestPoint:
    """The nearest surface point of each query."""

    sdf: Float[Tensor, " p"]
    """Metres, negative inside; saturated at `bound` where one was given."""
    face: Int[Tensor, " p"]
    barycentric: Float[Tensor, "p 3"]
    """Of the closest point on `face`. Far beyond `bound`: of some point of the surface, not the closest."""


def available() -> tuple[Impl, ...]:
    """The implementations that this machine can run."""
    return ("tree", "reference", "igl") if importlib.util.find_spec("igl") else ("tree", "reference")


def closest_point(
    vertices: Float[Tensor, "v 3"],
    faces: Int[Tensor, "f 3"],
    points: Float[Tensor, "p 3"],
    bound: tuple[float, float] | None = None,
    impl: Impl = "auto",
    normals: Pseudonormals | None = None,
    tree: SearchTree | None = None,
) -> ClosestPoint:
    """Exact signed distance of `points` to the mesh, on a CPU; differentiable in points and vertices.

    `normals` (float64) and `tree` are the mesh's own, where they are known: several searches in one mesh share them.

    With `bound` = (low, high), low < 0 < high, values beyond it saturate, and their search may be skipped.
    `tree`, which `auto` takes, walks a tree of triangles in compiled loops. `reference` is brute force in float64. `igl` calls
    libigl. All find the same.
    """
    if not len(faces):
        raise InputError("closest_point", "faces", "at least one triangle", 0)
    differentiable = torch.is_grad_enabled() and (vertices.requires_grad or points.requires_grad)
    with torch.no_grad():
        mesh, query = vertices.detach().double(), points.detach().double()
        if not (torch.isfinite(mesh).all() and torch.isfinite(query).all()):
            raise InputError("closest_point", "vertices, points", "finite numbers", "NaN or Inf")
        normals = pseudonormals(mesh, faces) if normals is None else normals
        if impl in ("auto", "tree"):
            tree = SearchTree.of_triangles(mesh.numpy(), faces.numpy()) if tree is None else tree
            if not differentiable:
                return _compiled(mesh, faces, points, bound, normals, tree)
            face, barycentric = map(torch.from_numpy, closest_triangle(tree, query.numpy()))
        elif impl == "igl":
            face, barycentric = _search_igl(mesh, faces, query)
        else:
            face, barycentric = _search_reference(mesh, faces, query)
    found = signed(vertices, faces, points, face, barycentric, normals)
    return found if bound is None else replace(found, sdf=found.sdf.clamp(*bound))


def _compiled(
    mesh: Tensor,
    faces: Tensor,
    points: Tensor,
    bound: tuple[float, float] | None,
    normals: Pseudonormals,
    tree: SearchTree,
) -> ClosestPoint:
    """What the search of a tree and `signed` find, from compiled loops: without gradient."""
    query = points.detach().double()
    found = signed_closest(tree, query.numpy(), faces.numpy(), normals, bound)
    sdf, face, barycentric, unsure = map(torch.from_numpy, found)
    if unsure.any():
        inside = winding_number(mesh, faces[normals.kept], query[unsure]) > 0.5
        sdf[unsure] = torch.where(inside, -1.0, 1.0).to(sdf) * sdf[unsure].abs()
    sdf = sdf.to(points.dtype)
    return ClosestPoint(sdf if bound is None else sdf.clamp(*bound), face, barycentric.to(points.dtype))


def signed(
    vertices: Float[Tensor, "v 3"],
    faces: Int[Tensor, "f 3"],
    points: Float[Tensor, "p 3"],
    face: Int[Tensor, " p"],
    barycentric: Float[Tensor, "p 3"],
    normals: Pseudonormals,
) -> ClosestPoint:
    """Distance and sign of `points` whose closest face and barycentrics (float64) are known; differentiable."""
    with torch.no_grad():
        mesh, query = vertices.detach().double(), points.detach().double()
        nearest = (mesh[faces[face]] * barycentric[..., None]).sum(1)
        outward = normals.at(faces, face, barycentric)
        sign = torch.where(((query - nearest) * outward).sum(-1) >= 0, 1.0, -1.0)
        unsure = normals.unsure(faces, face, barycentric)
        if unsure.any():
            inside = winding_number(mesh, faces[normals.kept], query[unsure]) > 0.5
            sign[unsure] = torch.where(inside, -1.0, 1.0).to(sign.dtype)
    sdf = _signed_distance(vertices, faces, points, face, barycentric, sign, outward)
    return ClosestPoint(sdf, face, barycentric.to(points.dtype))


def _signed_distance(
    vertices: Tensor, faces: Tensor, points: Tensor, face: Tensor, barycentric: Tensor, sign: Tensor, outward: Tensor
) -> Tensor:
    """± the distance to (face, barycentric), differentiable; on the surface it has the pseudonormal's slope."""
    dtype = points.dtype
    nearest = (vertices[faces[face]] * barycentric.to(dtype)[..., None]).sum(1)
    offset = points - nearest
    square = (offset * offset).sum(-1)
    on_surface = square <= 1e-30
    distance = torch.where(on_surface, 1.0, square).sqrt()
    along = (offset * outward.to(dtype)).sum(-1)
    return torch.where(on_surface, along, sign.to(dtype) * distance)


def _search_reference(mesh: Tensor, faces: Tensor, query: Tensor) -> tuple[Tensor, Tensor]:
    """Every point against every triangle, float64."""
    corner = mesh[faces].unbind(1)
    face = torch.zeros(len(query), dtype=torch.long)
    barycentric = torch.zeros_like(query)
    step = max(1, 2_000_000 // len(faces))
    for start in range(0, len(query), step):
        rows = slice(start, start + step)
        square, weight = closest_on_triangle(query[rows, None], *corner)
        face[rows] = square.argmin(1)
        barycentric[rows] = weight[torch.arange(len(square)), face[rows]]
    return face, barycentric


def _search_igl(mesh: Tensor, faces: Tensor, query: Tensor) -> tuple[Tensor, Tensor]:
    """libigl's AABB tree (CPU, float64) for the closest face; optional extra `sdf`."""
    import igl

    _, face, _ = igl.point_mesh_squared_distance(query.cpu().numpy(), mesh.cpu().numpy(), faces.cpu().numpy())
    face = torch.as_tensor(face, dtype=torch.long)
    _, barycentric = closest_on_triangle(query, *mesh[faces[face]].unbind(1))
    return face, barycentric
