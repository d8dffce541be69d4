"""`capture import`: each layout of the field, written as published, is the capture that it was made from; what cannot be used is listed."""

from __future__ import annotations

import errno
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli.main import main
from capture import foreign
from capture.foreign import BODIES, FACES, Scene, pickled
from capture.tiny_capture import TinyCapture
from PIL import Image
from scipy.spatial.transform import Rotation

from avatarrex.capture.fit.check import check_capture
from avatarrex.capture.importers.axes import TURNS, up_axis
from avatarrex.capture.importers.difference import difference_matte, quality
from avatarrex.capture.importers.import_capture import import_capture
from avatarrex.capture.importers.pictures import as_matte, matte_rule
from avatarrex.capture.importers.zju import flat_numbers
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError
from avatarrex.files.gate import UNFINISHED
from avatarrex.signals.joints import JOINT_NAMES


@pytest.fixture(scope="module")
def body() -> Scene:
    return foreign.scene()


@pytest.fixture(scope="module")
def head() -> Scene:
    return foreign.heads()


@pytest.mark.parametrize("layout", BODIES)
def test_a_body(layout: str, body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    BODIES[layout](body, tmp_path / "source")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / f"{UNFINISHED}x.json").touch()  # of a process that was killed
    assert main(["capture", "import", str(tmp_path / "source"), str(tmp_path / "out")]) == 0
    assert f"{layout}: body, 3 cameras, 3 frames" in capsys.readouterr().out
    assert not list((tmp_path / "out").rglob(".*"))
    capture = open_capture(tmp_path / "out")
    rig = capture.rigs["body"]
    for found, exact in zip(rig.signals, body.signals):
        np.testing.assert_allclose(found.translation, exact.translation, atol=1e-6)
        np.testing.assert_allclose(found.global_orient, exact.global_orient, atol=1e-6)
        np.testing.assert_allclose(found.body_pose, exact.body_pose, atol=1e-6)
    for view, camera in zip(rig.views, body.cameras.values()):
        np.testing.assert_allclose(view.camera.intrinsics, camera.intrinsics, atol=1e-9)
        np.testing.assert_allclose(view.camera.camera_from_world, camera.camera_from_world, atol=1e-9)
    (report,) = check_capture(capture, frames=3).rigs
    assert (report.mean("template") or 0) > (0.98 if layout == "ZJU-MoCap" else 0.999), "its hands are relaxed"
    assert len(rig.missing) == (layout == "AvatarReX"), "missing_img_files.txt"


@pytest.mark.parametrize("layout", FACES)
def test_a_face(layout: str, head: Scene, tmp_path: Path) -> None:
    """One camera stays, the head moves: what the picture shows is the same, whatever world it is in."""
    FACES[layout](head, tmp_path / "source")
    found = import_capture(tmp_path / "source", tmp_path / "out")
    assert (found.layout, found.rig, found.pictures, found.problems) == (layout, "face", 3, ())
    (report,) = check_capture(open_capture(tmp_path / "out"), frames=3).rigs
    assert (report.mean("template") or 0) > 0.985
    with np.load(tmp_path / "out" / "face" / "smpl_params.npz") as arrays:
        assert ("flame_expression" in arrays) == (layout == "IMAvatar")
        assert ("nerface_expression" in arrays) == (layout == "NeRFace")


def test_what_cannot_be_used_is_listed_and_ends_nothing(body: Scene, tmp_path: Path) -> None:
    source = tmp_path / "source"
    foreign.written_zju(body, source)
    (source / "new_params" / "1.npy").unlink()
    damaged = source / "Camera_B1" / "000000.jpg"
    damaged.write_bytes(damaged.read_bytes()[:-400])
    (source / "mask_cihp" / "Camera_B2" / "000002.png").unlink()
    Image.new("RGB", (30, 40)).save(source / "Camera_B3" / "000000.jpg")
    found = import_capture(source, tmp_path / "out")
    said = "\n".join(found.problems)
    assert "frame 1, new_params/1.npy: expected the file to be there" in said
    assert "Camera_B1 frame 0: expected a whole picture" in said
    assert "Camera_B2 frame 2: expected a matte, found none" in said
    assert "Camera_B3 frame 0: expected 120x160 pixels, as the calibration says, found 30x40" in said
    assert (len(found.problems), found.pictures) == (4, 3)
    missing = open_capture(tmp_path / "out").rigs["body"].missing
    assert missing == {(0, 0), (2, 0), (0, 1), (1, 1), (2, 1), (1, 2)}
    assert json.loads((tmp_path / "out" / "import.json").read_text())["problems"] == list(found.problems)


