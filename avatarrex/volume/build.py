"""Step I: driving signals and fields to an SDF volume (paper sec. 4).

Each piece is reused while its key is the same; the others are built side by side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.fields.body import BodyFrame
from avatarrex.fields.body_without_hands import BodyWithoutHands
from avatarrex.fields.outgrowth import PosedOutgrowth
from avatarrex.fields.template_distance import TemplateDistance
from avatarrex.ops.side_by_side import SideBySide
from avatarrex.ops.skinning import blend_rotations
from avatarrex.parts.part import PartState
from avatarrex.settings import RenderSettings
from avatarrex.templates.model import skinned_normals
from avatarrex.templates.parts import PARTS
from avatarrex.templates.posed import PosedPerson, TemplateKey
from avatarrex.volume.body_grid import build_body_grid, refined
from avatarrex.volume.bricks import Bricks
from avatarrex.volume.contact import find_contact
from avatarrex.volume.part_box import UnplacedBox, build_part_box
from avatarrex.volume.prefilter import prefiltered
from avatarrex.volume.sdf_volume import BodyGrid, PartBox, SdfVolume
from avatarrex.volume.small_components import without_small_components
from avatarrex.volume.temporal_reuse import ChangedRegion, PreviousGrid, ReusableBody, reuse_unchanged
from avatarrex.volume.thin_limbs import with_thin_limbs


@dataclass(frozen=True)
class PieceKey:
    """What the body grid, or the box of a hand or the face, depends on."""

    pose: TemplateKey
    voxel: float
    everywhere: bool
    version: int
    """Of its fields."""


@dataclass(frozen=True)
class VolumeKey:
    """What a volume depends on."""

    body: PieceKey
    parts: Mapping[str, PieceKey]
    """Of those that are there."""
    hidden: frozenset[str]
    bricks: int
    thin: int
    prefilter: bool


@dataclass(frozen=True)
class BuiltPart:
    """A part's box and what its field prepared for this driving signal."""

    box: UnplacedBox
    state: PartState


@dataclass(frozen=True)
class BuiltBody:
    """The body's field in this pose and its grid, without bricks."""

    field: BodyWithoutHands
    grid: BodyGrid
    stored: BodyGrid
    """`grid` with the bricks of thin limbs, prefiltered."""
    changed: ChangedRegion | None


@dataclass(frozen=True)
class AvatarVolume:
    """The volume and the posed fields it was made from; shading evaluates the same fields for colour."""

    sdf: SdfVolume
    body: BodyWithoutHands
    grid: BodyGrid
    """What the field was evaluated to, without bricks."""
    stored: BodyGrid
    """`grid` with the bricks of thin limbs, prefiltered; bricks that a view adds are in `sdf` alone."""
    parts: dict[str, BuiltPart]
    changed: ChangedRegion | None
    """Where the body differs from that of the previous frame, some of whose state it reuses; None: it is exact."""
    key: VolumeKey

    @property
    def body_frame(self) -> BodyFrame:
        """Of the body's field."""
        return self.body.frame

    @property
    def skin(self) -> TemplateDistance:
        """Of the whole template."""
        return self.body.skin

    @property
    def states(self) -> dict[str, PartState]:
        """What each part prepared, by name."""
        return {name: part.state for name, part in self.parts.items()}

    def follows(self, other: AvatarVolume) -> bool:
        """Whether `changed` tells how the body differs from that of `other`."""
        return self.changed is not None and self.changed.since is other.body_frame


def build_volume(
    avatar: Avatar,
    posed: PosedPerson,
    settings: RenderSettings,
    counters: Counters,
    previous: AvatarVolume | None,
    off_screen: frozenset[str] = frozenset(),
) -> AvatarVolume:
    """Build the volume of `posed`, taking from `previous` every piece whose key has not changed.

    Parts `off_screen` are left out unless `previous` has them.
    """
    key = _key(avatar, posed, settings, previous, off_screen)
    if previous and previous.key == key and _enough(previous, settings):
        return previous
    body, parts = _pieces(avatar, posed, settings, counters, previous, key)
    boxes = []
    for name, part in parts.items():
        if previous and body.stored is previous.stored and previous.parts.get(name) is part:
            boxes.append(next(box for box in previous.sdf.parts if box.name == name))
        else:
            boxes.append(_place(body, part.box, posed.root_from_part(name), counters))
    sdf = SdfVolume(body.stored, tuple(boxes))
    return AvatarVolume(sdf, body.field, body.grid, body.stored, parts, body.changed, key)


