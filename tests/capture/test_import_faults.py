"""Files that are damaged, of another capture, or numbered otherwise: each becomes one line, and none silently wrong data."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli import capture_prepare
from avatarrex_studio.cli.main import main
from capture.filmed import toml
from capture.foreign import jpg, png_bytes, put

from avatarrex.capture.importers.actorshq import read_actorshq
from avatarrex.capture.importers.calibrations import find_cameras
from avatarrex.capture.importers.detections import read_detections
from avatarrex.capture.importers.faces import _flame_row, _nerface_row
from avatarrex.capture.importers.footage import find_footage
from avatarrex.capture.importers.import_capture import _begun, rest_pelvis
from avatarrex.capture.importers.pictures import matte_rule
from avatarrex.capture.importers.preparing import Options, Preparing
from avatarrex.capture.importers.source import Reading, smplx_parameters
from avatarrex.capture.importers.zju import _names
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.linked import link
from avatarrex.capture.readers.rigs import SMPLX_PELVIS
from avatarrex.capture.synthetic.cameras import body_ring
from avatarrex.errors import InputError
from avatarrex.files.json_text import write_json
from avatarrex.templates.person import load_person

GREY = np.full((16, 12, 3), 90, np.uint8)
CAMERAS = {f"c{k}": camera for k, camera in enumerate(body_ring(2, 12, 16, np.zeros(3)))}
LENSES = tuple(Lens(name, camera, np.zeros(5)) for name, camera in CAMERAS.items())


def film(source: Path, first: int = 3) -> Path:
    """Two cameras from frame `first` on; the first of c1 was not taken. Pictures, mattes and keypoints have the same numbers."""
    put(source / "calibration.toml", toml(CAMERAS).encode())
    for name in CAMERAS:
        for number in range(first + (name == "c1"), first + 3):
            put(source / "images" / name / f"{number:04d}.jpg", jpg(GREY + number))
            put(source / "mattes" / name / f"{number:04d}.png", png_bytes(255 * (GREY[..., 0] > 0)))
            person = {"people": [{"pose_keypoints_2d": [number, 1.0, 1.0] * 25}]}
            put(source / "keypoints" / name / f"{number:04d}_keypoints.json", json.dumps(person).encode())
    return source


def steps(work: Preparing, count: int) -> list[str]:
    """What the first steps say."""
    said: list[str] = []
    for line in work.run():
        said.append(line)
        if line.startswith(f"{count} "):
            break
    return said


def test_all_that_a_camera_has_is_numbered_alike(tmp_path: Path) -> None:
    work = Preparing(film(tmp_path / "film"), tmp_path / "out")
    steps(work, 4)
    assert [sorted(work.pictures(lens)) for lens in LENSES] == [[0, 1, 2], [1, 2]]
    assert not (work.body / "c1" / "mask" / "pha" / "00000000.png").exists()
    points, sure, _ = read_detections(tmp_path / "film" / "keypoints", LENSES, 3, work.first)
    nose = sure[0, 0].argmax()
    np.testing.assert_allclose(points[:, 0, nose, 0], [3.5, 4.5, 5.5])
    np.testing.assert_allclose(points[:, 1, nose, 0], [0, 4.5, 5.5])


def test_files_beside_videos_may_count_from_one(tmp_path: Path) -> None:
    put(tmp_path / "videos" / "c0.mp4", b"")
    for number in (1, 2):
        put(tmp_path / "mattes" / "c0" / f"{number}.png", png_bytes(GREY[..., 0]))
        put(tmp_path / "masks" / "c0" / f"{number + 1}.png", png_bytes(GREY[..., 0]))
    work = Preparing(tmp_path, tmp_path / "out")
    assert [frame for frame, _ in work.beside(("mattes",))["c0"].frames()] == [0, 1]
    assert [frame for frame, _ in work.beside(("masks",))["c0"].frames()] == [2, 3]


def test_damaged_pictures_are_left_out_and_those_of_before_are_removed(tmp_path: Path) -> None:
    source = film(tmp_path / "film", 0)
    damaged, odd, matte = (source / "images" / "c0" / f"000{k}.jpg" for k in range(3))
    damaged.write_bytes(damaged.read_bytes()[:-8])
    odd.write_bytes(jpg(np.zeros((8, 8, 3), np.uint8)))
    matte = source / "mattes" / "c1" / "0001.png"
    matte.write_bytes(png_bytes(np.full((4, 4), 255)))
    work = Preparing(source, tmp_path / "out")
    put(work.body.parent.parent / "prepare.json", b"{}")
    put(work.body / "c0" / "00000009.jpg", b"of another stride")
    said = "\n".join(steps(work, 4))
    assert "0000.jpg: expected a whole PNG or JPEG" in said
    assert "c0 frame 1: expected 12x16 pixels, found 8x8" in said
    assert "c1 matte of frame 1: expected 12x16 pixels, found 4x4" in said
    assert sorted(work.pictures(LENSES[0])) == [2]


def test_a_step_is_done_again_for_its_own_options_and_files(tmp_path: Path) -> None:
    source, out = film(tmp_path / "film"), tmp_path / "out"
    steps(Preparing(source, out), 3)
    put(source / "notes.md", b"of somebody")
    again = steps(Preparing(source, out, Options(fps=25, height=1.8)), 3)
    assert sum("(done before)" in line for line in again) == 3
    again = steps(Preparing(source, out, Options(stride=2)), 3)
    assert sum("(done before)" in line for line in again) == 1
    shutil.rmtree(source / "mattes")
    with pytest.raises(InputError, match="found none of them"):
        steps(Preparing(source, out, Options(stride=2)), 3)
    assert sorted(json.loads((out / "prepare.json").read_text())) == ["cameras", "pictures"]


def test_folders_of_others_stay(tmp_path: Path) -> None:
    put(tmp_path / "out" / "capture" / "kept", b"")
    (tmp_path / "film").mkdir()
    with pytest.raises(InputError, match="capture: expected a name that is free"):
        Preparing(tmp_path / "film", tmp_path / "out")
    put(tmp_path / "out" / "refined" / "kept", b"")
    for said in (None, [1], {"key": 3}):
        if said is not None:
            write_json(tmp_path / "out" / capture_prepare.REFINED, said)
        with pytest.raises(InputError, match="refined: expected a name that is free"):
            capture_prepare._refined(tmp_path, tmp_path / "out", "a", "default")
    assert (tmp_path / "out" / "refined" / "kept").exists()


def test_other_mattes_are_refined_and_trained_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def refine(capture: str, every: bool, out: Path, template: str) -> int:
        made.append(f"refined on {template}, every frame" if every else "refined")
        put(out / capture_prepare.FIGURES, b"{}")
        return 0

    monkeypatch.setattr(capture_prepare, "refine", refine)
    for key in ("a", "a", "b"):
        capture_prepare._refined(tmp_path, tmp_path, key, "models")
    put(tmp_path / "refined" / capture_prepare.FILE, b"")  # killed before its pictures were written
    capture_prepare._refined(tmp_path, tmp_path, "b", "models")
    assert made == 3 * ["refined on models, every frame"]
    run, marker = tmp_path / "run", tmp_path / capture_prepare.TRAINED
    begun = []
    for key in ("a", "a", "b"):
        begun.append(capture_prepare._begun(run, marker, key))
        put(run / "run.json", key.encode())
    assert begun == [False, True, False]
    assert (tmp_path / "run_before_1" / "run.json").read_text() == "a"


@pytest.mark.parametrize(
    "words", ["--fps 0", "--height 0", "--height -1", "--stride 0", "--train foo", "--fps nan", "--held-out-frames 3"]
)
def test_options_are_judged_before_any_work(words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["capture", "prepare", str(film(tmp_path / "film")), str(tmp_path / "out"), *words.split()]) == 2
    assert words.split()[0] in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_frames_beyond_the_film_are_refused_before_the_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whose keypoints, all in one point, no fit takes."""
    words = ["capture", "prepare", str(film(tmp_path / "film")), str(tmp_path / "out"), "--held-out-frames", "5:9"]
    assert main(words) == 2
    assert (
        "--held-out-frames: expected some of the 3 frames of the motion, found 5:9"
        in capsys.readouterr().err.splitlines()[-1]
    )


