"""What of a person no skin explains: an outgrowth (fields/outgrowth.py) carved from the training's mattes, a visual hull at rest.

Voxels about the template are carried along in some frames, by the skin or by a joint, and projected into all pictures. One belongs to
the hull where (nearly) all pictures have the person (Laurentini 1994), and to an outgrowth where many have it outside the template's
own outline, so that the air between an arm and the chest, before or behind which there mostly is a limb, does not count.

Letters: p voxels. Root frame at rest, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter, label
from scipy.spatial import cKDTree

from avatarrex.avatar import Avatar
from avatarrex.capture.fit.check import FOREGROUND, compared_frames, posed_in_world, silhouette
from avatarrex.capture.readers.rigs import Rig
from avatarrex.fields.outgrowth import MARGIN, REACH, VOXEL, Outgrowth
from avatarrex.ops.skinning import blend_rotations

FRAMES = 16
NEAREST, FARTHEST = 0.02, REACH - 0.015
"""Metres from the nearest vertex between which an outgrowth is looked for."""
INSIDE = 0.95
"""Share of the pictures that have to have the person at a voxel."""
UNEXPLAINED = 0.2
"""Share of the pictures that have to have it there outside the template's outline."""
ASIDE = 0.04
"""Metres beyond the template's outline that cloth explains."""
AROUND = 0.03
"""Metres around an unexplained voxel within which the hull belongs to the outgrowth."""
LEAST = 100
"""Voxels (of half a cubic centimetre) of an outgrowth at least: less is noise of the mattes."""
ALL, MORE = 0.95, 1.1
"""Share of what the skin carries that hangs on the joint, too, and how many times as much has to: another thing elsewhere stays."""
ANCHORED = 0.025
"""Metres between the anchors of an outgrowth, about those of the skin."""
CARRIES = 0.1
"""Share of the skin beneath an outgrowth that a joint moves at least, that it may hang on it."""


@dataclass(frozen=True)
class _Voxels:
    """Those about the template that may be an outgrowth's."""

    first: np.ndarray
    """The grid's lowest voxel: x, y, z."""
    shape: tuple[int, ...]
    """z, y, x."""
    points: Float[np.ndarray, "p 3"]

    def within(self, some: Bool[np.ndarray, " p"]) -> _Voxels:
        """Some of them."""
        return replace(self, points=self.points[some])

    def hull(self, inside: Float[np.ndarray, " p"], unexplained: Float[np.ndarray, " p"]) -> Bool[np.ndarray, "z y x"]:
        """The outgrowth by their evidence; empty where there is none."""
        hull, seed = np.zeros(self.shape, bool), np.zeros(self.shape, bool)
        place = tuple((np.rint(self.points / VOXEL).astype(int) - self.first).T[::-1])
        hull[place] = inside >= INSIDE
        seed[place] = (inside >= INSIDE) & (unexplained >= UNEXPLAINED)
        pieces, _ = label(seed)
        size = np.bincount(pieces.ravel())
        size[0] = 0
        seed = (size >= LEAST)[pieces]
        near = distance_transform_edt(~seed) * VOXEL <= AROUND if seed.any() else seed
        return np.asarray(hull & near)


def carve(avatar: Avatar, rig: Rig) -> Outgrowth | None:
    """What stands off the avatar's template in the pictures of the rig that are not held out; None where nothing does.

    What the vertices beneath it carry or, where that is in it and clearly more is found so, what hangs on one of their joints: a pony tail
    turns with the head, though its end is next to the back.
    """
    voxels = _voxels(avatar)
    hull, joint = voxels.hull(*_evidence(avatar, rig, voxels.points)), None
    if not hull.any():
        return None
    found = (np.argwhere(hull)[:, ::-1] + voxels.first) * VOXEL
    near = voxels.within(cKDTree(found).query(voxels.points, distance_upper_bound=REACH)[0] < np.inf)
    hung = {each: near.hull(*_evidence(avatar, rig, near.points, each)) for each in _carriers(avatar, found)}
    whole = {each: one for each, one in hung.items() if (one & hull).sum() >= ALL * hull.sum()}
    best = max(whole, key=lambda each: whole[each].sum(), default=None)
    if best is not None and whole[best].sum() > MORE * hull.sum():
        hull, joint = whole[best], best
    return _distance(voxels.first, hull, joint)


