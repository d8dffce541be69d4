"""Hand field: the exact signed distance to the posed hand mesh, and a colour MLP on it (paper sec. 3.2, eq. 8 to 10).

Everything lives in the wrist frame, metres, and depends on φ (and shape) alone. Letters: p points, v vertices, f faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn.functional import normalize

from avatarrex.fields.composition import BAND
from avatarrex.fields.presets import COORDINATE_OCTAVES, Preset
from avatarrex.ops.closest_point import ClosestPoint, Impl, closest_point
from avatarrex.ops.closest_tree import TriangleTree
from avatarrex.ops.encoding import encode
from avatarrex.ops.pseudonormal import Pseudonormals, pseudonormals
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.templates.hand import HandTemplate
from avatarrex.templates.mesh import vertex_normals

SCALE = 0.12
"""Metres: a hand with its stub spans less than ±2 of this, where γ clamps; its shortest wavelength is 2.4 cm."""


@dataclass(frozen=True)
class HandQuery:
    """What the hand mesh says about points."""

    sdf: Float[Tensor, " p"]
    """Metres; saturated beyond the bound it was asked with."""
    face: Int[Tensor, " p"]
    barycentric: Float[Tensor, "p 3"]
    normal: Float[Tensor, "p 3"]
    """Interpolated posed vertex normal, unit: an input of the colour, not the source of the sign."""


@dataclass(frozen=True)
class HandSurface:
    """A posed hand, prepared for many look-ups."""

    vertices: Float[Tensor, "v 3"]
    normals: Float[Tensor, "v 3"]
    pseudonormals: Pseudonormals
    tree: TriangleTree | None
    """On a CPU."""


class HandField(nn.Module):
    """One hand. Only the colour MLP has parameters."""

    def __init__(self, template: HandTemplate, preset: Preset) -> None:
        super().__init__()
        self.side = template.side
        self.faces: Tensor
        self.blend_weight: Tensor
        self.canonical: Tensor
        self.register_buffer("faces", template.model.faces.clone(), persistent=False)
        self.register_buffer("blend_weight", template.blend_weight.float().clone(), persistent=False)
        self.register_buffer("canonical", template.model.v_template.float() / SCALE, persistent=False)
        first, *rest = preset.hand.hidden
        self.of_point = nn.Linear(3 * (1 + 2 * COORDINATE_OCTAVES) + 3 + 1, first)
        self.of_pose = nn.Linear(135, first, bias=False)
        layers: list[nn.Module] = []
        for a, b in zip((first, *rest), (*rest, 3)):
            layers += [nn.ReLU(), nn.Linear(a, b)]
        self.head = nn.Sequential(*layers)

    def sdf(
        self,
        vertices: Float[Tensor, "v 3"],
        position: Float[Tensor, "p 3"],
        bound: tuple[float, float] | None = BAND,
        impl: Impl = "auto",
        surface: HandSurface | None = None,
    ) -> HandQuery:
        """s_H of `position` for a posed mesh `vertices`; beyond `bound` (the composition's band) it saturates.

        `surface` is that mesh, where it has been prepared.
        """
        if surface is None:
            normals = vertex_normals(vertices, self.faces)
            return self._query(closest_point(vertices, self.faces, position, bound, impl), normals)
        known = surface.pseudonormals, surface.tree
        return self._query(closest_point(vertices, self.faces, position, bound, impl, *known), surface.normals)

    def beside(self, surface: HandSurface, position: Float[Tensor, "p 3"]) -> HandQuery:
        """The same without bound, of a mesh that has been prepared."""
        return self.sdf(surface.vertices, position, None, surface=surface)

    def surface(self, vertices: Float[Tensor, "v 3"]) -> HandSurface:
        """A posed mesh, prepared; no gradient flows into it."""
        mesh = vertices.detach()
        tree = TriangleTree.of(mesh, self.faces) if mesh.device.type == "cpu" else None
        return HandSurface(mesh, vertex_normals(mesh, self.faces), pseudonormals(mesh.double(), self.faces), tree)

    def _query(self, found: ClosestPoint, normals: Float[Tensor, "v 3"]) -> HandQuery:
        normal = normalize((normals[self.faces[found.face]] * found.barycentric[..., None]).sum(1), dim=-1)
        return HandQuery(found.sdf, found.face, found.barycentric, normal)

    def omega(self, query: HandQuery) -> Float[Tensor, " p"]:
        """Painted blend weight ω of the closest surface point."""
        return (self.blend_weight[self.faces[query.face]] * query.barycentric).sum(-1)

    def colour(
        self, vertices: Float[Tensor, "v 3"], hand_pose: Float[Tensor, "15 3"], query: HandQuery | Float[Tensor, "p 3"]
    ) -> Float[Tensor, "p 3"]:
        """C_H, sRGB in [0, 1], of points or of a query already made; φ as rotvecs, radians."""
        if not isinstance(query, HandQuery):
            query = self.sdf(vertices, query)
        canonical = (self.canonical[self.faces[query.face]] * query.barycentric[..., None]).sum(1)
        depth = query.sdf[:, None] / BAND[1]
        point = torch.cat([encode(canonical, COORDINATE_OCTAVES), query.normal, depth], -1)
        turned = matrix_from_rotvec(hand_pose) - torch.eye(3, dtype=hand_pose.dtype, device=hand_pose.device)
        return torch.sigmoid(self.head(self.of_point(point) + self.of_pose(turned.reshape(135))))
