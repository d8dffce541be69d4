"""Lenses, pixel centres, the person's size, and the check of all of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from avatarrex_studio.cli.main import main
from capture.tiny_capture import TinyCapture

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.camera import Camera
from avatarrex.capture.fit.check import check_capture, iou, silhouette, template_surface
from avatarrex.capture.fit.person_fit import fit_person
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.readers.undistort import distort, source_pixels, undistort
from avatarrex.errors import InputError
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

CAPTURE = Path(__file__).parents[2].parent / "shared" / "data" / "capture" / "person_f001.zip"
needs_capture = pytest.mark.skipif(not CAPTURE.exists(), reason="needs person_f001.zip in ../shared/data/capture")
LENS = np.array([-0.28, 0.09, 0.002, -0.0015, 0.01])


def scene(points: np.ndarray) -> np.ndarray:
    """A smooth picture on the plane z = 1, (…, 3) in 0 … 255."""
    x, y = points[..., 0], points[..., 1]
    return 128 + 100 * np.stack([np.sin(9 * x + 2 * y), np.cos(7 * y), np.sin(5 * x) * np.cos(6 * y)], -1)


def plane(camera: Camera) -> np.ndarray:
    """Every pixel centre's point of the plane z = 1, (h, w, 2)."""
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([column, row], -1)
    return (pixels - camera.intrinsics[:2, 2]) / camera.intrinsics[[0, 1], [0, 1]]


@pytest.mark.parametrize("distortion", [LENS, np.array([0.15, 0, 0, 0, 0])])
def test_a_picture_through_a_lens_comes_back(distortion: np.ndarray) -> None:
    camera = Camera(np.array([[150.0, 0, 83], [0, 145, 57], [0, 0, 1]]), np.eye(4), 160, 120)
    lens = Lens("a", camera, distortion)
    assert lens.distorts
    taken_at = plane(camera)
    ideal = taken_at.copy()
    for _ in range(60):  # the point that the lens puts there, by fixed point: |k r²| is well below 1
        ideal += taken_at - distort(ideal, distortion)
    assert np.abs(distort(ideal, distortion) - taken_at).max() < 1e-9
    taken = np.rint(scene(ideal)).astype(np.uint8)
    wanted = scene(plane(camera))
    pixels = source_pixels(lens)
    inside = ((pixels > 0.5) & (pixels < np.array([118.5, 158.5])[:, None, None])).all(0)
    assert inside.mean() > 0.7
    # rounding twice, and the bilinear error h²/8 |f''| of a curvature of 100 · 9² / 150² levels a pixel²
    assert np.abs(undistort(taken, pixels) - wanted)[inside].max() < 1.6
    assert np.abs(taken - wanted)[inside].max() > 12
    mirrored = source_pixels(Lens("a", camera, -distortion))
    assert np.abs(undistort(taken, mirrored) - wanted)[inside].max() > 12
    grey = undistort(taken[..., 0], pixels)
    assert np.array_equal(grey, undistort(taken, pixels)[..., 0])


def test_an_ideal_lens_changes_nothing(tmp_path: Path) -> None:
    capture = TinyCapture.make(("face",))
    plain = open_capture(capture.zip(tmp_path / "a.zip")).rigs["face"]
    capture.calibrate("face", distCoeff=[5e-5, 0, 0, 0])
    assert np.array_equal(open_capture(capture.zip(tmp_path / "b.zip")).rigs["face"].image(0, 0), plain.image(0, 0))
    capture.calibrate("face", distCoeff=LENS.tolist())
    bent = open_capture(capture.zip(tmp_path / "c.zip"))
    assert "face: images of 1 of 1 cameras are undistorted" in bent.notes
    assert not np.array_equal(bent.rigs["face"].image(0, 0), plain.image(0, 0))


def test_pixel_centres_are_at_a_half() -> None:
    """A sphere's outline in closed form: the rays through i + 0.5 that meet it."""
    camera = Camera.orbit(25, 10, 3.0, 40, (0.1, 0.0, 0.05), 160, 120)
    rays = np.concatenate([plane(camera), np.ones((120, 160, 1))], -1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    middle = camera.camera_from_world[:3, :3] @ [0.15, 0.1, 0] + camera.camera_from_world[:3, 3]
    exact = np.linalg.norm(np.cross(rays, middle), axis=-1) < 0.4
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.4)
    vertices, faces = np.array(ball.vertices) + np.array([0.15, 0.1, 0]), np.array(ball.faces)
    assert iou(silhouette(vertices, faces, camera), exact) > 0.995
    for half in (-0.5, 0.5):
        shifted = camera.intrinsics.copy()
        shifted[:2, 2] += half
        off = Camera(shifted, camera.camera_from_world, 160, 120)
        assert iou(silhouette(vertices, faces, off), exact) < 0.98


@pytest.fixture(scope="module")
def other() -> Person:
    """Somebody else: another shape, and joints moved by centimetres."""
    rng = np.random.default_rng(5)
    offsets = 0.01 * rng.standard_normal((55, 3))
    offsets[:22] *= 3
    offsets[0] = 0
    return resize_person(load_person(), PersonFit(rng.standard_normal(10), offsets))


