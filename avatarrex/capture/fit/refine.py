"""A capture's tracking refined by its own pictures (paper, appendix *Implementation details*): shape and poses of 20 frames of
each rig, then, with the shape fixed, the pose of every frame by itself.

Only the training's split is read. What else is refined than the paper's: with the shape the skin is fitted to the mattes of the same
frames (`surface_fit.py`), so that clothes do not pull at the poses; the avatar's training fits its own anew. Jaw, eyes and expressions
stay as they were tracked. Letters: t frames, j joints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from tqdm import tqdm

from avatarrex.capture.fit.check import shown_frames
from avatarrex.capture.fit.outlines import Seen
from avatarrex.capture.fit.pose_fit import Marks, Round, Shot, fit_pose, fit_shape
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
SHAPE_ROUNDS = (Round(0.06, 0.03), Round(0.04, 0.02))
"""Each after the skin has been fitted to the poses that are known by then: without clothes on it shape takes them for flesh."""
POSE_ROUNDS = (Round(0.08, 0.05), Round(0.06, 0.03), Round(0.04, 0.02), Round(0.04, 0.02))


@dataclass(frozen=True, eq=False)
class Body:
    """Whom the poses are fitted for."""

    person: Person
    """Of the refined shape, its skin on the mattes; signals for it have a β of zero."""

    @property
    def shape(self) -> np.ndarray:
        """β, (10,)."""
        assert self.person.fit is not None
        return self.person.fit.shape


def refine_body(capture: Capture) -> Body:
    """Shape and skin, from `SHAPE_FRAMES` frames. What reading a picture raises is raised."""
    first, off = _starting_fit(capture), np.zeros(10)
    shots = key_shots(capture, SHAPE_FRAMES)
    person = _shaped(capture, first, off)
    poses = [fit_pose(person, one, one.first, POSE_ROUNDS[:2]) for one in tqdm(shots, desc="refine shape", leave=False)]
    few = slice(None, None, SHAPE_FRAMES // SKIN_FRAMES)
    for step in SHAPE_ROUNDS:
        dressed = fit_to_mattes(person, [one.at(pose) for one, pose in zip(shots[few], poses[few])])
        poses, change = fit_shape(dressed, shots, poses, off, step)
        off = off + change
        person = _shaped(capture, first, off)
    return Body(fit_to_mattes(person, [one.at(pose) for one, pose in zip(shots[few], poses[few])]))


def refine_pose(body: Body, rig: Rig, frame: int) -> Signals:
    """Of one frame, by all cameras of the training's split; its β is zero. What reading a picture raises is raised."""
    one = shot(rig, frame)
    return fit_pose(body.person, one, one.first, POSE_ROUNDS)


def shot(rig: Rig, frame: int) -> Shot:
    """What the training's cameras saw of a frame."""
    views = [view for view in Splits.of(rig).train.views if rig.available(view, frame)]
    first = rig.signals[frame].replace(shape=np.zeros(10))
    pictures = tuple((rig.views[view].camera, partial(rig.matte, view, frame)) for view in views)
    points = rig.keypoints
    marks = () if points is None else tuple(
        Marks(rig.views[view].camera, points.joints, *points.at(view, frame)) for view in views
    )  # fmt: skip
    return Shot(first, Seen(first, pictures), marks)


def key_shots(capture: Capture, count: int) -> list[Shot]:
    """`count` frames of each rig, evenly spread over the training's split."""
    return [shot(rig, frame) for rig in capture.rigs.values() for frame in shown_frames(rig, count)]


def _starting_fit(capture: Capture) -> PersonFit:
    """The capture's person as one that is resized."""
    if capture.person.fit is not None:
        return replace(capture.person.fit, surface=None)
    return PersonFit(next(iter(capture.rigs.values())).signals[0].shape, np.zeros((55, 3)))


def _shaped(capture: Capture, first: PersonFit, off: np.ndarray) -> Person:
    """The person with another β than at first."""
    return resize_person(load_person(capture.person.name), replace(first, shape=first.shape + off))
