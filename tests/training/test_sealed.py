"""No path of a training reads what is not in its split."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tiny_recipe
from avatarrex_studio.cli import train
from avatarrex_studio.cli.main import main
from capture.tiny_capture import FRAMES, TinyCapture

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers import rigs
from avatarrex.capture.readers.images_store import Pictures
from avatarrex.capture.readers.rigs import Capture, Rig, View, open_capture
from avatarrex.capture.readers.splits import Sealed, Split, Splits, sealed, sealed_rig, slices, with_validation
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import load_person, resize_person
from avatarrex.templates.person_fit import PersonFit
from avatarrex.training.core.held_out import HeldOut
from avatarrex.training.runs.folder import read_about

TEST_FRAME, VALIDATION_FRAME = 2, 1
TEST_CAMERAS = {"body": "c1", "face": "f1"}
HELD_OUT = {
    "held_out_frames": {rig: [TEST_FRAME] for rig in TEST_CAMERAS},
    "held_out_cameras": {rig: [camera] for rig, camera in TEST_CAMERAS.items()},
    "validation_frames": {rig: [VALIDATION_FRAME] for rig in TEST_CAMERAS},
}


class Touched(Exception):
    """Something of another split was read."""


class Guard:
    """Raises `Touched` for everything of the test, and for the validation's but while a `HeldOut` measures."""

    measuring = False

    def check(self, what: str, test: bool) -> None:
        if test or not self.measuring:
            raise Touched(what)


class Guarded:
    """Signals or a camera behind a guard."""

    def __init__(self, inner: object, what: str, guard: Guard, test: bool) -> None:
        for name, value in {"_inner": inner, "_what": what, "_guard": guard, "_test": test}.items():
            object.__setattr__(self, name, value)

    def __getattr__(self, name: str):
        if name.startswith("__"):
            raise AttributeError(name)
        self._guard.check(f"{self._what}: {name}", self._test)
        return getattr(self._inner, name)


class GuardedSignals(Guarded, Signals):
    """Of a frame that is not the training's."""


class GuardedCamera(Guarded, Camera):
    """That is held out."""


class GuardedPictures(Pictures):
    """Of a rig, each behind the guard."""

    def __init__(self, inner: Pictures, rig: Rig, guard: Guard, seen: set[tuple[str, int, int]]) -> None:
        self.inner, self.rig, self.guard, self.seen = inner, rig, guard, seen

    def get(self, kind: str, view: int, frame: int) -> np.ndarray:
        if frame == TEST_FRAME or view in self.rig.held_out_views:
            self.guard.check(f"{self.rig.name}: {kind} {view} {frame}", True)
        if frame == VALIDATION_FRAME:
            self.guard.check(f"{self.rig.name}: {kind} {view} {frame}", False)
        self.seen.add((self.rig.name, view, frame))
        return self.inner.get(kind, view, frame)


def guarded(capture: Capture, guard: Guard, seen: set[tuple[str, int, int]]) -> Capture:
    """The capture behind a guard."""
    found = {}
    for name, rig in capture.rigs.items():
        signals = tuple(
            own if frame == 0 else GuardedSignals(own, f"{name}: signals {frame}", guard, frame == TEST_FRAME)
            for frame, own in enumerate(rig.signals)
        )
        views = tuple(
            View(own.name, GuardedCamera(own.camera, f"{name}: {own.name}", guard, True))
            if view in rig.held_out_views
            else own
            for view, own in enumerate(rig.views)
        )
        pictures = GuardedPictures(rig.pictures, rig, guard, seen)
        found[name] = replace(rig, signals=replace(rig.signals, frames=signals), views=views, pictures=pictures)
    return replace(capture, rigs=found)


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    """Of a person who is first fitted to the mattes; both rigs with a frame and a camera held out."""
    person = resize_person(load_person(), PersonFit(np.full(10, 0.3), np.zeros((55, 3))))
    tiny = TinyCapture.make(person=person)
    for name, data in [*tiny.files.items()]:  # the face's only camera twice
        if name.startswith("face/f0/"):
            tiny.files[name.replace("f0", "f1")] = data
    calibration = json.loads(tiny.files["face/calibration_full.json"])
    calibration["f1"] = calibration["f0"]
    tiny.files["face/calibration_full.json"] = json.dumps(calibration).encode()
    return tiny.manifest(**HELD_OUT).folder(tmp_path_factory.mktemp("sealed") / "capture")


