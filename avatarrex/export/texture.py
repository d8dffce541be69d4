"""The colours of a surface as one ordinary picture: albedo times the light that falls on it.

    texture(u) = clip((albedo(u) · s + tint(u)) · (1 + l(u) (E(n(u)) − 1)))

s is the albedo's scale, tint what pose and expression add (none at rest), l the share of the light that follows the normal
(`Surface.lit`), E the avatar's light. E is evaluated at the vertices, where normals are, and interpolated in each triangle of the
atlas; a texel outside every triangle takes the light of the nearest one inside.

Letters: v vertices, h w texels.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from avatarrex.distil.texels import Texels, texels
from avatarrex.fields.light import Irradiance
from avatarrex.surface.surface import Surface


def light_on(surface: Surface, normals: Float[Tensor, "v 3"], light: Irradiance) -> Float[np.ndarray, "v 3"]:
    """What the albedo is multiplied by at each vertex, under unit normals in the root frame."""
    with torch.no_grad():
        return np.asarray(light.mixed(normals.float(), torch.from_numpy(surface.lit)).numpy())


def baked_texture(
    surface: Surface, factor: Float[np.ndarray, "v 3"], tint: Float[np.ndarray, "v 3"] | None = None
) -> UInt8[np.ndarray, "h w 3"]:
    """The texture under a light, `factor` (`light_on`)."""
    places = texels(surface.uv, surface.uv_faces, *surface.albedo.shape[:2])
    colour = surface.albedo * surface.albedo_scale
    if tint is not None:
        colour = colour + 255 * spread(places, surface, tint)
    colour = colour * spread(places, surface, factor)
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


def spread(places: Texels, surface: Surface, values: Float[np.ndarray, "v c"]) -> Float[np.ndarray, "h w c"]:
    """Values of vertices as a picture in the surface's atlas."""
    return places.image(places.interpolated(surface.faces, values))
