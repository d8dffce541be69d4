"""The same frame with nothing skipped: float64, every voxel, every node, every stage by its reference. For small images.

What render_frame does by narrow bands, bricks, compute shaders and cut-offs is done here by evaluating everything;
tests hold the fast frame to this one (tests/reference/test_voxel_frame.py). Contact between limbs is not handled. The frame
without even the voxels is in reference/oracle.py, which poses and shades by this file.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.fields.body import BodyField, BodyFrame
from avatarrex.fields.composition import WHOLE, emptied
from avatarrex.fields.face import FaceField
from avatarrex.fields.hand import HandField, HandSurface
from avatarrex.fields.light import Light
from avatarrex.fields.patches import patches_reference
from avatarrex.fields.tone import ToneMap
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.pipeline import RenderSettings
from avatarrex.pointmap.raycast import PointMap, raycast
from avatarrex.signals.driving import Signals
from avatarrex.templates.face import FaceTemplate, pose_face
from avatarrex.templates.hand import HandTemplate, pose_hand
from avatarrex.templates.model import PosedTemplate, pose_template, skinned_normals
from avatarrex.templates.posed import PART_JOINT
from avatarrex.templates.transform import world_from_root
from avatarrex.volume.body_grid import MARGIN, lattice_around
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.limbs import Ownership, nodes_of
from avatarrex.volume.part_box import CLAMP, FACE_BAND, HAND_MARGIN, face_skin
from avatarrex.volume.sdf_volume import PARTS, BodyGrid, PartBox, SdfVolume
from avatarrex.volume.template_distance import TemplateDistance

Module = TypeVar("Module", bound=nn.Module)
Part = TypeVar("Part", HandTemplate, FaceTemplate)


@dataclass(frozen=True)
class PosedReference:
    """Everything in float64: fields, posed meshes, coefficients."""

    body: BodyField
    hands: dict[str, HandField]
    face: FaceField
    tone: ToneMap
    light: Light
    template: PosedTemplate
    frame: BodyFrame
    meshes: dict[str, Tensor]
    views: Tensor
    value: dict[str, Tensor]
    skin: TemplateDistance
    surfaces: dict[str, HandSurface]
    """Of the hands, without trees."""

    def part_from_root(self, name: str) -> Tensor:
        """Rigid (4, 4)."""
        return torch.linalg.inv(self.template.joint_transforms[PART_JOINT[name]])

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
    volume = SdfVolume(
        _body_grid(posed, settings.voxel),
        tuple(_part_box(avatar, posed, name, settings.part_voxel) for name in PARTS if name not in settings.hidden),
    )
    view = posed.seen_from(camera, signals)
    pointmap = raycast(volume, view, "reference", antialias=False)
    return shade_reference(posed, pointmap, view), pointmap


def pose_reference(avatar: Avatar, signals: Signals) -> PosedReference:
    """Fields and templates of `avatar` in float64, posed."""
    person = avatar.person
    body, face = _double(avatar.body), _double(avatar.face)
    body.widths = replace(body.widths, colour_cutoff=0.0)
    value = {name: torch.as_tensor(np.array(getattr(signals, name))).double() for name in _SIGNALS}
    model, shape = person.body.double(), value["shape"]
    pose = torch.cat([torch.zeros(1, 3), value["body_pose"], torch.zeros(33, 3)])
    template = pose_template(model, pose, shape, torch.zeros(model.expression_dirs.shape[2], dtype=torch.float64))
    meshes = {
        name: pose_hand(_in_double(getattr(person, name)), value[f"{name}_pose"], shape)
        for name in ("left_hand", "right_hand")
    }
    meshes["face"] = pose_face(
        _in_double(person.face), value["expression"], value["jaw_pose"], value["eye_pose"], shape
    )
    normals = skinned_normals(model, template).numpy()
    hand_weight, clothing_offset = avatar.hand_weight.double().numpy(), avatar.body.clothing_offset.double().numpy()
    skin = TemplateDistance.of(template.vertices.numpy(), normals, hand_weight, clothing_offset, closed=True)
    coefficients = torch.cat([value["expression"], value["jaw_pose"], value["eye_pose"].flatten()])
    return PosedReference(
        body,
        {name: _double(avatar.hand(name)) for name in ("left_hand", "right_hand")},
        face,
        _double(avatar.tone),
        _double(avatar.light),
        template,
        body.frame(template, body.code(matrix_from_rotvec(value["body_pose"]))),
        meshes,
        face.driven(meshes["face"].float(), coefficients.float(), "reference").double(),
        value,
        skin,
        {
            name: HandSurface.of(meshes[name], avatar.hand(name).faces, "reference")
            for name in ("left_hand", "right_hand")
        },
    )


def _body_grid(posed: PosedReference, voxel: float) -> BodyGrid:
    """Every voxel, by every node that hears it."""
    skin = posed.template.vertices.numpy()
    lattice = lattice_around(np.concatenate([skin - MARGIN, skin + MARGIN]), voxel)
    points = _points(lattice)
    sdf = torch.cat([posed.body.sdf(posed.frame, block, impl="reference") for block in points.split(20000)])
    here = posed.skin.query(points.numpy())
    sdf = emptied(here.clamped(sdf), torch.as_tensor(here.weight))
    return BodyGrid(lattice.origin, lattice.voxel, sdf.reshape(lattice.shape))


def _part_box(avatar: Avatar, posed: PosedReference, name: str, voxel: float) -> PartBox:
    """Every voxel of a part's box: hands by all triangles, the face by its tri-planes."""
    mesh = posed.meshes[name]
    painted = avatar.person.face.blend_weight if name == "face" else posed.hands[name].blend_weight
    weight, margin = painted.double(), FACE_BAND if name == "face" else HAND_MARGIN
    lattice = _box(mesh[weight > 0].numpy(), margin, (2 if name == "face" else 4) * voxel, voxel)
    points = _points(lattice)
    if name == "face":
        planes = posed.face.geometry_planes(posed.views)
        distance = torch.cat([posed.face.sdf(planes, block) for block in points.split(100000)])
        here = face_skin(posed.face, mesh, weight).query(points.numpy())
        omega = torch.as_tensor(np.where(here.distance < FACE_BAND, here.weight, 0))
    else:
        query = posed.hands[name].sdf(mesh, points, impl="reference", surface=posed.surfaces[name])
        distance, omega = query.sdf, posed.hands[name].omega(query)
    box_from_part = np.eye(4)
    box_from_part[:3, 3] = -lattice.origin
    field = torch.stack([distance.clamp(-CLAMP, CLAMP), omega], -1).reshape(*lattice.shape, 2)
    return PartBox(name, box_from_part @ posed.part_from_root(name).numpy(), voxel, field)


