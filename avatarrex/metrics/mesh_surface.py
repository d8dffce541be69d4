"""A baseline's mesh as a surface that OpenGL draws: skin, expressions and a texture, no corrections and no light of its own.

The texture is the baseline's texels in an atlas: what they are at its places is what the mesh is drawn with in software.
Letters: v vertices. Metres.
"""

from __future__ import annotations

import numpy as np

from avatarrex.distil.atlas import make_atlas
from avatarrex.distil.texels import texels
from avatarrex.metrics.baselines import MeshDrawer, look_up
from avatarrex.surface.surface import INFLUENCES, Correction, Surface
from avatarrex.templates.person import Person

SIDE = 1024
"""Texels: 2 mm on the body, half of what the baselines' are apart."""


def mesh_surface(drawer: MeshDrawer, side: int = SIDE) -> Surface:
    """The mesh of `drawer` with a texture of `side`² texels."""
    person = drawer.mesh.person
    body, faces = person.body, drawer.mesh.faces.astype(np.int32)
    rest, weights, part = body.v_template.numpy(), body.weights.numpy(), parts_of(person)
    joint = np.argsort(-weights, 1, "stable")[:, :INFLUENCES]
    weight = np.take_along_axis(weights, joint, 1)
    atlas = make_atlas(rest, faces, part)
    places = texels(atlas.uv, atlas.uv_faces, side, side)
    colour = look_up(drawer.texels, places.face, places.barycentric.astype(np.float64))
    moved, directions = (value.numpy() for value in body.expressive)
    morph = np.ascontiguousarray(directions.transpose(2, 0, 1), np.float32)
    holder = np.zeros(len(rest), np.int32)
    holder[faces.ravel()] = np.repeat(np.arange(len(faces), dtype=np.int32), 3)
    return Surface(
        **vars(atlas),
        vertices=rest.astype(np.float32),
        faces=faces,
        joint=joint.astype(np.uint8),
        weight=(weight / weight.sum(1, keepdims=True)).astype(np.float32),
        template_face=holder,
        barycentric=(faces[holder] == np.arange(len(rest))[:, None]).astype(np.float32),
        part=part,
        albedo=places.image(np.rint(255 * np.clip(colour, 0, 1)).astype(np.uint8)),
        albedo_scale=1.0,
        lit=np.zeros(len(rest), np.float32),
        morph_vertex=moved.astype(np.int32),
        morph=morph,
        morph_colour=np.zeros_like(morph),
        correction=Correction.none(len(rest)),
    )


def parts_of(person: Person) -> np.ndarray:
    """(v,) 0 the body, 1.. the part that most of a vertex belongs to."""
    share = person.blend_weight.numpy()
    return np.where(share.max(1) > 0.5, share.argmax(1) + 1, 0).astype(np.uint8)
