"""`capture refine`: the written capture is better tracked, whole, and made of the training's frames alone; it goes on where it stopped."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from avatarrex_studio.cli.main import main
from capture.test_pose_fit import off_by
from capture.tiny_capture import TinyCapture, cameras, npz, parameters

from avatarrex.capture.fit import refine as schedule
from avatarrex.capture.fit import refining
from avatarrex.capture.fit.check import joint_distances, template_surface
from avatarrex.capture.fit.outlines import Seen
from avatarrex.capture.fit.paint import POINTS, Paint, Points, Posed
from avatarrex.capture.fit.pose_fit import Shot
from avatarrex.capture.fit.refine import Body
from avatarrex.capture.fit.refined_capture import write_refined
from avatarrex.capture.fit.refining import FILE, Refining
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.manifest import FORMAT
from avatarrex.capture.readers.rigs import Capture, Rig, open_capture
from avatarrex.capture.readers.splits import sealed
from avatarrex.capture.synthetic.keypoints import detected
from avatarrex.errors import InputError
from avatarrex.files.gate import UNFINISHED
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit


def tracked(rng: np.random.Generator, person: Person | None = None) -> TinyCapture:
    """With keypoints, poses off by 2° and 1 cm; the last frame and the last camera are held out, and cannot be decoded."""
    capture = TinyCapture.make(("body",), person=person, scale=2)
    exact = capture.signals
    joints = np.stack(
        [template_surface(person or load_person(), one.replace(expression=np.zeros(52)))[1] for one in exact]
    )
    lenses = [Lens(name, camera, np.zeros(5)) for name, camera in cameras("body", 2).items()]
    capture.files["body/keypoints.npz"] = npz(**detected(joints, lenses, [1]))
    noisy = [off_by(one, rng) for one in exact]
    changed = parameters(noisy, person is None)
    capture.change(
        **{key: changed[key] for key in ("global_orient", "body_pose", "transl", "left_hand_pose", "right_hand_pose")}
    )
    capture.manifest(held_out_frames={"body": [2]}, held_out_cameras={"body": ["c2"]})
    for name in ("body/c0/mask/pha/00000002.jpg", "body/c2/mask/pha/00000001.jpg"):
        capture.files[name] = capture.files[name][:-300]
    return capture


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """One skin, one round less."""
    monkeypatch.setattr(schedule, "SHAPE_ROUNDS", schedule.SHAPE_ROUNDS[:1])
    monkeypatch.setattr(schedule, "POSE_ROUNDS", schedule.POSE_ROUNDS[:3])


def errors(capture: Capture) -> np.ndarray:
    """(t,) metres: mean of the body's joints, by frame."""
    found = joint_distances(capture, capture.rigs["body"], range(3))
    assert found is not None
    return np.asarray(found[:, :22].mean(1))


