"""The avatar's shape of one frame: a coarse body grid and fine boxes for hands and face (paper sec. 4, Step I).

Letters: z y x voxels, p points. Root frame, metres, negative inside. Storage is what the builder chose (float32, or
half: an SDF error of 8e-6 m); every ray caster reads the same stored numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.fields.composition import WHOLE, Composed, compose, step_bound
from avatarrex.ops.finite import require_finite
from avatarrex.ops.trilinear import trilinear
from avatarrex.templates.parts import PARTS
from avatarrex.volume.bricks import Bricks


@dataclass(frozen=True, eq=False)
class BodyGrid:
    """The body field on a regular grid."""

    origin: Float[np.ndarray, "3"]
    """Root-frame position of voxel 0's centre, float64 metres."""
    voxel: float
    sdf: Float[Tensor, "z y x"]
    bricks: Bricks | None = None
    """Cells that are stored more finely than `sdf`."""
    known: Bool[np.ndarray, "z y x"] | None = None
    """Voxels that the field was evaluated at; the others store a lower bound of the distance. Where the grid is prefiltered (prefilter.py)
    known voxels store other values than the field's."""

    def __post_init__(self) -> None:
        require_finite("volume", body=self.sdf)


@dataclass(frozen=True, eq=False)
class Contact:
    """The body field around a part, split into the nodes near the part along the surface and all others."""

    first: Int[np.ndarray, "3"]
    """Index (z, y, x) into the body lattice of the block's first voxel."""
    field: Float[Tensor, "z y x 2"]
    """(own, others)."""

    def __post_init__(self) -> None:
        require_finite("volume", contact=self.field)


