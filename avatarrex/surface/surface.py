"""The surface of an avatar: a textured mesh distilled from its exact field, skinned forward, corrected by the pose.

    p̄' = p̄ + shape·β + morph·ψ + Δp(θ, φ)      p = Σ_k w_k A_{j_k} p̄'        colour = (albedo(uv) + Δc(θ, ψ)) · E(n)

A_j are the body template's skinning matrices (all 55 joints turn here: body, jaw, eyes, fingers), E the avatar's light
(fields/light.py) of the posed normal n, that of body and hands as far as `lit` says, else the face's. Hands and face have the
template's own vertices.

Letters: v vertices, t texture vertices, f faces, k joints of a vertex, m vertices moved by expressions, e expressions,
g groups, q joints of a group, n fitted poses, r rank. Metres at rest (T-pose, neutral, flat hands), root frame; colours sRGB-encoded.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float32, Int32, UInt8

INFLUENCES = 8
"""Joints that carry a vertex at most."""


@dataclass(frozen=True, eq=False)
class Correction:
    """How rest positions and colours change with the pose: by how like it is to each of the poses that were fitted (pose_kernel.py).

        [Δp, Δc](v) = basis(v)ᵀ · clip(Σ_n weights_gn k_g(R, R_n), low_g, high_g),   g = group(v)

    R are the rotations of the driving signal (about each joint's rest axes). A joint of −1 is none. The clip keeps a pose far from
    all that were fitted near them.
    """

    group: UInt8[np.ndarray, " v"]
    poses: Float32[np.ndarray, "n 55 3"]
    """Axis–angle vectors of the poses that were fitted."""
    joints: Int32[np.ndarray, "g q"]
    closeness: Float32[np.ndarray, "g q"]
    """c of those joints."""
    weights: Float32[np.ndarray, "g n r"]
    low: Float32[np.ndarray, "g r"]
    high: Float32[np.ndarray, "g r"]
    basis: Float32[np.ndarray, "v r 6"]
    """Metres at rest, then sRGB."""

    @classmethod
    def none(cls, vertices: int) -> Correction:
        """Of rank 0: a mesh of so many vertices that skinning alone moves."""
        return cls(
            group=np.zeros(vertices, np.uint8),
            poses=np.zeros((1, 55, 3), np.float32),
            joints=np.full((1, 1), -1, np.int32),
            closeness=np.zeros((1, 1), np.float32),
            weights=np.zeros((1, 1, 0), np.float32),
            low=np.zeros((1, 0), np.float32),
            high=np.zeros((1, 0), np.float32),
            basis=np.zeros((vertices, 0, 6), np.float32),
        )


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh that any pose, expression and shape can be applied to (`pose_surface`)."""

    vertices: Float32[np.ndarray, "v 3"]
    faces: Int32[np.ndarray, "f 3"]
    """Counter-clockwise seen from outside."""
    joint: UInt8[np.ndarray, "v k"]
    """The joints that carry each vertex, SMPL-X order, the strongest first; unused ones have weight 0."""
    weight: Float32[np.ndarray, "v k"]
    """Sum 1."""
    template_face: Int32[np.ndarray, " v"]
    """The body template's triangle nearest to each vertex: how the vertex follows the shape β."""
    barycentric: Float32[np.ndarray, "v 3"]
    """In that triangle."""
    part: UInt8[np.ndarray, " v"]
    """0 the body, 1.. the parts in the order of `PARTS`."""
    uv: Float32[np.ndarray, "t 2"]
    """Texture coordinates in [0, 1]; (0, 0) is the top left corner of the first texel."""
    uv_vertex: Int32[np.ndarray, " t"]
    """The vertex of each texture vertex."""
    uv_faces: Int32[np.ndarray, "f 3"]
    """Texture vertices of each face: `faces` is `uv_vertex[uv_faces]`."""
    albedo: UInt8[np.ndarray, "h w 3"]
    """Colour with the light divided out; 255 is `albedo_scale`."""
    albedo_scale: float
    lit: Float32[np.ndarray, " v"]
    """Share of the light on body and hands: 1 there, 0 on the face, which has a light of its own."""
    morph_vertex: Int32[np.ndarray, " m"]
    morph: Float32[np.ndarray, "e m 3"]
    """Displacement of `morph_vertex` by each of the 52 expressions at 1, metres at rest."""
    morph_colour: Float32[np.ndarray, "e m 3"]
    """Change of colour likewise."""
    correction: Correction
    key: str = ""
    """Of the weights that it was distilled from (`weights_key`)."""
    meta: dict[str, Any] = field(default_factory=dict)
    """Errors against the exact frame, times, counts: what `distil` prints."""

    @cached_property
    def colour_texture(self) -> UInt8[np.ndarray, "h w 3"]:
        """The albedo as an image in which 255 is 1: what a viewer without the avatar's light shows, before `lit`."""
        return np.clip(np.rint(self.albedo * self.albedo_scale), 0, 255).astype(np.uint8)
