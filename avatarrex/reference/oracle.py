"""The exact frame: no voxels, no narrow bands, no cut-offs; what every level's error is measured against. Small images.

The composed field itself in float64 (volume/composed_field.py), the first crossing of every ray by dense samples
(reference/dense_rays.py), and the colours there by reference implementations (reference/voxel_frame.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn.functional import normalize

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.pointmap.point_map import CoveredPixels, PointMap
from avatarrex.pointmap.rays import RayPlane, pixel_centres
from avatarrex.reference.dense_rays import DenseField, dense_crossing
from avatarrex.reference.voxel_frame import PosedReference, pose_reference, shade_reference
from avatarrex.signals.driving import Signals
from avatarrex.volume.composed_field import ComposedField, composed_field

STEP = 0.001
"""Metres between samples along a ray (docs/accuracy.md compares two densities)."""
SLOPE = 0.00025
"""Half the distance, metres, over which the normal is the field's slope."""


@dataclass(frozen=True)
class Oracle:
    """One exact frame."""

    image: Float[Tensor, "h w 4"]
    """Premultiplied sRGB and hit mask, float64."""
    pointmap: PointMap
    field: ComposedField
    camera: Camera
    """In the root frame."""


@torch.no_grad()
def render_oracle(
    avatar: Avatar,
    signals: Signals,
    camera: Camera,
    step: float = STEP,
    hidden: frozenset[str] = frozenset(),
) -> Oracle:
    """The exact frame of `signals` seen by the world camera `camera`; parts in `hidden` are not drawn."""
    posed = pose_reference(avatar, signals)
    view = camera.seen_from(posed.person.world_from_root(signals))
    field = exact_field(avatar, posed, hidden | avatar.hidden)
    pointmap = cast(field, view, step)
    side = field(pointmap.position[pointmap.hit].double()).side
    return Oracle(shade_reference(posed, pointmap, view, side, avatar.ownership), pointmap, field, view)


def exact_field(avatar: Avatar, posed: PosedReference, hidden: frozenset[str]) -> ComposedField:
    """The float64 field of a posed avatar."""
    shown = {name: state for name, state in posed.states.items() if name not in hidden}
    body = replace(posed.body, contact=avatar.ownership, reference=False)
    return composed_field(posed.avatar, posed.person, body, shown, Counters())


def cast(field: ComposedField, view: Camera, step: float = STEP) -> PointMap:
    """Point map of a root-frame camera by dense samples `step` metres apart."""
    low, high = field.bounds
    rays = RayPlane.of(view, (low + high) / 2).rays(pixel_centres(view, torch.float64))
    t = dense_crossing(field, rays, step)
    pixel = torch.nonzero(t.isfinite())[:, 0]
    position = rays[pixel].at(t[pixel])
    covered = CoveredPixels(pixel, position, slope(field, position), field(position).part_weight)
    return covered.scatter(view, "float64 oracle", {"rays": len(t)})


def slope(field: DenseField, position: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
    """Unit normals by central differences."""
    offsets = SLOPE * torch.eye(3, dtype=position.dtype)
    change = [field.sdf(position + offset) - field.sdf(position - offset) for offset in offsets]
    return normalize(torch.stack(change, -1), dim=-1)


def near_seam(oracle: Oracle, blend_weight: Float[Tensor, " v"], within: float = 0.02) -> Bool[Tensor, "h w"]:
    """Hit pixels within `within` metres of a template vertex where 0 < ω < 1; `blend_weight` ω of one part or several."""
    band = ((blend_weight > 0) & (blend_weight < 1)).numpy()
    apart = cKDTree(oracle.field.body.skin.vertices[band]).query(oracle.pointmap.position.numpy())[0]
    return oracle.pointmap.hit & torch.as_tensor(apart < within)
