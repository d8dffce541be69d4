"""A capture's tracking refined by its own pictures (paper, appendix *Implementation details*): shape and poses of 20 frames of
each rig, then, with the shape fixed, the pose of every frame by itself.

Only the training's split is read. What else is refined than the paper's: with the shape the skin is fitted to the mattes of the same
frames (`surface_fit.py`), so that clothes do not pull at the poses; the avatar's training fits its own anew. Jaw, eyes and expressions
stay as they were tracked. Letters: t frames, j joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from tqdm import tqdm

from avatarrex.capture.fit.check import shown_frames
from avatarrex.capture.fit.outlines import Seen
from avatarrex.capture.fit.paint import Paint, Posed
from avatarrex.capture.fit.photo import Photo
from avatarrex.capture.fit.pose_fit import NAKED_SIGMA, Marks, Round, Shot, fit_pose, fit_shape, keypoint_cost
from avatarrex.capture.fit.surface_fit import fit_to_mattes
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Splits
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

SHAPE_FRAMES = 20
"""Of each rig (paper)."""
SKIN_FRAMES = 6
"""Of each rig: each limb is then seen along and across."""
SHAPE_ROUNDS = (Round(0.06, 0.03, NAKED_SIGMA), Round(0.04, 0.02, NAKED_SIGMA))
"""Each after the skin has been fitted to the poses that are known by then: without clothes on it shape takes them for flesh."""
CLEARLY = 0.8
"""Share of the cost that poses by outlines may have: they follow the noise of a frame's keypoints, by 1 % on a prepared capture."""
BLURS = (0.010, 0.005)
"""Metres, round by round, in which colours of those frames are compared; each paints anew, and ends with the skin on the mattes again."""
PATTERN_ROUNDS = (Round(0.04, 0.02),) * 3
"""By colours, too."""
NEAR = 2
"""Rounds of a pose after which its colours are within reach: two more change nothing (3.6 and 3.5 mm, 21.95 and 21.90 dB)."""
POSE_ROUNDS = (Round(0.08, 0.05), Round(0.06, 0.03), Round(0.04, 0.02), Round(0.04, 0.02))
NAKED_ROUNDS = (Round(0.08, 0.05, NAKED_SIGMA), Round(0.06, 0.03, NAKED_SIGMA))
"""Before the skin is on the mattes."""


@dataclass(frozen=True, eq=False)
class Body:
    """Whom the poses are fitted for."""

    person: Person
    """Of the refined shape, its skin on the mattes; signals for it have a β of zero."""
    paint: Paint | None = None
    """Its colours, where poses are fitted by them."""

    @property
    def shape(self) -> np.ndarray:
        """β, (10,)."""
        assert self.person.fit is not None
        return self.person.fit.shape


def refine_body(capture: Capture, colours: bool = True) -> Body:
    """Shape and skin, with `colours` those, too, from `SHAPE_FRAMES` frames. What reading a picture raises is raised."""
    first, off = _starting_fit(capture), np.zeros(10)
    shots = key_shots(capture, SHAPE_FRAMES)
    poses = first_poses(_shaped(capture, first, off), shots)
    for step in SHAPE_ROUNDS:
        dressed = _dressed(_shaped(capture, first, off), shots, poses)
        poses, change = fit_shape(dressed, shots, poses, off, step)
        off = off + change
    dressed = _dressed(_shaped(capture, first, off), shots, poses)
    if not colours:
        return Body(dressed)
    for blur in tqdm(BLURS, desc="refine colours", unit="round", leave=False):
        paint = Paint.of(dressed, _shown(shots, poses), blur)
        poses = [fit_pose(dressed, one, pose, PATTERN_ROUNDS[:1], paint) for one, pose in zip(shots, poses)]
        dressed = _dressed(_shaped(capture, first, off), shots, poses)
    return Body(dressed, Paint.of(dressed, _shown(shots, poses)))


def refine_pose(body: Body, rig: Rig, frame: int) -> Signals:
    """Of one frame, by all cameras of the training's split; its β is zero. What reading a picture raises is raised."""
    one = shot(rig, frame)
    if body.paint is None:
        return fit_pose(body.person, one, one.first, POSE_ROUNDS)
    near = fit_pose(body.person, one, one.first, POSE_ROUNDS[:NEAR])
    return fit_pose(body.person, one, near, PATTERN_ROUNDS, body.paint)


def first_poses(person: Person, shots: list[Shot]) -> list[Signals]:
    """What the skin is first fitted to: poses as they were tracked, or by outlines where keypoints agree with those clearly more.

    Outlines of the naked template are drawn by clothes, and a skin that is fitted there keeps them. What reading a matte raises is raised.
    """
    outlined = [fit_pose(person, one, one.first, NAKED_ROUNDS) for one in tqdm(shots, "refine shape", leave=False)]
    tracked = [one.first for one in shots]
    ways, found = (sum(map(partial(keypoint_cost, person), shots, poses)) for poses in (tracked, outlined))
    return outlined if found <= CLEARLY * ways else tracked


def _dressed(person: Person, shots: list[Shot], poses: list[Signals]) -> Person:
    """With its skin on the mattes of some of the frames."""
    few = slice(None, None, max(SHAPE_FRAMES // SKIN_FRAMES, 1))
    return fit_to_mattes(person, [one.at(pose) for one, pose in zip(shots[few], poses[few])])


def _shown(shots: list[Shot], poses: list[Signals]) -> Iterator[Posed]:
    """The frames' pictures with their poses."""
    return ((pose, one.photos) for one, pose in zip(shots, poses))


def shot(rig: Rig, frame: int) -> Shot:
    """What the training's cameras saw of a frame."""
    views = [view for view in Splits.of(rig).train.views if rig.available(view, frame)]
    first = rig.signals[frame].replace(shape=np.zeros(10))
    pictures = tuple((rig.views[view].camera, partial(rig.matte, view, frame)) for view in views)
    points = rig.keypoints
    marks = () if points is None else tuple(
        Marks(rig.views[view].camera, points.joints, *points.at(view, frame)) for view in views
    )  # fmt: skip
    photos = tuple(
        Photo(camera, partial(rig.image, view, frame), matte) for view, (camera, matte) in zip(views, pictures)
    )
    return Shot(first, Seen(first, pictures), marks, photos)


def key_shots(capture: Capture, count: int) -> list[Shot]:
    """`count` frames of each rig, evenly spread over the training's split."""
    return [shot(rig, frame) for rig in capture.rigs.values() for frame in shown_frames(rig, count)]


def _starting_fit(capture: Capture) -> PersonFit:
    """The capture's person as one that is resized."""
    if capture.person.fit is not None:
        return replace(capture.person.fit, surface=None)
    rig = next(iter(capture.rigs.values()))
    return PersonFit(rig.signals[Splits.of(rig).train.frames[0]].shape, np.zeros((55, 3)))


def _shaped(capture: Capture, first: PersonFit, off: np.ndarray) -> Person:
    """The person with another β than at first."""
    return resize_person(load_person(capture.person.name), replace(first, shape=first.shape + off))