def test_an_import_of_another_source_is_refused_and_changed_files_are_linked_anew(tmp_path: Path) -> None:
    one, other, out = tmp_path / "one", tmp_path / "other", tmp_path / "out"
    for source in (one, other):
        put(source / "a.jpg", source.name.encode())
    put(out / ".x7k.json", b"{")  # of a process that was killed in its first write
    _begun(one, out, "ActorsHQ")
    assert json.loads((out / "capture.json").read_text())["complete"] is False
    _begun(one, out, "ActorsHQ")
    with pytest.raises(InputError, match=f"one that {other} is imported into, found one"):
        _begun(other, out, "ActorsHQ")
    for source in (one, one, other):
        link(Archive(source), "a.jpg", out / "a.jpg")
    assert (out / "a.jpg").read_text() == "other"
    assert os.path.samefile(other / "a.jpg", out / "a.jpg")


def test_cameras_have_names_of_their_own() -> None:
    assert _names([{0: "c0/1.jpg"}, {0: "c1/1.jpg"}]) == ["c0", "c1"]
    assert _names([{0: "c0/images/1.jpg"}, {0: "c1/images/1.jpg"}]) == ["camera00", "camera01"]


HEAD = "name,w,h,rx,ry,rz,tx,ty,tz,fx,fy,px,py\n"
ROW = "c0,12,16,0,0,0,0,0,-3,1,1,0.5,0.5\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [(HEAD + 2 * ROW, "name: expected each camera once"), (HEAD + 200_000 * "1", "a table with commas")],
)
def test_tables_of_cameras(text: str, said: str, tmp_path: Path) -> None:
    put(tmp_path / "calibration.csv", text.encode())
    with pytest.raises(InputError, match=said):
        read_actorshq(Reading(Archive(tmp_path), "", load_person()))


