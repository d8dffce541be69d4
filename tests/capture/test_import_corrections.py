"""What a person says goes before what an import guesses, and a few frames are a capture of their own, to be looked at."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli.main import main
from capture import foreign
from capture.foreign import BODIES, Scene
from capture.tiny_capture import npz

from avatarrex.capture.fit.check import check_capture
from avatarrex.capture.importers.axes import TURNS
from avatarrex.capture.importers.corrections import few
from avatarrex.capture.importers.source import Source, SourceView
from avatarrex.capture.readers.calibration import Lens, read_calibration
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.signals.library import named_hand

MEAN = np.full(45, 0.2)


@pytest.fixture(scope="module")
def body() -> Scene:
    return foreign.scene()


def avatarrex(body: Scene, source: Path, scale: float = 1.0, **changed: np.ndarray) -> Path:
    """As published, but cameras in another unit, and some parameters otherwise."""
    BODIES["AvatarReX"](body, source)
    file = source / "calibration_full.json"
    entries = json.loads(file.read_text())
    for entry in entries.values():
        entry["T"] = (scale * np.array(entry["T"])).tolist()
    file.write_text(json.dumps(entries))
    with np.load(source / "smpl_params.npz") as old:
        (source / "smpl_params.npz").write_bytes(npz(**{**old, **changed}))
    return source


def imported(source: Path, out: Path, *words: str) -> int:
    return main(["capture", "import", str(source), str(out), *words])


def test_a_unit_that_was_said(body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Centimetres, which are guessed to be millimetres."""
    source = avatarrex(body, tmp_path / "source", 100.0)
    assert imported(source, tmp_path / "out", "--unit", "cm") == 0
    assert "unit: camera positions in cm, as was said" in capsys.readouterr().out
    for view, camera in zip(open_capture(tmp_path / "out").rigs["body"].views, body.cameras.values()):
        np.testing.assert_allclose(view.camera.camera_from_world, camera.camera_from_world, atol=1e-9)


def test_an_axis_that_was_said(body: Scene, tmp_path: Path) -> None:
    """Of a world with +Z up: +Y leaves it as it is, +Z is what is guessed."""
    BODIES["ZJU-MoCap"](body, tmp_path / "source")
    exact = [camera.camera_from_world for camera in body.cameras.values()]
    for up, same in (("+Z", True), ("+Y", False), ("-X", False)):
        assert imported(tmp_path / "source", tmp_path / "out", f"--up={up}") == 0
        found = [view.camera.camera_from_world for view in open_capture(tmp_path / "out").rigs["body"].views]
        assert np.allclose(found, exact, atol=1e-9) == same, up


