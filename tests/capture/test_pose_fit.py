"""Poses and shape come back from outlines and keypoints; the derivatives are those of the posed template."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import silhouette, template_surface
from avatarrex.capture.fit.outlines import Seen, measured
from avatarrex.capture.fit.pose_change import TURNED, UNKNOWNS, Levers, stepped, way_from
from avatarrex.capture.fit.pose_fit import SHAPE_SIGMA, Marks, Round, Shot, fit_pose, fit_shape, pose_equations
from avatarrex.capture.fit.refine import first_poses
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.limits import random_signals
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

CAMERAS = [Camera.orbit(72 * k, 10, 3.0, 45, (0, -0.1, 0), 240, 320) for k in range(5)]
ROUNDS = (Round(0.08, 0.05), Round(0.06, 0.03), Round(0.04, 0.02))
ALL = tuple(range(55))


def posed(rng: np.random.Generator) -> Signals:
    return random_signals(rng, 0.3).replace(translation=np.zeros(3), shape=np.zeros(10), expression=np.zeros(52))


def off_by(signals: Signals, rng: np.random.Generator) -> Signals:
    """2° a joint, 1 cm of the root."""
    step = np.concatenate(
        [0.01 / np.sqrt(3) * rng.standard_normal(3), 0.035 / np.sqrt(3) * rng.standard_normal(UNKNOWNS - 3)]
    )
    return stepped(signals, step)


def matte(person: Person, signals: Signals, camera: Camera) -> np.ndarray:
    return 255 * silhouette(template_surface(person, signals)[0], person.body.faces.numpy(), camera).astype(np.uint8)


def shot(person: Person, exact: Signals, first: Signals, marked: bool = False) -> Shot:
    """What the cameras saw of somebody, with keypoints that are right where `marked`."""
    pictures = tuple((camera, partial(matte, person, exact, camera)) for camera in CAMERAS)
    joints = template_surface(person, exact)[1]
    marks = tuple(Marks(camera, ALL, camera.pixels(joints)[0], np.ones(55)) for camera in CAMERAS)
    return Shot(first, Seen(first, pictures), marks if marked else ())


def error(person: Person, one: Signals, other: Signals) -> float:
    """Mean distance of the body's joints, metres."""
    joints = (template_surface(person, signals)[1][:22] for signals in (one, other))
    return float(np.linalg.norm(np.subtract(*joints), axis=1).mean())


@pytest.fixture(scope="module")
def person() -> Person:
    return resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3))))


def test_points_follow_the_joints(person: Person, rng: np.random.Generator) -> None:
    """Against differences of whole posed templates, without the blend shapes that are left out."""
    bare = replace(person, body=replace(person.body, posedirs=None, pose_columns=None))
    signals = random_signals(rng, 0.4).replace(shape=0.5 * rng.standard_normal(10))
    ends, outward = rng.integers(0, len(person.body.v_template), (60, 2)), rng.standard_normal((60, 3))
    levers = Levers.of(bare, signals)
    edges, joints = levers.of_edges(ends, outward), levers.of_joints(ALL)
    neutral = signals.replace(expression=np.zeros(52))
    wanted = ("pelvis", "spine2", "left_shoulder", "right_wrist", "left_knee", "right_index2")
    for column in (0, 1, 2, *(3 + 3 * TURNED.index(JOINT_NAMES.index(name)) + k for name in wanted for k in range(3))):
        step = np.zeros(UNKNOWNS)
        step[column] = 0.01
        (one, first), (other, second) = (template_surface(bare, stepped(neutral, way)) for way in (step, -step))
        moved = np.einsum("kc,kc->k", outward, (one - other)[ends].mean(1)) / 0.02
        np.testing.assert_allclose(edges[:, column], moved, atol=2e-4)
        np.testing.assert_allclose(joints[..., column], (first - second) / 0.02, atol=2e-4)


def test_steps_add_up(rng: np.random.Generator) -> None:
    first = random_signals(rng, 0.4)
    step = 0.2 * rng.standard_normal(UNKNOWNS)
    after = stepped(first, step)
    np.testing.assert_allclose(way_from(first, after), step, atol=1e-9)
    np.testing.assert_array_equal(after.jaw_pose, first.jaw_pose)
    np.testing.assert_array_equal(after.expression, first.expression)
    knee = JOINT_NAMES.index("left_knee")
    own = Rotation.from_rotvec(np.array(first.body_pose[knee - 1]))
    turn = Rotation.from_rotvec(step[3 + 3 * TURNED.index(knee) :][:3]) * own
    np.testing.assert_allclose(after.body_pose[knee - 1], turn.as_rotvec(), atol=1e-9)