def test_a_full_disk_is_no_problem_of_the_sources(
    body: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Pictures that the disk does not take are not left out one by one: the import ends, and goes on with more room."""
    foreign.written_zju(body, tmp_path / "source")

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    words = ["capture", "import", str(tmp_path / "source"), str(tmp_path / "out")]
    with monkeypatch.context() as patch:
        patch.setattr(Image.Image, "save", full)
        assert main(words) == 2
    assert "No space left on device" in capsys.readouterr().err.splitlines()[-1]
    assert json.loads((tmp_path / "out" / "capture.json").read_text())["complete"] is False
    assert main(words) == 0
    assert "9 pictures with mattes" in capsys.readouterr().out


def test_numbers_from_one(body: Scene, tmp_path: Path) -> None:
    foreign.written_zju(body, tmp_path)
    for frame in (2, 1, 0):
        (tmp_path / "new_params" / f"{frame}.npy").rename(tmp_path / "new_params" / f"{frame + 1}.npy")
    found = import_capture(tmp_path, tmp_path / "out")
    assert "new_params: files are numbered from 1" in found.notes
    assert not found.problems


def test_a_root_that_poses_have_a_part_of_and_names_with_backslashes(body: Scene, tmp_path: Path) -> None:
    """The poses' own turn comes first, then Rh: x = R(Rh) R(poses[:3]) x_model + Th."""
    foreign.written_zju(body, tmp_path, rooted=True, slash="\\")
    found = import_capture(tmp_path, tmp_path / "out")
    assert (found.pictures, found.problems) == (9, ())
    for read, exact in zip(open_capture(tmp_path / "out").rigs["body"].signals, body.signals):
        np.testing.assert_allclose(read.global_orient, exact.global_orient, atol=1e-6)
        np.testing.assert_allclose(read.translation, exact.translation, atol=1e-6)


def test_flames_neck_is_our_head(head: Scene, tmp_path: Path) -> None:
    """Its neck turns the skull about the upper end of the neck, where the body's head joint is."""
    foreign.written_imavatar(head, tmp_path / "source")
    path = tmp_path / "source" / "flame_params.json"
    said = json.loads(path.read_text())
    for entry in said["frames"]:
        entry["pose"][3:6] = [0.1, 0.2, 0.3]
    path.write_text(json.dumps(said))
    import_capture(tmp_path / "source", tmp_path / "out")
    for signals in open_capture(tmp_path / "out").rigs["face"].signals:
        turned = dict(zip(JOINT_NAMES[1:22], signals.body_pose))
        np.testing.assert_allclose(turned["head"], [0.1, 0.2, 0.3])
        np.testing.assert_allclose(turned["neck"], 0)


def test_without_parameters(body: Scene, tmp_path: Path) -> None:
    foreign.written_actorshq(body, tmp_path / "source")
    (tmp_path / "source" / "smpl_params.npz").unlink()
    found = import_capture(tmp_path / "source", tmp_path / "out")
    assert not found.posed
    assert "no parameters: `capture prepare` finds poses from keypoints" in found.notes
    assert (tmp_path / "out/body/Cam001/00000002.jpg").exists()


def test_unknown_folders_are_refused_with_the_table(tmp_path: Path) -> None:
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / "x.txt").write_text("")
    with pytest.raises(
        InputError, match=r"calibration_full\.json \(AvatarReX\);.*annots\.npy \(ZJU-MoCap\).*found x\.txt"
    ):
        import_capture(tmp_path / "odd", tmp_path / "out")
    with pytest.raises(InputError, match="one that is in ours"):
        import_capture(TinyCapture.make(("body",)).folder(tmp_path / "ours"), tmp_path / "out")


class _Calls:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return print, ("called",)


