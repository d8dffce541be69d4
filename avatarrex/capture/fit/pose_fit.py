"""Pose and shape of a person from the pictures, beginning at what tracking says (paper, appendix *Implementation details*).

    E = E_sil + λ_1 E_kpt + λ_2 E_reg

E_sil compares silhouettes, E_kpt detected keypoints with the projected joints, E_reg = |θ − θ_init|² + |β − β_init|². By
Gauss–Newton: E_sil by the outlines of `outlines.py`, whose distances s from the template's edge to the matte's are weighted by the
edges' lengths, Σ ℓ ρ(s)/σ_s². The derivative of the pixels' error by the pose lies on that outline alone: a soft rasteriser spreads it over
a band of pixels and descends in hundreds of steps, where Gauss–Newton on the distances needs a few. (Where the rim folds, at fingers,
several edges share it and count each.)

Letters: k constraints, m unknowns of a pose, b those of the shape. World metres, radians, pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.fit.outlines import Seen, measured
from avatarrex.capture.fit.paint import Paint, Pull
from avatarrex.capture.fit.photo import Photo
from avatarrex.capture.fit.pose_change import UNKNOWNS, Levers, stepped, way_from
from avatarrex.capture.fit.size_fit import joints_change, outline_change
from avatarrex.capture.readers.rigs import Rig
from avatarrex.capture.readers.splits import Splits
from avatarrex.capture.zbuffer import NEAREST_DEPTH
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person

OUTLINE_LENGTH, NAKED_SIGMA, DRESSED_SIGMA = 0.05, 0.02, 0.01
"""Metres of outline that count as one measurement, and its σ: neighbours err together, by clothes and flesh, less once the skin is on
the mattes."""
KEYPOINT_SIGMA, KEYPOINT_OUTLIER = 0.006, 0.03
"""Of a picture's longer side: σ of a keypoint of confidence 1, and where its weight has fallen to ¼ (Geman–McClure)."""
TURN_SIGMA, PLACE_SIGMA, SHAPE_SIGMA = 0.05, 0.02, 0.3
"""What tracking may be off: radians of a joint, metres of the root, coefficients of β. (λ_2 of the paper is one for pose and shape, and
per picture; outlines of a clothed person agree with each other on a shape that is not hers.)"""


@dataclass(frozen=True, eq=False)
class Marks:
    """Keypoints of one picture."""

    camera: Camera
    joints: tuple[int, ...]
    points: np.ndarray
    """(k, 2)."""
    confidence: np.ndarray
    """(k,)."""


@dataclass(frozen=True, eq=False)
class Shot:
    """One frame: its tracked pose, mattes, keypoints."""

    first: Signals
    seen: Seen
    marks: tuple[Marks, ...]
    photos: tuple[Photo, ...] = ()

    def at(self, signals: Signals) -> Seen:
        """The mattes, with another pose."""
        return Seen(signals, self.seen.pictures)


@dataclass(frozen=True)
class Round:
    """One step of a fit."""

    search: float
    """Metres to look for the matte's edge."""
    outlier: float
    """Metres at which an outline's weight has fallen to ¼."""
    sigma: float = DRESSED_SIGMA
    """Metres, of the outlines."""


@dataclass(eq=False)
class Equations:
    """Normal equations H x = g of a step."""

    matrix: np.ndarray
    right: np.ndarray

    def add(self, rows: np.ndarray, residual: np.ndarray, weight: np.ndarray) -> None:
        """Constraints rows x = residual."""
        weighted = rows * weight[:, None]
        self.matrix += rows.T @ weighted
        self.right += weighted.T @ residual


def pose_equations(person: Person, shot: Shot, signals: Signals, step: Round, shaped: bool = False) -> Equations:
    """Of a frame: m unknowns of its pose, after which with `shaped` come ten changes of β."""
    count = UNKNOWNS + (10 if shaped else 0)
    found, levers = Equations(np.zeros((count, count)), np.zeros(count)), Levers.of(person, signals)
    outline = measured(person, shot.at(signals), step.search)
    rows = levers.of_edges(outline.vertices, outline.outward)
    shape = _shape_directions(person) if shaped else None
    if shape is not None:
        rows = np.concatenate([rows, outline_change(person, signals, outline, *shape)[:, 3:]], 1)
    ends = person.body.v_template[outline.vertices].double().numpy()
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    robust = (1 + (outline.distance / step.outlier) ** 2) ** -2
    found.add(rows, outline.distance, robust * length / (OUTLINE_LENGTH * step.sigma**2))
    change = levers.of_joints(tuple(range(55)))
    if shape is not None:
        change = np.concatenate([change, joints_change(person, signals, shape[1])[..., 3:]], 2)
    for marks in shot.marks:
        _add_marks(found, levers.joints, change, marks)
    sigma = np.concatenate([np.full(3, PLACE_SIGMA), np.full(UNKNOWNS - 3, TURN_SIGMA)])
    away = np.zeros(count)
    away[:UNKNOWNS] = way_from(shot.first, signals)
    weight = np.zeros(count)
    weight[:UNKNOWNS] = sigma**-2.0
    found.matrix += np.diag(weight)
    found.right -= weight * away
    return found


