"""Captures are read as they were written, in every layout, lazily, and exactly where the person is our own."""

from __future__ import annotations

import pickle
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from capture.tiny_capture import FRAMES, HEIGHT, WIDTH, TinyCapture, cameras, jpeg, npz, png

from avatarrex.capture.readers.images_store import ByteCache
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.library import named_hand


@pytest.fixture(scope="module")
def tiny() -> TinyCapture:
    return TinyCapture.make()


@pytest.fixture
def copy(tiny: TinyCapture) -> TinyCapture:
    return TinyCapture(tiny.signals, dict(tiny.files))


def same(one: Capture, other: Capture) -> bool:
    return all(
        one.rigs[name].signals.frames == other.rigs[name].signals.frames
        and np.array_equal(one.rigs[name].image(0, 1), other.rigs[name].image(0, 1))
        for name in other.rigs
    )


def test_our_own_capture_comes_back_exactly(tiny: TinyCapture, tmp_path: Path) -> None:
    capture = open_capture(tiny.zip(tmp_path / "tiny.zip"))
    assert set(capture.rigs) == {"body", "face"}
    assert capture.person.fit is None
    assert capture.notes == ()
    rig = capture.rigs["body"]
    assert rig.frames == FRAMES
    assert list(rig.signals) == tiny.signals
    assert not rig.missing | rig.held_out_frames | rig.held_out_views
    for view, (name, camera) in zip(rig.views, cameras("body").items()):
        assert view.name == name
        assert (view.camera.width, view.camera.height) == (WIDTH, HEIGHT)
        np.testing.assert_allclose(view.camera.intrinsics, camera.intrinsics, atol=1e-12)
        np.testing.assert_allclose(view.camera.camera_from_world, camera.camera_from_world, atol=1e-12)
    image, matte = rig.image(2, 1), rig.matte(2, 1)
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert matte.shape == (HEIGHT, WIDTH)
    assert 0.02 < (matte > 128).mean() < 0.5
    assert np.abs(image[matte > 250].astype(int).mean(0) - [200, 120, 60]).max() < 8


def test_every_packing_reads_the_same(copy: TinyCapture, tmp_path: Path) -> None:
    plain = open_capture(copy.folder(tmp_path / "folder"))
    assert same(open_capture(copy.zip(tmp_path / "a.zip")), plain)
    assert same(open_capture(copy.zip(tmp_path / "b.zip", prefix="person one/")), plain)


def test_a_bare_folder_is_the_body(copy: TinyCapture, tmp_path: Path) -> None:
    whole = open_capture(copy.folder(tmp_path / "folder"))
    bare = open_capture(tmp_path / "folder" / "body")
    assert set(bare.rigs) == {"body"}
    assert bare.rigs["body"].signals.frames == whole.rigs["body"].signals.frames


def test_a_bare_face_folder_is_a_face(copy: TinyCapture, tmp_path: Path) -> None:
    whole = open_capture(copy.folder(tmp_path / "folder"))
    bare = open_capture((tmp_path / "folder" / "face").rename(tmp_path / "close ups"))
    assert set(bare.rigs) == {"face"}
    assert bare.rigs["face"].signals.frames == whole.rigs["face"].signals.frames
    millimetres = np.stack([frame.translation for frame in copy.signals]) * 1000
    copy.calibrate("face", T=lambda given: (1000 * np.array(given)).tolist()).change("face", transl=millimetres)
    files = {name.removeprefix("face/"): data for name, data in copy.files.items() if name.startswith("face/")}
    again = open_capture(TinyCapture([], files).zip(tmp_path / "a.zip"))
    assert set(again.rigs) == {"face"}
    assert sum("in millimetres" in note for note in again.notes) == 2


def test_without_a_face_rig_the_head_is_the_bodys(copy: TinyCapture, tmp_path: Path) -> None:
    copy.files = {name: data for name, data in copy.files.items() if name.startswith("body/")}
    notes = open_capture(copy.folder(tmp_path / "a")).notes
    assert notes == ("face: no rig of its own: the head is learned from the body's cameras",)


