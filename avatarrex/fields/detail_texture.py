"""Static detail: what a surface looks like in every pose, in texels that lie on the triangles of a template at rest. Ours.

    c = sigmoid(𝒞(p, v) + Σ_k b_k(x) t_k) · E(n),      x the closest point of p̄ on the triangles

The texels of a triangle lie on a lattice of its barycentric coordinates (mesh colours: Yuksel, Keyser and House 2010, here without
shared edges), as many along an edge as the equilateral triangle of its area has; b_k interpolates linearly between the three around
x. So no atlas is cut, and a place is a triangle with barycentrics. Texels are logits: beside networks that say 0, sigmoid(t) is the
albedo, which is what avatars store of it, one byte a channel.

Letters: f triangles, t texels, p points, k texels around a point: 3 on one sheet, 6 on two.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import cKDTree
from torch import Tensor, nn

from avatarrex.fields import loops
from avatarrex.ops.native import spread
from avatarrex.ops.triangle_grid import TriangleGrid

TEXELS = "detail.texel"
"""How the names of texels in a state end."""
MOST_EDGE = 64
"""Texels along an edge at most."""
OFF = (0.04, 0.06)
"""Metres off the triangles where detail fades out: a pony tail must not be painted on the neck beneath it."""
ROUNDED = 1e-9
"""Of a texel's spacing: a place so near to a texel is at it."""
NEARBY, SOME = 0.003, 64
"""Metres in which an unseen texel looks for the nearest seen one; farther off one in so many of those will do (texels of the back of
an eyeball are as far from many: searches among all of them take minutes)."""
DARKEST = 0.5 / 255
"""Albedo of the least texel, and 1 less that of the largest: beyond, a logit says nothing that a byte could."""


@dataclass(frozen=True)
class TexelPlaces:
    """Which texels points lie between."""

    texel: Int[Tensor, "p k"]
    share: Float[Tensor, "p k"]
    """b_k; their sum is 1, and fades to 0 where no texels lie."""

    def faded(self, share: Float[np.ndarray, " p"]) -> TexelPlaces:
        """With so much of each point's shares."""
        return TexelPlaces(self.texel, self.share * torch.from_numpy(share).to(self.share)[:, None])

    def with_more(self, rows: Int[np.ndarray, " o"], others: TexelPlaces) -> TexelPlaces:
        """With the texels of `others`, too, at the points of these rows; twice as many a point."""
        if not len(rows):
            return self
        count, at = self.texel.shape[1], torch.from_numpy(rows)
        texel, share = (torch.cat([each, torch.zeros_like(each)], 1) for each in (self.texel, self.share))
        texel[at, count:], share[at, count:] = others.texel, others.share
        return TexelPlaces(texel, share)


