"""The template itself as a surface: a stand-in for a distilled one, made in a second, with every field in use."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from avatarrex.surface.surface import INFLUENCES, Correction, Surface
from avatarrex.templates.parts import PARTS
from avatarrex.templates.person import Person, load_person


@lru_cache
def template_surface(amplitude: float = 0.0, texture: int = 64) -> Surface:
    """The default person's template. `amplitude`: metres of a correction that every joint's turn causes; 0: none."""
    person = load_person()
    body = person.body
    order = np.argsort(-body.weights.numpy(), 1, "stable")[:, :INFLUENCES]
    weight = np.take_along_axis(body.weights.numpy(), order, 1)
    v, faces = len(body.v_template), body.faces.numpy().astype(np.int32)
    holder = np.zeros(v, np.int32)
    holder[faces.ravel()] = np.repeat(np.arange(len(faces)), 3)
    corner = (faces[holder] == np.arange(v)[:, None]).astype(np.float32)
    position = body.v_template.numpy()
    span = position.max(0) - position.min(0)
    uv = ((position - position.min(0)) / span)[:, :2]
    morphed, directions = (value.numpy() for value in body.expressive)
    shade = np.linspace(60, 200, texture).astype(np.uint8)
    return Surface(
        vertices=position.astype(np.float32),
        faces=faces,
        joint=order.astype(np.uint8),
        weight=(weight / weight.sum(1, keepdims=True)).astype(np.float32),
        template_face=holder,
        barycentric=corner,
        part=_parts(person),
        uv=np.stack([uv[:, 0], 1 - uv[:, 1]], 1).astype(np.float32),
        uv_vertex=np.arange(v, dtype=np.int32),
        uv_faces=faces,
        albedo=np.repeat(np.stack(np.broadcast_arrays(shade[:, None], shade[None]), -1), 2, -1)[..., :3].copy(),
        albedo_scale=1.0,
        lit=1 - person.blend_weight[:, PARTS.index("face")].numpy(),
        morph_vertex=morphed.astype(np.int32),
        morph=np.ascontiguousarray(directions.transpose(2, 0, 1), np.float32),
        morph_colour=np.full((directions.shape[2], len(morphed), 3), 0.02, np.float32),
        correction=_correction(order[:, 0], amplitude),
    )


def _parts(person: Person) -> np.ndarray:
    strongest = person.blend_weight.argmax(1).numpy() + 1
    return np.where(person.blend_weight.amax(1).numpy() > 0.5, strongest, 0).astype(np.uint8)


def _correction(group: np.ndarray, amplitude: float) -> Correction:
    """Groups by the strongest joint; its own turn moves the vertex."""
    groups, rank, n, v = 55, 4, 3, len(group)
    joints = np.stack([np.arange(groups), np.full(groups, -1)], 1).astype(np.int32)
    rng = np.random.default_rng(0)
    return Correction(
        group=group.astype(np.uint8),
        poses=rng.normal(0, 0.5, (n, 55, 3)).astype(np.float32),
        joints=joints,
        closeness=np.full(joints.shape, 0.5, np.float32),
        weights=rng.normal(size=(groups, n, rank)).astype(np.float32),
        low=np.full((groups, rank), -1, np.float32),
        high=np.full((groups, rank), 1, np.float32),
        basis=(amplitude * rng.normal(size=(v, rank, 6))).astype(np.float32),
    )
