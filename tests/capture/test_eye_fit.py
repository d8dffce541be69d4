"""Lids are found by drawing them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import pytest
from scipy.spatial import cKDTree

from avatarrex.camera import Camera
from avatarrex.capture.fit import eye_fit
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.fit.eye_fit import fit_eyes
from avatarrex.capture.fit.paint import Posed
from avatarrex.capture.fit.photo import Photo
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.templates.face_offsets import FaceOffsets
from avatarrex.templates.model import EYES
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

BODY = load_person().body
REST, FACES = BODY.v_template.double().numpy(), BODY.faces.numpy()
BALLS = BODY.of_groups(EYES).numpy()
EYE = REST[BALLS].mean(0)
"""Between both."""
BLINK = [EXPRESSION_NAMES.index(name) for name in ("eyeBlinkLeft", "eyeBlinkRight")]
FINER = 3
"""Samples along a pixel of the pictures, which are drawn finer than the fit draws."""
CLOSE = [Camera.orbit(angle, 0, 0.7, 10, tuple(EYE), 320, 160) for angle in (-30, 0, 30)]
BEHIND = [Camera.orbit(angle, 0, 0.7, 10, tuple(EYE), 320, 160) for angle in (160, 180, 200)]
"""No eye is in sight from there."""


def lids() -> np.ndarray:
    """Vertices of the left eye's upper lid, where it meets the ball, a few millimetres apart."""
    ball = REST[BODY.groups["left_eye"]]
    near = ~BALLS & (cKDTree(ball).query(REST)[0] < 0.004)
    upper = near & (REST[:, 1] > ball[:, 1].mean() + 0.003) & (REST[:, 2] > ball[:, 2].mean())
    return np.flatnonzero(upper)


def person(rest: Sequence[float] = (0, 0, 0), closing: float = 0.0) -> Person:
    """Its left upper lid moved, and less of both blinks."""
    chosen = lids()[::4]
    moves = closing * BODY.expression_dirs.double().numpy()[chosen][..., BLINK]
    offsets = FaceOffsets(
        tuple(chosen.tolist()), np.tile(rest, (len(chosen), 1)), np.eye(52)[BLINK], moves, eye_joints=True
    )
    return resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3)), face=offsets))


def signals(blink: float, gaze: float = 0.0) -> Signals:
    expression = np.zeros(52)
    expression[BLINK] = blink
    return Signals.rest().replace(expression=expression, eye_pose=np.tile([gaze, 0, 0], (2, 1)))


def colour(face: np.ndarray, share: np.ndarray) -> np.ndarray:
    """White balls with dark irises, patterned skin."""
    place = np.einsum("hwk,hwkc->hwc", share, REST[FACES[face]])
    ball = BALLS[FACES[face]].all(-1)
    front = max(REST[BODY.groups["left_eye"]].tolist(), key=lambda point: point[2])
    iris = np.linalg.norm(np.abs(place[..., :2]) - np.abs(front[:2]), axis=-1) < 0.006
    skin = 0.5 + 0.1 * np.sin(2 * np.pi * place / 0.012)
    eye = np.where(iris, 0.15, 0.85)[..., None] * np.ones(3)
    return np.asarray(np.where(ball[..., None], eye, skin))


def photo(somebody: Person, one: Signals, camera: Camera, gain: float) -> Photo:
    """As a camera integrates over its pixels."""
    h, w = camera.height, camera.width
    face, share, _ = visible_faces(template_surface(somebody, one)[0], FACES, camera.resized(w * FINER, h * FINER))
    fine = gain * colour(face, share) * (face >= 0)[..., None]
    picture = np.rint(255 * fine.reshape(h, FINER, w, FINER, 3).mean((1, 3))).astype(np.uint8)
    matte = np.rint(255 * (face >= 0).reshape(h, FINER, w, FINER).mean((1, 3))).astype(np.uint8)
    return Photo(camera, partial(np.asarray, picture), partial(np.asarray, matte))


