"""The same frame with nothing skipped: float64, every voxel, every node, every stage by its reference. For small images.

What render_frame does by narrow bands, bricks, compute shaders and cut-offs is done here by evaluating everything;
tests compare the fast frame with this one (tests/reference/test_voxel_frame.py). Contact between limbs is left out. The
frame without even the voxels is in oracle.py, which poses and shades by this file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.fields.body_without_hands import BodyWithoutHands
from avatarrex.fields.composition import WHOLE
from avatarrex.fields.light import Irradiance
from avatarrex.fields.limbs import Ownership, nodes_of
from avatarrex.fields.patches import patches_reference
from avatarrex.parts.part import CLAMP, PartState
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.raycast import raycast
from avatarrex.settings import RenderSettings
from avatarrex.shading.colour import surface_points
from avatarrex.signals.driving import Signals
from avatarrex.templates.face import FaceTemplate
from avatarrex.templates.hand import HandTemplate
from avatarrex.templates.parts import PARTS
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.volume.body_grid import BOX_MARGIN, lattice_around
from avatarrex.volume.build import body_frame, template_distance
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.narrow_band import halved
from avatarrex.volume.part_box import coarse_lattice
from avatarrex.volume.sdf_volume import BodyGrid, PartBox, SdfVolume

PartTemplate = TypeVar("PartTemplate", HandTemplate, FaceTemplate)
BLOCK_POINTS = 100_000
"""Points of a box that are evaluated at once."""


@dataclass(frozen=True)
class PosedReference:
    """An avatar in float64 under one driving signal."""

    avatar: Avatar
    person: PosedPerson
    body: BodyWithoutHands
    """Every node at every point; limbs that touch are not split."""
    states: dict[str, PartState]
    """What each part prepared, by its reference."""
    light: Irradiance
    """What falls on body and hands, root frame."""


@torch.no_grad()
def render_reference(
    avatar: Avatar, signals: Signals, camera: Camera, settings: RenderSettings
) -> tuple[Float[Tensor, "h w 4"], PointMap]:
    """Image (premultiplied sRGB and hit mask, float64) and point map of one frame; no antialiasing."""
    posed = pose_reference(avatar, signals)
    shown = (name for name in PARTS if name not in settings.hidden)
    boxes = tuple(_part_box(posed, name, settings.part_voxel) for name in shown)
    view = camera.seen_from(posed.person.world_from_root(signals))
    pointmap = raycast(SdfVolume(_body_grid(posed, settings.voxel), boxes), view, "reference", antialias=False)
    return shade_reference(posed, pointmap, view), pointmap


@torch.no_grad()
def pose_reference(avatar: Avatar, signals: Signals) -> PosedReference:
    """Fields and templates of `avatar` in float64, posed."""
    exact = _in_double(avatar)
    person = pose_person(exact.person, signals, Counters(), None, torch.float64)
    body = BodyWithoutHands(
        exact.body, body_frame(exact, person), template_distance(exact, person), None, reference=True
    )
    states = {
        name: part.prepare(person.parts[name], person.coefficients[name], Counters(), "reference")
        for name, part in exact.parts.items()
    }
    return PosedReference(exact, person, body, states, exact.light.over(person.world_from_root(signals)))


def _body_grid(posed: PosedReference, voxel: float) -> BodyGrid:
    """Every voxel, by every node in reach."""
    vertices = posed.body.skin.vertices
    lattice = lattice_around(np.concatenate([vertices - BOX_MARGIN, vertices + BOX_MARGIN]), voxel)
    sdf = posed.body.sdf(_points(lattice), Counters())
    return BodyGrid(lattice.origin, lattice.voxel, sdf.reshape(lattice.shape))


def _part_box(posed: PosedReference, name: str, voxel: float) -> PartBox:
    """Every voxel of a part's box."""
    part = posed.avatar.parts[name]
    lattice = coarse_lattice(part, posed.person.parts[name], voxel)
    for _ in range(part.halvings):
        lattice = halved(lattice)
    blocks = [part.distance(posed.states[name], block, "reference") for block in _points(lattice).split(BLOCK_POINTS)]
    distance, omega = (torch.cat(values) for values in zip(*blocks))
    root_from_box = np.eye(4)
    root_from_box[:3, 3] = lattice.origin
    field = torch.stack([distance.clamp(-CLAMP, CLAMP), omega], -1).reshape(*lattice.shape, 2)
    return PartBox(name, np.linalg.inv(posed.person.root_from_part(name) @ root_from_box), lattice.voxel, field)


def shade_reference(
    posed: PosedReference,
    pointmap: PointMap,
    view: Camera,
    side: Int[Tensor, " p"] | None = None,
    ownership: Mapping[str, Ownership] = MappingProxyType({}),
) -> Tensor:
    """Every field that has a share in a hit pixel; of the body the nodes of that pixel's `side` (`Composed.side`)."""
    hit = pointmap.hit
    position, weight = pointmap.position[hit].double(), pointmap.part_weight[hit].double()
    gaze = torch.nn.functional.normalize(position - torch.as_tensor(view.centre), dim=-1)
    field, whole, light = posed.body.field, posed.body.frame, posed.light
    patches = patches_reference(field.patch_network, whole.code.embedding)
    colour, side = torch.zeros_like(position), torch.full((len(position),), WHOLE) if side is None else side
    for limb in side.unique().tolist():
        here = side == limb
        point, along, frame = position[here], gaze[here], whole.restricted(nodes_of(ownership, limb))
        colour[here] = field.colour(frame, patches, point, along, impl="reference", light=light)
    colour = colour * (1 - weight.sum(-1, keepdim=True))
    for column, name in enumerate(PARTS):
        points = surface_points(posed.person.root_from_part(name), position, gaze, light)
        own = posed.avatar.parts[name].colour(posed.states[name], points, Counters(), "reference")
        colour = colour + weight[:, column, None] * own
    image = torch.zeros(*hit.shape, 4, dtype=torch.float64)
    image[hit] = torch.cat([colour.clamp(0, 1), torch.ones_like(colour[:, :1])], -1)
    return image


def _in_double(avatar: Avatar) -> Avatar:
    """A copy in float64 whose colour networks skip nothing."""
    exact, person = avatar.frozen_copy(), avatar.person
    for module in exact.modules().values():
        module.double()
    exact.body.widths = replace(exact.body.widths, colour_cutoff=0.0)
    double = replace(
        person,
        body=person.body.double(),
        left_hand=_template_in_double(person.left_hand),
        right_hand=_template_in_double(person.right_hand),
        face=_template_in_double(person.face),
        blend_weight=person.blend_weight.double(),
    )
    return replace(exact, person=double)


def _template_in_double(part: PartTemplate) -> PartTemplate:
    return replace(part, model=part.model.double(), blend_weight=part.blend_weight.double())


def _points(lattice: Lattice) -> Tensor:
    return torch.as_tensor(lattice.position(np.arange(np.prod(lattice.shape))))