def test_parameters_of_another_form_are_a_problem(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "smpl_params.npz",
        body_pose=np.zeros((2, 7)),
        global_orient=np.zeros((2, 3)),
        transl=np.zeros((2, 3)),
    )
    reading = Reading(Archive(tmp_path), "", load_person())
    assert smplx_parameters(reading, "smpl_params.npz") == {}
    assert "smpl_params.npz: body_pose: expected" in reading.problems[0]


def test_the_pelvis_is_where_the_reader_has_it() -> None:
    joints = np.zeros((55, 3))
    joints[0], joints[1] = (0, 300, 0), (0, 1700, 0)
    assert rest_pelvis({}) is SMPLX_PELVIS
    np.testing.assert_allclose(rest_pelvis({"tpose_joints": joints}), [0, 0.3, 0])
    np.testing.assert_allclose(rest_pelvis({"tpose_joints": joints, "shape10": np.zeros(10)}), 0)


@pytest.mark.parametrize("matrix", [np.zeros((4, 4)), np.diag([-1.0, 1, 1, 1]), np.diag([2.0, 2, 2, 1])])
def test_heads_need_rotations(matrix: np.ndarray) -> None:
    entry = {
        "transform_matrix": matrix.tolist(),
        "world_mat": matrix[:3].tolist(),
        "expression": [0] * 76,
        "pose": [0] * 15,
    }
    with pytest.raises(InputError, match=r"frames\[4\]\.transform_matrix: expected"):
        _nerface_row(entry, "f.json", 4)
    with pytest.raises(InputError, match=r"frames\[4\]\.world_mat: expected a rotation"):
        _flame_row({**entry, "expression": [0] * 50}, "f.json", 4)


def test_names_of_thousands_of_letters(tmp_path: Path) -> None:
    assert not Archive(tmp_path).exists("a" * 5000)