def pictures(
    somebody: Person, gains: tuple[float, ...] = (1.0, 1.0, 1.0), cameras: list[Camera] = CLOSE
) -> list[Posed]:
    return [
        (one, tuple(photo(somebody, one, camera, gain) for camera, gain in zip(cameras, gains)))
        for one in (signals(0.0), signals(0.0, 0.4), signals(0.3, -0.3), signals(0.6))
    ]


def off(one: Person, two: Person, blink: float) -> float:
    """The part of the eyeballs that one shows and the other hides, of what the second shows."""
    camera = CLOSE[1].resized(4 * CLOSE[1].width, 4 * CLOSE[1].height)
    faces = (visible_faces(template_surface(each, signals(blink))[0], FACES, camera)[0] for each in (one, two))
    first, second = ((face >= 0) & BALLS[FACES[face]].all(-1) for face in faces)
    return float((first != second).sum() / second.sum())


def test_a_lid_that_ends_lower_is_found_whatever_the_exposures() -> None:
    """In twelve pictures of three exposures, by more than a third."""
    theirs = person((0, -0.0015, 0))
    found = fit_eyes(person(), pictures(theirs, (0.55, 0.8, 1.1)))
    before, after = off(person(), theirs, 0.0), off(found, theirs, 0.0)
    assert before > 0.2
    assert after < 0.65 * before


def test_expressions_move_what_they_did() -> None:
    fit = fit_eyes(person(), pictures(person((0, -0.0015, 0), closing=-0.3))).fit
    assert fit is not None
    assert fit.face is not None
    assert fit.face.rest.any()
    assert not fit.face.moves.any()


def test_lids_that_are_right_stay() -> None:
    theirs = person((0, -0.0015, 0))
    assert off(fit_eyes(theirs, pictures(theirs)), theirs, 0.0) < 0.015


def test_without_an_eye_in_sight_nothing_moves() -> None:
    theirs = person((0, -0.0015, 0))
    found = fit_eyes(person(), pictures(theirs, cameras=BEHIND))
    assert found.fit is not None
    assert found.fit.face is not None
    assert not found.fit.face.rest.any()


def test_an_eye_that_a_picture_cuts_to_a_line_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(eye_fit, "LEAST", 5)
    theirs = person((0, -0.0015, 0))
    edge = int(CLOSE[1].pixels(REST[BODY.groups["left_eye"]])[0][:, 0].mean())
    cut = [CLOSE[1].cropped(edge, 0, 1, CLOSE[1].height)]
    found = fit_eyes(person(), pictures(theirs, (1.0,), cut))
    assert found.fit is not None
    assert found.fit.face is not None
    assert not found.fit.face.rest.any()


def test_an_eyeball_moves_with_the_head_whatever_the_gaze() -> None:
    """Where its joint moves along."""
    mesh, up = eye_fit._Mesh.about(BODY, "left_eye"), 0.001
    weights = (mesh.share @ BALLS.astype(float))[:, None]
    one = signals(0, 0.4).replace(global_orient=np.array([0, 0.5, 0]))
    joint = JOINT_NAMES.index("left_eye")
    front = max(BODY.groups["left_eye"].tolist(), key=lambda vertex: REST[vertex, 2])
    moved = FaceOffsets((front,), np.array([[0, up, 0]]), np.zeros((0, 52)), np.zeros((1, 3, 0)), eye_joints=True)
    theirs = resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3)), face=moved))
    assert theirs.body.joint_template[joint, 1] - BODY.joint_template[joint, 1] == pytest.approx(up, abs=1e-6)
    cameras = [
        Camera.orbit(np.degrees(0.5) + 45, 0, 0.7, 10, tuple(template_surface(person(), one)[1][joint]), 320, 160)
    ]
    seen = [eye_fit._Picture.of(photo(person(), one, camera, 1.0)) for camera in cameras]
    view = eye_fit._views(person(), mesh, weights, one, seen)[0]
    ball = np.abs(view.moves[:, 0]).sum((1, 2)) > 0
    places = [template_surface(each, one)[0][front] for each in (person(), theirs)]
    pixels = np.diff(cameras[0].pixels(np.stack(places))[0], axis=0)[0] / up
    assert ball.sum() > 50
    full = view.moves[:, 0] / np.maximum(np.linalg.norm(view.moves[:, 0], axis=(1, 2), keepdims=True), 1e-9)
    wanted = pixels / np.linalg.norm(pixels)
    found = full[ball][:, :, 1].mean(0)
    np.testing.assert_allclose(found / np.linalg.norm(found), wanted, atol=0.05)


