"""Where another limb reaches into a part's box: the body field of the part's own nodes and of all the others.

A hand on a hip is a union (docs/architecture.md, 'How the parts compose'): the composed value of the hand must never
replace the hip's flesh. Both fields are evaluated on the body's lattice, inside the box only, and only when a vertex of
another limb is there. Towards the box's faces both become the field of the whole body, or the surface would jump there:
nodes of the arm whose support reaches the hip move it by a millimetre.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.fields.body_without_hands import BodyWithoutHands
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.part_box import UnplacedBox
from avatarrex.volume.sdf_volume import BodyGrid, Contact

FADE = 0.03
"""Metres inside the box's faces over which limbs come to be split: past the margin within which a part is blended."""


def split_share(
    local: Float[Tensor, "p 3"], low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]
) -> Float[Tensor, " p"]:
    """How far limbs are split at part-frame points: 0 outside the box and on its faces, 1 from `FADE` inside on."""
    depth = torch.minimum(local - torch.as_tensor(low).to(local), torch.as_tensor(high).to(local) - local)
    return (depth.amin(-1) / FADE).clamp(0, 1)


def faded(apart: Float[Tensor, "p 2"], whole: Float[Tensor, " p"], share: Float[Tensor, " p"]) -> Float[Tensor, "p 2"]:
    """(own, others) `apart` where their share is 1; their union is the `whole` body's field where it is 0. Metres.

    The part's own limb fades where it is the nearer of both. Elsewhere it stays away, or it would bring the whole body's
    surface to a place that is another part's as well: a cheek beside the hand's box has the face's surface alone.
    """
    towards = torch.where(share[:, None] == 1, apart, whole[:, None] + share[:, None] * (apart - whole[:, None]))
    (away, other), near = apart.unbind(-1), towards[:, 0]
    own = near.maximum(away.minimum(near + (away - other).clamp_min(0)))
    return torch.stack([own, towards[:, 1]], -1)


def find_contact(
    body: BodyWithoutHands,
    grid: BodyGrid,
    stored: BodyGrid,
    part: UnplacedBox,
    root_from_part: np.ndarray,
    counters: Counters,
) -> Contact | None:
    """Evaluate `own` and `others` in the box of `part` when another limb is in it, else None.

    `grid` has the field's values; both limbs take along what `stored` differs from it by (prefilter.py), as the body around the box does.
    """
    corners, part_from_root = part.lattice.corners(), np.linalg.inv(root_from_part)
    low, high = corners.min(0), corners.max(0)
    limbs = body.limbs(part.name, part_from_root, low, high)
    if limbs is None:
        return None
    lattice = Lattice(grid.origin, grid.voxel, (grid.sdf.shape[0], grid.sdf.shape[1], grid.sdf.shape[2]))
    placed = corners @ root_from_part[:3, :3].T + root_from_part[:3, 3]
    first = np.floor((placed.min(0) - grid.origin) / grid.voxel).astype(int)[::-1]
    last = np.ceil((placed.max(0) - grid.origin) / grid.voxel).astype(int)[::-1]
    first, last = np.maximum(first, 0), np.minimum(last, np.array(lattice.shape) - 1)
    block = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last)), indexing="ij")
    index = np.ravel_multi_index([axis.ravel() for axis in block], lattice.shape)
    position = lattice.position(index)
    local = torch.as_tensor(position @ part_from_root[:3, :3].T + part_from_root[:3, 3])
    points = torch.as_tensor(position, dtype=torch.float32)
    pairs = body.field.pairs(body.frame, points)
    apart = limbs.own_and_others(points, pairs)
    whole = grid.sdf.flatten()[index]
    change = stored.sdf.flatten()[index] - whole
    values = faded(apart, whole, split_share(local, low, high).float()) + change[:, None]
    counters.add("voxels_evaluated", 2 * len(index))
    counters.add("local_mlp_evaluations", len(pairs.point))
    shape = tuple(int(n) for n in last - first + 1)
    return Contact(first=first, field=values.reshape(*shape, 2))