def add_pattern(found: Equations, person: Person, signals: Signals, pull: Pull) -> None:
    """Let colours draw at the equations of a pose."""
    rows = Levers.of(person, signals).of_edges(pull.vertex[:, None], pull.axis)
    found.add(rows, pull.distance, pull.weight)


def _shape_directions(person: Person) -> tuple[np.ndarray, np.ndarray]:
    """How vertices (v, 3, 13) and joints (55, 3, 13) at rest follow place (not at all) and β."""
    body = person.body
    vertices, joints = (part[..., :10].double().numpy() for part in (body.shapedirs, body.joint_shapedirs))
    joints = joints - joints[:1]
    return tuple(np.concatenate([np.zeros((len(part), 3, 3)), part], 2) for part in (vertices, joints))  # type: ignore[return-value]


def _add_marks(found: Equations, places: np.ndarray, change: np.ndarray, marks: Marks) -> None:
    """Of joints that are at `places` (55, 3) and move by `change` (55, 3, m)."""
    camera = marks.camera
    kept = np.flatnonzero(camera.seen(places[list(marks.joints)])[:, 2] > NEAREST_DEPTH)
    if not len(kept):
        return
    joints = np.array(marks.joints)[kept]
    size = max(camera.width, camera.height)
    rows = camera.slopes(places[joints]) @ change[joints]
    off = marks.points[kept] - camera.pixels(places[joints])[0]
    robust = (1 + (np.linalg.norm(off, axis=1) / (KEYPOINT_OUTLIER * size)) ** 2) ** -2
    weight = robust * (marks.confidence[kept] / (KEYPOINT_SIGMA * size)) ** 2
    found.add(rows.reshape(-1, rows.shape[2]), off.ravel(), np.repeat(weight, 2))


def keypoint_cost(person: Person, shot: Shot, signals: Signals) -> float:
    """E_kpt of a pose: Σ ρ(way / σ), robust; 0 without keypoints."""
    joints, total = template_surface(person, signals)[1], 0.0
    for marks in shot.marks:
        size = max(marks.camera.width, marks.camera.height)
        away = np.linalg.norm(marks.points - marks.camera.pixels(joints[list(marks.joints)])[0], axis=1) / size
        robust = away**2 / (1 + (away / KEYPOINT_OUTLIER) ** 2)
        total += float((marks.confidence / KEYPOINT_SIGMA) ** 2 @ robust)
    return total


def keypoint_error(person: Person, rig: Rig) -> float | None:
    """Mean distance of the posed joints from the keypoints, pixels, weighted by confidence, over the training's split; None without any."""
    found, split = rig.keypoints, Splits.of(rig).train
    total, weights = 0.0, 0.0
    for frame in split.frames if found else ():
        assert found is not None
        joints = template_surface(person, rig.signals[frame])[1][list(found.joints)]
        for view in split.views:
            points, confidence = found.at(view, frame)
            away = np.linalg.norm(points - rig.views[view].camera.pixels(joints)[0], axis=1)
            total, weights = total + float(confidence @ away), weights + float(confidence.sum())
    return total / weights if weights else None


def fit_pose(
    person: Person, shot: Shot, signals: Signals, rounds: tuple[Round, ...], paint: Paint | None = None
) -> Signals:
    """The frame's pose, from `signals` on; with `paint` by its colours, too. What reading a picture raises is raised."""
    for step in rounds:
        found = pose_equations(person, shot, signals, step)
        if paint is not None:
            add_pattern(found, person, signals, paint.pull(person, (signals, shot.photos)))
        signals = stepped(signals, np.linalg.solve(found.matrix, found.right))
    return signals


def fit_shape(
    person: Person, shots: list[Shot], poses: list[Signals], off: np.ndarray, step: Round
) -> tuple[list[Signals], np.ndarray]:
    """Poses of all frames and a change of β (10,), solved together; β is `off` (10,) from tracking's.

    The poses are eliminated first (Schur complement): they meet in β alone.
    """
    matrix, right = np.eye(10) / SHAPE_SIGMA**2, -off / SHAPE_SIGMA**2
    kept = []
    for shot, signals in zip(shots, poses):
        found = pose_equations(person, shot, signals, step, shaped=True)
        own, both, shape = found.matrix[:UNKNOWNS, :UNKNOWNS], found.matrix[:UNKNOWNS, UNKNOWNS:], slice(UNKNOWNS, None)
        solved = np.linalg.solve(own, np.column_stack([both, found.right[:UNKNOWNS]]))
        matrix = matrix + found.matrix[shape, shape] - both.T @ solved[:, :-1]
        right = right + found.right[shape] - both.T @ solved[:, -1]
        kept.append(solved)
    change = np.linalg.solve(matrix, right)
    return [stepped(one, solved[:, -1] - solved[:, :-1] @ change) for one, solved in zip(poses, kept)], change
