"""Hand field: the exact signed distance to the posed hand mesh, and a colour MLP on it (paper sec. 3.2, eq. 8 to 10).

Where fingers pass into each other or the palm, the closest feature may be skin within another finger's flesh, and its outer
side is not outside: there the winding number says what is (a fist had holes along its contacts).

Everything lives in the wrist frame, metres, and depends on φ (and shape) alone. Letters: p points, v vertices, f faces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import normalize

from avatarrex.fields.composition import BAND
from avatarrex.fields.local_networks import mlp
from avatarrex.fields.presets import COORDINATE_OCTAVES, Preset
from avatarrex.ops.closest_point import Impl, closest_point
from avatarrex.ops.crossings import winding
from avatarrex.ops.encoding import encode
from avatarrex.ops.pseudonormal import Pseudonormals, pseudonormals, winding_number
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.search_tree import SearchTree
from avatarrex.templates.hand import HandTemplate
from avatarrex.templates.mesh import vertex_normals

SCALE = 0.12
"""Metres: a hand with its stub spans less than ±2 of this, where γ clamps; its shortest wavelength is 2.4 cm."""
TEST_HEIGHT = 1e-4
"""Metres over the skin at which a test decides whether it is buried."""
TEST_SPACING = 0.006
"""Metres between tested places on a face, half of that on most: less than half a finger tip."""
MOST_STEPS = 8
"""Such places along the side of a face, at most."""
TESTS = 8
"""Of a face, about: as many points are tested one by one sooner."""


@dataclass(frozen=True)
class HandQuery:
    """What the hand mesh says about points."""

    sdf: Float[Tensor, " p"]
    """Metres; saturated beyond the bound of the query."""
    face: Int[Tensor, " p"]
    barycentric: Float[Tensor, "p 3"]
    normal: Float[Tensor, "p 3"]
    """Interpolated posed vertex normal, unit: an input of the colour, not the source of the sign."""

    def facing(self, gaze: Float[Tensor, "p 3"]) -> HandQuery:
        """As seen along unit `gaze` (from the eye): a normal that turns away from the eye is mirrored towards it.

        What is seen faces the eye; but where a finger dips into the palm, the skin that is closest may be buried, and bright
        with the light of a side that is out of sight.
        """
        away = (self.normal * gaze).sum(-1, keepdim=True).clamp_min(0)
        return replace(self, normal=self.normal - 2 * away * gaze)


@dataclass(frozen=True)
class HandSurface:
    """A posed hand, prepared for many look-ups."""

    vertices: Float[Tensor, "v 3"]
    faces: Int[Tensor, "f 3"]
    normals: Float[Tensor, "v 3"]
    pseudonormals: Pseudonormals
    tree: SearchTree | None
    """On a CPU; the reference has none, and the winding number decides every sign."""

    @classmethod
    def of(cls, vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"], impl: Impl = "auto") -> HandSurface:
        """No gradient flows into it. `reference`: no tree."""
        mesh = vertices.detach()
        compiled = mesh.device.type == "cpu" and impl != "reference"
        tree = SearchTree.of_triangles(mesh.numpy(), faces.numpy()) if compiled else None
        return cls(mesh, faces, vertex_normals(mesh, faces), pseudonormals(mesh.double(), faces), tree)

    @cached_property
    def buried(self) -> Bool[Tensor, " f"]:
        """Faces that lie, in part, in another finger's flesh or the palm's, or are turned inside out, and those around a corner
        that does."""
        faces, exact, outward = self.faces, self.vertices.double(), self.pseudonormals
        corner = self.wrapped(exact + TEST_HEIGHT * normalize(outward.vertex, dim=-1))
        corner[faces[corner[faces].any(-1)]] = True
        return corner[faces].any(-1) | self._pierced(exact[faces], normalize(outward.face, dim=-1))

    def doubtful(self, face: Int[Tensor, " p"]) -> Int[Tensor, " k"]:
        """Which of the points closest to these faces the pseudonormal does not place: those of buried faces; all, where they
        are fewer than the tests that find those."""
        if self.tree is None or ("buried" not in self.__dict__ and len(face) < TESTS * len(self.faces)):
            return torch.arange(len(face), device=face.device)
        return torch.nonzero(self.buried[face])[:, 0]

    def _pierced(self, corners: Float[Tensor, "f 3 3"], normal: Float[Tensor, "f 3"]) -> Bool[Tensor, " f"]:
        """Faces that other flesh contains between their corners: just outside of one there is flesh, or just inside none."""
        side = (corners - corners.roll(1, 1)).norm(dim=-1).amax(1)
        steps = (side / TEST_SPACING).ceil().long().clamp(2, MOST_STEPS)
        found = torch.zeros(len(corners), dtype=torch.bool, device=corners.device)
        for count in steps.unique().tolist():
            rows = torch.nonzero(steps == count)[:, 0]
            place = _between(count).to(corners) @ corners[rows]
            lift = TEST_HEIGHT * normal[rows, None]
            outside, inside = (self.wrapped((place + way).reshape(-1, 3)) for way in (lift, -lift))
            found[rows] = (outside | ~inside).view(len(rows), -1).any(1)
        return found

    def wrapped(self, position: Float[Tensor, "p 3"]) -> Bool[Tensor, " p"]:
        """Whether the mesh winds about points."""
        if self.tree is not None:
            return torch.from_numpy(winding(self.tree, position.detach().numpy())) > 0
        return winding_number(self.vertices.double(), self.faces, position.double()) > 0.5


@lru_cache
def _between(steps: int) -> Float[Tensor, "k 3"]:
    """Barycentric coordinates of a grid on a triangle, `steps` a side, without its corners."""
    grid = [(i, j, steps - i - j) for i in range(steps + 1) for j in range(steps + 1 - i)]
    return torch.tensor([place for place in grid if max(place) < steps]) / steps


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
        self.head = nn.Sequential(nn.ReLU(), *mlp((first, *rest, 3), "relu"))

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
        known = HandSurface.of(vertices, self.faces, impl) if surface is None else surface
        found = closest_point(vertices, self.faces, position, bound, impl, known.pseudonormals, known.tree)
        sdf = found.sdf
        unsure = known.doubtful(found.face)
        within = known.wrapped(position.detach()[unsure])
        wrong, far = within != (sdf.detach()[unsure] < 0), bound[1] if bound else torch.inf
        unsure, within = unsure[wrong], within[wrong]
        sdf = sdf.index_copy(0, unsure, torch.where(within, -sdf[unsure].abs(), sdf[unsure].abs().clamp_max(far)))
        normals = vertex_normals(vertices, self.faces) if surface is None else surface.normals
        normal = normalize((normals[self.faces[found.face]] * found.barycentric[..., None]).sum(1), dim=-1)
        return HandQuery(sdf, found.face, found.barycentric, normal)

    def surface(self, vertices: Float[Tensor, "v 3"]) -> HandSurface:
        """A posed mesh, prepared; no gradient flows into it."""
        return HandSurface.of(vertices, self.faces)

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
        return torch.sigmoid(self.head(self.of_point(point) + self.of_pose(turned.reshape(1, 135))))