def _carriers(avatar: Avatar, points: Float[np.ndarray, "p 3"]) -> list[int]:
    """Joints that move a good part of the skin beneath."""
    body = avatar.person.body
    nearest = cKDTree(body.v_template.double().numpy()).query(points)[1]
    share = np.bincount(body.weights.argmax(1).numpy()[nearest], minlength=body.weights.shape[1]) / len(points)
    carriers: list[int] = np.flatnonzero(share >= CARRIES).tolist()
    return carriers


def _voxels(avatar: Avatar) -> _Voxels:
    """Those beside the template."""
    rest = avatar.person.body.v_template.double().numpy()
    first = np.floor((rest.min(0) - REACH) / VOXEL).astype(int)
    last = np.ceil((rest.max(0) + REACH) / VOXEL).astype(int)
    axes = [np.arange(a, b + 1) for a, b in zip(first, last)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3) * VOXEL
    distance, nearest = cKDTree(rest).query(points, distance_upper_bound=FARTHEST)
    beside = np.isfinite(distance) & (distance > NEAREST)
    nearest = np.where(beside, nearest, 0)
    normal = avatar.person.body.normals.double().numpy()[nearest]
    beside &= (np.einsum("pc,pc->p", points - rest[nearest], normal) > 0) & ~avatar.body.replaced.numpy()[nearest]
    return _Voxels(first, tuple(len(axis) for axis in axes[::-1]), points[beside])


def _evidence(
    avatar: Avatar, rig: Rig, points: Float[np.ndarray, "p 3"], joint: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Shares (p,) of the pictures that see each voxel: with the person there, and with it outside the template's outline.

    `joint`: what carries the voxels; None: the nearest vertex of each.
    """
    person, rest = avatar.person, avatar.person.body.v_template.double().numpy()
    nearest = cKDTree(rest).query(points)[1]
    lever = points - rest[nearest]
    seen, inside, unexplained = np.zeros((3, len(points)))
    free = [frame for frame in range(rig.frames) if frame not in rig.held_out_frames]
    for frame in (free[k] for k in compared_frames(len(free), FRAMES)):
        posed, world = posed_in_world(person, rig.signals[frame])
        vertices = posed.vertices.double().numpy()
        if joint is None:
            turn = blend_rotations(posed.skinning, person.body.weights, person.body.parents).double().numpy()
            placed = vertices[nearest] + np.einsum("pij,pj->pi", turn[nearest], lever)
        else:
            moved = posed.skinning[joint].double().numpy()
            placed = points @ moved[:3, :3].T + moved[:3, 3]
        placed, vertices = (some @ world[:3, :3].T + world[:3, 3] for some in (placed, vertices))
        for view in (view for view in range(len(rig.views)) if view not in rig.held_out_views):
            if not rig.available(view, frame):
                continue
            camera = rig.views[view].camera
            pixel, depth = camera.pixels(placed, nearest=1e-3)
            column, row = np.floor(pixel).astype(int).T
            there = (depth > 0.02) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
            column, row = np.where(there, column, 0), np.where(there, row, 0)
            person_there = there & (rig.matte(view, frame)[row, column] > FOREGROUND)
            radius = max(round(ASIDE * camera.intrinsics[0, 0] / float(np.median(depth))), 1)
            outline = binary_dilation(silhouette(vertices, person.body.faces.numpy(), camera), iterations=radius)
            seen += there
            inside += person_there
            unexplained += person_there & ~outline[row, column]
    return inside / np.maximum(seen, 1), unexplained / np.maximum(seen, 1)


def _distance(first: np.ndarray, hull: np.ndarray, joint: int | None) -> Outgrowth:
    """The signed distance of a hull (z, y, x) whose lowest voxel is `first` (x, y, z), on a joint."""
    margin = int(np.ceil(MARGIN / VOXEL))
    hull = np.pad(hull, margin)
    inside = np.argwhere(hull)
    low, high = inside.min(0) - margin, inside.max(0) + margin + 1
    own = hull[tuple(slice(a, b) for a, b in zip(low, high))]
    distance = np.where(own, 0.5 - distance_transform_edt(own), distance_transform_edt(~own) - 0.5) * VOXEL
    smooth = gaussian_filter(distance, 1.0).clip(max=MARGIN)
    found = Outgrowth(torch.from_numpy(first - margin + low[::-1]), torch.from_numpy(smooth).float())
    return found if joint is None else found.hanging_on(joint, ANCHORED)
