"""The synthetic capture as files: exact, the same again, resumed, and one clear line where it cannot be made."""

from __future__ import annotations

import errno
import json
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from avatarrex_studio.cli.main import main
from PIL import Image

from avatarrex.camera import Camera
from avatarrex.capture.fit.pose_fit import keypoint_error
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.synthetic import make as synthetic
from avatarrex.capture.synthetic import plan as plans
from avatarrex.capture.synthetic.make import make_capture
from avatarrex.capture.synthetic.plan import RigSize, Size, plan
from avatarrex.capture.synthetic.subject import load_subject
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.errors import InputError
from avatarrex.gl.context import gl_unavailable

needs_gl = pytest.mark.skipif(gl_unavailable() is not None, reason=str(gl_unavailable()))
TINY = Size(72, 96, 2, 4, RigSize(2, 2, (1,), 128), RigSize(2, 2, (1,), 128))


@pytest.fixture(scope="module")
def tiny_size() -> Iterator[None]:
    """A size called `tiny` beside the others: two cameras and two frames a rig."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(plans.SIZES, "tiny", TINY)
        yield


@pytest.fixture(scope="module")
def made(tiny_size: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture that no test changes."""
    return make_capture(tmp_path_factory.mktemp("synthetic") / "tiny", "tiny", seed=3)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file by its path."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def views(folder: Path, rig: str) -> dict[str, Camera]:
    """Cameras of a rig, read with nothing but json and NumPy."""
    cameras = {}
    for serial, entry in json.loads((folder / rig / "calibration_full.json").read_text()).items():
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.reshape(entry["R"], (3, 3)), entry["T"]
        assert entry["distCoeff"] == [0.0] * 5
        cameras[serial] = Camera(np.reshape(entry["K"], (3, 3)), pose, *entry["imgSize"])
    return cameras


@needs_gl
def test_layout_and_marks(made: Path) -> None:
    manifest = json.loads((made / "capture.json").read_text())
    assert manifest["complete"] is True
    assert (manifest["format"], manifest["size"], manifest["seed"], manifest["garment"]) == (1, "tiny", 3, "printed")
    files = contents(made)
    for rig in ("body", "face"):
        cameras = list(views(made, rig))
        assert len(cameras) == 2
        for serial in cameras:
            for frame in range(2):
                for name in (f"{rig}/{serial}/{frame:08d}.jpg", f"{rig}/{serial}/mask/pha/{frame:08d}.jpg"):
                    assert name in files
                truth = f"{rig}/{serial}/truth/{frame:08d}.npz"
                assert (truth in files) == (frame in manifest["depth_frames"][rig])
        assert set(manifest["held_out_frames"][rig]) < set(range(2))
        assert manifest["held_out_frames"][rig]
        assert set(manifest["held_out_cameras"][rig]) < set(cameras)
        assert set(manifest["held_out_frames"][rig]) <= set(manifest["depth_frames"][rig])
    assert not [name for name in files if name.endswith(".part")]


@needs_gl
def test_the_reader_takes_it_and_its_parameters_reproduce_the_meshes(made: Path) -> None:
    capture = open_capture(made)
    assert capture.person.hash == load_subject().person.hash
    assert capture.ground_truth.keys() == capture.rigs.keys()
    for name, rig in capture.rigs.items():
        assert rig.missing == frozenset()
        assert rig.held_out_views == {1}
        pelvis = capture.person.body.joint_template[0].double().numpy()
        assert rig.keypoints is not None
        assert 0.5 < keypoint_error(capture.person, rig) < 0.05 * rig.views[0].camera.height
        for frame in range(rig.frames):
            signals = rig.signals[frame]
            posed = load_subject().pose(signals).vertices
            turned = synthetic_world(signals, pelvis, posed)
            np.testing.assert_allclose(capture.ground_truth[name].vertices[frame], turned, atol=2e-6)


