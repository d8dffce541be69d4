"""Step I: driving signals and fields to an SDF volume (paper sec. 4), with each piece kept while its key holds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.fields.body import BodyFrame
from avatarrex.fields.hand import HandSurface
from avatarrex.templates.model import skinned_normals
from avatarrex.templates.posed import PART_JOINT, PosedPerson
from avatarrex.volume.body_grid import build_body_grid, refined
from avatarrex.volume.body_without_hands import BodyWithoutHands
from avatarrex.volume.contact import find_contact
from avatarrex.volume.part_box import PartField, face_box, hand_box
from avatarrex.volume.sdf_volume import BodyGrid, PartBox, SdfVolume
from avatarrex.volume.small_components import without_small_components
from avatarrex.volume.template_distance import TemplateDistance
from avatarrex.volume.temporal_reuse import ChangedRegion, PreviousGrid, ReusableBody, reuse_unchanged

if TYPE_CHECKING:
    from avatarrex.pipeline import RenderSettings


@dataclass(frozen=True)
class AvatarVolume:
    """The volume and the posed fields it was made from; shading asks the same fields for colour."""

    sdf: SdfVolume
    body: BodyWithoutHands
    grid: BodyGrid
    """Without bricks: those of `sdf` grow with what is seen."""
    parts: dict[str, PartField]
    views: Tensor | None
    """Orthographic views of the face mesh, (3, 7, 256, 256), or what else drives the face; None while it is not built."""
    planes: Tensor | None
    """Geometry tri-planes of this expression; None while the face is not built."""
    changed: ChangedRegion | None
    """Where the body differs from that of the frame before, some of whose state it kept; None: it is exact."""
    keys: dict[str, object]
    notes: tuple[str, ...] = ()

    @property
    def body_frame(self) -> BodyFrame:
        """Of the body's field."""
        return self.body.frame

    @property
    def skin(self) -> TemplateDistance:
        """Of the template's whole skin."""
        return self.body.skin

    @property
    def hands(self) -> dict[str, HandSurface]:
        """The posed hands that were built, prepared for look-ups."""
        return {name: part.surface for name, part in self.parts.items() if part.surface is not None}

    def follows(self, other: AvatarVolume) -> bool:
        """Whether `changed` tells how the body differs from that of `other`."""
        return self.changed is not None and self.changed.since is other.body_frame


def build_volume(
    avatar: Avatar,
    posed: PosedPerson,
    settings: RenderSettings,
    counters: Counters,
    previous: AvatarVolume | None,
    unseen: frozenset[str] = frozenset(),
) -> AvatarVolume:
    """Build the volume of `posed`, taking from `previous` every piece whose key has not changed.

    Parts `unseen` are left out unless `previous` has them.
    """
    every = settings.everywhere
    stored: object = settings.voxel, every
    unmoved = previous is not None and previous.keys["posed"] == posed.keys["body"]
    if settings.reuse_tolerance and previous and unmoved and previous.grid.voxel <= settings.voxel:
        stored = previous.keys[
            "stored"
        ]  # whoever looks around, or drags something else, keeps the voxels that are there
    keys: dict[str, object] = {"hidden": settings.hidden, "bricks": settings.bricks, "stored": stored}
    keys["posed"] = posed.keys["body"]
    keys["body"] = posed.keys["body"], keys["stored"]
    for name in PART_JOINT:
        key = part_key(posed, settings, name)
        known = previous is not None and previous.keys[name] == key
        keys[name] = None if name in settings.hidden or (name in unseen and not known) else key
    exact = previous is None or settings.reuse_tolerance > 0 or previous.changed is None  # enough for what is asked
    if previous and previous.keys == keys and exact:
        return previous

    def kept(name: str) -> bool:
        return previous is not None and previous.keys[name] == keys[name]

    parts: dict[str, PartField] = {}
    views, planes = (previous.views, previous.planes) if previous and kept("face") else (None, None)
    for name in PART_JOINT:
        if keys[name] is None:
            continue
        if previous and kept(name) and name in previous.parts:
            parts[name] = previous.parts[name]
        elif name == "face":
            views = avatar.face.driven(posed.parts["face"], posed.face_coefficients)
            planes, parts[name] = _face_part(avatar, posed, views, settings, counters)
        else:
            hand, voxel = avatar.hand(name), settings.part_voxel
            parts[name] = hand_box(name, hand, posed.parts[name], voxel, counters, every)
    if previous and kept("body") and exact:
        body, grid, changed = previous.body, previous.grid, previous.changed
    else:
        before = previous if settings.reuse_tolerance and kept("stored") else None
        body, grid, changed = _body(avatar, posed, settings, counters, before)
    boxes = []
    for name, part in parts.items():
        if previous and grid is previous.grid and previous.parts.get(name) is part:
            boxes.append(next(box for box in previous.sdf.parts if box.name == name))
        else:
            boxes.append(_place(body, grid, part, posed.root_from_part(name), counters))
    return AvatarVolume(SdfVolume(grid, tuple(boxes)), body, grid, parts, views, planes, changed, keys)


