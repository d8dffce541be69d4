"""What is wrong with a capture is said in one line, with the file and the key."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from capture.tiny_capture import FRAMES, TinyCapture, jpeg
from partial_png import partial_png

from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError

PARAMETERS, CALIBRATION = "body/smpl_params.npz", "body/calibration_full.json"


@pytest.fixture(scope="module")
def tiny() -> TinyCapture:
    return TinyCapture.make(("body",))


def pickled() -> bytes:
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=True, body_pose=np.array([{}], dtype=object))
    return stream.getvalue()


def with_nan(columns: int) -> np.ndarray:
    values = np.zeros((FRAMES, columns))
    values[1, 2] = np.nan
    return values


def put(name: str, data: bytes) -> Callable[[TinyCapture], None]:
    return lambda capture: capture.files.__setitem__(name, data)


def cut(name: str) -> Callable[[TinyCapture], None]:
    return lambda capture: capture.files.__setitem__(name, capture.files[name][: len(capture.files[name]) // 2])


def change(**arrays: object) -> Callable[[TinyCapture], None]:
    return lambda capture: capture.change(**arrays) and None


def calibrate(**values: object) -> Callable[[TinyCapture], None]:
    return lambda capture: capture.calibrate(**values) and None


def manifest(**values: object) -> Callable[[TinyCapture], None]:
    return lambda capture: capture.manifest(**values) and None


CASES: dict[str, tuple[Callable[[TinyCapture], object], str, str, str]] = {
    "NaN in a pose": (change(body_pose=with_nan(63)), PARAMETERS, "body_pose", "finite"),
    "NaN in the path": (change(transl=with_nan(3)), PARAMETERS, "transl", "finite"),
    "fewer expressions": (change(arkit52=np.zeros((2, 52))), PARAMETERS, "arkit52", "as many frames as body_pose"),
    "fewer hands": (change(left_hand_pose=np.zeros((2, 45))), PARAMETERS, "left_hand_pose", "as many frames"),
    "PCA hands": (change(left_hand_pose=np.zeros((FRAMES, 6))), PARAMETERS, "left_hand_pose", "PCA off"),
    "no mean of the hands": (change(flat_hand_mean=False), PARAMETERS, "hands_meanl", "to be there"),
    "no orientation": (change(global_orient=None), PARAMETERS, "global_orient", "to be there"),
    "no path": (change(transl=None), PARAMETERS, "transl", "to be there"),
    "no pose": (change(body_pose=None), PARAMETERS, "body_pose", "to be there"),
    "no frames": (change(body_pose=np.zeros((0, 63))), PARAMETERS, "body_pose", "at least one frame"),
    "text for numbers": (change(transl=np.array(["a"])), PARAMETERS, "transl", "numbers"),
    "a name twice": (change(arkit_names=np.array(["jawOpen"] * 52)), PARAMETERS, "arkit_names", "at most once"),
    "shape of nine": (change(shape10=np.zeros(9)), PARAMETERS, "shape10", "(10,)"),
    "objects": (put(PARAMETERS, pickled()), PARAMETERS, "body_pose", "no pickled"),
    "half a file": (cut(PARAMETERS), PARAMETERS, "", "complete .npz"),
    "no JSON": (cut(CALIBRATION), CALIBRATION, "", "JSON"),
    "no cameras": (put(CALIBRATION, b"{}"), CALIBRATION, "", "one entry per camera"),
    "a camera's name": (put(CALIBRATION, b'{"../../etc": {}}'), CALIBRATION, "'../../etc'", "can name a folder"),
    "no K": (calibrate(K=None), CALIBRATION, "c0.K", "to be there"),
    "K of eight": (calibrate(K=[1] * 8), CALIBRATION, "c0.K", "9 numbers"),
    "K of nothing": (calibrate(K=[0] * 9), CALIBRATION, "c0.K", "focal lengths"),
    "a mirror": (calibrate(R=[1, 0, 0, 0, 1, 0, 0, 0, -1]), CALIBRATION, "c0.R", "a rotation"),
    "a scale": (calibrate(R=[2, 0, 0, 0, 2, 0, 0, 0, 2]), CALIBRATION, "c0.R", "a rotation"),
    "NaN in T": (calibrate(T=[0, float("nan"), 1]), CALIBRATION, "c0.T", "finite"),
    "far away": (calibrate(T=[0, 0, 40.0]), CALIBRATION, "c0.T", "20 m from the person"),
    "half a pixel": (calibrate(imgSize=[60.5, 80]), CALIBRATION, "c0.imgSize", "integers"),
    "a fisheye": (calibrate(distCoeff=[0, 0, 0, 0, 0, 0.1]), CALIBRATION, "c0.distCoeff", "4 or 5"),
    "two gains": (calibrate(gain=[1, 1]), CALIBRATION, "c0.gain", "3 numbers"),
    "no light": (calibrate(gain=[1, 0, 1]), CALIBRATION, "c0.gain", "[r, g, b], factors from 0.125 to 8"),
    "another size": (calibrate(imgSize=[80, 60]), "body/c0/00000000.jpg", "", "80x60 pixels"),
    "no picture": (put("body/c0/00000000.jpg", b"hello"), "body/c0/00000000.jpg", "", "JPEG or PNG"),
    "a newer format": (manifest(format=2), "capture.json", "format", "at most 1"),
    "no list": (manifest(held_out_frames=[1]), "capture.json", "held_out_frames", "a list per rig"),
    "an unknown rig": (manifest(held_out_frames={"feet": []}), "capture.json", "held_out_frames", "body"),
    "a frame too far": (manifest(held_out_frames={"body": [3]}), "capture.json", "held_out_frames.body", "0 to 2"),
    "an unknown camera": (manifest(held_out_cameras={"body": ["x"]}), "capture.json", "held_out_cameras.body", "c0"),
    "a stray line": (
        put("body/missing_img_files.txt", b"c0/picture"),
        "body/missing_img_files.txt",
        "line 1",
        "CAMERA",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_bad_input(tiny: TinyCapture, tmp_path: Path, name: str) -> None:
    spoil, file, field, expected = CASES[name]
    capture = TinyCapture(tiny.signals, dict(tiny.files))
    spoil(capture)
    with pytest.raises(InputError) as raised:
        open_capture(capture.zip(tmp_path / "a.zip"))
    assert raised.value.source == f"{tmp_path}/a.zip/{file}"
    assert raised.value.field == field
    assert expected in raised.value.expected
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("packed", [True, False])
def test_a_cut_off_picture(tiny: TinyCapture, tmp_path: Path, packed: bool) -> None:
    capture = TinyCapture(tiny.signals, dict(tiny.files))
    cut("body/c1/00000002.jpg")(capture)
    path = capture.zip(tmp_path / "a.zip") if packed else capture.folder(tmp_path / "a")
    rig = open_capture(path).rigs["body"]
    with pytest.raises(InputError, match=r"c1/00000002\.jpg: expected a whole picture"):
        rig.image(1, 2)
    assert rig.matte(1, 2).any()


@pytest.mark.parametrize(("name", "kind"), [("mask/pha/00000002.png", "matte"), ("00000002.png", "image")])
def test_a_half_empty_picture(tiny: TinyCapture, tmp_path: Path, name: str, kind: str) -> None:
    """Of which Pillow reads the missing half as black."""
    capture = TinyCapture(tiny.signals, dict(tiny.files))
    del capture.files[f"body/c1/{name[:-4]}.jpg"]
    capture.files[f"body/c1/{name}"] = partial_png(np.full((80, 60, 3), 255, np.uint8), 40)
    rig = open_capture(capture.folder(tmp_path / "a")).rigs["body"]
    with pytest.raises(InputError, match=rf"c1/{name}: expected a whole picture, found 50% of its pixels"):
        getattr(rig, kind)(1, 2)


def test_a_later_picture_of_another_size(tiny: TinyCapture, tmp_path: Path) -> None:
    capture = TinyCapture(tiny.signals, dict(tiny.files))
    capture.files["body/c1/00000002.jpg"] = jpeg(np.zeros((8, 8, 3), np.uint8))
    rig = open_capture(capture.zip(tmp_path / "a.zip")).rigs["body"]
    with pytest.raises(
        InputError, match=r"c1/00000002\.jpg: expected 60x80 pixels, as the calibration says, found 8x8"
    ):
        rig.image(1, 2)


@pytest.mark.parametrize("name", ["../evil.jpg", "/etc/passwd", "body/../../x", "C:/x", r"..\x"])
def test_names_that_lead_out_are_refused(tiny: TinyCapture, tmp_path: Path, name: str) -> None:
    path = tiny.zip(tmp_path / "a.zip")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(name, b"")
    with pytest.raises(InputError, match="names inside the archive"):
        open_capture(path)


def test_a_damaged_zip(tiny: TinyCapture, tmp_path: Path) -> None:
    path = tiny.zip(tmp_path / "a.zip")
    with zipfile.ZipFile(path) as archive:
        place = archive.getinfo("body/c0/00000001.jpg").header_offset
    data = bytearray(path.read_bytes())
    data[place + 60 : place + 90] = bytes(30)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"c0/00000001\.jpg: expected a file that can be read"):
        open_capture(path).rigs["body"].image(0, 1)
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=r"a folder or a \.zip file"):
        open_capture(path)


def test_unknown_layouts_say_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "annots.npy").write_bytes(b"")
    (tmp_path / "images").mkdir()
    with pytest.raises(InputError, match=r"calibration_full\.json \(AvatarReX\).*found annots\.npy, images"):
        open_capture(tmp_path)
    with pytest.raises(InputError, match="nothing there"):
        open_capture(tmp_path / "nowhere")
    with pytest.raises(InputError, match="another kind of file"):
        open_capture(tmp_path / "annots.npy")


def test_a_giant_is_refused(tiny: TinyCapture, tmp_path: Path) -> None:
    capture = TinyCapture(tiny.signals, dict(tiny.files))
    from avatarrex.templates.person import load_person

    joints = 1.35 * load_person().body.joint_template.double().numpy()
    capture.change(shape10=None, tpose_joints=joints)
    with pytest.raises(InputError, match=r"a person 1\.2 to 2\.2 m tall"):
        open_capture(capture.zip(tmp_path / "a.zip"))


def test_no_picture_at_all(tiny: TinyCapture, tmp_path: Path) -> None:
    files = {name: data for name, data in tiny.files.items() if not name.endswith(".jpg")}
    with pytest.raises(InputError, match="images with mattes of cameras c0"):
        open_capture(TinyCapture(tiny.signals, files).folder(tmp_path / "a"))
    assert json.loads(files[CALIBRATION])