def test_hands_without_parameters_are_relaxed(copy: TinyCapture, tmp_path: Path) -> None:
    copy.change(right_hand_pose=None)
    capture = open_capture(copy.folder(tmp_path / "a"))
    for signals, given in zip(capture.rigs["body"].signals, copy.signals):
        np.testing.assert_array_equal(signals.left_hand_pose, given.left_hand_pose)
        np.testing.assert_allclose(signals.right_hand_pose, named_hand("relaxed", "right"))
    assert "body: hands: no right_hand_pose in the file: relaxed in every frame" in capture.notes
    copy.change(left_hand_pose=None, flat_hand_mean=False)  # nothing to add a mean to
    capture = open_capture(copy.folder(tmp_path / "a"))
    np.testing.assert_allclose(capture.rigs["body"].signals[1].left_hand_pose, named_hand("relaxed", "left"))
    assert any("no left_hand_pose and no right_hand_pose" in note for note in capture.notes)
    assert not any("mean pose" in note for note in capture.notes)
    copy.change(left_hand_pose=np.zeros((FRAMES, 45)), hands_meanl=np.full(45, 0.1))
    capture = open_capture(copy.folder(tmp_path / "a"))  # the other hand's mean is not needed
    np.testing.assert_allclose(capture.rigs["body"].signals[1].left_hand_pose, 0.1)
    np.testing.assert_allclose(capture.rigs["body"].signals[1].right_hand_pose, named_hand("relaxed", "right"))


def test_pictures_with_an_alpha_channel_are_their_own_mattes(copy: TinyCapture, tmp_path: Path) -> None:
    rig = open_capture(copy.folder(tmp_path / "a")).rigs["body"]
    image, matte = rig.image(1, 2), rig.matte(1, 2)
    for frame in range(FRAMES):
        pixels = np.dstack([rig.image(1, frame), rig.matte(1, frame)])
        copy.files[f"body/c1/{frame:08d}.png"] = png(pixels)
        del copy.files[f"body/c1/{frame:08d}.jpg"], copy.files[f"body/c1/mask/pha/{frame:08d}.jpg"]
    capture = open_capture(copy.folder(tmp_path / "b"))
    found = capture.rigs["body"]
    assert "body: pictures of 1 of 3 cameras are their own mattes (alpha channel)" in capture.notes
    assert not found.missing
    np.testing.assert_array_equal(found.image(1, 2), image)
    np.testing.assert_array_equal(found.matte(1, 2), matte)
    copy.files["body/c1/00000001.png"] = png(image)
    with pytest.raises(ValueError, match=r"c1/00000001\.png: expected an alpha channel.* found RGB"):
        open_capture(copy.folder(tmp_path / "c")).rigs["body"].matte(1, 1)


def test_a_captures_key_is_that_of_its_calibration_and_parameters(copy: TinyCapture, tmp_path: Path) -> None:
    key = open_capture(copy.folder(tmp_path / "folder")).key
    assert len(key) == 16
    assert open_capture(copy.zip(tmp_path / "a.zip", prefix="person one/")).key == key
    copy.change("face", transl=np.stack([frame.translation for frame in copy.signals]) + 0.01)
    assert open_capture(copy.zip(tmp_path / "b.zip")).key != key


def test_thuman_folders(copy: TinyCapture, tmp_path: Path) -> None:
    moved = {}
    for name, data in copy.files.items():
        parts = name.split("/")
        if parts[0] == "body":
            moved[
                "calibration.json" if parts[1] == "calibration_full.json"
                else "/".join(parts[1:]) if len(parts) == 2
                else f"{'masks' if 'mask' in parts else 'images'}/{parts[1]}/{parts[-1]}"
            ] = data  # fmt: skip
    assert same(open_capture(copy.folder(tmp_path / "a")), open_capture(TinyCapture([], moved).folder(tmp_path / "b")))


def test_missing_pictures(copy: TinyCapture, tmp_path: Path) -> None:
    lines = ["c0/00000002.jpg", "", r"body\c1\mask\pha\00000000.jpg", "nobody/00000001.jpg"]
    copy.files["body/missing_img_files.txt"] = "\r\n".join(lines).encode()
    del copy.files["body/c2/00000001.jpg"], copy.files["body/c2/mask/pha/00000002.jpg"]
    capture = open_capture(copy.folder(tmp_path / "a"))
    rig = capture.rigs["body"]
    assert rig.missing == {(0, 2), (1, 0), (2, 1), (2, 2)}
    assert [note for note in capture.notes if "2 pictures listed as missing" in note]
    assert [note for note in capture.notes if "2 of 9 pictures are not there" in note]
    assert not rig.available(2, 1)
    assert rig.available(2, 0)
    with pytest.raises(ValueError, match=r"view 2 \(c2\), frame 1"):
        rig.image(2, 1)


