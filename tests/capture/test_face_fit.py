"""A face of other proportions and other expression shapes is found by its colours."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from capture.striped_face import (
    CAMERAS,
    EXPRESSIONS,
    JAW,
    LAMP,
    TURN,
    Y_TURN,
    cheek,
    chin,
    off,
    outer,
    person,
    photo,
    pictures,
    signals,
)
from capture.tiny_capture import TinyCapture
from scipy.spatial import cKDTree

from avatarrex.camera import Camera
from avatarrex.capture.fit import expression_gains, face_fit, lips
from avatarrex.capture.fit.capture_fit import fit_geometry
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.fit.face_fit import fit_face, fit_to_pictures
from avatarrex.capture.fit.lips import away_from_lips, touching
from avatarrex.capture.fit.paint import Points, Posed, Seen, sights
from avatarrex.capture.fit.photo import Photo
from avatarrex.capture.readers.drawn import MAKER
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.face_offsets import FaceOffsets, mesh_edges
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.model import EYES, MOUTH
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit, SurfaceOffsets


@pytest.fixture(autouse=True)
def no_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains of expressions have tests of their own (test_expression_gains.py)."""
    monkeypatch.setattr(expression_gains, "BLURS", ())


@pytest.fixture(scope="module")
def other() -> Person:
    """A cheek 6 mm farther out, and a jaw that opens by a third less. (A face that slid on itself would look the same: nobody knows
    its colours.)"""
    body, face = load_person().body, load_person().face
    nodes = face.body_vertex_ids.numpy()[face.blend_weight.numpy() > 0.3][::10]
    rest = body.v_template.double().numpy()
    out = np.exp(-0.5 * (np.linalg.norm(rest[nodes] - rest[cheek()], axis=1) / 0.025) ** 2)
    less = -body.expression_dirs[nodes][..., [JAW]].double().numpy() / 3
    return person(FaceOffsets(tuple(nodes.tolist()), out[:, None] * [0.005, 0, 0.003], np.eye(52)[[JAW]], less))


