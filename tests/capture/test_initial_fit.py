"""From cameras and keypoints alone: every calibration's format, both detectors' files, and a first fit within two centimetres."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli.main import main
from capture import filmed
from capture.clothed import Clothed

from avatarrex.camera import Camera
from avatarrex.capture.fit.initial import Initial, fit_initial
from avatarrex.capture.fit.landmarks import landmarks
from avatarrex.capture.fit.triangulation import triangulate
from avatarrex.capture.importers.calibrations import find_cameras
from avatarrex.capture.importers.detections import read_detections
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.synthetic.cameras import body_ring, fitted
from avatarrex.capture.synthetic.motions import body_motion
from avatarrex.errors import InputError
from avatarrex.files.gate import UNFINISHED
from avatarrex.files.json_text import write_json

NOISE, WRONG = 2.0, 0.05
"""Pixels, and the share of keypoints that are anywhere in the picture."""


class Moving(Clothed):
    """Consecutive frames at thirty a second; nothing is drawn."""

    @property
    def motion(self):  # type: ignore[no-untyped-def, override]
        whole = body_motion(80, self.seed)
        return replace(whole, frames=tuple(whole[20 + frame] for frame in range(self.frames)))


@pytest.fixture(scope="module")
def moving() -> np.ndarray:
    return filmed.exact_landmarks(Moving(frames=6).motion)


def ring(places: np.ndarray, count: int) -> list[Camera]:
    return fitted(body_ring(count, 384, 512, (places.min((0, 1)) + places.max((0, 1))) / 2), places, 0.9)


def fit(places: np.ndarray, cameras: list[Camera], **options: object) -> Initial:
    found = filmed.detected(places, cameras, NOISE, WRONG)
    lenses = tuple(Lens(f"c{k}", camera, np.zeros(5)) for k, camera in enumerate(cameras))
    return fit_initial(lenses, found[..., :2], found[..., 2], **options)  # type: ignore[arg-type]


def off(found: Initial, places: np.ndarray) -> float:
    """Metres, mean over all 55 joints."""
    return float(np.linalg.norm(found.poses.posed(found.bones)[1] - places[:, :55], axis=2).mean())


@pytest.mark.parametrize(("count", "metres"), [(16, 0.02), (4, 0.03)])
def test_joints_from_noisy_keypoints(count: int, metres: float, moving: np.ndarray) -> None:
    found = fit(moving, ring(moving, count))
    assert off(found, moving) < metres / 1.5
    assert found.height == pytest.approx(1.78, abs=0.03)
    arrays = found.parameters(30.0)
    assert arrays["body_pose"].shape == (6, 63)
    assert np.nanmedian(found.residuals()) < 0.02


def test_hands_of_few_frames_a_second() -> None:
    """Neighbours far apart do not draw at wrists, and joints have the range that they turn in: 7.3 mm with one for all axes, 6.6 tied."""
    places = filmed.exact_landmarks(Clothed(frames=12).motion)
    wrists = [landmarks().names.index(f"{side}_wrist") for side in ("left", "right")]
    found = fit(places, ring(places, 8))
    away = found.poses.posed(found.bones)[1][:, wrists] - places[:, wrists]
    assert np.linalg.norm(away, axis=2).mean() < 0.0058


def test_centimetres_and_another_axis_up(moving: np.ndarray) -> None:
    cameras = ring(moving, 6)
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    other = []
    for one in cameras:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = one.camera_from_world[:3, :3] @ turn.T, 100 * one.camera_from_world[:3, 3]
        other.append(replace(one, camera_from_world=pose))
    found = filmed.detected(moving, cameras, NOISE, WRONG)
    made = fit_initial(
        tuple(Lens(f"c{k}", one, np.zeros(5)) for k, one in enumerate(other)), found[..., :2], found[..., 2]
    )
    assert off(made, moving) < 0.015
    assert any("centimetres" in note for note in made.notes)
    assert any("+Z" in note for note in made.notes)


def test_outliers_are_left_out_and_lonely_points_are_not_found() -> None:
    rng = np.random.default_rng(0)
    places = rng.uniform(-0.5, 0.5, (5, 4, 3))
    cameras = tuple(body_ring(5, 384, 512, np.zeros(3)))
    points = np.stack([camera.pixels(places)[0] for camera in cameras], 1)
    points[:, 1, 0] += 60
    confidence = np.ones(points.shape[:3])
    confidence[:, 1:, 3] = 0
    found = triangulate(cameras, points, confidence)
    np.testing.assert_allclose(found.position[:, :3], places[:, :3], atol=1e-6)
    assert (found.agree[:, 0] == 4).all()
    assert not found.found[:, 3].any()


def test_nobody_is_refused(moving: np.ndarray) -> None:
    cameras = ring(moving, 4)
    lenses = tuple(Lens(f"c{k}", camera, np.zeros(5)) for k, camera in enumerate(cameras))
    with pytest.raises(InputError, match="two cameras agree on hips and shoulders"):
        fit_initial(lenses, np.zeros((2, 4, len(landmarks().names), 2)), np.zeros((2, 4, len(landmarks().names))))


CALIBRATIONS: dict[str, Callable[[dict[str, Camera]], dict[str, str]]] = {
    "TOML": lambda cameras: {"Calib_scene.toml": filmed.toml(cameras)},
    "OpenCV YAML": filmed.easymocap,
    "COLMAP": lambda cameras: filmed.colmap(cameras, 1.0),
}


@pytest.mark.parametrize("kind", CALIBRATIONS)
def test_calibrations(kind: str, tmp_path: Path) -> None:
    cameras = {f"cam{k}": camera for k, camera in enumerate(body_ring(3, 384, 512, np.zeros(3)))}
    for name, text in CALIBRATIONS[kind](cameras).items():
        (tmp_path / name).write_text(text)
    found = find_cameras(tmp_path, dict.fromkeys(cameras, (384, 512)))
    assert (found.kind, found.scaled, [lens.name for lens in found.lenses]) == (kind, kind != "COLMAP", list(cameras))
    points = np.random.default_rng(0).uniform(-1, 1, (5, 3))
    for lens, camera in zip(found.lenses, cameras.values()):
        np.testing.assert_allclose(lens.camera.intrinsics, camera.intrinsics, atol=1e-6)
        if kind != "COLMAP":  # whose world is turned
            np.testing.assert_allclose(lens.camera.pixels(points)[0], camera.pixels(points)[0], atol=1e-5)
        assert np.linalg.norm(lens.camera.centre) == pytest.approx(3.2)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("calibration.toml", "[a]\nmatrix = 3\n", r"a\.matrix: expected 9 finite numbers, found 1"),
        ("calibration.toml", "[a", "expected TOML"),
        ("calibration.json", "{}", "expected an object with one entry per camera"),
        ("nothing.txt", "", "cameras.txt with images.txt, found none of them"),
    ],
)
def test_bad_calibrations(name: str, text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=said):
        find_cameras(tmp_path)


def test_both_detectors_say_the_same(moving: np.ndarray, tmp_path: Path) -> None:
    cameras = ring(moving, 2)
    lenses = tuple(Lens(f"c{k}", camera, np.zeros(5)) for k, camera in enumerate(cameras))
    exact = filmed.detected(moving[:2], cameras, 0, 0)
    for view, lens in enumerate(lenses):
        (tmp_path / "open" / lens.name).mkdir(parents=True)
        (tmp_path / "media").mkdir(exist_ok=True)
        for frame in range(2):
            said = filmed.openpose(exact[frame, view])
            said["people"].insert(0, {"pose_keypoints_2d": [0.0] * 75})
            (tmp_path / "open" / lens.name / f"v_{frame:012d}_keypoints.json").write_text(json.dumps(said))
        frames = [filmed.mediapipe(exact[frame, view], (384, 512)) for frame in range(2)]
        (tmp_path / "media" / f"{lens.name}.json").write_text(json.dumps({"frames": frames}))
    (tmp_path / "open" / "c1" / "v_000000000001_keypoints.json").write_text(
        '{"people": [{"pose_keypoints_2d": [1, 2]}]}'
    )
    names = landmarks().names
    for folder, problems in (("open", 1), ("media", 0)):
        points, confidence, said = read_detections(tmp_path / folder, lenses)
        assert len(said) == problems
        seen = confidence > 0
        np.testing.assert_allclose(points[seen], exact[seen, :2], atol=2e-3)
        for name in ("left_knee", "right_index3", "left_thumb_tip", "nose", "right_heel"):
            assert seen[0, :, names.index(name)].all(), name
        assert not seen[:, :, names.index("spine2")].any()
        assert not seen[1, 1].any() or folder == "media"


def test_a_folder_becomes_a_capture_and_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Images, mattes, Caliscope's calibration and OpenPose's files; the second time nothing is done again, `--redo` does."""
    one = Clothed(cameras=4, frames=2, size=(96, 128))
    source, out = filmed.film(one, tmp_path / "film"), tmp_path / "out"
    words = ["capture", "prepare", str(source), str(out), "--no-refine", "--held-out-frames", "1:2"]
    for folder in (out, out / "steps", out / "capture" / "body"):  # of a process that was killed
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{UNFINISHED}x.json").touch()
    write_json(out / "prepare.json", {})
    assert main(words) == 0
    assert not list(out.rglob(".*"))
    said = capsys.readouterr().out
    assert "TOML: 4 cameras" in said
    assert "8 mattes, imported" in said
    assert "verdict: " in said
    rig = open_capture(out / "capture").rigs["body"]
    exact = filmed.exact_landmarks(one.motion)
    for frame in range(2):
        assert np.linalg.norm(rig.signals[frame].translation - exact[frame, 0]) < 0.04
    assert rig.keypoints is not None
    assert not rig.missing
    assert rig.held_out_frames == {1}
    steps = sorted(path.name for path in (out / "steps").glob("*.png"))
    assert steps == ["1_cameras.png", "2_pictures.png", "3_mattes.png", "4_keypoints.png", "5_fit.png", "6_face.png"]
    assert main([*words, "--redo", "fit"]) == 0
    said = capsys.readouterr().out
    assert said.count("(done before)") == 4
    (source / "keypoints" / "c0" / "c0_000000000001_keypoints.json").unlink()
    assert main(words) == 0
    assert capsys.readouterr().out.count("(done before)") == 3
    assert main([*words, "--redo", "eat"]) == 2
    assert (
        "--redo: expected one of cameras, pictures, mattes, keypoints, fit, face, found eat" in capsys.readouterr().err
    )
