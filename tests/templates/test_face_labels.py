"""Lips, brows and mouth of a fitted face are the vertices that they are on the template."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.errors import InputError
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.albedo import LIPS, inside_mouth
from avatarrex.templates.face import FaceTemplate, cut_face
from avatarrex.templates.face_offsets import FaceOffsets
from avatarrex.templates.model import EYES, TEETH
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit


def lowered(stay: bool = True) -> Person:
    """The default person whose skin from the nose down is 6 mm lower and 8 mm farther back, teeth and tongue as they are."""
    body = load_person().body
    rest, teeth = body.v_template, body.of_groups((*TEETH, "tongue"))
    middle = rest[body.of_groups(TEETH)].mean(0)
    near = (rest - middle).norm(dim=1) < 0.05
    skin = torch.nonzero(near & ~teeth & (body.v_template[:, 2] > middle[2] - 0.01))[:, 0]
    nodes = tuple(skin[:: max(len(skin) // 200, 1)].tolist())
    offsets = FaceOffsets(
        nodes, np.tile([0, -0.006, -0.008], (len(nodes), 1)), np.zeros((0, 52)), np.zeros((len(nodes), 3, 0))
    )
    return resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3)), face=offsets, labels_stay=stay))


def on_body(face: FaceTemplate, values: torch.Tensor) -> dict[int, list[float]]:
    """By vertex of the body."""
    return dict(zip(face.body_vertex_ids.tolist(), values.tolist()))


@pytest.fixture(scope="module")
def fitted() -> Person:
    return lowered()


def test_labels_are_the_templates_vertices(fitted: Person) -> None:
    plain, face = load_person().face, fitted.face
    moved = (fitted.body.v_template - load_person().body.v_template).norm(dim=1)
    lips = (plain.albedo - torch.tensor(LIPS)).abs().amax(1) < 1e-6
    assert moved[plain.body_vertex_ids[lips]].mean() > 0.005, "the lips are elsewhere"
    known, found = on_body(plain, plain.albedo), on_body(face, face.albedo)
    eyes = set(load_person().body.of_groups(EYES).nonzero()[:, 0].tolist())
    both = (known.keys() & found.keys()) - eyes
    assert len(both) > 4000
    assert all(found[vertex] == known[vertex] for vertex in both)
    inside = on_body(plain, plain.inside)
    assert all(value == inside[vertex] for vertex, value in on_body(face, face.inside).items() if vertex in inside)


def test_irises_are_where_the_fitted_balls_look_ahead() -> None:
    """What the joints' offsets turn and shear an eyeball by at rest does not turn the iris."""
    joints = np.zeros((55, 3))
    joints[JOINT_NAMES.index("jaw")] = 0, -0.01, -0.015
    person = resize_person(load_person(), PersonFit(np.linspace(-1.0, 1.0, 10), joints))
    ball = person.face.model.of_groups(EYES)
    assert torch.equal(person.face.albedo[ball], cut_face(person.body).albedo[ball])
    known, found = on_body(load_person().face, load_person().face.albedo), on_body(person.face, person.face.albedo)
    eyes = person.body.of_groups(EYES).nonzero()[:, 0].tolist()
    assert sum(found[vertex] != known[vertex] for vertex in eyes) > 3, "the template's irises would be elsewhere"


def test_omega_is_one_within_the_mouth_and_not_at_the_throat() -> None:
    """Where teeth and tongue were fitted so low that skin of the throat lies between them."""
    body = load_person().body
    rows = [int(body.groups[name][0]) for name in (*TEETH, "tongue")]
    low = FaceOffsets(tuple(rows), np.tile([0, -0.04, -0.02], (3, 1)), np.zeros((0, 52)), np.zeros((3, 3, 0)))
    now, before = (
        resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3)), face=low, labels_stay=stay))
        for stay in (True, False)
    )
    inside = inside_mouth(body.v_template, body.groups)
    assert (now.blend_weight[inside, 2] == 1).all()
    assert torch.equal(now.face.blend_weight, now.blend_weight[now.face.body_vertex_ids, 2])
    raised = before.blend_weight[:, 2] > now.blend_weight[:, 2] + 0.1
    assert raised.sum() > 3, "skin between the teeth was raised to 1"
    assert not (raised & inside).any()


def test_old_fits_keep_the_labels_of_where_they_lie(fitted: Person) -> None:
    assert fitted.fit is not None
    data = json.loads(json.dumps(fitted.fit.to_json()))
    assert PersonFit.from_json(data, "avatar.json").labels_stay
    del data["labels_stay"]
    old = PersonFit.from_json(data, "avatar.json")
    assert list(old.to_json()) == ["shape", "joint_offsets", "face"], "what the hash of an old avatar is of"
    before = resize_person(load_person(), old)
    cut = cut_face(before.body)
    for name in ("albedo", "inside", "blend_weight"):
        assert torch.equal(getattr(before.face, name), getattr(cut, name)), name
    known = on_body(load_person().face, load_person().face.inside)
    chin = [v for v, inside in on_body(before.face, before.face.inside).items() if inside and not known[v]]
    assert len(chin) > 5, "skin that lies between the teeth is labelled as mouth"
    assert before.hash != fitted.hash
    assert torch.equal(before.body.v_template, fitted.body.v_template)
    for bare in (before.naked, before.with_template_face):
        assert bare.fit is not None
        assert not bare.fit.labels_stay
    data["labels_stay"] = 1
    with pytest.raises(InputError, match=r"person_fit\.labels_stay: expected true or false"):
        PersonFit.from_json(data, "avatar.json")


@pytest.mark.parametrize("stay", [True, False])
def test_a_saved_avatar_has_its_labels(stay: bool, tmp_path: Path) -> None:
    avatar = Avatar.create(lowered(stay), "compact")
    save_avatar(avatar, tmp_path / "one.avatar")
    again = load_avatar(tmp_path / "one.avatar")
    assert again.person.hash == avatar.person.hash
    assert torch.equal(again.face.albedo, avatar.face.albedo)
    assert torch.equal(again.face.albedo, lowered().face.albedo.float()) is stay


def test_whoever_has_nothing_fitted_has_the_templates_labels() -> None:
    same = resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3))))
    for name in ("albedo", "inside", "blend_weight"):
        assert torch.equal(getattr(same.face, name), getattr(load_person().face, name)), name
