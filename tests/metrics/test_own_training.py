"""An avatar is measured by the splits of its own training, and where that training saw the person stand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli.evaluate import _person_fitted
from avatarrex_studio.cli.main import main
from drawn_capture import HELD_OUT_FRAME, write_capture

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import save_avatar
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.errors import InputError
from avatarrex.metrics.own_training import as_trained, own_training
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit, SurfaceOffsets

BEFORE = {"body": {"frames": [0], "views": [1]}}
"""What a run kept when there was no validation."""
KEPT = {"body": {"test": {"frames": "0:1", "cameras": ["side"]}, "validation": {"frames": "1:2", "cameras": ["front"]}}}
SMALL = PersonFit(-np.eye(10)[0], np.zeros((55, 3)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_capture(tmp_path_factory.mktemp("own"), size=64)


@pytest.fixture(scope="module")
def capture(folder: Path) -> Capture:
    return open_capture(folder)


@pytest.fixture(scope="module")
def fitted() -> Avatar:
    """An avatar whose skin was fitted: 2 cm beyond the template's along z."""
    surface = SurfaceOffsets(tuple(range(0, 13000, 400)), np.full((33, 3), [0, 0, 0.02]))
    avatar = Avatar.create(resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3)), surface)), "compact")
    avatar.meta["untrained"] = ["face", "left_hand", "right_hand"]
    return avatar


def trained(avatar: Avatar, capture: Capture, **said: object) -> Avatar:
    training = {"capture_key": capture.key, "splits": KEPT, "pelvis": [0.0, 0.0, 0.0], **said}
    return replace(avatar, meta={**avatar.meta, "training": training})


def test_splits_come_from_the_avatars_training(capture: Capture, fitted: Avatar) -> None:
    assert capture.rigs["body"].held_out_frames == {HELD_OUT_FRAME}
    found, own = as_trained(trained(fitted, capture), "me.avatar", capture)
    assert own
    rig = found.rigs["body"]
    assert (rig.held_out_frames, rig.held_out_views, rig.validation_frames) == ({0}, {1}, {1})
    assert found.notes[-1] == "splits: as in the avatar's training (me.avatar: avatar.json: training)"
    assert found.rigs["body"].signals == capture.rigs["body"].signals
    other, own = as_trained(trained(fitted, capture, capture_key="0" * 16), "me.avatar", capture)
    assert not own
    assert other is capture


def test_a_place_that_the_files_leave_open_is_the_trainings(capture: Capture, fitted: Avatar) -> None:
    unsized = replace(capture, sized=False, pelvis=np.array([0.0, -0.3, 0.0]))
    found, _ = as_trained(trained(fitted, capture, pelvis=[0.01, 0.5, 0.02]), "me.avatar", unsized)
    assert found.sized
    assert found.person is fitted.person
    before, after = unsized.rigs["body"].signals[1], found.rigs["body"].signals[1]
    np.testing.assert_allclose(after.translation - before.translation, [0.01, 0.8, 0.02])


