"""Eyes and lids stay at the eyes' joints, whatever the fit of the skin does around them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.errors import InputError
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates import person_fit
from avatarrex.templates.model import EYES
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import EYE_FREE, EYE_STAYS, PersonFit, SurfaceOffsets

SHAPE = np.linspace(-1.0, 1.0, 10)
JOINTS = np.zeros((55, 3))
JOINTS[JOINT_NAMES.index("left_eye")] = 0.003, 0.001, -0.002
NODES = tuple(range(0, 13_000, 40))


def somebody(stay: bool | None) -> Person:
    """With a head that is a tenth wider and 6 mm farther in front; None: without a skin of their own."""
    place = load_person().body.v_template.double().numpy()[list(NODES)]
    wider = np.column_stack([0.1 * place[:, 0], np.zeros(len(place)), np.full(len(place), 0.006)])
    surface = None if stay is None else SurfaceOffsets(NODES, wider, eyes_stay=stay)
    return resize_person(load_person(), PersonFit(SHAPE, JOINTS, surface))


def from_joint(person: Person, eye: str) -> np.ndarray:
    """Of the middle of the ball."""
    ball = person.body.v_template[person.body.groups[eye]].double().numpy()
    return np.asarray(ball.mean(0) - person.body.joint_template[JOINT_NAMES.index(eye)].numpy())


def away() -> np.ndarray:
    """(v, 2) metres from the middles of the balls, at rest."""
    rest, groups = load_person().body.v_template.double().numpy(), load_person().body.groups
    return np.stack([np.linalg.norm(rest - rest[groups[eye]].mean(0), axis=1) for eye in EYES], 1)


@pytest.mark.parametrize("eye", EYES)
def test_balls_stay_about_their_joints(eye: str) -> None:
    stays = from_joint(somebody(True), eye)
    np.testing.assert_allclose(stays, from_joint(load_person(), eye), atol=1e-6)
    assert np.linalg.norm(from_joint(somebody(False), eye) - stays) > 0.004


def test_lids_stay_with_them_and_the_rest_of_the_skin_is_free() -> None:
    plain, moved, stays = (somebody(stay).body.v_template.double().numpy() for stay in (None, False, True))
    for column in away().T:
        step = (stays - plain)[column < EYE_STAYS]  # one for all
        np.testing.assert_allclose(step, np.broadcast_to(step[0], step.shape), atol=1e-6)
    far = away().min(1) > EYE_FREE
    np.testing.assert_allclose(stays[far], moved[far], atol=1e-7)
    assert (np.linalg.norm(moved - plain, axis=1)[far] > 0.005).mean() > 0.9


def test_it_is_part_of_the_fit_and_old_files_have_moved_eyes() -> None:
    person = somebody(True)
    assert person.fit is not None
    data = json.loads(json.dumps(person.fit.to_json()))
    again = resize_person(load_person(), PersonFit.from_json(data, "avatar.json"))
    assert again.hash == person.hash
    del data["surface"]["eyes_stay"]
    before = resize_person(load_person(), PersonFit.from_json(data, "avatar.json"))
    assert torch.equal(before.body.v_template, somebody(False).body.v_template)
    data["surface"]["eyes_stay"] = 1
    with pytest.raises(InputError, match=r"person_fit\.surface\.eyes_stay: expected true or false"):
        PersonFit.from_json(data, "avatar.json")


def test_eyes_close_together_share_the_skin_between(monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole of it is kept or free, never more than once."""
    monkeypatch.setattr(person_fit, "EYE_STAYS", 0.035)
    monkeypatch.setattr(person_fit, "EYE_FREE", 0.06)
    near = person_fit._near_eyes(load_person().body)
    total = near["left_eye"] + near["right_eye"]
    assert total.max() < 1 + 1e-9
    assert ((near["left_eye"] > 0.3) & (near["right_eye"] > 0.3)).any()
    assert (total > 1 - 1e-9).sum() > 100
    moved, stays = (somebody(stay).body.v_template.double().numpy() for stay in (False, True))
    far = total == 0
    np.testing.assert_allclose(stays[far], moved[far], atol=1e-7)


def test_a_template_without_eyes_moves_whole() -> None:
    body = load_person().body
    blind = replace(body, groups={name: rows for name, rows in body.groups.items() if name not in EYES})
    surface = SurfaceOffsets(NODES, np.full((len(NODES), 3), 0.004), eyes_stay=True)
    np.testing.assert_allclose(surface.moved(blind), 0.004, atol=1e-9)