def test_a_drawn_picture_changes_as_the_jacobian_says() -> None:
    """As the skin about an eyeball moves up: the colours of both are even, so that all that changes is where lids end."""
    mesh = eye_fit._Mesh.about(BODY, "left_eye")
    place = np.concatenate([mesh.share @ REST, REST])
    skin = (~BALLS).astype(float)
    weights, paint = (mesh.share @ skin)[:, None], colour_of_corners(mesh)
    seen = eye_fit._Picture.of(photo(person(), signals(0), CLOSE[1], 1.0))

    def view(up: float) -> eye_fit._View:
        moved = place + up * np.concatenate([weights[:, 0], skin])[:, None] * [0, 1, 0]
        found = eye_fit._view(mesh, moved, weights, np.tile(np.eye(3), (len(weights), 1, 1)), seen)
        assert found is not None
        return found

    step, middle = 4e-4, view(0.0)  # half a pixel
    windows = np.full((2, *middle.shape, 3), np.nan)
    for window, one in zip(windows, (view(step), view(-step))):
        window[one.place] = one.matrix @ paint
    wanted = ((windows[0] - windows[1]) / (2 * step))[middle.place]
    found = middle.jacobian(middle.matrix @ paint)[:, :, 1]
    shown = np.isfinite(wanted)
    wanted, found = wanted[shown], found[shown]
    both = np.abs(wanted) + np.abs(found) > 20
    assert both.sum() > 300
    assert np.corrcoef(wanted[both], found[both])[0, 1] > 0.8
    assert (wanted * found).sum() / np.square(found).sum() == pytest.approx(1, abs=0.2)


def colour_of_corners(mesh: eye_fit._Mesh) -> np.ndarray:
    """(t, 3): dark balls, bright skin."""
    ball = mesh.share @ BALLS.astype(float)
    return np.asarray(np.where(ball[:, None] > 0.999, 0.2, 0.7) * np.ones(3))


def test_triangles_are_divided_where_they_lie() -> None:
    mesh = eye_fit._Mesh.about(BODY, "right_eye")
    place, whole = mesh.share @ REST, FACES

    def area(corners: np.ndarray) -> np.ndarray:
        a, b, c = corners.swapaxes(0, 1)
        return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))

    eye = REST[BODY.groups["right_eye"]].mean(0)
    near = (np.linalg.norm(REST - eye, axis=1) < eye_fit.DRAWN)[whole].all(1)
    drawn = area(place[mesh.faces[: mesh.drawn]])
    assert drawn.sum() == pytest.approx(area(REST[whole[near]]).sum())
    assert mesh.drawn == 16 * near.sum()
    assert drawn[mesh.ball].sum() == pytest.approx(area(REST[whole[near & BALLS[whole].all(1)]]).sum())
    np.testing.assert_allclose(mesh.uneven @ np.ones(len(place)), 0, atol=1e-9)
    values = np.arange(len(place), dtype=float)
    ends = {tuple(sorted(pair)) for a, b, c in mesh.faces[: mesh.drawn].tolist() for pair in ((a, b), (b, c), (c, a))}
    assert values @ (mesh.uneven @ values) == pytest.approx(sum((values[a] - values[b]) ** 2 for a, b in ends))