def test_a_camera_without_pictures_is_left_out(copy: TinyCapture, tmp_path: Path) -> None:
    copy.files = {name: data for name, data in copy.files.items() if "/c1/" not in name}
    capture = open_capture(copy.folder(tmp_path / "a"))
    assert [view.name for view in capture.rigs["body"].views] == ["c0", "c2"]
    assert "body: camera c1 has no images: left out" in capture.notes


def test_one_camera_is_enough(tmp_path: Path) -> None:
    capture = open_capture(TinyCapture.make(("face",)).zip(tmp_path / "a.zip"))
    assert [view.name for view in capture.rigs["face"].views] == ["f0"]


def test_mattes_of_three_channels(copy: TinyCapture, tmp_path: Path, rng: np.random.Generator) -> None:
    grey = rng.integers(0, 256, (HEIGHT // 8, WIDTH // 4), np.uint8).repeat(8, 0).repeat(4, 1)
    copy.files["body/c0/mask/pha/00000000.jpg"] = jpeg(grey)
    copy.files["body/c0/mask/pha/00000001.jpg"] = jpeg(np.repeat(grey[..., None], 3, 2))
    rig = open_capture(copy.folder(tmp_path / "a")).rigs["body"]
    assert np.abs(rig.matte(0, 0).astype(int) - rig.matte(0, 1)).max() <= 1
    assert np.abs(rig.matte(0, 0).astype(int) - grey).mean() < 3


def test_what_is_held_out(copy: TinyCapture, tmp_path: Path) -> None:
    copy.manifest(held_out_frames={"body": [2]}, held_out_cameras={"body": ["c1"]}, seed=4)
    capture = open_capture(copy.folder(tmp_path / "a"))
    rig = capture.rigs["body"]
    assert (rig.held_out_frames, rig.held_out_views) == ({2}, {1})
    assert not capture.rigs["face"].held_out_frames
    assert capture.manifest["seed"] == 4
    chosen = rig.holding_out(frames=range(2), views=[0])
    assert (chosen.held_out_frames, chosen.held_out_views) == ({0, 1}, {0})
    with pytest.raises(ValueError, match="held-out view"):
        rig.holding_out(views=[3])


def test_coefficients_go_by_name(copy: TinyCapture, tmp_path: Path, rng: np.random.Generator) -> None:
    order = rng.permutation(52)
    values = np.stack([frame.expression for frame in copy.signals])[:, order]
    names = np.array([EXPRESSION_NAMES[k] for k in order])
    copy.change(arkit52=values[:, 5:], arkit_names=names[5:])
    read = open_capture(copy.folder(tmp_path / "a")).rigs["body"].signals
    for frame, signals in enumerate(read):
        expected = copy.signals[frame].expression.copy()
        expected[order[:5]] = 0
        np.testing.assert_array_equal(signals.expression, expected)


def test_a_hand_mean_is_added_where_the_file_says_so(
    copy: TinyCapture, tmp_path: Path, rng: np.random.Generator
) -> None:
    means = 0.3 * rng.standard_normal((2, 45))
    copy.change(flat_hand_mean=False, hands_meanl=means[0], hands_meanr=means[1])
    capture = open_capture(copy.folder(tmp_path / "a"))
    first = capture.rigs["body"].signals[0]
    np.testing.assert_allclose(first.left_hand_pose, copy.signals[0].left_hand_pose + means[0].reshape(15, 3))
    np.testing.assert_allclose(first.right_hand_pose, copy.signals[0].right_hand_pose + means[1].reshape(15, 3))
    assert any("mean pose added" in note for note in capture.notes)


@pytest.mark.parametrize(("cameras_mm", "person_mm"), [(True, False), (False, True), (True, True)])
def test_millimetres_are_converted_with_a_note(
    copy: TinyCapture, tmp_path: Path, cameras_mm: bool, person_mm: bool
) -> None:
    # far enough from the origin that neither unit fits the other's numbers
    away = np.array([6.0, 0.0, 0.0])
    moved = np.stack([frame.translation for frame in copy.signals]) + away
    copy.files.pop("face/calibration_full.json")
    copy.calibrate(
        R=np.eye(3).tolist(), T=lambda _: ((np.array([0, 0, 3.0]) - away) * (1000 if cameras_mm else 1)).tolist()
    )
    copy.change(transl=moved * (1000 if person_mm else 1))
    capture = open_capture(copy.folder(tmp_path / "a"))
    rig = capture.rigs["body"]
    np.testing.assert_allclose(rig.views[0].camera.centre, away - [0, 0, 3.0], atol=1e-9)
    np.testing.assert_allclose(rig.signals[1].translation, moved[1], atol=1e-9)
    assert sum("in millimetres, converted" in note for note in capture.notes) == cameras_mm + person_mm


def test_the_cache_keeps_to_its_budget(tiny: TinyCapture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = HEIGHT * WIDTH * 3
    rig = open_capture(tiny.zip(tmp_path / "a.zip"), memory_mb=2.5 * one / 2**20).rigs["body"]
    cache: ByteCache = rig.pictures._cache
    decoded = []
    make = rig.pictures._decode
    monkeypatch.setattr(rig.pictures, "_decode", lambda *key: decoded.append(key) or make(*key))
    first = rig.image(0, 0)
    assert rig.image(0, 0) is first
    assert not first.flags.writeable
    rig.image(0, 1)
    rig.image(0, 0)
    rig.image(0, 2)  # (0, 1) is the least recently used
    assert cache.stored == 2 * one
    rig.image(0, 0)
    assert len(decoded) == 3
    rig.image(0, 1)
    assert len(decoded) == 4
    assert cache.stored == 2 * one


def test_threads_and_pickles_read_the_same(tiny: TinyCapture, tmp_path: Path) -> None:
    capture = open_capture(tiny.zip(tmp_path / "a.zip"), memory_mb=0.05)
    rig = capture.rigs["body"]
    wanted = {(view, frame): rig.image(view, frame).copy() for view in range(3) for frame in range(FRAMES)}
    barrier = threading.Barrier(4)

    def work(seed: int) -> bool:
        order = np.random.default_rng(seed).permutation(len(wanted)).tolist() * 4
        barrier.wait()
        keys = list(wanted)
        return all(np.array_equal(rig.image(*keys[k]), wanted[keys[k]]) for k in order)

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, range(4)))
    again = pickle.loads(pickle.dumps(capture.rigs["body"]))
    assert np.array_equal(again.image(1, 2), wanted[1, 2])
    truth = pickle.loads(pickle.dumps(capture.ground_truth))["body"]
    assert np.array_equal(truth.vertices, capture.ground_truth["body"].vertices)


def test_depth_and_normals_where_there_are_any(copy: TinyCapture, tmp_path: Path, rng: np.random.Generator) -> None:
    depth = rng.uniform(1, 3, (HEIGHT, WIDTH)).astype(np.float32)
    normal = rng.standard_normal((HEIGHT, WIDTH, 3)).astype(np.float16)
    copy.files["body/c1/truth/00000002.npz"] = npz(depth=depth, normal=normal)
    copy.files["body/c2/truth/00000002.npz"] = npz(depth=depth[1:])
    truth = open_capture(copy.zip(tmp_path / "a.zip")).ground_truth["body"]
    assert np.array_equal(truth.depth(1, 2), depth)
    assert np.array_equal(truth.normal(1, 2), normal.astype(np.float32))
    assert truth.depth(1, 1) is None
    assert truth.normal(2, 2) is None
    with pytest.raises(ValueError, match=r"c2/truth/00000002\.npz: depth: expected shape \(80, 60\)"):
        truth.depth(2, 2)


def test_faces_of_transparent_cards_are_no_surface(copy: TinyCapture, tmp_path: Path) -> None:
    vertices = np.zeros((FRAMES, 4, 3), np.float32)
    faces = np.array([[0, 1, 2], [1, 2, 3], [0, 2, 3]])
    copy.files["body/ground_truth.npz"] = npz(
        vertices=vertices,
        faces=faces,
        face_material=np.array([0, 1, 0], np.int8),
        materials=np.array(["skin", "a_opacity"]),
    )
    truth = open_capture(copy.zip(tmp_path / "a.zip")).ground_truth["body"]
    assert truth.faces.tolist() == faces[[0, 2]].tolist()


def test_a_capture_that_is_still_being_made_says_so(copy: TinyCapture, tmp_path: Path) -> None:
    copy.manifest(complete=False, provenance={"person_hash": "0" * 16})
    notes = open_capture(copy.folder(tmp_path / "a")).notes
    assert "capture.json: the capture is not complete" in notes
    assert any("another version of the person (0000000000000000)" in note for note in notes)
