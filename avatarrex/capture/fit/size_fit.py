"""The size of a captured person whose file has neither our shape nor T-pose joints, from the outlines of the mattes.

A capture of the SMPL-X model says how each joint turns, but its bones and its J_0 belong to a body that is not here. Sought are
β, an offset of each bone (the right side's mirrors the left's) and J_0, where the pelvis is at translation 0:

    argmin  Σ ρ(nᵀ dx − s)²/σ_s²  +  |β|²  +  Σ_bones |offset|²/σ_b²

over the outlines of `outlines.py`, by Gauss–Newton. With the joints' rotations given, a skinned point is linear in rest
positions and joints, so dx is exact but for the β of the skin's smooth field. Before that the boxes about the mattes give J_0
and height, whose first guesses may be metres away. Letters: v vertices, j joints, k constraints, m unknowns. Metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from scipy.interpolate import RBFInterpolator
from tqdm import tqdm

from avatarrex.capture.fit.check import FOREGROUND, posed_in_world, template_surface
from avatarrex.capture.fit.outlines import EDGE_SHARE, Outline, Seen, measured, seen_frames
from avatarrex.capture.fit.person_fit import HEIGHT, height
from avatarrex.capture.readers.rigs import Capture
from avatarrex.errors import InputError
from avatarrex.ops.skinning import blend
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

FRAMES = 4
"""Of each rig: each limb is then seen along and across."""
BOX_OUTLIERS = (5.0, 2.0, 1.0, 0.5, 0.3, 0.2)
"""Metres, by round, at which the weight of a box's side has fallen to ¼ (Geman–McClure)."""
BOX_MARGIN = 0.01
"""Share of a picture's side: a matte that reaches so near to its edge is cut off there."""
ROUNDS = ((0.25, 0.2), (0.2, 0.12), (0.15, 0.08), (0.1, 0.05), (0.08, 0.04), (0.06, 0.03), (0.06, 0.03))
"""By round: metres to look for the matte's edge, and those at which an outline's weight has fallen to ¼."""
OUTLINE_SIGMA, BONE_SIGMA, PLACE_SIGMA = 0.1, 0.05, 10.0
"""σ_s of an outline, σ_b of a bone's offset, σ of J_0, which is as good as free; metres. Outlines agree with each other where clothes and
flesh are not the template's, so that a single one says little: with σ_s = 2 cm the joints are as near to person_f001's and
person_m002's (22 instead of 21 mm, 25 of 25), but by shapes of 4 to 6 standard deviations."""
PLACE, SHAPE = slice(0, 3), slice(3, 13)
"""Rows of the unknowns: J_0 and β; the bones' offsets follow."""
LARGEST = 15.0
"""Of a coefficient of β or a bone's offset in metres: beyond it the fit has diverged."""
LEFT, RIGHT = "left_", "right_"


class NoSize(InputError):
    """The mattes are not those of a person of any size under the capture's poses and cameras."""


def fit_size(capture: Capture, count: int = FRAMES) -> Capture:
    """The capture with a person of the size that its mattes show, its pelvis in place; only the training's split is looked at.

    Raises `InputError` for a picture that cannot be decoded, `NoSize` for mattes that nobody of a person's size has.
    """
    fit = _SizeFit(load_person(capture.person.name), seen_frames(capture, count))
    sigma = np.concatenate([np.full(3, PLACE_SIGMA), np.ones(10), np.full(3 * len(fit.bones), BONE_SIGMA)])
    unknown, coarse = np.zeros(len(sigma)), np.where(np.arange(len(sigma)) <= SHAPE.start, sigma, 1e-6)
    rounds: list[tuple[Callable[[Person, Seen], Outline], float, np.ndarray]] = [
        *((boxes, outlier, coarse) for outlier in BOX_OUTLIERS),
        *((partial(measured, search=search), outlier, sigma) for search, outlier in ROUNDS),
    ]
    for measure, outlier, spread in tqdm(rounds, desc="fit size", unit="round", leave=False):
        unknown = fit.improved(unknown, measure, outlier, spread)
    person = fit.person(unknown)
    if not HEIGHT[0] <= height(person) <= HEIGHT[1]:
        raise NoSize(
            capture.path, "", f"mattes of a person {HEIGHT[0]} to {HEIGHT[1]} m tall", f"{height(person):.2f} m"
        )
    note = f"person: {height(person):.2f} m tall, by the mattes of the training's split"
    return replace(capture.moved(unknown[PLACE]), person=person, sized=True, notes=(*capture.notes, note))


def boxes(person: Person, seen: Seen) -> Outline:
    """Sides of the boxes about the mattes as an outline: the template's outermost vertex is to be on each."""
    vertices = template_surface(person, seen.signals)[0]
    found: list[tuple[int, np.ndarray, float]] = []
    for camera, matte in seen.pictures:
        pixels, depth = camera.pixels(vertices)
        rows, columns = np.nonzero(matte() > FOREGROUND)
        if not len(rows) or depth.min() <= 0:
            continue
        for axis, places in enumerate((columns, rows)):
            size = (camera.width, camera.height)[axis]
            for sign, side in ((-1, float(places.min())), (1, float(places.max() + 1))):
                if BOX_MARGIN * size < side < (1 - BOX_MARGIN) * size:
                    vertex = int((sign * pixels[:, axis]).argmax())
                    metres = depth[vertex] / camera.intrinsics[axis, axis]
                    outward = sign * camera.camera_from_world[axis, :3]
                    found.append((vertex, outward, sign * (side - pixels[vertex, axis]) * metres))
    ends = np.array([[vertex, vertex] for vertex, _, _ in found], int).reshape(-1, 2)
    return Outline(ends, np.array([n for _, n, _ in found]).reshape(-1, 3), np.array([s for _, _, s in found]))


