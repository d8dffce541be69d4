"""The colours of a surface as one ordinary picture: albedo times the light that falls on it.

    texture(u) = clip((albedo(u) · s + tint(u)) · (1 + l(u) (E(n(u)) − 1)))

s is the albedo's scale, tint what pose and expression add (none at rest), l the share of the light that follows the normal
(`Surface.lit`), E the avatar's light. E is evaluated at the vertices, where normals are, and interpolated in each triangle of the
atlas; a texel outside every triangle takes the light of the nearest one inside, so that filtering across a seam finds no edge.

Letters: v vertices, t texture vertices, f faces, h w texels, p texels in a triangle.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, UInt8
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from avatarrex.fields.light import Light
from avatarrex.surface.surface import Surface

BATCH = 2_000_000
"""Texels of triangles' boxes in memory at a time."""


def light_on(surface: Surface, normals: Float[Tensor, "v 3"], light: Light) -> Float[np.ndarray, "v 3"]:
    """What the albedo is multiplied by at each vertex, under unit normals in the root frame."""
    with torch.no_grad():
        share = torch.from_numpy(surface.lit)[:, None]
        return np.asarray((1 + share * (light(normals.float()) - 1)).numpy())


def baked_texture(
    surface: Surface, factor: Float[np.ndarray, "v 3"], tint: Float[np.ndarray, "v 3"] | None = None
) -> UInt8[np.ndarray, "h w 3"]:
    """The texture under a light, `factor` (`light_on`)."""
    height, width = surface.albedo.shape[:2]
    colour = surface.albedo * surface.albedo_scale
    if tint is not None:
        colour = colour + 255 * spread(surface, tint, height, width)
    colour = colour * spread(surface, factor, height, width)
    return np.asarray(np.rint(np.clip(colour, 0, 255)), np.uint8)


def vertex_colours(
    surface: Surface, factor: Float[np.ndarray, "v 3"], tint: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, "v 3"]:
    """Colours in [0, 1] of the vertices: the equation of the module, without a texture of its own."""
    height, width = surface.albedo.shape[:2]
    place = np.zeros((len(surface.vertices), 2), np.int64)
    texel = np.clip((surface.uv * [width, height]).astype(np.int64), 0, [width - 1, height - 1])
    place[surface.uv_vertex] = texel
    albedo = surface.albedo[place[:, 1], place[:, 0]] * (surface.albedo_scale / 255)
    return np.asarray(np.clip((albedo + tint) * factor, 0, 1))


def spread(surface: Surface, values: np.ndarray, height: int, width: int) -> np.ndarray:
    """Values (v, c) of vertices as a picture (h, w, c) in the surface's atlas."""
    face, corner = texel_faces(surface.uv, surface.uv_faces, height, width)
    inside = face >= 0
    picture = np.zeros((height, width, values.shape[1]))
    picture[inside] = (corner[inside][..., None] * values[surface.faces[face[inside]]]).sum(1)
    if not inside.all():
        nearest = distance_transform_edt(~inside, return_distances=False, return_indices=True)
        picture = picture[tuple(nearest)]
    return picture


def texel_faces(uv: np.ndarray, uv_faces: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """The triangle (h, w) of the atlas at each texel's centre, −1 where there is none, and barycentrics (h, w, 3)."""
    corners = (uv.astype(np.float64) * [width, height])[uv_faces]
    low = np.clip(np.ceil(corners.min(1) - 0.5), 0, None).astype(np.int64)
    high = np.minimum(np.floor(corners.max(1) - 0.5), [width - 1, height - 1]).astype(np.int64)
    extent = np.maximum(high - low + 1, 0)
    face = np.full(height * width, -1)
    bary = np.zeros((height * width, 3))
    kept = np.flatnonzero(extent.prod(1))
    cuts = np.flatnonzero(np.diff(np.cumsum(extent[kept].prod(1)) // BATCH)) + 1
    for ids in np.split(kept, cuts):
        owner, texel, weight = _texels(corners[ids], low[ids], extent[ids])
        place = texel[:, 1] * width + texel[:, 0]
        face[place], bary[place] = ids[owner], weight
    return face.reshape(height, width), bary.reshape(height, width, 3)


def _texels(corners: np.ndarray, low: np.ndarray, extent: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangle (p,), texel x y (p, 2) and barycentrics (p, 3) of the texels whose centres are in triangles (f, 3, 2)."""
    count = extent.prod(1)
    owner = np.repeat(np.arange(len(low)), count)
    offset = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    texel = low[owner] + np.stack([offset % extent[owner, 0], offset // extent[owner, 0]], 1)
    a, b, c = corners[owner].transpose(1, 0, 2)
    point = texel + 0.5
    area = _cross(b - a, c - a)
    flat = np.abs(area) < 1e-12
    area = np.where(flat, 1, area)
    v, w = _cross(point - a, c - a) / area, _cross(b - a, point - a) / area
    weight = np.stack([1 - v - w, v, w], 1)
    inside = (weight >= -1e-9).all(1) & ~flat
    return owner[inside], texel[inside], weight[inside]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
