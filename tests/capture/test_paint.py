"""A pose is brought back by colours where outlines do not see that it is off."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from capture.test_pose_fit import CAMERAS, ROUNDS, posed, shot

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.fit.paint import Paint, Points
from avatarrex.capture.fit.photo import Blurred, Photo
from avatarrex.capture.fit.pose_change import TURNED, UNKNOWNS, Levers, stepped
from avatarrex.capture.fit.pose_fit import Shot, fit_pose
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

STRIPES = 2 * np.pi / 0.08
"""Radians a metre at rest."""
AROUND = CAMERAS[:4]
ELBOW, WRIST = (JOINT_NAMES.index(f"left_{name}") for name in ("elbow", "wrist"))


@pytest.fixture(scope="module")
def person() -> Person:
    return resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3))))


def pattern(person: Person, points: np.ndarray) -> np.ndarray:
    """Colours of places (…, 3) at rest."""
    return np.asarray(0.5 + 0.3 * np.sin(STRIPES * points))


def photo(person: Person, signals: Signals, camera: Camera, light: float = 1.0) -> Photo:
    """Of somebody in a soft pattern."""
    faces, rest = person.body.faces.numpy(), person.body.v_template.double().numpy()
    face, share, _ = visible_faces(template_surface(person, signals)[0], faces, camera)
    colour = light * pattern(person, np.einsum("hwk,hwkc->hwc", share, rest[faces[face]]))
    picture, matte = np.rint(255 * colour * (face >= 0)[..., None]).astype(np.uint8), 255 * (face >= 0).astype(np.uint8)
    return Photo(camera, partial(np.asarray, picture), partial(np.asarray, matte))


def photos(person: Person, signals: Signals, *lights: float) -> tuple[Photo, ...]:
    return tuple(photo(person, signals, *each) for each in zip(AROUND, lights))


def rolled(person: Person, signals: Signals, angle: float) -> Signals:
    """The left forearm turned about itself."""
    joints, row = template_surface(person, signals)[1], TURNED.index(ELBOW)
    bone = (joints[WRIST] - joints[ELBOW]) / np.linalg.norm(joints[WRIST] - joints[ELBOW])
    step = np.zeros(UNKNOWNS)
    step[3 + 3 * row : 6 + 3 * row] = angle * Levers.of(person, signals).axes[row].T @ bone
    return stepped(signals, step)


def off(person: Person, one: Signals, other: Signals) -> float:
    """Mean distance of the left forearm's skin, metres."""
    own = person.body.weights.numpy()[:, ELBOW] > 0.8
    skins = (template_surface(person, signals)[0][own] for signals in (one, other))
    return float(np.linalg.norm(np.subtract(*skins), axis=1).mean())


def test_colours_bring_back_what_outlines_do_not_see(person: Person, rng: np.random.Generator) -> None:
    """A forearm that is turned about itself; the exposure of the cameras differs from that of the paint."""
    exact, other = posed(rng), posed(rng)
    paint = Paint.of(person, [(other, photos(person, other, 1, 1, 1, 1))])
    first = rolled(person, exact, 0.25)
    mattes = shot(person, exact, first).seen
    seen = Shot(first, replace(mattes, pictures=mattes.pictures[:4]), (), photos(person, exact, 0.7, 0.6, 0.8, 0.65))
    outlines, colours = fit_pose(person, seen, first, ROUNDS[2:]), fit_pose(person, seen, first, ROUNDS, paint)
    before = off(person, first, exact)
    assert before > 0.005
    assert off(person, outlines, exact) > 0.7 * before
    assert off(person, colours, exact) < 0.35 * before


def test_paint_is_the_pattern(person: Person, rng: np.random.Generator) -> None:
    """Of what was seen; a picture of something else does not count."""
    exact, other = posed(rng), posed(rng)
    views = photos(person, exact, 1, 1, 1, 1)
    wrong = replace(views[0], image=lambda: np.full_like(views[0].image(), 255))
    paint = Paint.of(person, [(exact, views), (other, photos(person, other, 1, 1, 1, 1)), (exact, (wrong,))])
    rest, faces = person.body.v_template.double().numpy(), person.body.faces.numpy()
    place = np.einsum("pk,pkc->pc", paint.points.share, rest[faces[paint.points.face]])
    assert 0.5 < paint.known.mean() < 1
    away = np.abs(paint.colour - pattern(person, place))[paint.known]
    assert away.mean() < 0.06


def test_points_lie_evenly_and_not_on_hands(person: Person) -> None:
    points, body = Points.of(person), person.body
    owner = body.weights.numpy().argmax(1)[body.faces.numpy()[points.face, points.share.argmax(1)]]
    assert np.isin(owner, (ELBOW, WRIST + 1)).sum() > 500
    assert (owner >= JOINT_NAMES.index("left_index1")).mean() < 0.001


def test_slopes_are_those_of_the_picture(rng: np.random.Generator) -> None:
    """A picture that is linear in its columns and rows, seen from where its points are moved to."""
    camera = Camera.orbit(30, 10, 3.0, 45, (0, 0, 0), 64, 48)
    row, column = np.mgrid[:48, :64] + 0.5
    layers = [
        layer
        for _ in range(3)
        for layer in (0.01 * column + 0.02 * row, np.full((48, 64), 0.01), np.full((48, 64), 0.02))
    ]
    picture, place = Blurred(camera, np.stack(layers), np.ones((48, 64), bool)), 0.2 * rng.standard_normal((20, 3))
    colour, slope = picture.at(place)
    for axis in np.eye(3):
        moved = (picture.at(place + 1e-5 * axis)[0] - picture.at(place - 1e-5 * axis)[0]) / 2e-5
        np.testing.assert_allclose(slope @ axis, moved, atol=1e-5)
    assert np.ptp(colour) > 0.1


def test_a_point_is_hidden_by_what_lies_before_it() -> None:
    """Two squares behind each other, one of them turned away where it is seen alone, and a matte that ends."""
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    vertices = np.concatenate([0.2 * square, square - [0, 0, 0.5]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [4, 6, 5], [4, 7, 6]])
    camera = Camera.orbit(0, 0, 3.0, 60, (0, 0, 0), 60, 60)
    solid = np.ones((60, 60), bool)
    solid[:, :20] = False
    picture = Blurred(camera, np.zeros((9, 60, 60)), solid)
    place = np.array([[0, -0.1, 0], [0, 0, -0.5], [0.6, 0, -0.5], [0.6, 0, -0.5], [-0.9, 0, -0.5]])
    seen = picture.shows(vertices, faces, np.array([0, 2, 2, 4, 2]), place, 0.006)
    assert (seen != 0).tolist() == [True, False, True, False, False]
    vertices[4:, 2] = -0.003  # as far behind as a lid is thick
    place[:, 2] = vertices[[0, 4, 4, 4, 4], 2]
    for tolerance, thin in ((0.006, True), (0.002, False)):
        seen = picture.shows(vertices, faces, np.array([0, 2, 2, 4, 2]), place, tolerance)
        assert (seen != 0).tolist() == [True, thin, True, False, False]