def test_an_avatar_of_before_is_known_by_its_run(
    folder: Path, capture: Capture, fitted: Avatar, tmp_path: Path
) -> None:
    saved = tmp_path / "run" / "checkpoints" / "step_00000001" / "avatar.avatar"
    assert own_training(fitted, saved, capture) is None
    saved.parent.mkdir(parents=True)
    config = {"capture": str(folder), "held_out": BEFORE}
    (tmp_path / "run" / "run.json").write_text(json.dumps({"config": config}))
    found = own_training(fitted, saved, capture)
    assert found is not None
    assert (found.splits, found.pelvis) == (BEFORE, None)
    rig = found.applied(capture, fitted.person).rigs["body"]
    assert (rig.held_out_frames, rig.held_out_views, rig.validation_frames) == ({0}, {1}, frozenset())
    (tmp_path / "run" / "run.json").write_text(json.dumps({"config": {**config, "splits": KEPT}}))
    found = own_training(fitted, saved, capture)
    assert found is not None
    assert found.applied(capture, fitted.person).rigs["body"].validation_frames == {1}
    (tmp_path / "run" / "run.json").write_text(json.dumps({"config": {**config, "capture": "/elsewhere"}}))
    assert own_training(fitted, saved, capture) is None
    study = {"capture": str(folder), "variant": "full", "held_out": BEFORE["body"]}
    (tmp_path / "run" / "run.json").write_text(json.dumps({"config": study}))
    assert own_training(fitted, saved, capture) is None, "frames and views of a study, of no rig"


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"splits": [1]}, r"training: splits: expected an object with train, validation and test by rig, found \[1\]"),
        ({"splits": {"body": {}}}, r"splits\.body\.test\.cameras: expected a list of names, found None"),
        (
            {"splits": {"body": {"test": {"frames": [0], "cameras": []}}}},
            r"splits\.body\.test\.frames: expected A:B,…, found \[0\]",
        ),
        (
            {"splits": {"body": {"test": {"frames": "9:10", "cameras": []}}}},
            r"splits\.body\.test\.frames: expected some of the 3 frames",
        ),
        (
            {"splits": {"body": {"test": {"frames": "", "cameras": ["1"]}}}},
            r"splits\.body\.test\.cameras: expected some of front, .*, found 1",
        ),
        ({"splits": {"body": {"test": {"frames": "", "cameras": []}}}}, r"splits\.body\.validation\.frames"),
        ({"pelvis": [0, "a", 1]}, "training: pelvis: expected three finite numbers, metres"),
    ],
)
def test_what_is_wrong_is_named(capture: Capture, fitted: Avatar, said: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        as_trained(trained(fitted, capture, **said), "me.avatar", capture)


def test_the_command_measures_by_them_beside_the_fitted_mesh(
    folder: Path, capture: Capture, fitted: Avatar, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_avatar(trained(fitted, capture), tmp_path / "me.avatar")
    words = ["--frames", "0:1", "--views", "front", "--size", "32", "--baselines", "--json", str(tmp_path / "a.json")]
    assert main(["evaluate", str(tmp_path / "me.avatar"), str(folder), *words]) == 0
    said = capsys.readouterr().err
    assert "splits: as in the avatar's training" in said
    assert "another body" not in said
    found = json.loads((tmp_path / "a.json").read_text())
    assert found["held_out"] == {"frames": [0], "views": ["side"]}
    assert list(found["splits"]["held-out pose"]) == [
        "avatar", "naked textured mesh", "mean-colour mesh", "fitted textured mesh",
    ]  # fmt: skip


def test_whom_a_training_on_this_capture_poses(
    capture: Capture, fitted: Avatar, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The avatar's own body, a new fit of somebody who is not the studio's, or the studio's own person as it is."""
    monkeypatch.setattr("avatarrex.capture.fit.capture_fit.fit_geometry", lambda _: resize_person(load_person(), SMALL))
    assert _person_fitted(fitted, capture, own=True) is fitted.person
    assert _person_fitted(fitted, capture, own=False) is capture.person
    somebody = replace(capture, person=resize_person(load_person(), PersonFit(np.eye(10)[1], np.zeros((55, 3)))))
    found = _person_fitted(fitted, somebody, own=False)
    assert found.fit is not None
    np.testing.assert_array_equal(found.fit.shape, SMALL.shape)
    assert _person_fitted(fitted, replace(capture, person=fitted.person), own=False) is fitted.person


def test_the_face_alone_is_cut_by_that_person(
    folder: Path, capture: Capture, fitted: Avatar, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def cut(person: Person, *_: object) -> None:
        seen.append(person.hash)
        raise InputError("cut", "", "no more than this", "it")

    monkeypatch.setattr("avatarrex.metrics.face_region.face_alone", cut)
    save_avatar(trained(fitted, capture), tmp_path / "me.avatar")
    assert main(["evaluate", str(tmp_path / "me.avatar"), str(folder), "--face-only"]) == 2
    assert seen == [fitted.person.hash]
