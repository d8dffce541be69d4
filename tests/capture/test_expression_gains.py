"""How far a mouth moves with an expression is found by colours; what pictures do not show stays the template's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from capture.striped_face import EXPRESSIONS, JAW, chin, off, person, pictures
from scipy.spatial import cKDTree

from avatarrex.capture.fit import expression_gains, face_fit
from avatarrex.capture.fit.expression_gains import fit_gains
from avatarrex.capture.fit.face_fit import fit_to_pictures
from avatarrex.capture.fit.paint import Points, Posed, missed, sights
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.face_offsets import FaceOffsets
from avatarrex.templates.model import EYES
from avatarrex.templates.person import Person, load_person

SMILES = [EXPRESSION_NAMES.index(f"mouthSmile{side}") for side in ("Left", "Right")]
NO_DIRECTIONS = np.zeros((0, 52)), np.zeros((1, 3, 0))
OPENED = (*EXPRESSIONS, {"jawOpen": 0.4, "mouthSmileLeft": 0.5, "mouthSmileRight": 0.5})


@pytest.fixture(autouse=True)
def few_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """And every point a vote: a dozen pictures of a faint pattern say little."""
    monkeypatch.setattr(expression_gains, "BLURS", (0.01, 0.006, 0.004))
    monkeypatch.setattr(expression_gains, "POINTS_A_VOTE", 2.0)


def with_gains(gains: dict[int, float]) -> Person:
    values = np.ones(52)
    values[list(gains)] = list(gains.values())
    return person(FaceOffsets((chin(),), np.zeros((1, 3)), *NO_DIRECTIONS, gains=values))


@pytest.fixture(scope="module")
def points() -> Points:
    return face_fit._points(load_person())


@pytest.fixture(scope="module")
def shown() -> list[Posed]:
    """Of somebody whose jaw opens by less than half of the template's."""
    return pictures(with_gains({JAW: 0.45}), expressions=OPENED)


def test_a_jaw_that_opens_by_less_is_found(points: Points, shown: list[Posed]) -> None:
    found = fit_gains(with_gains({}), points, shown, "world")
    assert found[JAW] == pytest.approx(0.45, abs=0.08)
    assert found[SMILES] == pytest.approx([1, 1], abs=0.12)
    moving = [JAW, *SMILES]
    np.testing.assert_array_equal(np.delete(found, moving), 1)  # no picture shows them


def test_one_that_opens_by_more_is_found(points: Points) -> None:
    found = fit_gains(with_gains({}), points, pictures(with_gains({JAW: 1.3}), expressions=OPENED), "world")
    assert found[JAW] == pytest.approx(1.3, abs=0.1)


def test_what_is_right_stays(points: Points) -> None:
    found = fit_gains(with_gains({}), points, pictures(with_gains({}), expressions=OPENED), "world")
    np.testing.assert_allclose(found, 1, atol=0.06)