def part_key(posed: PosedPerson, settings: RenderSettings, name: str) -> object:
    """What the box of a hand or the face depends on."""
    return posed.keys[name], settings.part_voxel, settings.everywhere


def _body(
    avatar: Avatar, posed: PosedPerson, settings: RenderSettings, counters: Counters, before: AvatarVolume | None
) -> tuple[BodyWithoutHands, BodyGrid, ChangedRegion | None]:
    """The body of `posed`; with what stands still as in `before`, where that is given."""
    normals = skinned_normals(avatar.person.body, posed.body).double().numpy()
    state = ReusableBody(body_frame(avatar, posed), posed.body.vertices.double().numpy(), normals, None)
    if before:
        then = ReusableBody(before.body_frame, before.skin.vertices, before.skin.normals, None)
        state = reuse_unchanged(state, then, settings.reuse_tolerance, avatar.embedding_effect)
    painted = avatar.hand_weight.double().numpy(), avatar.body.clothing_offset.double().numpy()
    tree = before.skin.closest if before else None
    skin = TemplateDistance.of(state.vertices, state.normals, *painted, closed=True, tree=tree)
    body = BodyWithoutHands(avatar.body, state.frame, skin, avatar.ownership)
    kept = PreviousGrid(before.grid, state.changed) if before and state.changed else None
    grid = build_body_grid(body, settings.voxel, counters, settings.everywhere, kept)
    return body, grid if settings.everywhere else without_small_components(grid), state.changed


def refine_volume(
    avatar: Avatar,
    volume: AvatarVolume,
    seen: np.ndarray,
    side: int,
    counters: Counters,
    previous: AvatarVolume | None,
) -> AvatarVolume:
    """`volume` with bricks of side³ voxels in the body cells `seen` (flat), besides those that `previous` has."""
    kept = previous.sdf.body.bricks if previous and previous.grid is volume.grid else None
    kept = kept if kept and kept.side == side else None
    grid = refined(volume.body, volume.grid, seen, side, counters, kept)
    if grid.bricks is volume.sdf.body.bricks:
        return volume
    return replace(volume, sdf=SdfVolume(grid, volume.sdf.parts))


def body_frame(avatar: Avatar, posed: PosedPerson) -> BodyFrame:
    """The body field under the posed template: nodes, embedding, residuals."""
    with torch.no_grad():
        return avatar.body.frame(posed.body, avatar.body.code(posed.body_rotation))


def _face_part(
    avatar: Avatar, posed: PosedPerson, views: Tensor, settings: RenderSettings, counters: Counters
) -> tuple[Tensor, PartField]:
    with torch.no_grad():
        planes = avatar.face.geometry_planes(views)
    counters.add("unet_runs", 3)
    mesh, weight = posed.parts["face"], avatar.person.face.blend_weight
    return planes, face_box(avatar.face, planes, mesh, weight, settings.part_voxel, counters, settings.everywhere)


def _place(
    body: BodyWithoutHands, grid: BodyGrid, part: PartField, root_from_part: np.ndarray, counters: Counters
) -> PartBox:
    part_from_box = np.eye(4)
    part_from_box[:3, 3] = part.origin
    box_from_root = np.linalg.inv(root_from_part @ part_from_box)
    contact = find_contact(body, grid, part, root_from_part, body.ownership[part.name], counters)
    return PartBox(part.name, box_from_root, part.voxel, part.field, contact)