def refine_volume(
    volume: AvatarVolume,
    cells: np.ndarray,
    side: int,
    counters: Counters,
    previous: AvatarVolume | None,
) -> AvatarVolume:
    """`volume` with bricks of side³ voxels in the body cells `cells` (flat), besides those that `previous` has."""
    same = previous and previous.grid is volume.grid and previous.key.prefilter == volume.key.prefilter
    kept = previous.sdf.body.bricks if previous and same else None
    if kept is None or kept.side != side:
        kept = Bricks.none(side, volume.grid.sdf.numpy())
    grid = refined(volume.body, volume.grid, cells, kept, counters)
    if grid.bricks is volume.sdf.body.bricks:
        return volume
    return replace(volume, sdf=SdfVolume(prefiltered(grid) if volume.key.prefilter else grid, volume.sdf.parts))


def body_frame(avatar: Avatar, posed: PosedPerson) -> BodyFrame:
    """The body field under the posed template: nodes, embedding, residuals."""
    with torch.no_grad():
        return avatar.body.frame(posed.body, avatar.body.code(posed.body_rotation))


def template_distance(
    avatar: Avatar,
    posed: PosedPerson,
    skin: tuple[np.ndarray, np.ndarray] | None = None,
    near: TemplateDistance | None = None,
) -> TemplateDistance:
    """Distance to the posed template with the avatar's clothing offset.

    `skin`: vertices and normals (v, 3) in place of those of `posed`; `near`: the distance of another pose, whose tree is moved.
    """
    vertices, normals = skin or template_skin(avatar, posed)
    painted = avatar.person.hand_weight.double().numpy(), avatar.body.clothing_offset.double().numpy()
    tree, stands_off = near.closest if near else None, outgrowth(avatar, posed)
    return TemplateDistance.of(vertices, normals, *painted, closed=True, tree=tree, outgrowth=stands_off)


def outgrowth(avatar: Avatar, posed: PosedPerson) -> PosedOutgrowth | None:
    """What stands off the template farther than cloth, in this pose."""
    own, model = avatar.body.outgrowth, avatar.person.body
    if own is None:
        return None
    if own.joint is not None:
        return own.hung(len(model.v_template), posed.body.skinning[int(own.joint)].double().numpy())
    turn = blend_rotations(posed.body.skinning, model.weights[torch.from_numpy(own.carrier)], model.parents)
    return own.carried(posed.body.vertices.double().numpy(), turn.double().numpy())