def test_the_outline_carries_the_gradient_of_the_pixels_error(person: Person, rng: np.random.Generator) -> None:
    """What of silhouette and matte differs, in m² at the person, grows along a step as −Σ ℓ sign(s) J says.

    But for one factor: where the rim folds several edges share it. It is a part of `OUTLINE_LENGTH`.
    """
    exact = posed(rng)
    camera = Camera.orbit(20, 0, 6.0, 20, (0, -0.1, 0), 900, 1200)
    truth = matte(person, exact, camera) > 0
    scale, factors = (6.0 / camera.intrinsics[0, 0]) ** 2, []
    for column, size in ((0, 0.02), (0, -0.02), (1, 0.02), (5, -0.05)):
        step = np.zeros(UNKNOWNS)
        step[column] = size
        signals = stepped(exact, step)
        outline = measured(person, Seen(signals, ((camera, lambda: (255 * truth).astype(np.uint8)),)), 0.06)
        ends = camera.seen(template_surface(person, signals)[0][outline.vertices])[..., :2]
        length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        slope = -(length * np.sign(outline.distance)) @ Levers.of(person, signals).of_edges(
            outline.vertices, outline.outward
        )
        more, less = (
            ((matte(person, stepped(exact, way * step), camera) > 0) ^ truth).sum() * scale for way in (1.25, 0.75)
        )
        factors.append(slope[column] * 0.5 * size / (more - less))
    assert min(factors) > 0.9
    assert max(factors) < 1.25 * min(factors)


def test_outlines_weigh_by_the_sigma_of_the_round(person: Person, rng: np.random.Generator) -> None:
    exact = posed(rng)
    one = shot(person, exact, off_by(exact, rng))
    none, wide, near = (
        pose_equations(person, seen, one.first, Round(0.06, 0.03, sigma))
        for seen, sigma in ((replace(one, seen=Seen(one.first, ())), 0.01), (one, 0.02), (one, 0.01))
    )
    np.testing.assert_allclose(near.matrix - none.matrix, 4 * (wide.matrix - none.matrix), atol=1e-6)
    np.testing.assert_allclose(near.right - none.right, 4 * (wide.right - none.right), atol=1e-6)


@pytest.mark.parametrize(("marked", "share"), [(False, 0.45), (True, 0.1)])
def test_a_pose_comes_back(person: Person, rng: np.random.Generator, marked: bool, share: float) -> None:
    exact = posed(rng)
    first = off_by(exact, rng)
    one = shot(person, exact, first, marked)
    found = fit_pose(person, one, first, ROUNDS)
    assert error(person, found, exact) < share * error(person, first, exact)


def test_keypoints_alone_and_wrong_ones(person: Person, rng: np.random.Generator) -> None:
    """Without a picture's matte they are enough; a few that are far off, and those that were not seen, hardly pull."""
    exact = posed(rng)
    first = off_by(exact, rng)
    one = shot(person, exact, first, True)
    one = replace(one, seen=Seen(first, ()))
    before = error(person, first, exact)
    assert error(person, fit_pose(person, one, first, ROUNDS), exact) < 0.1 * before
    wrong = []
    for marks in one.marks:
        points, confidence = marks.points.copy(), marks.confidence.copy()
        points[rng.integers(0, 55, 3)] += 120
        points[5], confidence[5] = 1e5, 0
        wrong.append(replace(marks, points=points, confidence=confidence))
    assert error(person, fit_pose(person, replace(one, marks=tuple(wrong)), first, ROUNDS), exact) < 0.2 * before


def test_confidence_weighs(person: Person, rng: np.random.Generator) -> None:
    """None is as if the joint were not named; less pulls less."""
    exact = posed(rng)
    first = off_by(exact, rng)
    joints, left = template_surface(person, exact)[1], np.arange(55) < 30

    def found(confidence: float, named: tuple[int, ...] = ALL) -> Signals:
        marks = [
            Marks(
                camera,
                named,
                (camera.pixels(joints)[0] + np.where(left, 0, 4)[:, None])[list(named)],
                np.where(left, 1, confidence)[list(named)],
            )
            for camera in CAMERAS
        ]
        return fit_pose(person, Shot(first, Seen(first, ()), tuple(marks)), first, ROUNDS)

    unnamed = found(1, ALL[:30])
    np.testing.assert_allclose(way_from(unnamed, found(0)), 0, atol=1e-9)
    half, whole = (np.abs(way_from(unnamed, found(confidence))).sum() for confidence in (0.1, 1))
    assert 0 < half < 0.9 * whole