@dataclass(frozen=True, eq=False)
class PartBox:
    """A fine box in the frame of a wrist or the head."""

    name: str
    """One of `PARTS`."""
    box_from_root: Float[np.ndarray, "4 4"]
    """Rigid, root metres to box metres; voxel 0's centre at 0."""
    voxel: float
    field: Float[Tensor, "z y x 2"]
    """(s_part clamped to ±0.051, ω)."""
    contact: Contact | None = None

    def __post_init__(self) -> None:
        require_finite("volume", **{self.name: self.field, "box_from_root": torch.as_tensor(self.box_from_root)})

    @property
    def size(self) -> np.ndarray:
        """Metres (x, y, z) between the centres of the outermost voxels."""
        return self.voxel * (np.array(self.field.shape[2::-1]) - 1.0)

    def local(self, position: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """Root-frame points in box metres."""
        matrix = torch.as_tensor(self.box_from_root).to(position)
        return position @ matrix[:3, :3].T + matrix[:3, 3]

    def holds(self, position: Float[Tensor, "p 3"]) -> Bool[Tensor, " p"]:
        """Which root-frame points lie in the box."""
        local = self.local(position)
        return ((local >= 0) & (local <= torch.as_tensor(self.size).to(position))).all(-1)


@dataclass(frozen=True, eq=False)
class SdfVolume:
    """What rays are cast against."""

    body: BodyGrid
    parts: tuple[PartBox, ...] = ()

    @property
    def middle(self) -> np.ndarray:
        """Root-frame centre of the body grid, (3,) metres."""
        return self.body.origin + self.body.voxel * (np.array(self.body.sdf.shape[::-1]) - 1.0) / 2


@dataclass(frozen=True)
class Sample:
    """The composed field at points, and what a ray needs to know there."""

    composed: Composed
    """Signed distance, and the effective ω of `PARTS`."""
    step: Float[Tensor, " p"]
    """How far a ray may go from here, metres: the field's terms inside boxes, the nearest box outside."""
    voxel: Float[Tensor, " p"]
    """Side of the finest voxels stored here or less than a body voxel away, metres."""
    scale: Float[Tensor, " p"]
    """Side of the voxels that the surface is made of here, metres: body voxels and part voxels mixed by ω."""


def sample(volume: SdfVolume, position: Float[Tensor, "p 3"]) -> Sample:
    """Trilinear values of the stored volume, composed by the one rule (docs/architecture.md).

    `position` in the root frame, metres, float32 or float64; the result keeps its dtype. Outside the body grid the body
    is the value at the nearest border point plus the distance to it.
    """
    grid = volume.body
    body, voxel, place = _stored_body(grid, position)
    cell = voxel.clone()
    stored = stored_parts(volume, position)
    own = body[:, None] * stored.inside
    others = torch.full_like(own, torch.inf)
    reach = position.new_full(position.shape[:1], torch.inf)
    scale = voxel.clone()
    for part in volume.parts:
        k = PARTS.index(part.name)
        inside = stored.inside[:, k]
        rows = torch.nonzero(inside)[:, 0]
        reach = torch.where(inside, reach, reach.minimum(stored.distance[:, k] + part.voxel))
        if part.contact is not None:
            first = torch.as_tensor(part.contact.first[::-1].copy()).to(position)
            own[rows, k], others[rows, k] = trilinear(part.contact.field, place[rows] - first).unbind(-1)
        voxel[stored.distance[:, k] < grid.voxel] = part.voxel
        scale[rows] = scale[rows].minimum(cell[rows] + stored.omega[rows, k] * (part.voxel - cell[rows]))
    composed = compose(body, stored.inside, stored.sdf, stored.omega, own, others)
    bound = step_bound(composed.sdf, stored.inside, stored.sdf, own, others)
    return Sample(composed, bound.minimum(reach), voxel, scale)


def sides(volume: SdfVolume, position: Float[Tensor, "p 3"]) -> Int[Tensor, " p"] | None:
    """`sample(volume, position).composed.side`; None where no limb touches another."""
    touched = tuple(part for part in volume.parts if part.contact)
    if not touched:
        return None
    rows = _boxed(touched, position)
    side = torch.full((len(position),), WHOLE)
    found = sample(volume, position[rows]).composed.side
    assert found is not None
    return side.index_put((rows,), found)


def distance(volume: SdfVolume, position: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
    """`sample(volume, position).composed.sdf`; what lies in no part's box, most of a ray, is not composed."""
    found, _, _ = _stored_body(volume.body, position)
    rows = _boxed(volume.parts, position)
    return found.index_put((rows,), sample(volume, position[rows]).composed.sdf)


def _boxed(parts: tuple[PartBox, ...], position: Tensor) -> Tensor:
    """Rows of the points that lie in a part's box."""
    boxed = torch.zeros(len(position), dtype=torch.bool)
    for part in parts:
        boxed |= part.holds(position)
    return torch.nonzero(boxed)[:, 0]


def _stored_body(grid: BodyGrid, position: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Distance, the side of the voxels it comes from, and the place in body voxels."""
    place = (position - torch.as_tensor(grid.origin).to(position)) / grid.voxel
    size = torch.tensor(grid.sdf.shape).flip(0).to(position) - 1
    within = place.clamp(min=torch.zeros_like(size), max=size)
    body, voxel = trilinear(grid.sdf[..., None], place)[:, 0], torch.full_like(place[:, 0], grid.voxel)
    if grid.bricks is not None:
        rows, finer = grid.bricks.sample(within)
        body[rows], voxel[rows] = finer, grid.voxel / grid.bricks.side
    return body + grid.voxel * (place - within).norm(dim=-1), voxel, place


@dataclass(frozen=True)
class StoredParts:
    """What the part boxes store at points, in the order of `PARTS`; zero outside them."""

    inside: Bool[Tensor, "p k"]
    sdf: Float[Tensor, "p k"]
    omega: Float[Tensor, "p k"]
    distance: Float[Tensor, "p k"]
    """Metres to the box; +inf where there is no such part."""


def stored_parts(volume: SdfVolume, position: Float[Tensor, "p 3"]) -> StoredParts:
    """Trilinear values of all boxes at `position`, root frame."""
    count = len(position), len(PARTS)
    inside = torch.zeros(count, dtype=torch.bool)
    sdf, omega = position.new_zeros(count), position.new_zeros(count)
    apart = position.new_full(count, torch.inf)
    for part in volume.parts:
        k = PARTS.index(part.name)
        local = part.local(position)
        box = torch.as_tensor(part.size).to(position)
        apart[:, k] = torch.maximum(-local, local - box).clamp(min=0).norm(dim=-1)
        inside[:, k] = apart[:, k] == 0
        rows = torch.nonzero(inside[:, k])[:, 0]
        sdf[rows, k], omega[rows, k] = trilinear(part.field, local[rows] / part.voxel).unbind(-1)
    return StoredParts(inside, sdf, omega, apart)
