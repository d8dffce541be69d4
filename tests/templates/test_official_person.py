"""A person of SMPL-X, MANO and Faceverse files: the default person's twin, in the published counts, through the one interface."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from avatarrex_studio.cli.train import with_person
from official_files import write_faceverse
from person_files import LANDMARKS, person_faceverse, remeshed, write_person

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import Capture
from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.library import named_pose
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit
from avatarrex.templates.posed import pose_person


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_person(tmp_path_factory.mktemp("person") / "models")


@pytest.fixture(scope="module")
def person(folder: Path) -> Person:
    return load_person(folder)


def world(person: Person, part: str, signals: Signals) -> np.ndarray:
    """A part's posed vertices in the root frame."""
    posed = pose_person(person, signals, Counters(), None)
    frame = posed.root_from_part(part)
    return posed.parts[part].double().numpy() @ frame[:3, :3].T + frame[:3, 3]


def test_hands_lie_on_the_body_in_every_pose(person: Person) -> None:
    """Where a hand is blended with the body they are the same surface, wrists bent or not."""
    signals = Signals.rest().replace(body_pose=named_pose("wave"), shape=np.linspace(-1, 1, 10))
    posed = pose_person(person, signals, Counters(), None)
    for name in ("left_hand", "right_hand"):
        template = person.part(name)
        ids = template.body_vertex_ids[:-1]
        assert torch.equal(ids, torch.from_numpy(remeshed()[2][name.removesuffix("_hand")]))
        assert float(template.blend_weight.min()) == 0
        assert float(template.blend_weight.max()) == 1
        away = np.linalg.norm(world(person, name, signals)[:-1] - posed.body.vertices[ids].double().numpy(), axis=1)
        assert away[template.blend_weight[:-1].numpy() > 0].max() < 0.004


def test_the_face_lies_on_the_head_and_smiles(person: Person) -> None:
    """As the default person's does, whose twin it is; landmarks of the files are a few millimetres off each other."""
    default = load_person()
    for expression in (None, "jawOpen", "mouthSmileLeft"):
        values = np.zeros(52)
        if expression:
            values[EXPRESSION_NAMES.index(expression)] = 1
        signals = Signals.rest().replace(expression=values, shape=np.linspace(-1, 1, 10))
        away = np.linalg.norm(world(person, "face", signals) - world(default, "face", signals), axis=1)
        assert away.max() < 0.006
    assert len(LANDMARKS) > 8
    inside = person.face.blend_weight.numpy()
    assert abs(inside.sum() / default.face.blend_weight.numpy().sum() - 1) < 0.1


def test_omega_is_painted_on_the_body(person: Person) -> None:
    assert person.blend_weight.shape == (10475, 3)
    assert ((person.blend_weight > 0).sum(1) <= 1).all()
    assert (person.blend_weight.amax(0) == 1).all()


def test_an_avatar_stands_on_it(person: Person) -> None:
    avatar = Avatar.create(person, "compact")
    assert int(avatar.body.node_vertex.max()) < 10475
    assert len(avatar.ownership) == 3


def test_what_is_missing_is_named_and_what_is_changed_is_another_person(
    folder: Path, person: Person, tmp_path: Path
) -> None:
    with pytest.raises(
        InputError, match=r"SMPLX_NEUTRAL\.npz: expected the file to be there \(https://smpl-x\.is\.tue\.mpg\.de"
    ):
        load_person(tmp_path)
    with pytest.raises(InputError, match="several models: its size is its shape's"):
        resize_person(person, PersonFit(np.zeros(10), np.zeros((55, 3))))
    for file in ("SMPLX_NEUTRAL.npz", "MANO_LEFT.pkl", "MANO_RIGHT.pkl", "MANO_SMPLX_vertex_ids.pkl"):
        (tmp_path / file).symlink_to(folder / file)
    other = load_person(tmp_path)
    assert other.hash != person.hash
    assert (other.face.body_vertex_ids >= 0).all()  # cut out of the body
    with pytest.raises(InputError, match="several models: its size is its shape's"):  # but the hands are MANO's
        resize_person(other, PersonFit(np.zeros(10), np.zeros((55, 3))))


def test_few_landmarks_of_the_face_are_not_said_of_the_body(folder: Path, tmp_path: Path) -> None:
    fields = {**person_faceverse(), "keypoints": np.asarray(person_faceverse()["keypoints"])[:40]}
    (tmp_path / "SMPLX_NEUTRAL.npz").symlink_to(folder / "SMPLX_NEUTRAL.npz")
    write_faceverse(tmp_path / "faceverse_v2.npy", fields)
    with pytest.raises(InputError, match="Faceverse: keypoints: expected 68 or 478 landmarks, found 40"):
        load_person(tmp_path)


def test_another_person_has_no_size_of_the_captures(
    monkeypatch: pytest.MonkeyPatch, folder: Path, person: Person
) -> None:
    """Shapes and T-pose joints are the default person's; and several models have no size that could be fitted."""
    monkeypatch.setenv("AVATARREX_MODELS", str(folder))
    capture = Capture(folder, {}, load_person(), {}, ())
    assert with_person(capture, "default") is capture
    with pytest.raises(
        InputError, match="--person: expected default for a capture that says how large the person is, found models"
    ):
        with_person(capture, "models")
    with pytest.raises(InputError, match="--person: expected default, or a body alone"):
        with_person(replace(capture, sized=False), "models")
    body = replace(person, cut=True)
    monkeypatch.setattr("avatarrex.templates.person.load_person", lambda _: body)
    assert with_person(replace(capture, sized=False), "models").person is body