@pytest.mark.parametrize("own", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_noisy_capture_is_refined(
    own: bool, tmp_path: Path, quick: None, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    """The studio's own person by `shape10`, or another by `tpose_joints`."""
    person = None if own else resize_person(load_person(), PersonFit(0.5 * np.eye(10)[0], np.zeros((55, 3))))
    source, out = tracked(rng, person).folder(tmp_path / "noisy"), tmp_path / "fine"
    out.mkdir()
    (out / f"{UNFINISHED}x.npz").touch()  # of a process that was killed
    assert main(["capture", "refine", str(source), str(out)]) == 0
    said = capsys.readouterr().out
    assert not list(out.rglob(".*"))
    assert main(["capture", "refine", str(source), str(out)]) == 0, "as after a kill in its last moment"
    assert f"{out}: done before" in capsys.readouterr().out
    assert main(["capture", "refine", str(source), str(out), "--no-colours"]) == 2
    assert "or one with refining.npz to go on with" in capsys.readouterr().err
    before, after = open_capture(source), open_capture(out)
    assert (errors(after)[:2] < 0.5 * errors(before)[:2]).all()
    figures = json.loads((out / "refine.json").read_text())
    for what, falls in (("iou", False), ("iou_skin", False), ("keypoints_px", True), ("joints_mm", True)):
        one, other = (figures[state]["body"][what] for state in ("before", "after"))
        assert (other < one) == falls
        assert f"{other:.3f}" in said or f"{other:.2f}" in said
    assert (out / "refine_body.png").exists()
    assert not (out / FILE).exists()
    assert (out / "body/c0/00000001.jpg").samefile(source / "body/c0/00000001.jpg")
    made = after.manifest["refined"]
    assert made == {"from": before.key, "person": "default", "frames": {"body": [0, 1]}, "key": made["key"]}
    assert after.rigs["body"].held_out_frames == {2}
    first, last = (capture.rigs["body"].signals[2] for capture in (before, after))
    np.testing.assert_allclose(last.body_pose, first.body_pose, atol=1e-12)
    np.testing.assert_allclose(last.expression, first.expression)
    np.testing.assert_allclose(last.translation, first.translation, atol=2e-3)
    assert (after.person.fit is None) == own
    assert after.rigs["body"].signals.fps == before.rigs["body"].signals.fps


def test_it_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture, out, called = open_capture(TinyCapture.make(("body",)).zip(tmp_path / "a.zip")), tmp_path / "out", []
    person = resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3))))
    points = Points.of(person)
    paint = Paint(points, np.full((POINTS, 3), 0.25), np.arange(POINTS) % 3 > 0)
    monkeypatch.setattr(refining, "refine_body", lambda _, colours: called.append("body") or Body(person, paint))

    def pose(body: Body, rig: Rig, frame: int) -> Signals:
        called.append(frame)
        assert body.paint is not None
        np.testing.assert_array_equal(body.paint.colour, paint.colour)
        np.testing.assert_array_equal(body.paint.known, paint.known)
        np.testing.assert_array_equal(body.paint.points.face, points.face)
        return rig.signals[frame].replace(translation=np.full(3, 0.1 + frame))

    monkeypatch.setattr(refining, "refine_pose", pose)
    for wanted in ((0, 1), (0, 1, 2)):
        work = Refining(capture, out)
        body = work.body()
        for frame in wanted:
            work.pose(body, "body", frame)
    assert called == ["body", 0, 1, 2]
    assert body.person.hash == person.hash
    assert [one.translation[0] for one in work.signals("body")] == [0.1, 1.1, 2.1]
    for other, colours in ((replace(capture, key="0" * 16), True), (capture, False)):
        with pytest.raises(InputError, match=r"refining\.npz: key: expected this capture's, splits' and options'"):
            Refining(other, out, colours=colours)
    (out / FILE).write_bytes(b"PK")
    with pytest.raises(InputError, match=r"refining\.npz"):
        Refining(capture, out)


def test_the_skin_follows_poses_by_colours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was put on where the shape's rounds had the frames; what is painted last has it where colours have them.

    Poses are told by x; the first frame is held out.
    """
    tiny, put, painted = TinyCapture.make(("body",)).manifest(held_out_frames={"body": [0]}), [], []
    capture = sealed(open_capture(tiny.zip(tmp_path / "a.zip")), "train")
    first, points = capture.rigs["body"].signals[1], Points.of(load_person())

    def at(x: float) -> Signals:
        return first.replace(translation=np.array([x, 0, 0]))

    def paint(_: Person, shown: Iterable[Posed], blur: float = 0) -> Paint:
        painted.append(([pose.translation[0] for pose, _ in shown], blur))
        return Paint(points, np.full((POINTS, 3), len(painted)), np.ones(POINTS, bool))

    monkeypatch.setattr(schedule, "key_shots", lambda *_: [Shot(first, Seen(first, ()), ())])
    monkeypatch.setattr(schedule, "first_poses", lambda *_: [at(10)])
    monkeypatch.setattr(schedule, "fit_shape", lambda *_: ([at(20)], np.zeros(10)))
    monkeypatch.setattr(
        schedule, "fit_pose", lambda _, one, pose, rounds, by: at(pose.translation[0] + by.colour[0, 0])
    )
    monkeypatch.setattr(
        schedule, "fit_to_mattes", lambda person, seen: put.append(seen[0].signals.translation[0]) or person
    )
    monkeypatch.setattr(schedule.Paint, "of", paint)
    found = schedule.refine_body(capture).paint
    assert found is not None
    assert found.colour[0, 0] == 3
    assert put == [10, 20, 20, 21, 23]
    coarse, fine = schedule.BLURS
    assert painted == [([20], coarse), ([21], fine), ([23], 0)]
    put.clear()
    assert schedule.refine_body(capture, colours=False).paint is None
    assert put == [10, 20, 20]


def test_colours_can_be_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By `--no-colours`: no paint is made, and poses are sought without."""
    source, said = TinyCapture.make(("body",)).folder(tmp_path / "a"), []
    person = resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3))))
    monkeypatch.setattr(refining, "refine_body", lambda _, colours: said.append(colours) or Body(person))

    def pose(body: Body, _: Rig, frame: int) -> Signals:
        said.append(body.paint)
        raise InputError(frame, "", "the end of the test", "it")

    monkeypatch.setattr(refining, "refine_pose", pose)
    assert main(["capture", "refine", str(source), str(tmp_path / "out"), "--no-colours"]) == 2
    assert said == [False, None]


