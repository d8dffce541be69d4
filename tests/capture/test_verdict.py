"""Whether a capture can be trained on: what is wrong is named, with what to do, and `train` refuses before any work."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli import train
from avatarrex_studio.cli.main import main, parse
from capture.tiny_capture import TinyCapture, jpeg
from PIL import Image

from avatarrex.camera import Camera
from avatarrex.capture.fit import conventions
from avatarrex.capture.fit.alignment import Alignment, alignment
from avatarrex.capture.fit.check import CaptureReport, RigReport, Silhouette
from avatarrex.capture.fit.conventions import FLIP, likely_convention
from avatarrex.capture.fit.verdict import Reason, Verdict, judge
from avatarrex.capture.readers.images_store import Pictures
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.errors import InputError


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return TinyCapture.make(("body",)).zip(tmp_path_factory.mktemp("tiny") / "tiny.zip")


def swapped(tmp_path: Path) -> Path:
    """The capture with camera-to-world matrices in place of world-to-camera."""
    capture = TinyCapture.make(("body",))
    name = "body/calibration_full.json"
    calibration = json.loads(capture.files[name])
    for entry in calibration.values():
        turn = np.array(entry["R"]).reshape(3, 3)
        entry["R"], entry["T"] = turn.T.tolist(), (-turn.T @ entry["T"]).tolist()
    capture.files[name] = json.dumps(calibration).encode()
    return capture.zip(tmp_path / "swapped.zip")


def seen_by(capture: Capture, change: Callable[[Camera], Camera]) -> Capture:
    """The capture with other cameras."""
    rig = capture.rigs["body"]
    views = tuple(replace(view, camera=change(view.camera)) for view in rig.views)
    return replace(capture, rigs={"body": replace(rig, views=views)})


def posed(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Camera], Camera]:
    return lambda camera: replace(camera, camera_from_world=change(camera.camera_from_world))


def centred(matrix: np.ndarray) -> np.ndarray:
    changed = matrix.copy()
    changed[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return changed


def scaled(matrix: np.ndarray) -> np.ndarray:
    changed = matrix.copy()
    changed[:3, 3] *= 0.1
    return changed


Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""From ours, (x, y, z), to (x, −z, y)."""
SPOILED = {
    "R and T lead from the camera to the world: invert them": posed(np.linalg.inv),
    "the axes are OpenGL's": posed(lambda m: FLIP @ m),
    "lead from the camera to the world with OpenGL's axes": posed(lambda m: np.linalg.inv(FLIP @ m)),
    "T is the camera's place": posed(centred),
    "+Z up": posed(lambda m: m @ np.linalg.inv(Z_UP)),
    "centimetres": posed(scaled),
    "K is of pictures half as large": lambda camera: replace(
        camera, intrinsics=np.diag([0.5, 0.5, 1.0]) @ camera.intrinsics
    ),
}


