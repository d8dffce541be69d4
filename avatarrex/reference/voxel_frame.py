"""The same frame with nothing skipped: float64, every voxel, every node, every stage by its reference. For small images.

What render_frame does by narrow bands, bricks, compute shaders and cut-offs is done here by evaluating everything;
tests compare the fast frame with this one (tests/reference/test_voxel_frame.py). Contact between limbs is left out. The
frame without even the voxels is in oracle.py, which poses and shades by this file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.fields.body import BodyField, BodyFrame
from avatarrex.fields.body_without_hands import BodyWithoutHands
from avatarrex.fields.composition import WHOLE
from avatarrex.fields.light import Light
from avatarrex.fields.limbs import Ownership, nodes_of
from avatarrex.fields.patches import patches_reference
from avatarrex.fields.template_distance import TemplateDistance
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.parts.part import CLAMP, Part
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.raycast import raycast
from avatarrex.settings import RenderSettings
from avatarrex.shading.colour import surface_points
from avatarrex.signals.driving import Signals
from avatarrex.templates.face import FaceTemplate
from avatarrex.templates.hand import HandTemplate
from avatarrex.templates.model import PosedTemplate, pose_template, skinned_normals
from avatarrex.templates.parts import PART_JOINT, PARTS
from avatarrex.templates.transform import world_from_root
from avatarrex.volume.body_grid import BOX_MARGIN, lattice_around
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.narrow_band import halved
from avatarrex.volume.part_box import coarse_lattice
from avatarrex.volume.sdf_volume import BodyGrid, PartBox, SdfVolume

PartTemplate = TypeVar("PartTemplate", HandTemplate, FaceTemplate)
BLOCK_POINTS = 100_000
"""Points of a box that are evaluated at once."""


@dataclass(frozen=True)
class PosedReference:
    """Everything in float64: fields, posed meshes, coefficients."""

    body: BodyField
    light: Light
    parts: dict[str, Part[Any]]
    template: PosedTemplate
    frame: BodyFrame
    skin: TemplateDistance
    meshes: dict[str, Tensor]
    states: dict[str, Any]
    """What each part prepared, by its reference."""

    def root_from_part(self, name: str) -> np.ndarray:
        """Rigid (4, 4)."""
        return self.template.joint_transforms[PART_JOINT[name]].numpy()

    def seen_from(self, camera: Camera, signals: Signals) -> Camera:
        """A world camera in the root frame."""
        pelvis = self.template.joints[0].numpy()
        return camera.seen_from(world_from_root(signals.global_orient, signals.translation, pelvis))


@torch.no_grad()
def render_reference(
    avatar: Avatar, signals: Signals, camera: Camera, settings: RenderSettings
) -> tuple[Float[Tensor, "h w 4"], PointMap]:
    """Image (premultiplied sRGB and hit mask, float64) and point map of one frame; no antialiasing."""
    posed = pose_reference(avatar, signals)
    shown = (name for name in PARTS if name not in settings.hidden)
    boxes = tuple(_part_box(posed, name, settings.part_voxel) for name in shown)
    view = posed.seen_from(camera, signals)
    pointmap = raycast(SdfVolume(_body_grid(posed, settings.voxel), boxes), view, "reference", antialias=False)
    return shade_reference(posed, pointmap, view), pointmap


@torch.no_grad()
def pose_reference(avatar: Avatar, signals: Signals) -> PosedReference:
    """Fields and templates of `avatar` in float64, posed."""
    exact = _in_double(avatar)
    person, body = exact.person, exact.body
    shape = torch.as_tensor(np.array(signals.shape)).double()
    body_pose = torch.as_tensor(np.array(signals.body_pose)).double()
    pose = torch.cat([torch.zeros(1, 3), body_pose, torch.zeros(33, 3)])
    no_expression = torch.zeros(person.body.expression_dirs.shape[2], dtype=torch.float64)
    template = pose_template(person.body, pose, shape, no_expression)
    normals = skinned_normals(person.body, template).numpy()
    painted = exact.hand_weight.numpy(), body.clothing_offset.numpy()
    meshes, states = {}, {}
    for name, part in exact.parts.items():
        coefficients = torch.as_tensor(np.array(person.part(name).coefficients(signals))).double()
        meshes[name] = person.part(name).posed(coefficients, shape)
        states[name] = part.prepare(meshes[name], coefficients, Counters(), "reference")
    return PosedReference(
        body,
        exact.light,
        exact.parts,
        template,
        body.frame(template, body.code(matrix_from_rotvec(body_pose))),
        TemplateDistance.of(template.vertices.numpy(), normals, *painted, closed=True),
        meshes,
        states,
    )


def _body_grid(posed: PosedReference, voxel: float) -> BodyGrid:
    """Every voxel, by every node in reach."""
    vertices = posed.skin.vertices
    lattice = lattice_around(np.concatenate([vertices - BOX_MARGIN, vertices + BOX_MARGIN]), voxel)
    body = BodyWithoutHands(posed.body, posed.frame, posed.skin, None, reference=True)
    sdf = body.sdf(_points(lattice), Counters())
    return BodyGrid(lattice.origin, lattice.voxel, sdf.reshape(lattice.shape))


def _part_box(posed: PosedReference, name: str, voxel: float) -> PartBox:
    """Every voxel of a part's box."""
    part = posed.parts[name]
    lattice = coarse_lattice(part, posed.meshes[name], voxel)
    for _ in range(part.halvings):
        lattice = halved(lattice)
    blocks = [part.distance(posed.states[name], block, "reference") for block in _points(lattice).split(BLOCK_POINTS)]
    distance, omega = (torch.cat(values) for values in zip(*blocks))
    root_from_box = np.eye(4)
    root_from_box[:3, 3] = lattice.origin
    field = torch.stack([distance.clamp(-CLAMP, CLAMP), omega], -1).reshape(*lattice.shape, 2)
    return PartBox(name, np.linalg.inv(posed.root_from_part(name) @ root_from_box), lattice.voxel, field)


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
    patches = patches_reference(posed.body.patch_network, posed.frame.code.embedding)
    colour, side = torch.zeros_like(position), torch.full((len(position),), WHOLE) if side is None else side
    for limb in side.unique().tolist():
        here = side == limb
        point, along, frame = position[here], gaze[here], posed.frame.restricted(nodes_of(ownership, limb))
        colour[here] = posed.body.colour(frame, patches, point, along, impl="reference", light=posed.light)
    colour = colour * (1 - weight.sum(-1, keepdim=True))
    for column, name in enumerate(PARTS):
        points = surface_points(posed.root_from_part(name), position, gaze)
        own = posed.parts[name].colour(posed.states[name], points, Counters(), "reference")
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