class DetailTexture(nn.Module):
    """The texels of some of a template's triangles; it knows where they are from `lay` on."""

    edge: Tensor
    """(f,) texel intervals along an edge; 0 where a triangle has none."""

    def __init__(self, edge: UInt8[Tensor, " f"], off: tuple[float, float] = OFF) -> None:
        super().__init__()
        self.register_buffer("edge", edge)
        self.off = off
        self.texel = nn.Parameter(torch.zeros(int(texel_count(edge.long().numpy()).sum()), 3))
        self._lattice: _Lattice | None = None

    @classmethod
    def of(
        cls,
        vertices: Float[Tensor, "v 3"],
        faces: Int[Tensor, "f 3"],
        spacing: float,
        shown: Bool[Tensor, " f"],
        off: tuple[float, float] = OFF,
    ) -> DetailTexture:
        """Texels about `spacing` metres apart on the triangles that are `shown`, all grey; they fade out `off` metres from them."""
        a, b, c = vertices[faces].double().unbind(1)
        area = torch.linalg.cross(b - a, c - a).norm(dim=-1) / 2
        edge = ((4 * area / 3**0.5).sqrt() / spacing).round().clamp(1, MOST_EDGE) * shown
        texture = cls(edge.to(torch.uint8), off)
        texture.lay(vertices, faces)
        return texture

    def lay(self, vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"]) -> None:
        """Let the triangles be those of a mesh at rest, metres."""
        self._lattice = _Lattice(vertices.double().numpy(), faces.numpy(), self.edge.numpy(), self.off)

    @property
    def lattice(self) -> _Lattice:
        """Raises RuntimeError before `lay`."""
        if self._lattice is None:
            raise RuntimeError("the texture was not laid on a mesh")
        return self._lattice

    def places(self, rest: Float[Tensor, "p 3"], impl: str = "auto") -> TexelPlaces:
        """Of rest positions p̄, metres; not differentiable in them. `impl`: `auto` (compiled loops), `reference`."""
        points = rest.detach().double().numpy()
        face, weight = self.lattice.grid.closest(points)
        texel, share = self.lattice.around(self.lattice.shown[face], weight, points, impl)
        return TexelPlaces(torch.from_numpy(texel), torch.from_numpy(share).to(self.texel.dtype))

    def places_on(
        self, face: Int[np.ndarray, " p"], weight: Float[np.ndarray, "p 3"], off: Float[np.ndarray, "p 3"]
    ) -> TexelPlaces:
        """Of barycentrics on triangles that have texels, for points that are `off` them, metres."""
        texel, share = self.lattice.around(face, weight, self.lattice.at(face, weight) + off)
        return TexelPlaces(torch.from_numpy(texel), torch.from_numpy(share).to(self.texel.dtype))

    def forward(self, places: TexelPlaces) -> Float[Tensor, "p 3"]:
        """Logits; differentiable in the texels."""
        return torch.nn.functional.embedding_bag(places.texel, self.texel, per_sample_weights=places.share, mode="sum")

    @torch.no_grad()
    def paint(self, albedo: Float[Tensor, "t 3"]) -> None:
        """Set the texels to `albedo`, sRGB, light divided out."""
        self.texel.copy_(logit(albedo))

    def continued(
        self, albedo: Float[Tensor, "t 3"], known: Bool[Tensor, " t"], sheet: Int[Tensor, " t"] | None = None
    ) -> Float[Tensor, "t 3"]:
        """`albedo` where it is `known`, elsewhere the nearest known one's of the same `sheet`; of one where none is known, as it is."""
        found = albedo.clone()
        for own in [torch.ones_like(known)] if sheet is None else [sheet == one for one in sheet.unique()]:
            seen = known[own]
            if seen.any() and not seen.all():
                rows = torch.nonzero(own)[:, 0]
                nearest = _nearest(self.lattice.position[own.numpy()], seen.numpy())
                found[rows[~seen]] = albedo[rows[torch.from_numpy(nearest)]]
        return found


def texel_count(edge: Int[np.ndarray, " f"]) -> Int[np.ndarray, " f"]:
    """How many texels a triangle has that has so many intervals along an edge; none of 0."""
    return np.where(edge > 0, (edge + 1) * (edge + 2) // 2, 0)


def texel_number(i: np.ndarray, j: np.ndarray, r: np.ndarray | int) -> np.ndarray:
    """Of the texel at (i, j, r − i − j)/r within its triangle: rows of i, the longest first."""
    number: np.ndarray = i * (r + 1) - i * (i - 1) // 2 + j
    return number


def _nearest(place: Float[np.ndarray, "t 3"], known: Bool[np.ndarray, " t"]) -> Int[np.ndarray, " u"]:
    """Of each texel that is not `known` one that is, the nearest or hardly farther."""
    seen, others = np.flatnonzero(known), place[~known]
    away, nearest = cKDTree(place[seen]).query(others, distance_upper_bound=NEARBY)
    far, some = ~np.isfinite(away), seen[::SOME]
    found: np.ndarray = seen[np.where(far, 0, nearest)]
    found[far] = some[cKDTree(place[some]).query(others[far])[1]]
    return found


def logit(albedo: Float[Tensor, "t 3"]) -> Float[Tensor, "t 3"]:
    """Of what lies in [0, 1], ends excluded."""
    return torch.logit(albedo.clamp(DARKEST, 1 - DARKEST))


def to_bytes(texel: Float[Tensor, "t 3"]) -> UInt8[Tensor, "t 3"]:
    """Logits as files store them: rounded albedo."""
    return (255 * torch.sigmoid(texel.float())).round().to(torch.uint8)


def from_bytes(stored: UInt8[Tensor, "t 3"]) -> Float[Tensor, "t 3"]:
    """`to_bytes` undone; off by half a step of 1/255 in the albedo."""
    return logit(stored.float() / 255)


def packed(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """A state as files have it: texels as bytes, all else as it is."""
    return {name: to_bytes(value) if name.endswith(TEXELS) else value for name, value in state.items()}


def unpacked(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """`packed` undone."""
    return {name: from_bytes(value) if name.endswith(TEXELS) else value for name, value in state.items()}


class _Lattice:
    """Where the texels of a mesh's triangles are; the same for all copies of a texture."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, edge: np.ndarray, off: tuple[float, float]) -> None:
        self.vertices, self.faces, self.off = vertices, faces, off
        self.edge = edge.astype(np.int64)
        self.shown = np.flatnonzero(self.edge)
        self.first = np.concatenate([[0], np.cumsum(texel_count(self.edge))[:-1]])

    def __deepcopy__(self, _: dict[int, object]) -> _Lattice:
        return self

    @cached_property
    def grid(self) -> TriangleGrid:
        """Of the triangles that have texels, in their order."""
        return TriangleGrid.of(self.vertices, self.faces[self.shown])

    @cached_property
    def position(self) -> Float[np.ndarray, "t 3"]:
        """Metres at rest."""
        found = np.empty((int((self.first + texel_count(self.edge))[-1]), 3))
        for r in np.unique(self.edge[self.shown]).tolist():
            some = np.flatnonzero(self.edge == r)
            i, j = (table.ravel() for table in np.indices((r + 1, r + 1)))
            i, j = i[i + j <= r], j[i + j <= r]
            weight = np.stack([i, j, r - i - j], 1) / r
            rows = self.first[some, None] + texel_number(i, j, r)
            found[rows] = np.einsum("tk,fkc->ftc", weight, self.vertices[self.faces[some]])
        return found

    def at(self, face: np.ndarray, weight: np.ndarray) -> Float[np.ndarray, "p 3"]:
        """Metres at rest."""
        place: np.ndarray = np.einsum("pk,pkc->pc", weight, self.vertices[self.faces[face]])
        return place

    def around(
        self, face: np.ndarray, weight: np.ndarray, points: np.ndarray, impl: str = "auto"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Texels (p, 3) about places and their shares, faded by how far off the `points` (p, 3) are.

        In the small triangle that stands upright there, or on its head.
        """
        if impl == "auto":
            texel, share = np.empty((len(face), 3), np.int64), np.empty((len(face), 3), np.float32)
            tables = self.first, self.edge, self.vertices, self.faces
            spread(loops.texels_around, len(face), face, weight, points, tables, self.off, texel, share)
            return texel, share
        r = self.edge[face]
        scaled = weight * r[:, None]
        low = np.floor(scaled + ROUNDED).astype(np.int64)
        part, left = (scaled - low).clip(0, 1), r - low.sum(1)  # 0 at a texel, 1 upright, 2 on its head
        turned = (left == 2)[:, None]
        share = np.where(turned, 1 - part, part)
        share = np.where((left == 0)[:, None], [1.0, 0.0, 0.0], share / share.sum(1, keepdims=True).clip(ROUNDED))
        texel = np.empty((len(face), 3), np.int64)
        for axis, step in enumerate(np.eye(3, dtype=np.int64)):
            corner = np.where(turned, low + 1 - step, low + np.where(left == 1, 1, 0)[:, None] * step)
            texel[:, axis] = self.first[face] + texel_number(corner[:, 0], corner[:, 1], r)
        away = np.linalg.norm(points - self.at(face, weight), axis=1)
        fade = np.clip((self.off[1] - away) / (self.off[1] - self.off[0]), 0, 1)
        return texel, (share * fade[:, None]).astype(np.float32)