def test_the_verdict_is_of_the_trainings_split(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A capture that is wrong in all that the training sees is not good because of the rest, nor the other way round."""
    capture = open_capture(tiny)
    rig = replace(capture.rigs["body"], validation_frames=frozenset({1})).holding_out([2], [2])
    seen: list[tuple[int, int]] = []

    class Watched(Pictures):
        def get(self, kind: str, view: int, frame: int) -> np.ndarray:
            seen.append((view, frame))
            return rig.pictures.get(kind, view, frame)

    watched = replace(rig, pictures=Watched.__new__(Watched))
    for exact in (False, True):
        _, report, verdict = judge(replace(capture, rigs={"body": watched}), frames=4, exact=exact)
        assert verdict.state == "good"
        (found,) = report.rigs
        assert (found.views, found.cameras, found.compared, found.trained) == ((0, 1), ("c0", "c1"), (0,), 1)
        assert (found.joint_error_mm is not None) == exact
    monkeypatch.setattr(conventions, "PICTURES", 3)
    monkeypatch.setattr(conventions, "PIXELS", 80)
    likely_convention(capture, watched)
    assert set(seen) == {(0, 0), (1, 0)}


@pytest.mark.parametrize("remedy", SPOILED)
def test_another_convention_is_named(tiny: Path, remedy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conventions, "PICTURES", 3)
    monkeypatch.setattr(conventions, "PIXELS", 80)
    capture = seen_by(open_capture(tiny), SPOILED[remedy])
    found = likely_convention(capture, capture.rigs["body"])
    assert found is not None
    assert remedy in found


def test_sound_cameras_have_no_other_convention(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conventions, "PICTURES", 3)
    capture = open_capture(tiny)
    assert likely_convention(capture, capture.rigs["body"]) is None


def test_inverted_mattes_are_named(tmp_path: Path) -> None:
    capture = TinyCapture.make(("body",))
    for name in [name for name in capture.files if "/mask/" in name]:
        with Image.open(io.BytesIO(capture.files[name])) as picture:
            capture.files[name] = jpeg(255 - np.array(picture))
    inverted = open_capture(capture.zip(tmp_path / "a.zip"))
    verdict = judge(inverted, frames=1)[2]
    assert verdict.state == "unusable"
    assert "white (255) has to be the person" in " ".join(verdict.lines())
    assert likely_convention(inverted, inverted.rigs["body"]) == "the mattes are inverted: white is the person"


def test_how_a_bar_lies() -> None:
    """Closed form: a bar of 40×8 pixels turned by 10°, moved by (6, −3)."""
    row, column = np.mgrid[:120, :120] + 0.5

    def bar(x: float, y: float, degrees: float) -> np.ndarray:
        angle = np.radians(degrees)
        along = (column - x) * np.sin(angle) - (row - y) * np.cos(angle)
        across = (column - x) * np.cos(angle) + (row - y) * np.sin(angle)
        return np.asarray((np.abs(along) < 20) & (np.abs(across) < 4))

    found = alignment(bar(66, 57, 10), bar(60, 60, 0))
    assert found is not None
    assert found.lean_deg == pytest.approx(10, abs=0.5)
    np.testing.assert_allclose(found.shift, np.array([6, -3]) / np.sqrt(320), atol=0.02)
    part = alignment(bar(66, 57, 10)[:70], bar(60, 60, 0)[:70])
    assert part is not None
    assert part.lean_deg is None, "what is beyond the edge would lean it back"
    square = (np.abs(row - 60) < 9) & (np.abs(column - 60) < 9)
    still = alignment(square, square)
    assert still == Alignment((0.0, 0.0), None)
    assert alignment(square, square & False) is None


def report(*values: float, lies: tuple[Alignment, ...] = (), missing: tuple[int, ...] = ()) -> CaptureReport:
    """A body rig of as many cameras as values."""
    count = len(values)
    still = tuple(Alignment((0.0, 0.0), 0.0) for _ in values)
    silhouettes = tuple(
        Silhouette(view, 0, 0.1, value, None, None, lie) for view, (value, lie) in enumerate(zip(values, lies or still))
    )
    names = tuple(f"c{view}" for view in range(count))
    rig = RigReport(
        "body",
        12,
        10,
        30.0,
        tuple(range(count)),
        names,
        ("60x80",) * count,
        (3.0,) * count,
        missing or (0,) * count,
        (),
        (),
        silhouettes,
        None,
    )
    return CaptureReport("a.zip", 1.7, (rig,), ())


def judged(capture: Path, found: CaptureReport, monkeypatch: pytest.MonkeyPatch) -> Verdict:
    monkeypatch.setattr("avatarrex.capture.fit.verdict.check_capture", lambda *_: found)
    monkeypatch.setattr("avatarrex.capture.fit.verdict.likely_convention", lambda *_: None)
    return judge(open_capture(capture))[2]


@pytest.mark.parametrize(
    ("found", "state", "said"),
    [
        (report(0.8, 0.85, 0.82), "good", "verdict: good"),
        (report(0.66, 0.66, 0.68), "doubtful", "IoU 0.667 of the template with the mattes; look at the overlay"),
        (report(0.3, 0.4, 0.3), "unusable", "IoU 0.333"),
        (report(0.8, 0.85, 0.55), "doubtful", "body c2: IoU 0.550 where half of the cameras have 0.800; mend its"),
        (report(0.8), "doubtful", "one camera alone"),
        (report(0.8, 0.8, missing=(0, 6)), "doubtful", "body c1: 6 of 10 pictures are missing"),
        (
            report(0.8, 0.8, lies=(Alignment((0.0, 0.0), 6.0), Alignment((0.0, 0.0), -1.0))),
            "doubtful",
            "body c0: the template leans 6° right; R is off",
        ),
        (
            report(0.8, 0.8, lies=(Alignment((0.02, 0.0), 0.0), Alignment((-0.2, 0.15), 0.0))),
            "doubtful",
            "body c1: the template lies too far left and down; the principal point or T is off",
        ),
    ],
)
def test_reasons(tiny: Path, monkeypatch: pytest.MonkeyPatch, found: CaptureReport, state: str, said: str) -> None:
    verdict = judged(tiny, found, monkeypatch)
    assert verdict.state == state
    assert said in "\n".join(verdict.lines())
    assert verdict.to_json()["state"] == state
    assert len(verdict.reasons) == (state != "good")


def test_the_worst_reason_decides() -> None:
    doubtful, unusable = Reason("doubtful", "body c0", "one"), Reason("unusable", "face", "another")
    assert Verdict((doubtful, unusable, doubtful)).state == "unusable"
    assert Verdict((doubtful,)).state == "doubtful"
    assert Verdict(()).state == "good"


def test_mattes_of_nobody_are_unusable(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = replace(open_capture(tiny), sized=False)
    monkeypatch.setattr("avatarrex.capture.fit.size_fit.HEIGHT", (0.3, 0.4))
    _, _, verdict = judge(capture, frames=1)
    assert verdict.state == "unusable"
    assert re.search(r"person: no size fits the mattes: expected .* 0\.3 to 0\.4 m tall, found 1\.", verdict.lines()[1])


def test_a_size_at_which_the_template_tears_is_none(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of cameras in centimetres that were taken for millimetres: the verdict goes on to name them."""

    def torn(*_: object) -> None:
        raise InputError("template: left hand", "", "one open loop across the forearm", "33 open edges in several")

    monkeypatch.setattr("avatarrex.capture.fit.size_fit.resize_person", torn)
    monkeypatch.setattr("avatarrex.capture.fit.verdict.likely_convention", lambda *_: "T is in centimetres")
    capture = seen_by(replace(open_capture(tiny), sized=False), posed(scaled))
    lines = judge(capture, frames=1)[2].lines()
    assert "person: no size fits the mattes" in lines[1]
    assert "33 open edges" in lines[1]
    assert "T is in centimetres" in lines[2]


def test_a_convention_is_sought_before_a_size_was_fitted_to_it(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mattes in wrong axes have a person fitted to them that nobody is: no convention would put that one right."""
    monkeypatch.setattr(conventions, "PICTURES", 3)
    monkeypatch.setattr(conventions, "PIXELS", 80)

    def anywhere(capture: Capture) -> Capture:
        return replace(capture.moved(np.array([0.3, 0.9, 0.5])), sized=True)

    monkeypatch.setattr("avatarrex.capture.fit.verdict.fit_size", anywhere)
    capture = seen_by(replace(open_capture(tiny), sized=False), SPOILED["+Z up"])
    verdict = judge(capture, frames=1)[2]
    assert verdict.state == "unusable"
    assert "calibration: its world has +Z up" in " ".join(verdict.lines())


def test_the_command_ends_in_a_verdict(tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["capture", "check", str(tiny), "--frames", "1"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "verdict: good"
    out = tmp_path / "out"
    assert main(["capture", "check", str(swapped(tmp_path)), "--frames", "1", "--out", str(out)]) == 1
    said = capsys.readouterr().out
    assert "verdict: unusable\n  body: IoU 0." in said
    assert "calibration: R and T lead from the camera to the world: invert them (unusable)" in said
    kept = json.loads((out / "check.json").read_text())["verdict"]
    assert (kept["state"], kept["reasons"][0]["where"]) == ("unusable", "body")


def test_train_refuses_what_is_unusable_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, run = str(swapped(tmp_path)), tmp_path / "run"
    monkeypatch.setattr(train, "_open_run", lambda *_: pytest.fail("work has begun"))
    assert main(["train", path, "--out", str(run)]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "swapped.zip: body: expected a capture that can be trained on (`capture check` shows it; --force" in error
    assert not run.exists()
    options = parse(["train", path, "--out", str(run), "--force"])
    forced = train._fitted(open_capture(path), None, options)
    assert forced.rigs
    with pytest.raises(InputError):
        train._fitted(open_capture(path), None, parse(["train", path, "--out", str(run)]))