def test_only_what_the_training_sees_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames kept for validation are the training's no more than the test's; with `every` poses of all are sought, by its cameras."""
    capture = TinyCapture.make(("body",)).manifest(
        held_out_frames={"body": [2]}, held_out_cameras={"body": ["c2"]}, validation_frames={"body": [1]}
    )
    path = capture.zip(tmp_path / "a.zip")
    from avatarrex.capture.readers.splits import Sealed, with_validation

    whole = with_validation(open_capture(path))
    work = Refining(whole, tmp_path / "one")
    assert work.frames == {"body": (0,)}
    with pytest.raises(Sealed):
        work.training.rigs["body"].signals[1].full_pose()
    seen: list[Any] = []
    monkeypatch.setattr(refining, "refine_pose", lambda _, rig, frame: seen.append((rig, frame)) or rig.signals[frame])
    work = Refining(whole, tmp_path / "every", every=True)
    assert work.frames == {"body": (0, 1, 2)}
    work.pose(Body(load_person()), "body", 2)
    ((rig, frame),) = seen
    assert [rig.available(view, frame) for view in range(3)] == [True, True, False]
    shots = schedule.key_shots(work.training, 20)
    assert [len(one.seen.pictures) for one in shots] == [2]


def test_a_zip_is_copied(tmp_path: Path, rng: np.random.Generator) -> None:
    path, out = tracked(rng).zip(tmp_path / "a.zip", prefix="deep/"), tmp_path / "out"
    capture = open_capture(path)
    fit = PersonFit(capture.rigs["body"].signals[0].shape + 0.1, np.zeros((55, 3)))
    body = Body(resize_person(load_person(), fit))
    write_refined(capture, body, {"body": tuple(capture.rigs["body"].signals)}, {"from": "x"}, out)
    after = open_capture(out)
    np.testing.assert_allclose(after.rigs["body"].signals[1].shape, fit.shape)
    np.testing.assert_array_equal(after.rigs["body"].image(0, 1), capture.rigs["body"].image(0, 1))
    assert after.rigs["body"].keypoints is not None


def test_the_pelvis_of_the_files_model_is_kept(tmp_path: Path) -> None:
    """A model with its J_0 elsewhere than ours: what is written is read as the same poses of the same person."""
    person, away = resize_person(load_person(), PersonFit(np.eye(10)[1], np.zeros((55, 3)))), np.array([0.1, 0.9, -0.2])
    tiny = TinyCapture.make(("body",), person=person)
    joints = person.body.joint_template.double().numpy() + away
    tiny.change(tpose_joints=joints, transl=np.stack([one.translation for one in tiny.signals]) - away)
    capture = open_capture(tiny.zip(tmp_path / "a.zip"))
    np.testing.assert_allclose(capture.pelvis, away, atol=1e-6)
    signals = {"body": tuple(capture.rigs["body"].signals)}
    write_refined(capture, Body(capture.person), signals, {"from": "x"}, tmp_path / "out")
    after = open_capture(tmp_path / "out")
    assert after.manifest == {"format": FORMAT, "refined": {"from": "x"}}, "which the capture itself has none of"
    for before, other in zip(capture.rigs["body"].signals, after.rigs["body"].signals):
        one, two = (template_surface(of.person, frame)[1] for of, frame in ((capture, before), (after, other)))
        np.testing.assert_allclose(one, two, atol=1e-5)


def test_what_is_in_the_way_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = TinyCapture.make(("body",)).zip(tmp_path / "a.zip")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note.txt").write_text("mine")
    assert main(["capture", "refine", str(source), str(tmp_path / "full")]) == 2
    assert "full: expected a new or empty folder, or one with refining.npz to go on with" in capsys.readouterr().err
    assert main(["capture", "refine", str(tmp_path / "none"), str(tmp_path / "new")]) == 2
    assert "none: expected a capture: a folder or a .zip file" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
