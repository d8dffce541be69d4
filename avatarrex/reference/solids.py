"""Volumes of solids with a closed form: what ray casting is tested, measured and explained on.

A solid is a function of points (p, 3) to signed distances (p,), root frame, metres, negative inside; operators are
functions of functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.fields.composition import BAND, emptied
from avatarrex.volume.sdf_volume import BodyGrid, PartBox, SdfVolume

Solid = Callable[[Tensor], Tensor]
RAMP_LENGTH = 0.04
"""Metres over which ω rises from 0 to 1."""


def sphere(centre: Sequence[float], radius: float) -> Solid:
    """A ball."""
    return lambda p: (p - torch.tensor(centre).to(p)).norm(dim=-1) - radius


def capsule(start: Sequence[float], end: Sequence[float], radius: float) -> Solid:
    """All points within `radius` of a segment."""
    a, axis = np.asarray(start, dtype=float), np.asarray(end, dtype=float) - np.asarray(start, dtype=float)

    def distance(p: Tensor) -> Tensor:
        from_a = p - torch.as_tensor(a).to(p)
        along = (from_a @ torch.as_tensor(axis).to(p) / float(axis @ axis)).clamp(0, 1)
        value: Tensor = (from_a - along[:, None] * torch.as_tensor(axis).to(p)).norm(dim=-1) - radius
        return value

    return distance


def slab(low: float, high: float, axis: int = 1) -> Solid:
    """All points with a coordinate between `low` and `high`."""
    return lambda p: (p[:, axis] - (low + high) / 2).abs() - (high - low) / 2


def union(*solids: Solid) -> Solid:
    """What lies in any of the solids."""
    return lambda p: torch.stack([solid(p) for solid in solids]).amin(0)


def lattice_points(shape: tuple[int, ...], voxel: float) -> Float[Tensor, "p 3"]:
    """Voxel centres of a grid (z, y, x), float64 metres from voxel 0."""
    z, y, x = torch.meshgrid(*(torch.arange(side, dtype=torch.float64) for side in shape), indexing="ij")
    return voxel * torch.stack([x, y, z], -1).view(-1, 3)


def body_grid(solid: Solid, origin: Sequence[float], voxel: float, shape: tuple[int, int, int]) -> BodyGrid:
    """A solid on a grid (z, y, x) from voxel 0's centre `origin`."""
    first = np.asarray(origin, dtype=np.float64)
    values = solid(lattice_points(shape, voxel) + torch.as_tensor(first))
    return BodyGrid(first, voxel, values.float().view(*shape))


def part_box(
    name: str, solid: Solid, omega: Solid, root_from_box: np.ndarray, voxel: float, shape: tuple[int, int, int]
) -> PartBox:
    """A part's solid and ω, both functions of root points, in a box placed by the rigid `root_from_box` (4, 4)."""
    place = torch.as_tensor(root_from_box)
    points = lattice_points(shape, voxel) @ place[:3, :3].T + place[:3, 3]
    field = torch.stack([solid(points).clamp(BAND[0], -BAND[0]), omega(points)], -1)
    return PartBox(name, np.linalg.inv(root_from_box), voxel, field.float().view(*shape, 2))