CAMERA = (
    "[c0]\nsize = [12, 16]\nmatrix = [[9, 0, 6], [0, 9, 8], [0, 0, 1]]\nrotation = [0, 0, 0]\ntranslation = [0, 0, 3]\n"
)
BAD: dict[str, tuple[Callable[[str], str], str]] = {
    "row": (lambda text: text.replace("[0, 0, 1]]", "[0, 0, 2]]"), "c0.matrix: expected .* a last row"),
    "size": (lambda text: text.replace("12, 16", "12.7, 16"), "c0.size: expected integers"),
    "two": (lambda text: text + "distortions = [0.1, 0.1]\n", "c0.distortion: expected 4 or 5"),
    "mirror": (
        lambda text: text.replace("[0, 0, 0]", "[-1, 0, 0, 0, 1, 0, 0, 0, 1]"),
        "c0.rotation: expected a rotation",
    ),
    "digits": (lambda text: text.replace("12, 16", "1" * 5000), "expected TOML"),
    "hex": (lambda text: text.replace("[12, 16]", "0x" + "f" * 5000), "c0.size: expected numbers, found int"),
}


@pytest.mark.parametrize("what", BAD)
def test_calibrations_that_are_refused(what: str, tmp_path: Path) -> None:
    change, said = BAD[what]
    (tmp_path / "calibration.toml").write_text(change(CAMERA))
    with pytest.raises(InputError, match=said):
        find_cameras(tmp_path)


def test_settings_are_no_calibration_and_rotations_are_made_exact(tmp_path: Path) -> None:
    put(tmp_path / "Config.toml", b"[project]\nframe_rate = 60\n")
    rounded = CAMERA.replace("[0, 0, 0]", "[1, 0.001, 0, 0, 1, 0, 0, 0, 1]")
    put(tmp_path / "calibration" / "Calib.toml", rounded.encode())
    found = find_cameras(tmp_path)
    assert found.files == (tmp_path / "calibration" / "Calib.toml",)
    turn = found.lenses[0].camera.camera_from_world[:3, :3]
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-12)


def test_a_number_in_a_name_takes_no_memory(tmp_path: Path) -> None:
    person = json.dumps({"people": [{"pose_keypoints_2d": [1.0, 1.0, 1.0] * 25}]}).encode()
    for number in (0, 20240131):
        put(tmp_path / "c0" / f"{number}.json", person)
    put(tmp_path / "c1.json", b"5")
    points, _, problems = read_detections(tmp_path, LENSES)
    assert len(points) == 1
    assert problems == [
        "c1.json: frames: expected a list of at most 108000, found int",
        "keypoints: 1 files of frames that have no picture",
    ]


def test_noise_of_a_codec_is_no_label() -> None:
    empty, person = np.full((20, 30), 2, np.uint8), np.zeros((20, 30), np.uint8)
    person[5:15, 10:20] = 255
    assert matte_rule([empty, person]) == "grey"
    assert matte_rule([empty, empty]) == "labels"


def test_videos_of_phones_are_turned(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    path = tmp_path / "videos" / "c0.mp4"
    path.parent.mkdir()
    pixels = np.zeros((64, 96, 3), np.uint8)
    pixels[:, :48] = 255
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30, width=96, height=64, pix_fmt="yuv420p")
        for packet in [*stream.encode(av.VideoFrame.from_ndarray(pixels)), *stream.encode(None)]:
            container.mux(packet)
    content = bytearray(path.read_bytes())
    matrix = content.index(b"tkhd") + 44
    one = (1 << 16).to_bytes(4, "big")
    minus, none, last = (-(1 << 16) % 2**32).to_bytes(4, "big"), bytes(4), (1 << 30).to_bytes(4, "big")
    content[matrix : matrix + 36] = none + one + none + minus + none + none + none + none + last
    path.write_bytes(content)
    footage = find_footage(tmp_path, ("videos",))["c0"]
    assert footage.size == (64, 96)
    shown = next(footage.frames())[1]
    assert shown[:40].mean() > 200 > 50 > shown[60:].mean(), "a quarter turn clockwise"