def synthetic_world(signals: object, pelvis: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """x = R (v − J_0) + J_0 + t with R by Rodrigues' formula, written out."""
    axis = np.asarray(signals.global_orient)  # type: ignore[attr-defined]
    angle = np.linalg.norm(axis)
    k = axis / max(angle, 1e-12)
    v = vertices - pelvis
    turned = v * np.cos(angle) + np.cross(k, v) * np.sin(angle) + np.outer(v @ k, k) * (1 - np.cos(angle))
    return turned + pelvis + signals.translation  # type: ignore[attr-defined]


@needs_gl
@pytest.mark.parametrize("rig", ["body", "face"])
def test_matte_is_the_coverage_of_the_projected_mesh(made: Path, rig: str) -> None:
    """Against a NumPy z-buffer of the stored mesh; shifted by a pixel it must fail."""
    with np.load(made / rig / "ground_truth.npz") as truth:
        vertices, faces = truth["vertices"].astype(np.float64), truth["faces"].astype(np.int64)
    for serial, camera in views(made, rig).items():
        hit = visible_faces(vertices[1], faces, camera.resized(2 * camera.width, 2 * camera.height))[0] >= 0
        coverage = hit.reshape(camera.height, 2, camera.width, 2).mean((1, 3))
        matte = np.array(Image.open(made / rig / serial / "mask" / "pha" / "00000001.jpg")) / 255

        def overlap(a: np.ndarray, b: np.ndarray) -> float:
            return float(np.minimum(a, b).sum() / np.maximum(a, b).sum())

        assert overlap(matte, coverage) > 0.99
        assert overlap(matte, np.roll(coverage, 1, axis=1)) < 0.985


@needs_gl
def test_small_mattes_meet_the_mesh(tiny_size: None) -> None:
    """One body and one face picture of the pinned size: IoU ≥ 0.995 of mattes over one half."""
    from avatarrex.capture.synthetic.albedo_lattice import bake
    from avatarrex.capture.synthetic.rasteriser import Rasteriser

    for rig in plan("tiny", 0, "loose").rigs:
        camera = next(iter(rig.cameras.values())).resized(384, 512)
        posed, placed = rig.posed(1), rig.world_from_root(1)
        lattice = bake(rig.subject, np.full(len(rig.subject.faces), 1.0))
        rasteriser = Rasteriser(rig.subject.faces, lattice, 4)
        rasteriser.pose(posed, np.ones(len(posed.vertices)))
        matte = rasteriser.draw(camera.seen_from(placed)).colour[..., 3] > 0.5
        hit = visible_faces(rig.world_vertices[1].astype(np.float64), posed.faces, camera)[0] >= 0
        assert (matte & hit).sum() / (matte | hit).sum() > 0.995


@needs_gl
@pytest.mark.parametrize("rig", ["body", "face"])
def test_depth_and_normals_are_the_subjects(made: Path, rig: str) -> None:
    """Pixels with depth, carried back to the root frame, lie on the outer surface of the subject to a tenth of a millimetre."""
    pytest.importorskip("igl")
    planned = next(r for r in plan("tiny", 3, "printed").rigs if r.name == rig)
    frame = planned.depth_frames[-1]
    posed, placed = planned.posed(frame), planned.world_from_root(frame)
    for serial, camera in views(made, rig).items():
        with np.load(made / rig / serial / "truth" / f"{frame:08d}.npz") as truth:
            depth, normal = truth["depth"].astype(np.float64), truth["normal"].astype(np.float64)
        rows, columns = np.nonzero(depth)
        assert len(rows) > 300
        z = depth[rows, columns]
        ray = np.stack([columns + 0.5, rows + 0.5, np.ones(len(z))], 1) @ np.linalg.inv(camera.intrinsics).T
        seen = camera.seen_from(placed).camera_from_world
        points = (ray * z[:, None] - seen[:3, 3]) @ seen[:3, :3]
        assert np.abs(posed.signed_distance(points)).max() < 1e-4
        exact = posed.at(*posed.closest(points))[1] @ placed[:3, :3].T
        assert np.median((exact * normal[rows, columns]).sum(1)) > 0.9999
        assert not normal[depth == 0].any()
        assert (
            (depth > 0) <= (np.array(Image.open(made / rig / serial / "mask" / "pha" / f"{frame:08d}.jpg")) > 20)
        ).all()


@needs_gl
def test_what_is_missing_or_cut_short_is_made_again_and_nothing_else(made: Path, tmp_path: Path) -> None:
    """Deleted, truncated and zeroed files come back byte for byte; all others are left alone."""
    again = tmp_path / "again"
    shutil.copytree(made, again)
    before = contents(again)
    serial, other = views(made, "body")
    broken = {
        f"body/{serial}/00000000.jpg": None,
        f"body/{other}/mask/pha/00000001.jpg": 100,
        f"body/{other}/truth/00000000.npz": 900,
        "body/ground_truth.npz": 5000,
        "body/smpl_params.npz": 20,
    }
    for name, length in broken.items():
        path = again / name
        path.unlink() if length is None else path.write_bytes(before[name][:length])
    zeroed = again / "body" / serial / "00000001.jpg"
    zeroed.write_bytes(bytes(zeroed.stat().st_size))
    (again / "body" / serial / ".00000001.jpg.part").write_bytes(b"half")
    redrawn = (f"body/{serial}/", f"body/{other}/", "body/ground_truth", "body/smpl_params", "capture.json")
    kept = {name: (again / name).stat().st_mtime_ns for name in before if not name.startswith(redrawn)}
    make_capture(again, "tiny", seed=3)
    after = contents(again)
    assert {name for name in after if after[name] != before.get(name)} == set()
    assert set(after) == set(before)
    assert kept
    assert kept == {name: (again / name).stat().st_mtime_ns for name in kept}


@needs_gl
@pytest.mark.parametrize("stops", [1, 12])
def test_a_run_that_dies_goes_on_to_the_same_bytes(
    stops: int, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped in the middle of a write: no file under its final name is half, and the rest follows."""
    out, write, written = tmp_path / "stopped.zip", synthetic._write, []

    def dying(path: Path, content: bytes, whole: bool = True) -> None:
        written.append(path)
        if len(written) == stops:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.with_name(f".{path.name}.part").write_bytes(content[:50])
            raise KeyboardInterrupt
        write(path, content, whole)

    monkeypatch.setattr(synthetic, "_write", dying)
    with pytest.raises(KeyboardInterrupt):
        make_capture(out, "tiny", seed=3, archive=True)
    monkeypatch.setattr(synthetic, "_write", write)
    assert not out.exists()
    whole = contents(made)
    half = {name: content for name, content in contents(tmp_path / "stopped.zip.parts").items() if name[-5:] != ".part"}
    assert all(content == whole[name] for name, content in half.items() if name != "capture.json")
    assert not half or json.loads(half["capture.json"])["complete"] is False
    make_capture(out, "tiny", seed=3, archive=True)
    with zipfile.ZipFile(out) as archive:
        assert {name: archive.read(name) for name in archive.namelist()} == whole
    assert not (tmp_path / "stopped.zip.parts").exists()
    assert open_capture(out).rigs["face"].image(0, 1).shape == (96, 72, 3)


def test_the_disk_must_have_room(tiny_size: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=2**20))
    with pytest.raises(InputError, match=r"expected .* GiB of free disk space, found 0.00 GiB"):
        make_capture(tmp_path / "full", "tiny")
    assert not (tmp_path / "full" / "capture.json").exists()


@needs_gl
def test_a_disk_that_fills_up_gives_one_line(
    tiny_size: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write = Path.write_bytes

    def full(self: Path, data: bytes) -> int:
        if self.name.startswith(".ground_truth"):
            raise OSError(errno.ENOSPC, "No space left on device", str(self))
        return write(self, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    assert main(["capture", "make", str(tmp_path / "full"), "--size", "tiny"]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert "No space left on device" in said[0]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["OUT", "--size", "huge"], "--size: expected one of smoke, small, paper"),
        (["OUT", "--seed", "-1"], "--seed: expected an integer from 0"),
        (["OUT", "--seed", "4294967296"], "--seed: expected an integer from 0 to 4294967295"),
        (["OUT", "--garment", "kilt"], "--garment: expected one of printed, loose"),
        (["OUT", "--format", "tar"], "--format: expected one of folder, zip"),
        (["OUT", "--format", "zip"], "a name that ends in .zip"),
        (["OUT.zip"], "a name that ends in .zip"),
        (["FILE", "--size", "smoke"], "a new or empty folder, or a capture to go on with"),
        (["FILE/below", "--size", "smoke"], "Not a directory"),
        (["OTHERS", "--size", "smoke"], "a new or empty folder, or a capture to go on with"),
        (["BEGUN", "--size", "smoke", "--seed", "8"], "a new folder, or one begun with"),
        (["BROKEN", "--size", "smoke"], "the capture.json of a synthetic capture"),
        (["DEEP", "--size", "smoke"], "the capture.json of a synthetic capture nested at most 64 deep"),
    ],
)
def test_bad_arguments_give_one_line(
    words: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "FILE").write_text("no folder")
    begun = {"size": "smoke", "seed": 7, "garment": "printed"}
    for name, text in (("OTHERS", ""), ("BEGUN", json.dumps(begun)), ("BROKEN", "[]"), ("DEEP", "[" * 900)):
        (tmp_path / name).mkdir()
        (tmp_path / name / ("capture.json" if text else "notes.txt")).write_text(text)
    before = contents(tmp_path)
    assert main(["capture", "make", str(tmp_path / words[0]), *words[1:]]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert expected in said[0]
    assert contents(tmp_path) == before