def test_pictures_that_show_little_change_little(
    points: Points, shown: list[Posed], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fewer votes, a smaller step: of one round."""
    monkeypatch.setattr(expression_gains, "BLURS", (0.006,))
    many = fit_gains(with_gains({}), points, shown, "world")[JAW]
    monkeypatch.setattr(expression_gains, "POINTS_A_VOTE", 1e5)
    few = fit_gains(with_gains({}), points, shown, "world")[JAW]
    assert 1 - few < 0.3 * (1 - many)
    assert 1 - many > 0.1
    monkeypatch.setattr(expression_gains, "POINTS_A_VOTE", 1e15)
    assert fit_gains(with_gains({JAW: 0.6}), points, shown, "world")[JAW] == pytest.approx(1, abs=1e-3)


def test_gains_stay_within_what_faces_have(points: Points, shown: list[Posed], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(expression_gains, "LEAST", 0.7)
    assert fit_gains(with_gains({}), points, shown, "world")[JAW] == 0.7


def test_what_does_not_differ_between_frames_and_no_teeth_change_nothing(
    points: Points, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, plain = with_gains({JAW: 0.6}), person(FaceOffsets((chin(),), np.zeros((1, 3)), *NO_DIRECTIONS))
    for names in ({}, {"jawOpen": 0.5}):
        alike = pictures(person(), expressions=(names, {**names, "mouthPucker": 0.05}))
        assert fit_gains(begun, points, alike, "world")[JAW] == 0.6
        assert not len(fit_gains(plain, points, alike, "world"))  # and nothing of it is in the file
    base = load_person()
    bare = replace(base, body=replace(base.body, groups={name: base.body.groups[name] for name in EYES}))
    monkeypatch.setattr(expression_gains, "load_person", lambda _: bare)
    assert fit_gains(begun, points, pictures(person())[:2], "world")[JAW] == 0.6


def test_colours_are_eliminated_exactly(points: Points, shown: list[Posed]) -> None:
    """As by least squares with every point's colour among the unknowns."""
    few = points.chosen(
        expression_gains._about_mouth(load_person().body, points) & (np.arange(len(points.face)) % 101 == 0)
    )
    begun, poses = with_gains({}), [one for one, _ in shown]
    seen = [list(sights(begun, few, one, 0.006)) for one in shown]
    shapes = few.between(load_person().body.expression_dirs.double().numpy(), load_person().body.faces.numpy())
    form, pull = expression_gains._equations(begun, few, shapes, poses, seen)
    rows, right = [], []
    for each in missed(begun, few, poses, seen):
        root = np.sqrt(each.weight)[:, None, None]
        gain = root * (each.slope @ (shapes[each.row] * each.signals.expression))
        colour = np.zeros((len(each.row), 3, len(few.face), 3))
        colour[np.arange(len(each.row)), :, each.row] = -np.eye(3)
        rows.append(
            np.concatenate([gain, root * colour.reshape(*gain.shape[:2], -1)], axis=2).reshape(
                -1, 52 + 3 * len(few.face)
            )
        )
        right.append((root[..., 0] * each.off).ravel())
    whole, off = np.concatenate(rows), np.concatenate(right)
    curved, along = whole.T @ whole, whole.T @ off
    inner = np.linalg.pinv(curved[52:, 52:], hermitian=True)
    np.testing.assert_allclose(
        form, curved[:52, :52] - curved[:52, 52:] @ inner @ curved[52:, :52], atol=1e-6 * form.max()
    )
    np.testing.assert_allclose(pull, along[:52] - curved[:52, 52:] @ inner @ along[52:], atol=1e-6 * np.abs(pull).max())
    assert len(few.face) > 40


def test_what_all_frames_share_is_not_sought(points: Points) -> None:
    """A face of another rest would look like it."""
    opened = ({"jawOpen": 0.5}, {"jawOpen": 0.5, "mouthSmileLeft": 0.8})
    found = fit_gains(with_gains({}), points, pictures(with_gains({JAW: 0.45}), expressions=opened), "world")
    assert found[JAW] == 1
    assert found[SMILES[0]] != 1


def test_points_are_about_the_mouth(points: Points) -> None:
    """No lid is among them: what it hides of an eyeball changes as it moves."""
    body = load_person().body
    rest = body.v_template.double().numpy()
    kept = expression_gains._about_mouth(body, points)
    place = points.between(rest, body.faces.numpy())
    eyes = rest[np.concatenate([body.groups[name] for name in EYES])]
    assert 0.2 < kept.mean() < 0.8
    assert cKDTree(eyes).query(place[kept])[0].min() > 0.01
    assert np.linalg.norm(place[kept] - rest[chin()], axis=1).min() < 0.003


def test_a_fitted_face_opens_as_far_as_pictures_do(shown: list[Posed], monkeypatch: pytest.MonkeyPatch) -> None:
    """With offsets of nodes alone it does not: that is how far they begin away. In a mixture that no picture has, too."""
    monkeypatch.setattr(face_fit, "SPACING", 0.02)
    truth, other = with_gains({JAW: 0.45}), {"jawOpen": 0.6, "mouthSmileLeft": 0.8}

    def missed() -> list[float]:
        """Millimetres."""
        found = fit_to_pictures(person(), shown, (0.004, 0.003))
        return [off(found, truth, names, chin()) for names in (EXPRESSIONS[1], other)]

    found = missed()
    monkeypatch.setattr(expression_gains, "BLURS", ())
    for with_them, without in zip(found, missed()):
        assert without > 4
        assert with_them < 0.4 * without