def shade_reference(
    posed: PosedReference,
    pointmap: PointMap,
    view: Camera,
    side: Int[Tensor, " p"] | None = None,
    ownership: Mapping[str, Ownership] = MappingProxyType({}),
) -> Tensor:
    """Every hit pixel asks every field that has a share; the body's nodes of that pixel's `side` (`Composed.side`)."""
    hit = pointmap.hit
    position, weight = pointmap.position[hit].double(), pointmap.part_weight[hit].double()
    gaze = torch.nn.functional.normalize(position - torch.as_tensor(view.centre), dim=-1)
    patches = patches_reference(posed.body.patch_network, posed.frame.code.embedding)
    colour, side = torch.zeros_like(position), torch.full((len(position),), WHOLE) if side is None else side
    for limb in side.unique().tolist():
        here = side == limb
        point, along, among = position[here], gaze[here], nodes_of(ownership, limb)
        colour[here] = posed.body.colour(
            posed.frame, patches, point, along, impl="reference", light=posed.light, among=among
        )
    colour = colour * (1 - weight.sum(-1, keepdim=True))
    for column, name in enumerate(PARTS):
        place = posed.part_from_root(name)
        local, turned = position @ place[:3, :3].T + place[:3, 3], gaze @ place[:3, :3].T
        if name == "face":
            own = posed.face.colour(posed.face.colour_planes(posed.views), local, turned)
            own = posed.tone(own, gaze, turned)
        else:
            query = posed.hands[name].sdf(posed.meshes[name], local, impl="reference", surface=posed.surfaces[name])
            query = query.seen(turned)
            own = posed.hands[name].colour(posed.meshes[name], posed.value[f"{name}_pose"], query)
            own = own * posed.light(query.normal @ place[:3, :3])
        colour = colour + weight[:, column, None] * own
    image = torch.zeros(*hit.shape, 4, dtype=torch.float64)
    image[hit] = torch.cat([colour.clamp(0, 1), torch.ones_like(colour[:, :1])], -1)
    return image


_SIGNALS = (
    "global_orient", "body_pose", "left_hand_pose", "right_hand_pose", "jaw_pose", "eye_pose", "expression", "shape",
)  # fmt: skip


def _double(module: Module) -> Module:
    return copy.deepcopy(module).double()


def _in_double(part: Part) -> Part:
    """A hand or face template with its model in float64."""
    return replace(part, model=part.model.double())


def _points(lattice: Lattice) -> Tensor:
    return torch.as_tensor(lattice.position(np.arange(np.prod(lattice.shape))))


def _box(mesh: np.ndarray, margin: float, coarse: float, voxel: float) -> Lattice:
    """The lattice of part_box.py: on multiples of the coarse voxel, refined to `voxel`."""
    first = np.floor((mesh.min(0) - margin) / coarse).astype(int)
    size = np.ceil((mesh.max(0) + margin) / coarse).astype(int) - first
    z, y, x = (int(n) * round(coarse / voxel) + 1 for n in size[::-1])
    return Lattice(first * coarse, voxel, (z, y, x))