class _SizeFit:
    """The unknowns J_0 (3), β (10) and bones (b, 3) as one row (m,), and how the outlines of `seen` hang on them."""

    def __init__(self, base: Person, seen: list[Seen]) -> None:
        self.base, self.seen = base, seen
        names = base.body.joint_names
        self.bones = [name for name in names[1:22] if not name.startswith(RIGHT)]
        spread = np.zeros((55, 3, len(self.bones), 3))
        for joint in range(1, 55):
            spread[joint] = spread[base.body.parents[joint]]
            if joint < 22:
                side = 1.0 if names[joint].startswith(LEFT) else -1.0 if names[joint].startswith(RIGHT) else 0.0
                spread[joint, :, self.bones.index(names[joint].replace(RIGHT, LEFT))] = np.diag([side, 1.0, 1.0])
        self.spread = spread.reshape(55, 3, -1)
        """A joint's offset by those of the bones that carry it."""

    def person(self, unknown: np.ndarray) -> Person:
        """Of this size. Raises `NoSize` for what no `PersonFit` takes."""
        widest = float(np.abs(unknown[SHAPE.start :]).max())
        if not widest < LARGEST:
            raise NoSize("mattes", "", f"outlines of a person (shape and bones within {LARGEST:g})", f"{widest:.3g}")
        try:
            return resize_person(self.base, PersonFit(unknown[SHAPE], self.spread @ unknown[SHAPE.stop :]))
        except InputError as error:  # so torn that hands and face cannot be cut from it
            expected = "outlines of a person whose hands and face are whole"
            raise NoSize("mattes", "", expected, f"{error.source}: {error.found}") from None

    def improved(
        self, unknown: np.ndarray, measure: Callable[[Person, Seen], Outline], outlier: float, sigma: np.ndarray
    ) -> np.ndarray:
        """One step of Gauss–Newton; `sigma` (m,) of what each unknown is likely to be."""
        person = self.person(unknown)
        change = self._rest_change(person)
        matrix, right = np.diag(sigma**-2.0), np.zeros(len(unknown))
        for one in self.seen:
            signals = one.signals.replace(translation=one.signals.translation + unknown[PLACE])
            outline = measure(person, replace(one, signals=signals))
            rows = outline_change(person, signals, outline, *change)
            weight = (1 + (outline.distance / outlier) ** 2) ** -2 * EDGE_SHARE / OUTLINE_SIGMA**2
            matrix += rows.T @ (rows * weight[:, None])
            right += rows.T @ (weight * (outline.distance + rows @ unknown))
        solved: np.ndarray = np.linalg.solve(matrix, right)
        return solved

    def _rest_change(self, person: Person) -> tuple[np.ndarray, np.ndarray]:
        """How vertices (v, 3, m) and joints (55, 3, m) at rest follow the unknowns."""
        body = self.base.body.double()
        assert person.fit is not None
        shaped = (body.joint_template + body.joint_shapedirs[..., :10] @ torch.from_numpy(person.fit.shape)).numpy()
        place = (body.v_template + body.shapedirs[..., :10] @ torch.from_numpy(person.fit.shape)).numpy()
        field = RBFInterpolator(shaped, self.spread.reshape(55, -1), kernel="linear", degree=1)(place)
        still = np.zeros((len(place), 3, 3))
        vertices = np.concatenate([still, body.shapedirs[..., :10].numpy(), field.reshape(len(place), 3, -1)], 2)
        joints = np.concatenate([still[:55], body.joint_shapedirs[..., :10].numpy(), self.spread], 2)
        return vertices, joints


def outline_change(
    person: Person, signals: Signals, outline: Outline, vertices: np.ndarray, joints: np.ndarray
) -> np.ndarray:
    """nᵀ dx (k, m) of the outline's edges, by the change of vertices and joints at rest."""
    posed, world = posed_in_world(person, signals)
    turn = posed.joint_transforms[:, :3, :3].double().numpy()
    moved = _carried(person, turn, joints) - np.einsum("jcd,jdm->jcm", turn, joints)
    used, row = np.unique(outline.vertices, return_inverse=True)
    weights = person.body.weights[used]
    linear = blend(posed.skinning, weights)[:, :, :3].double().numpy()
    points = np.einsum("ucd,udm->ucm", linear, vertices[used])
    points += (weights.double().numpy() @ moved.reshape(55, -1)).reshape(points.shape)
    points = np.einsum("cd,udm->ucm", world[:3, :3], points)
    points[:, :, PLACE] += np.eye(3)
    change: np.ndarray = np.einsum("kc,kcm->km", outline.outward, points[row.reshape(outline.vertices.shape)].mean(1))
    return change


def joints_change(person: Person, signals: Signals, joints: np.ndarray) -> np.ndarray:
    """dp (55, 3, m) of the posed joints, world, by their change at rest (55, 3, m) beside the root."""
    posed, world = posed_in_world(person, signals)
    turn = posed.joint_transforms[:, :3, :3].double().numpy()
    return np.asarray(np.einsum("cd,jdm->jcm", world[:3, :3], _carried(person, turn, joints)))


def _carried(person: Person, turn: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(55, 3, m): each bone's change turned as the bone is, added up from the root, which stays."""
    moved = np.zeros_like(joints)
    for joint, parent in enumerate(person.body.parents[1:], 1):
        moved[joint] = moved[parent] + turn[parent] @ (joints[joint] - joints[parent])
    return moved