def test_a_captured_persons_joints_are_met(other: Person, tmp_path: Path) -> None:
    away = torch.tensor([0.3, 0.9, 0.1])  # J_0 is where the capture has it, not where ours is
    capture = TinyCapture.make(person=other)
    for rig in ("body", "face"):
        capture.change(rig, transl=np.stack([s.translation for s in capture.signals]) - away.numpy())
        capture.change(rig, tpose_joints=(other.body.joint_template + away).double().numpy())
    read = open_capture(capture.zip(tmp_path / "a.zip"))
    assert read.person.fit is not None
    np.testing.assert_allclose(read.person.body.joint_template, other.body.joint_template, atol=1e-6)
    report = check_capture(read, frames=2)
    for rig in report.rigs:
        assert rig.joint_error_mm is not None
        assert rig.joint_error_mm[1] < 0.01
    body = report.rigs[0]
    fitted, before = body.mean("template"), body.mean("unfitted")
    assert fitted is not None
    assert before is not None
    assert fitted > 0.9 > before + 0.05
    assert body.mean("mesh") == pytest.approx(1, abs=0.01)


def test_the_same_joints_leave_the_person_alone() -> None:
    person = load_person()
    same = fit_person(person, person.body.joint_template.double().numpy() + np.array([1.0, 2, 3]), "test")
    assert same.fit is not None
    assert np.abs(same.fit.shape).max() < 1e-5
    np.testing.assert_allclose(same.body.v_template, person.body.v_template, atol=1e-5)


def test_a_taller_person_is_the_same_person_larger() -> None:
    """Joints 5 % further apart: the skin follows an affine field of offsets exactly, but for what β takes on."""
    person = load_person()
    taller = fit_person(person, 1.05 * person.body.joint_template.double().numpy(), "test")
    np.testing.assert_allclose(taller.body.joint_template, 1.05 * person.body.joint_template, atol=1e-6)
    error = (taller.body.v_template - 1.05 * person.body.v_template).norm(dim=-1)
    assert error.mean() < 0.005
    assert (person.body.v_template * 0.05).norm(dim=-1).mean() > 0.02


def test_joints_of_no_t_pose_are_refused() -> None:
    person = load_person()
    with pytest.raises(InputError, match="joints of a T-pose"):
        fit_person(person, person.body.joint_template.double().numpy()[:, [2, 0, 1]], "a.npz")


def test_an_avatar_keeps_its_size(other: Person, tmp_path: Path) -> None:
    avatar = Avatar.create(other, "compact")
    save_avatar(avatar, tmp_path / "other.avatar")
    again = load_avatar(tmp_path / "other.avatar")
    assert again.person.hash == other.hash != load_person().hash
    assert again.person.name == "default"
    for name in ("v_template", "joint_template"):
        assert torch.equal(getattr(again.person.body, name), getattr(other.body, name))
    assert torch.equal(again.person.left_hand.model.v_template, other.left_hand.model.v_template)
    save_avatar(avatar, tmp_path / "folder")
    meta = json.loads((tmp_path / "folder" / "avatar.json").read_text())
    assert again.meta["person_fit"] == meta["person_fit"]
    meta["person_fit"]["joint_offsets"][5][1] = 1e9
    (tmp_path / "folder" / "avatar.json").write_text(json.dumps(meta))
    with pytest.raises(InputError, match=r"folder: avatar\.json: person_fit\.joint_offsets"):
        load_avatar(tmp_path / "folder")


def test_the_command_says_and_draws_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = TinyCapture.make().manifest(held_out_frames={"body": [1, 2]}).zip(tmp_path / "tiny.zip")
    assert main(["capture", "check", str(path), "--out", str(tmp_path / "out"), "--frames", "2"]) == 0
    said = capsys.readouterr().out
    assert "body: 3 frames at 30 a second; of the training's split 1 frames, 3 cameras, 0 pictures missing" in said
    assert "held out: frames 1–2; cameras none" in said
    report = json.loads((tmp_path / "out" / "check.json").read_text())
    assert [rig["rig"] for rig in report["rigs"]] == ["body", "face"]
    for rig in report["rigs"]:
        assert min(item["template"] for item in rig["silhouettes"]) > 0.97  # the JPEG's edge is all that differs
        assert rig["joint_error_mm"][1] < 0.01
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"body.png", "face.png", "check.json"}
    assert main(["capture", "check", str(path), "--rig", "face", "--frames", "none"]) == 2
    assert main(["capture", "check", str(tmp_path / "nowhere")]) == 2
    assert "nothing there" in capsys.readouterr().err


@needs_capture
def test_a_person_this_project_did_not_model() -> None:
    capture = open_capture(CAPTURE)
    assert {name: (len(rig.views), rig.frames) for name, rig in capture.rigs.items()} == {
        "body": (10, 60),
        "face": (5, 60),
    }
    for name, rig in capture.rigs.items():
        assert not rig.missing
        for frame in (0, 31, 59):
            joints = template_surface(capture.person, rig.signals[frame].replace(expression=np.zeros(52)))[1]
            assert np.abs(joints - capture.ground_truth[name].joints[frame]).max() < 1e-5
    assert capture.rigs["face"].signals[20].expression.max() > 0.3


@needs_capture
@pytest.mark.parametrize(("rig", "view"), [("body", 2), ("face", 1)])
def test_its_mesh_meets_its_mattes_at_half_pixels(rig: str, view: int) -> None:
    capture = open_capture(CAPTURE)
    truth, cameras = capture.ground_truth[rig], capture.rigs[rig]
    vertices, camera = truth.vertices[20], cameras.views[view].camera
    inside = cameras.matte(view, 20) > 128
    exact = iou(silhouette(vertices, truth.faces, camera), inside)
    assert exact > 0.997
    for half in (-0.5, 0.5):
        shifted = camera.intrinsics.copy()
        shifted[:2, 2] += half
        off = Camera(shifted, camera.camera_from_world, camera.width, camera.height)
        assert iou(silhouette(vertices, truth.faces, off), inside) < 1 - 3 * (1 - exact)