@pytest.mark.parametrize(
    ("layout", "place"), [("AvatarReX", "calibration_full.json: c"), ("ActorsHQ", "source: Cam00")]
)
def test_a_unit_that_was_said_is_not_guessed_again(
    layout: str, place: str, body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Centimetres, called metres, might be millimetres; a rig's kind is not judged by that, either."""
    far = {name: Lens(name, camera, np.zeros(5)).scaled(100.0).camera for name, camera in body.cameras.items()}
    BODIES[layout](replace(body, cameras=far), tmp_path / "source")
    assert imported(tmp_path / "source", tmp_path / "out", "--unit", "m") == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert place in said
    assert ".T: expected a camera 0.1 to 20 m from the person (in the unit that was said), found 3" in said
    assert not (tmp_path / "out").exists()


def test_a_person_in_another_unit_than_the_cameras(
    body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    metres = foreign.smplx(body)["transl"]
    source = avatarrex(body, tmp_path / "source", transl=1000 * metres)
    assert imported(source, tmp_path / "out", "--unit", "m") == 0
    assert "the person's translation in millimetres" in capsys.readouterr().out
    for found, exact in zip(open_capture(tmp_path / "out").rigs["body"].signals, body.signals):
        np.testing.assert_allclose(found.translation, exact.translation, atol=1e-6)


@pytest.mark.parametrize("up", ["+Z", "-X", "+Y"])
def test_an_axis_that_was_said_of_cameras_alone(
    up: str, body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    BODIES["ActorsHQ"](body, tmp_path / "source")
    (tmp_path / "source" / "smpl_params.npz").unlink()
    assert imported(tmp_path / "source", tmp_path / "out", f"--up={up}") == 0
    assert (f"{up} of the file's world is up, as was said" in capsys.readouterr().out) == (up != "+Y")
    path = tmp_path / "out" / "body" / "calibration_full.json"
    for lens, camera in zip(read_calibration(path.read_text(), str(path)), body.cameras.values()):
        exact = camera.centre if up == "+Y" else TURNS[up].apply(camera.centre)
        np.testing.assert_allclose(lens.camera.centre, exact, atol=1e-9)


def test_hands_that_were_said(body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = avatarrex(body, tmp_path / "source", flat_hand_mean=np.array(True), hands_meanl=MEAN, hands_meanr=MEAN)
    poses = {}
    for said in ("flat", "mean"):
        assert imported(source, tmp_path / said, "--hands", said) == 0
        poses[said] = open_capture(tmp_path / said).rigs["body"].signals[0].left_hand_pose
    np.testing.assert_allclose(poses["flat"], body.signals[0].left_hand_pose, atol=1e-6)
    np.testing.assert_allclose(poses["mean"] - poses["flat"], MEAN.reshape(15, 3), atol=1e-6)
    assert imported(avatarrex(body, tmp_path / "none"), tmp_path / "other", "--hands", "mean") == 2
    assert "hands_meanl: expected the mean hand that --hands mean adds" in capsys.readouterr().err


@pytest.mark.parametrize("layout", ["AvatarReX", "ZJU-MoCap"])
def test_hands_without_parameters(layout: str, body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Relaxed; flat, or the file's mean, where that is said; a line tells which."""
    BODIES[layout](body, tmp_path / "source")
    if layout == "AvatarReX":
        avatarrex(body, tmp_path / "source", hands_meanl=MEAN, hands_meanr=2 * MEAN)
        with np.load(tmp_path / "source" / "smpl_params.npz") as file:
            arrays = {key: file[key] for key in file if "hand_pose" not in key}
        (tmp_path / "source" / "smpl_params.npz").write_bytes(npz(**arrays))
    none = "hands: no left_hand_pose and no right_hand_pose in the file: "
    rest = {"": named_hand("relaxed", "right"), "flat": np.zeros((15, 3)), "mean": 2 * MEAN.reshape(15, 3)}
    for said, line in (("", "relaxed"), ("flat", "flat"), ("mean", "the file's mean hand")):
        if layout == "ZJU-MoCap" and said == "mean":
            continue
        words = ["--hands", said] if said else []
        assert imported(tmp_path / "source", tmp_path / f"out{said}", *words) == 0
        assert f"{none}{line} in every frame{', as was said' if said else ''}\n" in capsys.readouterr().out
        for frame in open_capture(tmp_path / f"out{said}").rigs["body"].signals:
            np.testing.assert_allclose(frame.right_hand_pose, rest[said], atol=1e-6)


def test_hands_of_cameras_alone(body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    BODIES["ActorsHQ"](body, tmp_path / "source")
    (tmp_path / "source" / "smpl_params.npz").unlink()
    assert imported(tmp_path / "source", tmp_path / "out", "--hands", "flat") == 0
    assert "hands: no pose is in the file: --hands flat changes nothing\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words", ["--unit ft", "--up=Z", "--hands curled", "--preview 0", "--preview -1"], ids=lambda words: words[2:7]
)
def test_words_that_mean_nothing(words: str, body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    BODIES["AvatarReX"](body, tmp_path / "source")
    assert imported(tmp_path / "source", tmp_path / "out", *words.split()) == 2
    assert words.replace("=", " ").split()[0] in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_look_at_two_frames(body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first and the last, with their own parameters, the template over them; then the whole, in the same folder."""
    source, out = avatarrex(body, tmp_path / "source"), tmp_path / "out"
    (source / "missing_img_files.txt").unlink()
    assert imported(source, out, "--preview", "2") == 0
    assert "verdict: " in capsys.readouterr().out
    assert (out / "look" / "body.png").is_file()
    capture = open_capture(out)
    rig = capture.rigs["body"]
    assert rig.frames == 2
    for found, exact in zip(rig.signals, (body.signals[0], body.signals[2])):
        np.testing.assert_allclose(found.body_pose, exact.body_pose, atol=1e-6)
    assert (check_capture(capture, frames=2).rigs[0].mean("template") or 0) > 0.999
    assert any("a preview" in note for note in capture.notes)
    assert imported(source, out) == 0
    assert not (out / "look").exists(), "of the preview"
    whole = open_capture(out)
    assert (whole.rigs["body"].frames, [note for note in whole.notes if "preview" in note]) == (3, [])
    assert files(out / "body") == files(source), "frame 1 of the preview was the source's frame 2"


def files(root: Path) -> dict[str, bytes]:
    """Pictures and mattes by their names."""
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*.jpg")}


def test_ten_coefficients_are_no_rows_of_ten_frames(body: Scene) -> None:
    (name, camera), *_ = body.cameras.items()
    view = SourceView(Lens(name, camera, np.zeros(5)), {frame: f"{frame}.jpg" for frame in range(10)}, {})
    values = {"betas": np.arange(10.0), "expression": np.arange(20.0).reshape(10, 2)}
    found = few(Source("AvatarReX", "body", (view,), 10, values), 2).parameters
    np.testing.assert_equal(found["betas"], values["betas"])
    np.testing.assert_equal(found["expression"], values["expression"][[0, 9]])


def test_a_preview_leaves_a_finished_import_as_it_is(
    body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = avatarrex(body, tmp_path / "source"), tmp_path / "out"
    assert imported(source, out) == 0
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert imported(source, out, "--preview", "2") == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "out: expected a new or empty folder for --preview, found an import of all of source" in said
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_a_preview_of_fewer_frames_replaces_one_of_more(body: Scene, tmp_path: Path) -> None:
    source = avatarrex(body, tmp_path / "source")
    for count in (3, 1):
        assert imported(source, tmp_path / "out", "--preview", str(count)) == 0
        assert open_capture(tmp_path / "out").rigs["body"].frames == count
    assert {path.stem for path in (tmp_path / "out" / "body").rglob("*.jpg")} == {"00000000"}
