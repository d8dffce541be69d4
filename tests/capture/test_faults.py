"""`capture check` names what is wrong with files: order of cameras, flipped rows, half a pixel, hands against a mean, unit, axis."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from capture.clothed import Clothed

from avatarrex.capture.fit import conventions
from avatarrex.capture.fit.camera_order import exchanged
from avatarrex.capture.fit.conventions import likely_convention
from avatarrex.capture.fit.hand_mean import hand_readings
from avatarrex.capture.fit.pixel_shift import pixel_shift
from avatarrex.capture.fit.verdict import judge
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.errors import InputError
from avatarrex.signals.library import named_hand


@pytest.fixture(scope="module")
def clothed() -> Clothed:
    return Clothed(cameras=6, frames=2, seed=0, size=(168, 224))


@pytest.fixture(scope="module")
def sound(clothed: Clothed, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return open_capture(clothed.write(tmp_path_factory.mktemp("sound") / "capture"))


def opened(clothed: Clothed, path: Path, **changes: object) -> Capture:
    return open_capture(clothed.write(path / "capture", **changes))  # type: ignore[arg-type]


def test_a_sound_capture_gets_no_warning(sound: Capture) -> None:
    assert judge(sound, frames=2)[2].lines() == ["verdict: good"]


def test_exchanged_cameras_are_named(clothed: Clothed, tmp_path: Path) -> None:
    capture = opened(clothed, tmp_path, pictures={"c1": "c2", "c2": "c1"})
    verdict = judge(capture, frames=2)[2]
    assert verdict.state == "unusable"
    assert "camera order: c1's pictures are c2's, c2's pictures are c1's" in verdict.lines()[1]


def test_all_cameras_moved_on_by_one(clothed: Clothed, tmp_path: Path) -> None:
    capture = opened(clothed, tmp_path, pictures={f"c{k}": f"c{(k + 1) % 6}" for k in range(6)})
    assert exchanged(capture, capture.rigs["body"]) == {f"c{k}": f"c{(k + 1) % 6}" for k in range(6)}


def test_flipped_rows_are_named(clothed: Clothed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conventions, "PICTURES", 4)
    monkeypatch.setattr(conventions, "PIXELS", 96)
    capture = opened(clothed, tmp_path, flipped=True)
    assert (
        likely_convention(capture, capture.rigs["body"])
        == "the pictures' rows run from the bottom to the top: flip them"
    )


def test_centimetres_are_not_taken_for_inverted_mattes(sound: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """A template so near that it fills the pictures agrees with what is about the person, as inverted mattes would."""
    monkeypatch.setattr(conventions, "PICTURES", 4)
    monkeypatch.setattr(conventions, "PIXELS", 96)
    rig = sound.rigs["body"]

    def near(matrix: np.ndarray) -> np.ndarray:
        return np.column_stack([matrix[:, :3], matrix[:, 3] * (0.1, 0.1, 0.1, 1)])

    views = tuple(
        replace(view, camera=replace(view.camera, camera_from_world=near(view.camera.camera_from_world)))
        for view in rig.views
    )
    assert likely_convention(sound, replace(rig, views=views)) == "T is in centimetres: write metres"


@pytest.mark.parametrize("shift", [-0.5, 0.5])
def test_half_a_pixel_is_named(shift: float, sound: Capture) -> None:
    """Principal points that are off by half a pixel, as of centres at integers (−0.5)."""
    rig = sound.rigs["body"]
    moved = np.array([[0, 0, shift], [0, 0, shift], [0, 0, 0]])
    views = tuple(
        replace(view, camera=replace(view.camera, intrinsics=view.camera.intrinsics + moved)) for view in rig.views
    )
    found, before = (pixel_shift(sound, one) for one in (replace(rig, views=views), rig))
    assert found is not None
    assert before is not None
    assert found.half
    assert not before.half
    assert found.pixels[0] - before.pixels[0] == pytest.approx(-shift, abs=0.1)


@pytest.mark.parametrize("sign", [-1, 1])
def test_hands_against_a_mean_are_named(sign: int, sound: Capture) -> None:
    """The mean left out (−1), or counted twice; it is not the relaxed hand that the check has."""
    rig, rng = sound.rigs["body"], np.random.default_rng(4)
    mean = {side: 0.9 * named_hand("relaxed", side) + 0.05 * rng.standard_normal((15, 3)) for side in ("left", "right")}
    frames = tuple(
        one.replace(
            left_hand_pose=one.left_hand_pose + sign * mean["left"],
            right_hand_pose=one.right_hand_pose + sign * mean["right"],
        )
        for one in rig.signals
    )
    certain = {
        reading.sign: reading.certain
        for reading in hand_readings(sound, replace(rig, signals=replace(rig.signals, frames=frames)))
    }
    assert certain == {-sign: True, sign: False}
    assert not any(reading.certain for reading in hand_readings(sound, rig))


def test_hands_that_lie_beside_the_pictures_are_read(sound: Capture) -> None:
    """As of a person whose size was fitted to mattes with hands that are wrong."""
    rig, mean = sound.rigs["body"], {side: 0.9 * named_hand("relaxed", side) for side in ("left", "right")}
    frames = tuple(
        one.replace(
            left_hand_pose=one.left_hand_pose - mean["left"],
            right_hand_pose=one.right_hand_pose - mean["right"],
            translation=one.translation + np.array([0, 0.02, 0]),
        )
        for one in rig.signals
    )
    found = hand_readings(sound, replace(rig, signals=replace(rig.signals, frames=frames)))
    assert {reading.sign: reading.certain for reading in found} == {1: True, -1: False}
    assert found[0].better > 0.1


def test_the_tool_refuses_a_name_that_nothing_has(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "tools"))
    import foreign_captures

    monkeypatch.setattr(foreign_captures, "train", lambda *given: iter(()))
    monkeypatch.setattr(sys, "argv", ["foreign_captures.py", str(tmp_path), "train", "--only", "ZJV"])
    with pytest.raises(SystemExit) as ended:
        foreign_captures.main()
    assert ended.value.code == 2
    assert "nothing is called as --only says: ZJV" in capsys.readouterr().err


@pytest.mark.parametrize(("what", "only", "fault"), [("faults", "rows", ", rows"), ("train", "", "")])
def test_the_tool_goes_on_after_an_import_that_is_refused(
    what: str,
    only: str,
    fault: str,
    clothed: Clothed,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "tools"))
    import foreign_captures

    def refused(layout: str, *_: object) -> None:
        raise InputError(layout, "c0.T", "a camera 0.1 to 20 m from the person", "3 km")

    monkeypatch.setattr(foreign_captures, "clothed", lambda seed: clothed)
    monkeypatch.setattr(foreign_captures, "written", refused)
    for drawn in ("scene", "heads"):
        monkeypatch.setattr(foreign_captures.foreign, drawn, lambda: None)
    monkeypatch.setattr(sys, "argv", ["foreign_captures.py", str(tmp_path), what, "--only", only])
    assert foreign_captures.main() == 1
    said = capsys.readouterr().out.splitlines()
    layouts = foreign_captures.foreign.BODIES if what == "faults" else foreign_captures.LAYOUTS
    assert [line.split(":")[0] for line in said] == [f"!! {layout}{fault}" for layout in layouts]
    assert all("expected a camera 0.1 to 20 m" in line for line in said)