def test_nothing_is_called_by_a_pickle(body: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    foreign.written_zju(body, tmp_path)
    (tmp_path / "new_params" / "1.npy").write_bytes(pickled({"poses": _Calls()}))
    refused = "expected numbers, texts, .*found the global (__builtin__|builtins).print"
    (problem,) = import_capture(tmp_path, tmp_path / "out").problems
    assert re.fullmatch(rf"frame 1, new_params/1\.npy: byte \d+: {refused}", problem)
    for content, said in (
        (pickled({"cams": _Calls()}), rf"byte \d+: {refused}"),
        (pickled({"ims": [1]}), r"a dict of cams and ims, found \['ims'\]"),
        (pickled("words"), "a dict of cams and ims, found str"),
        (pickled({"a": 1})[:-5], "a dict of cams and ims that is whole"),
    ):
        (tmp_path / "annots.npy").write_bytes(content)
        with pytest.raises(InputError, match=rf"annots\.npy: .*{said}"):
            import_capture(tmp_path, tmp_path / "other")
    assert capsys.readouterr().out == ""


def test_lists_that_repeat_each_other_are_not_followed() -> None:
    nested: list = [1.0] * 3
    for _ in range(30):
        nested = [nested] * 3
    for value in (nested, [[1.0, 2.0]], {"a": 1}, ["1", "2", "3"], [1.0, np.nan, 2.0]):
        with pytest.raises(InputError, match=r"a\.npy: K: expected 3 (finite )?numbers"):
            flat_numbers(value, 3, "a.npy", "K")
    np.testing.assert_equal(flat_numbers([[1], np.array([[2.0], [3.0]])], 3, "a.npy", "K"), [1, 2, 3])


@pytest.mark.parametrize("axis", TURNS)
def test_up_axes(axis: str) -> None:
    stands = TURNS[axis].inv()
    assert up_axis(np.stack([(stands * Rotation.from_rotvec([0.1, yaw, 0])).as_rotvec() for yaw in (0, 2, 4)])) == axis
    assert up_axis(np.array([[np.pi / 2, 0, 0], [-np.pi / 2, 0, 0]])) == "+Y", "who rolls decides nothing"


def test_what_mattes_mean() -> None:
    empty, person = np.zeros((20, 30), np.uint8), np.zeros((20, 30), np.uint8)
    person[5:15, 10:20] = 255
    labels = np.uint8(person > 0) * 7
    assert [matte_rule([empty, one]) for one in (person, labels, 255 - person)] == ["grey", "labels", "inverted"]
    for one, rule in ((person, "grey"), (labels, "labels"), (255 - person, "inverted")):
        np.testing.assert_equal(as_matte(one, rule), person)


def test_what_differs_from_the_empty_scene() -> None:
    """A ring on a noisy gradient, lit a tenth brighter than the empty scene: its hole stays open, a speck goes."""
    rng = np.random.default_rng(0)
    row, column = np.mgrid[:120, :160]
    empty = np.stack([60 + 0.5 * column, 70 + 0.3 * row, np.full(row.shape, 90.0)], -1)
    away = np.hypot(row - 60, column - 80)
    ring = (away < 40) & (away > 15)
    seen = np.where(ring[..., None], (200.0, 160.0, 140.0), empty * 1.1)
    seen[5:7, 5:7] = 255
    noisy = [np.uint8(np.clip(one + 2 * rng.standard_normal(one.shape), 0, 255)) for one in (seen, empty)]
    matte = difference_matte(*noisy)
    assert ((matte > 127) != ring).mean() < 0.004
    assert quality(matte).faults() == []
    assert quality(np.full((9, 9), 255, np.uint8)).faults() == [
        "covers 100.0% of the picture",
        "covers 100% of the picture's border",
    ]


def test_what_hardly_differs_from_the_wall_is_the_person_and_edges_are_mixed() -> None:
    """Jeans before a wall of nearly their colour: no channel differs by more than its noise, all three do; a soft edge keeps its shares."""
    rng, (y, x) = np.random.default_rng(5), np.mgrid[:180, :170]
    exact = np.clip((38 - np.hypot(y - 90, x - 80)) / 2 + 0.5, 0, 1)  # an edge two pixels wide
    wall = np.array([90.0, 100.0, 95.0]) + 20 * np.sin(x / 9)[..., None]
    jeans, shirt = wall + np.array([10.0, -10.0, 12.0]), np.array([220.0, 210.0, 200.0])
    colour = np.where((y > 90)[..., None], jeans, shirt)
    seen = exact[..., None] * colour + (1 - exact[..., None]) * wall
    noisy = [np.uint8(np.clip(np.rint(one + 2 * rng.standard_normal(one.shape)), 0, 255)) for one in (seen, wall)]
    matte = difference_matte(*noisy) / 255
    assert ((matte > 0.5) != (exact > 0.5)).mean() < 0.02
    above = (y < 88) & (exact > 0) & (exact < 1)
    assert np.abs(matte - exact)[above].mean() < 0.06