@pytest.mark.slow
def test_no_path_of_a_training_reads_what_is_not_in_its_split(capture, tmp_path, monkeypatch):
    """Fit to the mattes, warm start and prior, both passes of both parts, codes and their range, tone, perceptual term,
    the training's own figures and pictures."""
    guard, seen = Guard(), set()
    real, measure = open_capture, HeldOut.measure
    monkeypatch.setattr(rigs, "open_capture", lambda path, **options: guarded(real(path, **options), guard, seen))
    monkeypatch.setitem(train.RECIPES, "smoke", replace(tiny_recipe.TINY, name="smoke"))
    measured = []

    def watched(self: HeldOut, step: int) -> float | None:
        guard.measuring = True
        try:
            measured.extend((self.part, frame) for frame, _ in self.pairs)
            return measure(self, step)
        finally:
            guard.measuring = False

    monkeypatch.setattr(HeldOut, "measure", watched)
    run = tmp_path / "run"
    try:
        assert main(["train", str(capture), "--recipe", "smoke", "--out", str(run), "--no-surface"]) == 0
    except (Sealed, Touched) as error:
        raise AssertionError(f"a path of the training was refused: {error}") from error
    assert {frame for _, _, frame in seen} == {0, VALIDATION_FRAME}
    assert {(name, view) for name, view, _ in seen} == {("body", 0), ("body", 2), ("face", 0)}
    assert set(measured) == {("face", VALIDATION_FRAME), ("body", VALIDATION_FRAME)}
    expected = {"train": "0:1", "validation": "1:2", "test": "2:3"}
    (*_, last) = sorted((run / "checkpoints").iterdir())
    for found in (read_about(run)["config"]["splits"], load_avatar(last / "avatar.avatar").meta["training"]["splits"]):
        for name, camera in TEST_CAMERAS.items():
            assert {split: values["frames"] for split, values in found[name].items()} == expected
            assert found[name]["test"]["cameras"] == [camera]
            assert camera not in found[name]["train"]["cameras"] + found[name]["validation"]["cameras"]


def test_what_a_sealed_rig_does_not_show_raises(capture):
    whole = open_capture(capture)
    rig = with_validation(whole).rigs["body"]
    training = sealed(with_validation(whole), "train")
    learnt = training.rigs["body"]
    assert training.ground_truth == {}
    assert np.array_equal(learnt.image(0, 0), rig.image(0, 0))
    assert np.array_equal(learnt.signals[0].body_pose, rig.signals[0].body_pose)
    assert learnt.views[2].camera is rig.views[2].camera
    for frame in (TEST_FRAME, VALIDATION_FRAME):
        assert not learnt.available(0, frame)
        for read in (learnt.image, learnt.matte):
            with pytest.raises(InputError, match=f"frame {frame}"):
                read(0, frame)
        for kind in ("image", "matte"):
            assert refused(learnt.pictures, kind, frame)
        with pytest.raises(Sealed, match=f"signals of frame {frame}"):
            learnt.signals[frame].full_pose()
        with pytest.raises(Sealed, match=f"signals of frame {frame}"):
            learnt.signals.at(frame / learnt.signals.fps).replace()
    with pytest.raises(Sealed, match="camera c1"):
        learnt.views[1].camera.pixels(np.zeros((1, 3)))
    with pytest.raises(Sealed):
        learnt.pictures.check_size(1, 0)
    validation = sealed(with_validation(whole), "validation").rigs["body"]
    assert [frame for frame in range(FRAMES) if validation.available(0, frame)] == [VALIDATION_FRAME]
    with pytest.raises(Sealed):
        validation.signals[TEST_FRAME].full_pose()
    again = Splits.of(learnt)
    assert (again.train, again.validation.frames) == (Split((0,), (0, 2)), ()), "sealing leaves nothing to give up"


def refused(pictures: Pictures, kind: str, frame: int) -> bool:
    """Whether a picture of the first camera cannot be read."""
    try:
        pictures.get(kind, 0, frame)
    except Sealed as error:
        return f"{kind} of view 0, frame {frame}" in str(error)
    return False


def test_validation_is_the_middle_of_what_is_not_held_out(capture):
    rig = replace(open_capture(capture).rigs["body"], validation_frames=None)
    signals = rig.signals
    for count, kept in ((3, ()), (10, (4,)), (40, (19, 20))):
        longer = replace(
            rig, signals=replace(signals, frames=(signals[0],) * count), held_out_frames=frozenset((1, count - 1))
        )
        splits = Splits.of(longer)
        assert splits.validation.frames == kept
        assert set(splits.train.frames) | set(splits.validation.frames) | {1, count - 1} == set(range(count))
        assert not set(splits.train.frames) & set(splits.validation.frames)
    assert slices([0, 1, 2, 5, 7, 8]) == "0:3,5:6,7:9"
    assert slices([]) == ""
    assert sealed_rig(rig, Split((1,), (0,))).missing >= {(1, 1), (0, 0)}


def test_frames_for_validation_are_named_by_the_capture_or_an_option(capture):
    opened = open_capture(capture)
    assert Splits.of(with_validation(opened).rigs["body"]).validation.frames == (VALIDATION_FRAME,)
    assert Splits.of(with_validation(opened, {"body": (0, TEST_FRAME)}).rigs["body"]).validation.frames == (0,)
    assert Splits.of(with_validation(opened, {"body": ()}).rigs["body"]).train.frames == (0, 1)
    wrong = (
        ({"body": [7]}, "integers from 0 to 2"),
        ({"hands": [0]}, "frames of body, face"),
        ([1], "lists"),
        ({"body": 1.5}, "2"),
    )
    for named, message in wrong:
        with pytest.raises(InputError, match=message):
            with_validation(replace(opened, manifest={"validation_frames": named}))