def test_shape_is_kept_where_tracking_had_it(person: Person, rng: np.random.Generator) -> None:
    first, off = posed(rng), rng.standard_normal(10)
    poses, change = fit_shape(person, [Shot(first, Seen(first, ()), ())], [first], off, ROUNDS[0])
    np.testing.assert_allclose(change, -off)
    np.testing.assert_allclose(way_from(first, poses[0]), 0, atol=1e-12)


def test_nothing_seen_leaves_the_pose(person: Person, rng: np.random.Generator) -> None:
    first = posed(rng)
    found = fit_pose(person, Shot(first, Seen(first, ()), ()), first, ROUNDS)
    np.testing.assert_allclose(found.full_pose(), first.full_pose(), atol=1e-12)
    away = fit_pose(person, Shot(first, Seen(first, ()), ()), off_by(first, rng), ROUNDS[:1])
    np.testing.assert_allclose(way_from(first, away), 0, atol=1e-6)


def test_shape_comes_back_with_the_poses(person: Person, rng: np.random.Generator) -> None:
    """Somebody of another β seen in three poses; solved at once, as eliminating the poses must give."""
    beta = np.array([0.8, -0.5, 0.6, *np.zeros(7)])
    somebody = resize_person(load_person(), PersonFit(beta, np.zeros((55, 3))))
    exact = [posed(rng) for _ in range(3)]
    poses = [off_by(one, rng) for one in exact]
    shots = [shot(somebody, one, first, True) for one, first in zip(exact, poses)]
    off, own = np.zeros(10), person
    whole, right = _whole_system(own, shots, poses)
    expected = np.linalg.solve(whole, right)[-10:]
    for step in ROUNDS:
        poses, change = fit_shape(own, shots, poses, off, step)
        if step is ROUNDS[0]:
            np.testing.assert_allclose(change, expected, atol=1e-8)
        off = off + change
        own = resize_person(load_person(), PersonFit(off, np.zeros((55, 3))))
    at_rest = [one.body.v_template.double().numpy() for one in (own, somebody, person)]
    assert np.abs(at_rest[0] - at_rest[1]).mean() < 0.4 * np.abs(at_rest[2] - at_rest[1]).mean()
    assert max(error(somebody, one, other) for one, other in zip(poses, exact)) < 0.012


def _whole_system(person: Person, shots: list[Shot], poses: list[Signals]) -> tuple[np.ndarray, np.ndarray]:
    """All poses and β in one matrix."""
    size = len(shots) * UNKNOWNS + 10
    matrix, right = np.zeros((size, size)), np.zeros(size)
    matrix[-10:, -10:] = np.eye(10) / SHAPE_SIGMA**2
    for number, (one, signals) in enumerate(zip(shots, poses)):
        found = pose_equations(person, one, signals, ROUNDS[0], shaped=True)
        place = np.r_[number * UNKNOWNS : (number + 1) * UNKNOWNS, size - 10 : size]
        matrix[np.ix_(place, place)] += found.matrix
        right[place] += found.right
    return matrix, right


def test_clothes_do_not_choose_the_poses_that_skin_is_fitted_to(person: Person, rng: np.random.Generator) -> None:
    """Good tracking stays, though mattes are of somebody wider and poses could follow a detector's noise; bad tracking gives way."""
    exact = posed(rng)
    wide = resize_person(load_person(), PersonFit(2 * np.eye(10)[1], np.zeros((55, 3))))
    cases = ((wide, exact, 0, True), (person, exact, 2, True), (person, off_by(exact, rng), 2, False))
    for mattes, first, noise, kept in cases:
        seen = shot(person, exact, first, marked=True)
        marks = (replace(one, points=one.points + noise * rng.standard_normal(one.points.shape)) for one in seen.marks)
        seen = replace(seen, marks=tuple(marks))
        pictures = tuple((camera, partial(matte, mattes, exact, camera)) for camera in CAMERAS)
        one = replace(seen, seen=Seen(first, pictures))
        (chosen,) = first_poses(person, [one])
        assert (chosen is first) == kept
    (unmarked,) = first_poses(person, [replace(one, marks=())])
    assert unmarked is not one.first