def test_rest_and_expressions_are_found(other: Person, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(face_fit, "SPACING", 0.02)
    found = fit_to_pictures(person(), pictures(other), (0.004, 0.003))
    for names, about in (({}, cheek()), (EXPRESSIONS[1], chin())):
        before, after = off(person(), other, names, about), off(found, other, names, about)
        assert before > 5
        assert after < 0.75 * before  # nine pictures of a faint pattern, and priors that want less


def test_an_eyeball_that_lies_elsewhere_is_found_but_for_its_lids(monkeypatch: pytest.MonkeyPatch) -> None:
    """By its colours alone; its lids, which are where they were, keep it."""
    monkeypatch.setattr(face_fit, "SPACING", 0.02)
    monkeypatch.setattr(face_fit, "FINE", 0.02)
    body = load_person().body
    place = body.v_template.double().numpy()
    front = [max(body.groups[name].tolist(), key=lambda vertex: place[vertex, 2]) for name in face_fit.EYES]
    away = np.array([[0.002, 0.0, 0.002], [0.0, 0.0, 0.0]])
    theirs = person(FaceOffsets(tuple(front), away, np.zeros((0, 52)), np.zeros((2, 3, 0))))
    close = [
        Camera.orbit(np.degrees(TURN) + angle, 0, 0.7, 10, tuple(Y_TURN @ place[front].mean(0)), 240, 120)
        for angle in (-50, 0, 50)
    ]

    def missed() -> float:
        fit = fit_to_pictures(person(), pictures(theirs, cameras=close), (0.003, 0.002, 0.002)).fit
        assert fit is not None
        assert fit.face is not None
        assert fit.face.vertices[:2] == tuple(front)
        return float(np.linalg.norm(fit.face.rest[0] - away[0]) / np.linalg.norm(away[0]))

    assert missed() > 0.7
    monkeypatch.setattr(face_fit, "LIDS", 0.0)
    assert missed() < 0.5  # lids that are elsewhere than theirs hide a third of its points


def of_balls(points: Points) -> np.ndarray:
    """Which of them lie on eyeballs."""
    body = load_person().body
    return np.isin(body.faces.numpy()[points.face], np.concatenate([body.groups[name] for name in EYES])).all(1)


def test_points_of_an_eyeball_next_to_lids_do_not_count() -> None:
    """Within the radius at rest; skin is left as it is."""
    base = load_person()
    points = face_fit._points(base)
    ball, rest = of_balls(points), base.body.v_template.double().numpy()[base.body.faces.numpy()[points.face]]
    place = np.einsum("pk,pkc->pc", points.share, rest)
    open_eye = ball & (place[:, 2] > np.quantile(place[ball, 2], 0.5))
    row = np.flatnonzero(open_eye | (~ball & (np.arange(len(ball)) % 3 > 0)))
    colour = place[row]
    sight = row, place[row, 0], colour, np.repeat(place[row, :, None], 3, axis=2)
    kept, cosine, seen, slope = face_fit._clear_of_lids(sight, face_fit._near_on_eyes(base, points, 0.003))
    away = cKDTree(place[ball & ~open_eye]).query(place[row])[0]
    np.testing.assert_array_equal(kept, row[~ball[row] | (away > 0.003)])
    assert 0.3 * open_eye.sum() < ball[kept].sum() < 0.9 * open_eye.sum()
    np.testing.assert_array_equal(seen, place[kept])
    np.testing.assert_array_equal(cosine, place[kept, 0])
    np.testing.assert_array_equal(slope[:, :, 2], place[kept])


def test_blurred_pictures_say_less_of_eyeballs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blurred by as much as an eye is open, one says nothing of an eyeball; a sharper one of what lies as far from lids as its blur."""
    points, improve = face_fit._points(load_person()), face_fit._Field.improve
    counts, ball, clear = [], of_balls(points), away_from_lips(load_person().body, points) > 0.012

    def counted(field: face_fit._Field, somebody: Person, poses: list[Signals], seen: list[list[Seen]]) -> None:
        rows = [row for shown in seen for row, *_ in shown]
        counts.append([sum(int(kind[row].sum()) for row in rows) for kind in (ball, ~ball & clear)])
        improve(field, somebody, poses, seen)

    monkeypatch.setattr(face_fit._Field, "improve", counted)
    fit_to_pictures(person(), pictures(person()), (0.006, 0.003, 0.001))
    (none, skin), (some, _), (many, same) = counts
    assert many > 800
    assert none == 0
    assert 0.2 * many < some < 0.4 * many  # half of it at ¾ of the blur, none at 1.5
    assert skin == pytest.approx(same, rel=0.02)


def test_closed_lids_hide_eyeballs() -> None:
    """They are thinner than what elsewhere counts as the same surface."""
    points = face_fit._points(load_person())
    ball = of_balls(points)
    shown = []
    for names in ({}, {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0}):
        one = signals(names)
        seen = sights(person(), points, (one, (photo(person(), one, CAMERAS[1]),)), 0.003)
        shown.append(sum(ball[row].sum() for row, *_ in seen))
    assert shown[0] > 100
    assert shown[1] < 0.1 * shown[0]


def test_expressions_move_no_eyeballs() -> None:
    """Hardly, even where pictures say so: what closes is lids."""
    base, nobody = load_person(), np.eye(52)[[JAW]]
    field = face_fit._Field(base, face_fit._points(base), nobody, np.zeros(52))
    eye = np.isin(field.nodes, np.concatenate([base.body.groups[name] for name in face_fit.EYES]))
    form = np.broadcast_to(1e4 * np.eye(6), (len(field.skin), 6, 6))
    rest, move = np.moveaxis(np.abs(field._solved(form, np.full((len(field.skin), 6), 1e2))), 2, 0)
    assert move[eye].max() < 0.15 * np.median(move[~eye])
    assert rest[eye].min() > 0.3 * np.median(rest[~eye])


def between_lips(somebody: Person) -> np.ndarray:
    """(c, 3) from lower to upper lip at rest, where the template's touch: by how much farther they are apart, metres."""
    upper, lower = touching(load_person().body).T
    rest, own = (each.body.v_template.double().numpy() for each in (load_person(), somebody))
    return (own[upper] - own[lower]) - (rest[upper] - rest[lower])


def test_lips_touch_from_corner_to_corner_where_the_jaw_parts_them() -> None:
    body = load_person().body
    pairs, rest = touching(body), body.v_template.double().numpy()
    assert len(pairs) > 30
    assert np.linalg.norm(rest[pairs[:, 0]] - rest[pairs[:, 1]], axis=1).max() < 0.004
    upper, lower = rest[pairs[:, 0], 0], rest[pairs[:, 1], 0]
    assert max(upper.min(), lower.min()) < -0.018
    assert min(upper.max(), lower.max()) > 0.018
    opened = rest + body.expression_dirs[..., JAW].double().numpy()
    away = opened[pairs[:, 0]] - opened[pairs[:, 1]]
    assert np.linalg.norm(away, axis=1).min() > 0.01
    assert (away[:, 1] > 0).all()  # the first is the upper one


def test_where_no_lips_touch_nothing_is_near_them() -> None:
    """A template whose mouth is open at rest, and one whose jaw carries nothing."""
    base = load_person()
    apart = base.body.v_template + base.body.expression_dirs[..., JAW]
    stiff = base.body.weights.clone()
    stiff[:, JOINT_NAMES.index("jaw")] = 0
    for body in (replace(base.body, v_template=apart), replace(base.body, weights=stiff)):
        assert touching(body).shape == (0, 2)
        assert np.isinf(away_from_lips(body, face_fit._points(base))).all()
    somebody = replace(base, body=body)
    field = face_fit._Field(somebody, face_fit._points(base), np.eye(52)[[JAW]], np.zeros(52))
    form = np.broadcast_to(1e4 * np.eye(6), (len(field.skin), 6, 6))
    assert np.isfinite(field._solved(form, np.ones((len(field.skin), 6)))).all()


def pulled_apart(field: face_fit._Field) -> tuple[np.ndarray, np.ndarray]:
    """What pictures say that draw lips apart, less with a mean expression than with more of it: form (v, 6, 6) and pull (v, 6)."""
    upper, lower = (np.isin(field.skin, side) for side in touching(load_person().body).T)
    pull = np.zeros((len(field.skin), 6))
    pull[upper, 2:4], pull[lower, 2:4] = (400, 200), (-400, -200)  # along y, at rest and along the direction
    return np.broadcast_to(1e5 * np.eye(6), (len(pull), 6, 6)), pull


def test_lips_that_pictures_draw_apart_stay_closed_at_rest_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    base, jaw = load_person(), np.eye(52)[[JAW]]

    def parted() -> list[float]:
        """Millimetres at ψ = 0, and at more than the mean expression."""
        field = face_fit._Field(base, face_fit._points(base), jaw, 0.4 * jaw[0])
        field.now = field._solved(*pulled_apart(field))
        face = field.offsets()
        moved = replace(face, rest=face.rest + face.moves[..., 0])
        return [1e3 * float(np.abs(between_lips(person(each))[:, 1]).mean()) for each in (face, moved)]

    closed, moved = parted()
    monkeypatch.setattr(face_fit, "CLOSED", 0.0)
    free, _ = parted()
    assert free > 0.3
    assert closed < 0.05 * free
    assert moved > 10 * closed


def test_a_tie_is_of_the_whole_rest() -> None:
    """Mean expression, what is undone of the skin's fit, and what that parted lips by: one step brings all of it together."""
    base, jaw = load_person(), np.eye(52)[[JAW]]
    lowered = base.body.weights[:, JOINT_NAMES.index("jaw")].double().numpy()[:, None] * [0, -0.004, 0]
    nodes = tuple(np.unique(touching(base.body)).tolist())
    surface = SurfaceOffsets(nodes, lowered[list(nodes)], eyes_stay=True)
    plain = PersonFit(np.zeros(10), np.zeros((55, 3)), surface)
    field = face_fit._Field(base, face_fit._points(base), jaw, 0.4 * jaw[0])
    field.begin(base, surface)
    field.now[..., 0] = field.now[..., 1] = lowered[list(field.nodes)]

    def parted() -> float:
        return float(between_lips(resize_person(base, replace(plain, face=field.offsets())))[:, 1].mean())

    before = parted()
    assert before > 0.001
    form = np.broadcast_to(1e4 * np.eye(6), (len(field.skin), 6, 6))
    field.now += field._solved(form, np.zeros((len(field.skin), 6)))
    assert abs(parted()) < 0.02 * before


def test_lips_do_not_open_though_no_point_is_between_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """The template's own pictures with a dark mouth: of what is between the lips no point tells, which draws them apart."""
    monkeypatch.setattr(face_fit, "SPACING", 0.02)
    base = load_person()
    dark = np.zeros(len(base.body.v_template), bool)
    dark[base.face.body_vertex_ids.numpy()] = base.face.mouth.numpy()
    faces = base.body.faces.numpy()

    def shown(one: Signals, camera: Camera) -> Photo:
        even = photo(person(), one, camera)
        face, _, _ = visible_faces(template_surface(person(), one)[0], faces, camera)
        inside = dark[faces[face]].any(-1)[..., None]
        return replace(even, image=partial(np.asarray, np.where(inside, np.uint8(10), even.image())))

    posed = [(signals(names), tuple(shown(signals(names), camera) for camera in CAMERAS)) for names in EXPRESSIONS]

    def opened() -> float:
        found = fit_to_pictures(person(), posed, (0.006, 0.004))
        return 1e3 * float(between_lips(found)[:, 1].mean())

    closed = abs(opened())
    monkeypatch.setattr(face_fit, "CLOSED", 0.0)
    monkeypatch.setattr(lips, "BESIDE", 0.0)
    assert closed < 0.1
    assert opened() > 0.5


def test_blurred_pictures_say_nothing_beside_the_lips(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within two blurs at rest of where lips touch; elsewhere all points count, those of lids, too."""
    base, rows, improve = load_person(), [], face_fit._Field.improve
    points = face_fit._points(base)
    place = np.einsum(
        "pk,pkc->pc", points.share, base.body.v_template.double().numpy()[base.body.faces.numpy()[points.face]]
    )
    line = base.body.v_template.double().numpy()[touching(base.body).ravel()]
    away = cKDTree(line).query(place)[0]
    np.testing.assert_allclose(away_from_lips(base.body, points), away, atol=1e-12)

    def noted(field: face_fit._Field, somebody: Person, poses: list[Signals], seen: list[list[Seen]]) -> None:
        rows.append(np.unique(np.concatenate([row for shown in seen for row, *_ in shown])))
        improve(field, somebody, poses, seen)

    monkeypatch.setattr(face_fit._Field, "improve", noted)
    fit_to_pictures(person(), pictures(person())[:1], (0.004, 0.001))
    (blurred, sharp), skin = rows, ~of_balls(points)
    assert away[blurred].min() >= 0.008
    assert 0.002 <= away[sharp].min() < 0.003
    far = skin[sharp] & (away[sharp] > 0.012)
    assert np.isin(sharp[far], blurred).mean() > 0.98


def widened(width: float) -> tuple[Person, np.ndarray]:
    """With a skin that outlines drew aside by `width` of the way from the head's middle, and what that moved vertices by."""
    base = load_person()
    rows = tuple(range(0, 13_000, 40))
    aside = width * base.body.v_template.double().numpy()[list(rows)] * [1, 0, 0]
    surface = SurfaceOffsets(rows, aside, eyes_stay=True)
    return resize_person(base, PersonFit(np.zeros(10), np.zeros((55, 3)), surface)), surface.moved(base.body)


def test_a_face_that_the_fit_of_its_skin_slid_goes_back() -> None:
    """A head that became wider has its temples where they are, and its mouth is as wide as it was: no outline told. Lips and the skin before
    them go together; beyond the face nothing does."""
    base, (begun, moved) = load_person(), widened(0.4)
    stepped = (fit_to_pictures(begun, pictures(begun)[:1], ()).body.v_template - begun.body.v_template).double().numpy()
    place = base.body.v_template.double().numpy()
    mouth = outer()[np.linalg.norm(place[outer()] - place[chin()], axis=1) < 0.05]
    aside = mouth[np.abs(moved[mouth, 0]) > 0.003]
    assert len(aside) > 20
    left = stepped[aside, 0] / -moved[aside, 0]
    assert 0.5 < np.quantile(left, 0.05) < np.quantile(left, 0.95) < 1.1
    assert np.abs(stepped[mouth, 1:]).max() < 0.5 * np.abs(moved[mouth]).max()
    away = base.blend_weight[:, 2].numpy() == 0
    assert np.abs(stepped[away]).max() < 0.25 * np.abs(moved[away & (place[:, 1] > 0.6)]).max()
    edges = np.stack(mesh_edges(base.body).nonzero(), 1)
    was, now = (
        np.linalg.norm(np.diff(v[edges], axis=1)[:, 0], axis=1) for v in (place + moved, place + moved + stepped)
    )
    assert (now > 2.2 * was.clip(1e-4)).mean() < 1e-3


def test_lids_and_lips_face_the_front_on_average() -> None:
    """Backs of lids and lips face the other way, and do not count."""
    base, place = load_person(), load_person().body.v_template.double().numpy()
    eyes = np.concatenate([base.body.groups[name] for name in face_fit.EYES])
    lids = np.flatnonzero(cKDTree(place[eyes]).query(place)[0] < 0.004)
    lips = np.flatnonzero(np.linalg.norm(place - place[base.body.groups["upper_teeth"]].mean(0), axis=1) < 0.02)
    for rows in (lids, lips):
        assert face_fit._outwards(base, rows.tolist())[:, 2].min() > 0.65
    assert (base.body.normals[lids, 2] < 0).double().mean() > 0.2


def test_a_face_moved_to_the_front_stays_there() -> None:
    base, rows = load_person(), tuple(range(0, 13_000, 40))
    surface = SurfaceOffsets(rows, np.tile([0, 0, 0.004], (len(rows), 1)), eyes_stay=True)
    begun = resize_person(base, PersonFit(np.zeros(10), np.zeros((55, 3)), surface))
    stepped = (fit_to_pictures(begun, pictures(begun)[:1], ()).body.v_template - begun.body.v_template).double().numpy()
    nose = int(outer()[base.body.v_template[outer(), 2].argmax()])
    assert abs(stepped[nose, 2]) < 0.0006
    eyes = np.concatenate([base.body.groups[name] for name in face_fit.EYES])
    np.testing.assert_allclose(stepped[eyes], 0, atol=2e-4)


def test_an_eyeball_is_tied_to_its_own_lids() -> None:
    body = load_person().body
    nodes, _ = face_fit._spread(body, outer())
    tied = face_fit._lids(body, nodes)
    np.testing.assert_array_equal(tied, tied.T)
    assert not tied[2:, 2:].any()
    assert not tied[:2, :2].any()
    left, right = (body.v_template.numpy()[[nodes[n] for n in np.flatnonzero(row)], 0] for row in tied[:2])
    assert min(len(left), len(right)) > 5
    assert left.min() > 0 > right.max()


def test_nodes_are_finer_at_lids_and_lips() -> None:
    body = load_person().body
    nodes, ways = face_fit._spread(body, outer())
    place = body.v_template.double().numpy()[list(nodes)]
    np.fill_diagonal(ways, np.inf)
    skin = np.isfinite(ways).any(1)
    for names, reach in face_fit.FEATURES:
        feature = np.concatenate([body.v_template.double().numpy()[body.groups[name]] for name in names])
        near = np.linalg.norm(place[:, None] - feature, axis=-1).min(1) < reach
        assert near.sum() > 10
        assert np.median(ways[skin & near].min(1)) < 0.013 < np.median(ways[skin].min(1))


def test_flesh_lies_between_a_cheek_and_the_cavity_alone() -> None:
    place = np.array([[0, 0, 0.008], [0, 0, 0.0], [0, 0, -0.003], [0, 0, -0.1]])
    normal = np.array(
        [[0, 0, 1.0], [0, 0, -1.0], [0, 0, 1.0], [0, 0, -1.0]]
    )  # cheek, cavity; a lip below, and what is far
    expected = np.zeros((4, 4))
    expected[0, 1] = expected[1, 0] = 1
    np.testing.assert_array_equal(face_fit._flesh(place, normal), expected)
    assert not face_fit._neighbours(np.where(np.eye(4) > 0, 0, np.inf)).any()
    base = load_person()
    field = face_fit._Field(base, face_fit._points(base), np.zeros((0, 52)), np.zeros(52))
    nodes = list(field.nodes)
    through = face_fit._flesh(base.body.v_template[nodes].double().numpy(), base.body.normals[nodes].double().numpy())
    assert through.any()
    tie = face_fit.TIE * face_fit.FLESH / face_fit.REST_SIGMA**2
    assert field.stiffness[..., 0][through > 0].max() <= -tie
    form = face_fit._differences(face_fit.FLESH * expected)
    step = np.array([0.002, -0.001, 5.0, 5.0])
    assert step @ form @ step == pytest.approx(face_fit.FLESH * 0.003**2)
    assert face_fit.FLESH > face_fit.TIE / 2


def test_a_face_that_is_the_templates_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(face_fit, "SPACING", 0.02)
    found = fit_to_pictures(person(), pictures(person()), (0.003,))
    assert found.fit is not None
    assert found.fit.face is not None
    assert off(found, person(), {}, cheek()) < 0.4
    assert off(found, person(), EXPRESSIONS[1], chin()) < 0.8


def test_cameras_of_other_exposure_move_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(face_fit, "SPACING", 0.02)
    found = fit_to_pictures(person(), pictures(person(), (0.93, 1.0, 1.07)), (0.003,))
    moved = (found.body.v_template - person().body.v_template)[outer()].norm(dim=1).mean()
    assert moved < 0.0007


def lit(somebody: Person, one: Signals, camera: Camera) -> Photo:
    """With a lamp at the world's left."""
    even, faces = photo(somebody, one, camera), somebody.body.faces
    vertices = template_surface(somebody, one)[0]
    face, share, _ = visible_faces(vertices, faces.numpy(), camera)
    normal = vertex_normals(torch.from_numpy(vertices), faces).numpy()[faces.numpy()[face]]
    gain = 1 + LAMP * np.einsum("hwk,hwkc->hwc", share, normal)[..., :1]
    return replace(even, image=partial(np.asarray, np.rint(gain * even.image()).astype(np.uint8)))


def test_a_lamp_before_which_a_head_turns_moves_little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six tenths at most of what it moves where it is taken for colours of the skin."""
    monkeypatch.setattr(face_fit, "SPACING", 0.02)
    turned = [signals({}).replace(global_orient=np.array([0, TURN + more, 0])) for more in (-0.5, 0, 0.5)]
    posed = [(one, tuple(lit(person(), one, camera) for camera in CAMERAS)) for one in turned]

    def moved(light: str = "world") -> float:
        found = fit_to_pictures(person(), posed, (0.004, 0.003, 0.002), light)
        return float((found.body.v_template - person().body.v_template)[outer()].norm(dim=1).mean())

    with_light_out = moved()
    assert moved("root") > with_light_out  # whose lamp stands still in the world
    monkeypatch.setattr(face_fit, "without_light", lambda somebody, points, poses, seen, frame: seen)
    assert with_light_out < 0.6 * moved()


def test_a_way_on_which_all_pictures_agree_says_nothing() -> None:
    """The point is then painted elsewhere; the way on which they do not agree counts."""
    sums, row = face_fit._Sums(np.array([0]), 2), np.array([0])
    along, across = np.zeros((1, 3, 3)), np.zeros((1, 3, 3))
    along[..., 0], across[..., 1] = 20.0, 20.0
    for sign, weight in ((1, 2.0), (-1, 4.0)):
        phi = np.array([1.0, 0.5 * sign])
        sums.add(row, along + sign * across, np.full((1, 3), 0.01 * sign), np.array([weight]), phi)
    form, pull = sums.equations()
    assert form[0, 0, 0] == pytest.approx(0, abs=1e-4)  # x at rest, k = 2 numbers an axis
    assert form[0, 1, 1] > 1  # x with the expression, which differs
    assert form[0, 2, 2] > 1  # y at rest
    assert pull[0, 0] == pytest.approx(0, abs=1e-6)
    assert pull[0, 2] > 0.1


def test_rest_is_without_an_expression(rng: np.random.Generator) -> None:
    """What is sought is the face at the frames' mean; of the file's, ψ = 0 is rest."""
    base, jaw = load_person(), np.eye(52)[[JAW]]
    field = face_fit._Field(base, face_fit._points(base), jaw, 0.3 * jaw[0])
    field.now = 0.01 * rng.standard_normal(field.now.shape)
    face, skin = field.offsets(), ~field.behind.any(1)
    np.testing.assert_allclose((face.rest + 0.3 * face.moves[..., 0])[skin], field.now[skin, :, 0], atol=2e-6)
    np.testing.assert_allclose(face.moves, field.now[..., 1:], atol=1e-6)


def test_teeth_and_tongue_lie_behind_the_lips() -> None:
    """An upper lip that lies 4 mm farther back takes the upper teeth along, a lower lip the lower teeth and the tongue."""
    base, nobody = load_person(), np.zeros((0, 52))
    rest = base.body.v_template.double().numpy()
    field = face_fit._Field(base, face_fit._points(base), nobody, np.zeros(52))
    pieces = {name: [k for k, node in enumerate(field.nodes) if node in base.body.groups[name]] for name in MOUTH}
    line = (rest[base.body.groups["upper_teeth"], 1].min() + rest[base.body.groups["lower_teeth"], 1].max()) / 2
    for upper in (True, False):
        back = ((rest[list(field.nodes), 1] > line) == upper) & ~field.behind.any(1)
        field.now[:] = 0
        field.now[back, 2, 0] = -0.004
        moved = {name: field.offsets().rest[rows] for name, rows in pieces.items()}
        for name, by in moved.items():
            assert by.shape == (1, 3)
            taken = by[0, 2] / -0.004
            assert taken > 0.75 if (name == "upper_teeth") == upper else taken < 0.25
        np.testing.assert_array_equal(moved["tongue"], moved["lower_teeth"])


def test_what_is_not_fitted(tmp_path: Path) -> None:
    """No face rig, and the studio's own person: they stay."""
    files = TinyCapture.make(("body",), person=person())
    capture = open_capture(files.zip(tmp_path / "a.zip"))
    assert fit_face(capture) is capture.person
    own = open_capture(TinyCapture.make().zip(tmp_path / "b.zip"))
    assert "face" in own.rigs
    assert own.person.fit is None
    assert fit_face(own) is own.person


def test_faces_that_differ_are_chosen(tmp_path: Path) -> None:
    rig = open_capture(TinyCapture.make(("face",), person=person()).zip(tmp_path / "a.zip")).rigs["face"]
    rest = Signals.rest()
    still = [rest] * 40
    untracked = replace(rig, signals=SignalSequence(tuple(still), 30.0))
    assert face_fit._different(untracked, range(40)) == []
    still[17] = signals(EXPRESSIONS[1])
    still[23] = rest.replace(jaw_pose=np.array([0.2, 0, 0]))
    chosen = face_fit._different(replace(rig, signals=SignalSequence(tuple(still), 30.0)), range(40))
    assert {17, 23} <= set(chosen)
    assert len(chosen) == face_fit.FRAMES
    assert np.diff(chosen).max() < 8


def test_training_fits_skin_and_face(tmp_path: Path) -> None:
    capture = open_capture(TinyCapture.make(person=person(), scale=2).zip(tmp_path / "a.zip"))
    found = fit_geometry(capture)
    assert found.fit is not None
    assert found.fit.surface is not None
    assert found.fit.face is not None


@pytest.mark.parametrize(("maker", "frame"), [(MAKER, "root"), ("somebody", "world")])
def test_the_light_is_fixed_where_the_capture_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, maker: str, frame: str
) -> None:
    capture = open_capture(TinyCapture.make(("face",), person=person(), scale=2).zip(tmp_path / "a.zip"))
    capture = replace(capture, manifest={**capture.manifest, "provenance": {"maker": maker}})
    frames = []

    def noted(somebody: Person, posed: list[Posed], light: str) -> Person:
        frames.append(light)
        return somebody

    monkeypatch.setattr(face_fit, "fit_to_pictures", noted)
    fit_face(capture)
    assert frames == [frame]


def test_nothing_held_out_is_looked_at(tmp_path: Path) -> None:
    files = TinyCapture.make(("face",), person=person(), scale=2)
    files.manifest(held_out_frames={"face": [1]})
    for name in [name for name in files.files if name.endswith("00000001.jpg")]:
        files.files[name] = files.files[name][:-400]  # whoever decodes it fails
    capture = open_capture(files.zip(tmp_path / "a.zip"))
    found = fit_face(capture)
    assert found.fit is not None
    assert found.fit.face is not None
    assert len(found.fit.face.directions) == 1
    with pytest.raises(InputError):
        capture.rigs["face"].matte(0, 1)