def rotation(axis: int, degrees: float) -> np.ndarray:
    """(3, 3) about a coordinate axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = [k for k in range(3) if k != axis]
    matrix = np.eye(3)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def capsule_man(shape: tuple[int, int, int] = (128, 128, 128), face_voxel: float = 0.0025) -> SdfVolume:
    """A man of capsules: a body grid (z, y, x) of 2 cm about the origin, hands of 5 mm in turned boxes, and a face."""
    hand_axis = np.array([np.cos(0.5), -np.sin(0.5), 0.0])
    wrist, head = np.array([0.55, 0.35, 0.02]), np.array([0.0, 0.72, 0.02])
    limbs = [
        capsule((0, 0, 0), (0, 0.42, 0), 0.15),
        capsule((0, 0.45, 0), (0, 0.62, 0.01), 0.06),
        sphere(head.tolist(), 0.105),
    ]
    hands, parts = [], []
    for side, name in ((1, "left_hand"), (-1, "right_hand")):
        mirror = np.array([side, 1, 1])
        joint, along = wrist * mirror, hand_axis * mirror
        limbs += [
            capsule((0.16 * side, 0.47, 0), joint.tolist(), 0.045),
            capsule((0.09 * side, -0.05, 0), (0.14 * side, -0.8, 0.02), 0.07),
            capsule((0.14 * side, -0.82, 0), (0.14 * side, -0.82, 0.14), 0.045),
            capsule(joint.tolist(), (joint + 0.15 * along).tolist(), 0.03),
        ]
        hands.append(_hand(joint, along))
        parts.append((name, hands[-1], _ramp(joint, along), _box_at(joint, along)))
    mouth = head + np.array([0, -0.04, 0.09])
    face = union(limbs[1], limbs[2], capsule((0, 0.74, 0.12), (0, 0.71, 0.14), 0.012))
    face_omega = _ramp(head + np.array([0, 0, 0.04]), np.array([0.0, 0.0, 1.0]))
    hand_weights = [weight for _, _, weight, _ in parts]

    def body(p: Tensor) -> Tensor:
        sdf = union(*limbs)(p)
        for weight in hand_weights:
            sdf = emptied(sdf, weight(p))
        return sdf

    boxes = [part_box(name, hand, weight, box, 0.005, (32, 40, 60)) for name, hand, weight, box in parts]
    place = np.eye(4)
    place[:3, 3] = mouth + np.array([-0.15, -0.11, -0.07])
    z, y, x = (round(side / face_voxel) + 1 for side in (0.13, 0.29, 0.30))
    boxes.append(part_box("face", face, face_omega, place, face_voxel, (z, y, x)))
    origin = -0.02 * np.array(shape[::-1]) / 2
    return SdfVolume(body_grid(body, origin.tolist(), 0.02, shape), tuple(boxes))


def _hand(wrist: np.ndarray, along: np.ndarray) -> Solid:
    """A palm, four spread fingers and a thumb, with 6 cm of forearm."""
    across = np.array([0.0, 0.0, 1.0])
    tips = [wrist + 0.17 * along + spread * across for spread in (-0.045, -0.015, 0.015, 0.045)]
    roots = [wrist + 0.07 * along + 0.6 * (tip - wrist - 0.17 * along) for tip in tips]
    fingers = [capsule(root.tolist(), tip.tolist(), 0.008) for root, tip in zip(roots, tips)]
    thumb = capsule((wrist + 0.03 * along).tolist(), (wrist + 0.08 * along + 0.06 * across).tolist(), 0.009)
    palm = capsule((wrist - 0.06 * along).tolist(), (wrist + 0.06 * along).tolist(), 0.028)
    return union(palm, thumb, *fingers)


def _ramp(start: np.ndarray, along: np.ndarray) -> Solid:
    """ω: 0 before `start`, 1 from `RAMP_LENGTH` on; 0 again from 30 cm away, where other limbs are."""

    def omega(p: Tensor) -> Tensor:
        offset = p - torch.as_tensor(start).to(p)
        rise = (offset @ torch.as_tensor(along).to(p) / RAMP_LENGTH).clamp(0, 1)
        value: Tensor = rise * (offset.norm(dim=-1) < 0.3)
        return value

    return omega


def _box_at(wrist: np.ndarray, along: np.ndarray) -> np.ndarray:
    """root_from_box of a box whose x runs along the hand, turned 20° about it."""
    across = np.array([0.0, 0.0, 1.0])
    frame = np.stack([along, np.cross(across, along), across], 1) @ rotation(0, 20)
    place = np.eye(4)
    place[:3, :3] = frame
    place[:3, 3] = wrist + frame @ np.array([-0.06, -0.0975, -0.0775])
    return place