def template_skin(avatar: Avatar, posed: PosedPerson) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and unit normals of the posed template, (v, 3) float64."""
    normals = skinned_normals(avatar.person.body, posed.body)
    return posed.body.vertices.double().numpy(), normals.double().numpy()


def _key(
    avatar: Avatar,
    posed: PosedPerson,
    settings: RenderSettings,
    previous: AvatarVolume | None,
    off_screen: frozenset[str],
) -> VolumeKey:
    def key(piece: str, voxel: float) -> PieceKey:
        return PieceKey(posed.keys[piece], voxel, settings.everywhere, avatar.versions.get(piece, 0))

    body, old = key("body", settings.voxel), previous.key if previous else None
    unmoved = old is not None and old.body.pose == body.pose
    if settings.reuse_tolerance and previous and old and unmoved and previous.grid.voxel <= settings.voxel:
        # A turned view, or a moved hand, keeps the voxels that are there.
        body = replace(body, voxel=old.body.voxel)
    parts = {name: key(name, settings.part_voxel) for name in PARTS if name not in settings.hidden}
    there = {} if old is None else old.parts
    parts = {name: key for name, key in parts.items() if name not in off_screen or there.get(name) == key}
    return VolumeKey(body, parts, settings.hidden, settings.bricks, _thin_side(settings), settings.prefilter)


def _thin_side(settings: RenderSettings) -> int:
    """Voxels along the side of a brick of thin limbs; 0: they have none."""
    return 0 if settings.bricks else settings.thin


def _enough(previous: AvatarVolume, settings: RenderSettings) -> bool:
    """Whether its body is as exact as these settings want it."""
    return settings.reuse_tolerance > 0 or previous.changed is None


def _pieces(
    avatar: Avatar,
    posed: PosedPerson,
    settings: RenderSettings,
    counters: Counters,
    previous: AvatarVolume | None,
    key: VolumeKey,
) -> tuple[BuiltBody, dict[str, BuiltPart]]:
    """Body and parts of `key`: those of `previous` where theirs is the same, the others anew and side by side."""
    kept, body = {}, None
    if previous:
        kept = {name: previous.parts[name] for name in key.parts if previous.key.parts.get(name) == key.parts[name]}
        if previous.key.body == key.body and _enough(previous, settings):
            body = BuiltBody(previous.body, previous.grid, previous.stored, previous.changed)
            if (previous.key.thin, previous.key.prefilter) != (key.thin, key.prefilter):
                body = replace(body, stored=_stored(avatar, body.field, body.grid, settings, counters))
    work = SideBySide()
    common = avatar, posed, settings, counters
    new_body = None if body else work.add(_body, *common, _reusable(previous, key, settings))
    others = [name for name in reversed(PARTS) if name in key.parts and name not in kept]
    new = {name: work.add(_part, *common, name, _prepared(previous, key, name)) for name in others}
    work.run()
    if new_body:
        body = new_body.result()
    assert body is not None
    return body, {name: kept[name] if name in kept else new[name].result() for name in key.parts}


def _reusable(previous: AvatarVolume | None, key: VolumeKey, settings: RenderSettings) -> AvatarVolume | None:
    """`previous` where its body may be reused in part: it differs in its pose at most."""
    if not settings.reuse_tolerance or previous is None:
        return None
    return previous if replace(previous.key.body, pose=key.body.pose) == key.body else None


def _body(
    avatar: Avatar, posed: PosedPerson, settings: RenderSettings, counters: Counters, before: AvatarVolume | None
) -> BuiltBody:
    """The body of `posed`; what has not moved is reused from `before`, where that is given."""
    state = ReusableBody(body_frame(avatar, posed), *template_skin(avatar, posed), None)
    if before and avatar.body.outgrowth is None:  # far from the skin that carries it, nobody knows what it left
        then = ReusableBody(before.body_frame, before.skin.vertices, before.skin.normals, None)
        state = reuse_unchanged(state, then, settings.reuse_tolerance, avatar.embedding_effect)
    skin = template_distance(avatar, posed, (state.vertices, state.normals), before.skin if before else None)
    body = BodyWithoutHands(avatar.body, state.frame, skin, avatar.ownership)
    kept = PreviousGrid(before.grid, state.changed) if before and state.changed else None
    grid = build_body_grid(body, settings.voxel, counters, settings.everywhere, kept)
    grid = grid if settings.everywhere else without_small_components(grid)
    return BuiltBody(body, grid, _stored(avatar, body, grid, settings, counters), state.changed)


def _stored(
    avatar: Avatar, body: BodyWithoutHands, grid: BodyGrid, settings: RenderSettings, counters: Counters
) -> BodyGrid:
    """`grid` as `settings` want it stored."""
    side = _thin_side(settings)
    stored = with_thin_limbs(body, grid, avatar.person.thin_limbs, side, counters) if side else grid
    return prefiltered(stored) if settings.prefilter else stored


def _prepared(previous: AvatarVolume | None, key: VolumeKey, name: str) -> PartState | None:
    """What the same fields prepared of a part for the signal before."""
    if previous is None or name not in previous.parts:
        return None
    return previous.parts[name].state if previous.key.parts[name].version == key.parts[name].version else None


def _part(
    avatar: Avatar,
    posed: PosedPerson,
    settings: RenderSettings,
    counters: Counters,
    name: str,
    before: PartState | None,
) -> BuiltPart:
    part, vertices = avatar.parts[name], posed.parts[name]
    state = part.prepare(vertices, posed.coefficients[name], counters, before=before)
    box = build_part_box(part, state, vertices, settings.part_voxel, counters, settings.everywhere)
    return BuiltPart(box, state)


def _place(body: BuiltBody, part: UnplacedBox, root_from_part: np.ndarray, counters: Counters) -> PartBox:
    part_from_box = np.eye(4)
    part_from_box[:3, 3] = part.origin
    box_from_root = np.linalg.inv(root_from_part @ part_from_box)
    contact = find_contact(body.field, body.grid, body.stored, part, root_from_part, counters)
    return PartBox(part.name, box_from_root, part.voxel, part.field, contact)
