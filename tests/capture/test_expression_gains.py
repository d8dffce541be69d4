"""How far a mouth moves with an expression is found by colours; what pictures do not show stays the template's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from capture.striped_face import EXPRESSIONS, JAW, chin, off, person, pictures, signals

from avatarrex.capture.fit import expression_gains, face_fit
from avatarrex.capture.fit.expression_gains import fit_gains
from avatarrex.capture.fit.face_fit import fit_to_pictures
from avatarrex.capture.fit.paint import Points, Posed
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.face_offsets import FaceOffsets
from avatarrex.templates.model import EYES
from avatarrex.templates.person import Person, load_person

SMILES = [EXPRESSION_NAMES.index(f"mouthSmile{side}") for side in ("Left", "Right")]
OPENED = (*EXPRESSIONS, {"jawOpen": 0.4, "mouthSmileLeft": 0.5, "mouthSmileRight": 0.5})


@pytest.fixture(autouse=True)
def few_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """And every point a vote: a dozen pictures of a faint pattern say little."""
    monkeypatch.setattr(expression_gains, "BLURS", (0.01, 0.006, 0.004))
    monkeypatch.setattr(expression_gains, "ALIKE", 2.0)


def with_gains(gains: dict[int, float]) -> Person:
    values = np.ones(52)
    values[list(gains)] = list(gains.values())
    return person(FaceOffsets((chin(),), np.zeros((1, 3)), np.zeros((0, 52)), np.zeros((1, 3, 0)), gains=values))


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
    monkeypatch.setattr(expression_gains, "ALIKE", 1e5)
    few = fit_gains(with_gains({}), points, shown, "world")[JAW]
    assert 1 - few < 0.3 * (1 - many)
    assert 1 - many > 0.1


def test_gains_stay_within_what_faces_have(points: Points, shown: list[Posed], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(expression_gains, "LEAST", 0.7)
    assert fit_gains(with_gains({}), points, shown, "world")[JAW] == 0.7


def test_no_expression_and_no_teeth_change_nothing(points: Points, monkeypatch: pytest.MonkeyPatch) -> None:
    calm = [(replace(signals({}), expression=np.zeros(52)), photos) for _, photos in pictures(person())[:1]]
    begun = with_gains({JAW: 0.6})
    assert fit_gains(begun, points, calm, "world")[JAW] == 0.6
    base = load_person()
    bare = replace(base, body=replace(base.body, groups={name: base.body.groups[name] for name in EYES}))
    monkeypatch.setattr(expression_gains, "load_person", lambda _: bare)
    assert fit_gains(begun, points, pictures(person())[:2], "world")[JAW] == 0.6


def test_points_are_about_the_mouth(points: Points) -> None:
    """No lid is among them: what it hides of an eyeball changes as it moves."""
    body = load_person().body
    about = expression_gains._about_mouth(body, points)
    place = expression_gains._between(body.v_template.double().numpy(), body, about)
    assert 0.2 * len(points.face) < len(place) < 0.8 * len(points.face)
    eyes = body.v_template[np.concatenate([body.groups[name] for name in EYES])].double().numpy()
    assert np.linalg.norm(place[:, None] - eyes.mean(0), axis=2).min() > 0.015
    assert np.linalg.norm(place - body.v_template.double().numpy()[chin()], axis=1).min() < 0.003


def test_a_fitted_face_opens_as_far_as_pictures_do(shown: list[Posed], monkeypatch: pytest.MonkeyPatch) -> None:
    """With offsets of nodes alone it does not: that is how far they begin away. In a mixture that no picture has, too."""
    monkeypatch.setattr(face_fit, "SPACING", 0.02)
    truth, alone = with_gains({JAW: 0.45}), {"jawOpen": 0.6, "mouthSmileLeft": 0.8}

    def missed() -> list[float]:
        """Millimetres."""
        found = fit_to_pictures(person(), shown, (0.004, 0.003))
        return [off(found, truth, names, chin()) for names in (EXPRESSIONS[1], alone)]

    found = missed()
    monkeypatch.setattr(expression_gains, "BLURS", ())
    for with_them, without in zip(found, missed()):
        assert without > 4
        assert with_them < 0.4 * without
