"""Fisheye lenses: an independent model's points come back from them, every format says the same, and what they film is a pinhole's."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from capture import filmed
from capture.clothed import Clothed, subject

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import iou, silhouette, template_surface
from avatarrex.capture.importers.calibrations import find_cameras
from avatarrex.capture.importers.import_capture import calibration, import_capture
from avatarrex.capture.importers.preparing import Preparing
from avatarrex.capture.readers.calibration import Lens, fisheye_lens, read_calibration
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.readers.undistort import bend, source_pixels, straighten
from avatarrex.errors import InputError

EQUIDISTANT = (0.0, 0.0, 0.0, 0.0)
REAL = (-0.0284, 0.0073, -0.0093, 0.0021)
"""As of a wide action camera."""
FOLDED = (-0.25, 0.0, 0.0, 0.0)
"""Its rays turn back at 66°."""


@dataclass(frozen=True)
class Fisheye(Camera):
    """Takes pictures by the definition of OpenCV's fisheye, from angles in float64; `intrinsics` are the picture's as taken."""

    coefficients: tuple[float, ...] = EQUIDISTANT

    def pixels(self, points: np.ndarray, nearest: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = np.moveaxis(self.seen(points), -1, 0)
        angle, way = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
        radius = angle + sum(k * angle ** (2 * n + 3) for n, k in enumerate(self.coefficients))
        plane = np.stack([radius * np.cos(way), radius * np.sin(way), np.ones_like(radius)], -1)
        return (plane @ self.intrinsics.T)[..., :2], z

    def resized(self, width: int, height: int) -> Camera:
        return Fisheye(**{**vars(super().resized(width, height)), "coefficients": self.coefficients})


def camera_of(degrees: float, coefficients: tuple[float, ...] = EQUIDISTANT) -> Fisheye:
    """Which without coefficients sees so far to the left; its pixels are no squares, its principal point is not the middle."""
    width, height = 1920, 1080
    focal, middle = width / 2 / math.radians(degrees), np.array([width / 2 + 14.3, height / 2 - 9.7])
    intrinsics = np.array([[focal, 0, middle[0]], [0, 1.02 * focal, middle[1]], [0, 0, 1]])
    return Fisheye(intrinsics, Camera.orbit(20, 10, 2.0).camera_from_world, width, height, coefficients)


def lens_of(camera: Fisheye, name: str = "a") -> Lens:
    plain = Camera(camera.intrinsics, camera.camera_from_world, camera.width, camera.height)
    return fisheye_lens(name, plain, np.array(camera.coefficients), "file", "")


@pytest.mark.parametrize(
    ("degrees", "coefficients"),
    [(45, EQUIDISTANT), (45, REAL), (45, FOLDED), (62, REAL), (90, EQUIDISTANT), (90, REAL)],
)
def test_points_come_back(degrees: float, coefficients: tuple[float, ...], rng: np.random.Generator) -> None:
    camera = camera_of(degrees, coefficients)
    lens = lens_of(camera)
    points = rng.uniform(-2.5, 2.5, (4000, 3))
    exact, depth = lens.camera.pixels(points)
    inside = ((exact > 0) & (exact < (camera.width, camera.height))).all(1) & (depth > 0.05)
    assert inside.sum() > 300
    seen = camera.pixels(points[inside])[0]
    np.testing.assert_allclose(straighten(lens, seen), exact[inside], atol=1e-3)
    np.testing.assert_allclose(bend(lens, exact[inside]), seen, atol=1e-3)
    assert np.abs(seen - exact[inside]).max() > 20


@pytest.mark.parametrize(("degrees", "kept", "share"), [(45, 40.3, 0.94), (62, 51.2, 0.88), (90, 60.0, 0.92)])
def test_a_pinhole_is_filled_and_not_cropped_to_nothing(degrees: float, kept: float, share: float) -> None:
    """Each of its pixels is in the picture as taken; of the longer side's angle it has most, its middle is nearly as large."""
    lens = lens_of(camera_of(degrees))
    row, column = source_pixels(lens)
    assert min(row.min(), column.min()) >= 0
    assert row.max() <= lens.camera.height - 1
    assert column.max() <= lens.camera.width - 1
    focal, middle = lens.camera.intrinsics[0, 0], lens.camera.intrinsics[0, 2]
    assert math.degrees(math.atan(middle / focal)) == pytest.approx(kept, abs=0.1)
    assert focal / lens.taken[0, 0] == pytest.approx(share, abs=0.01)


def test_rounding_leaves_no_row_beyond(rng: np.random.Generator) -> None:
    """The middles of the outermost pixels, of many lenses."""
    for degrees in rng.uniform(40, 80, 40):
        lens = lens_of(camera_of(float(degrees), REAL))
        (x, y), size = lens.taken[:2, 2], np.array([lens.camera.width, lens.camera.height])
        sides = np.array([[0.5, y], [x, 0.5], [size[0] - 0.5, y], [x, size[1] - 0.5]])
        found = np.float32(bend(lens, sides) - 0.5)
        assert (found >= 0).all()
        assert (found <= size - 1).all()


def test_what_no_pinhole_can_show_is_nowhere() -> None:
    """Rays beyond 70° are not seen; what a lens whose rays turn back cannot show is black, not another place of the picture."""
    wide = lens_of(camera_of(90))
    ways = np.radians([69, 71, 120])
    at = wide.taken[:2, 2] + wide.taken[0, 0] * np.stack([ways, 0 * ways], 1)
    assert np.isfinite(straighten(wide, at)).all(1).tolist() == [True, False, False]
    folded = lens_of(camera_of(45, FOLDED))
    ways = np.tan(np.radians([65, 68]))
    far = folded.camera.intrinsics[:2, 2] + folded.camera.intrinsics[0, 0] * np.stack([ways, 0 * ways], 1)
    assert (np.abs(bend(folded, far)) < 1e4).all(1).tolist() == [True, False]
    middle = wide.taken[:2, 2]
    np.testing.assert_allclose([straighten(wide, middle), bend(wide, middle)], [middle, middle])


def toml(cameras: dict[str, Camera], coefficients: tuple[float, ...]) -> str:
    """As Caliscope writes it."""
    plain = filmed.toml(cameras)
    return plain.replace("[0.0, 0.0, 0.0, 0.0]", str(list(coefficients))).replace("fisheye = false", "fisheye = true")


def easymocap(cameras: dict[str, Camera]) -> dict[str, str]:
    files = filmed.easymocap(cameras)
    for k, name in enumerate(cameras):
        data = ", ".join(map(str, REAL))
        files["intri.yml"] = files["intri.yml"].replace(
            f"dist_{name}: !!opencv-matrix\n  rows: 1\n  cols: 5\n  dt: d\n  data: [0, 0, 0, 0, 0]",
            f"dist_{name}: !!opencv-matrix\n  rows: 4\n  cols: 1\n  dt: d\n  data: [{data}]\nfisheye_{name}: {('1', 'true')[k % 2]}",
        )
    return files


def opencv_json(cameras: dict[str, Camera]) -> dict[str, str]:
    table = {}
    for name, one in cameras.items():
        k = one.intrinsics.copy()
        k[:2, 2] -= 0.5
        pose = {"R": one.camera_from_world[:3, :3].tolist(), "T": one.camera_from_world[:3, 3].tolist()}
        table[name] = {"K": k.tolist(), "dist": list(REAL), "size": [one.width, one.height], "fisheye": True, **pose}
    return {"calibration.json": json.dumps(table)}


def colmap(cameras: dict[str, Camera]) -> dict[str, str]:
    """Its world is turned and in other units: only the pictures are compared."""
    files = filmed.colmap(cameras, 1.0)
    lines = files["cameras.txt"].replace("PINHOLE", "OPENCV_FISHEYE").splitlines()
    return {
        **files,
        "cameras.txt": "\n".join([lines[0], *(f"{line} {' '.join(map(str, REAL))}" for line in lines[1:])]),
    }


FILES = {
    "TOML": lambda cameras: {"camera_array.toml": toml(cameras, REAL)},
    "OpenCV YAML": easymocap,
    "OpenCV JSON": opencv_json,
    "COLMAP": colmap,
    "AvatarReX JSON": lambda cameras: {
        "calibration_full.json": json.dumps(calibration(tuple(lens_of(one, name) for name, one in cameras.items())))
    },
}


@pytest.mark.parametrize("kind", FILES)
def test_every_format_says_the_same(kind: str, tmp_path: Path) -> None:
    cameras = {
        f"c{k}": replace(camera_of(50, REAL), camera_from_world=Camera.orbit(90 * k).camera_from_world) for k in (0, 1)
    }
    for name, text in FILES[kind](cameras).items():
        (tmp_path / name).write_text(text)
    found = find_cameras(tmp_path, dict.fromkeys(cameras, (1920, 1080)))
    assert found.kind == kind
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (20, 3))
    for lens, camera in zip(found.lenses, cameras.values(), strict=True):
        np.testing.assert_allclose(lens.taken, camera.intrinsics, atol=1e-6)
        np.testing.assert_allclose(lens.distortion, REAL)
        if kind != "COLMAP":
            np.testing.assert_allclose(bend(lens, lens.camera.pixels(points)[0]), camera.pixels(points)[0], atol=1e-3)


@pytest.mark.parametrize(("model", "count"), [("RADIAL_FISHEYE", 2), ("SIMPLE_RADIAL_FISHEYE", 1)])
def test_colmaps_shorter_fisheyes(model: str, count: int, tmp_path: Path) -> None:
    files = filmed.colmap({"c0": Camera.orbit()})
    numbers = " ".join(map(str, REAL[:count]))
    (tmp_path / "cameras.txt").write_text(f"1 {model} 1920 1080 900 960 540 {numbers}\n")
    (tmp_path / "images.txt").write_text(files["images.txt"])
    (lens,) = find_cameras(tmp_path).lenses
    np.testing.assert_allclose(lens.distortion, [*REAL[:count], *[0] * (4 - count)])
    np.testing.assert_allclose(lens.taken, [[900, 0, 960], [0, 900, 540], [0, 0, 1]])


WRONG = {
    "five": ([0.1, 0.0, 0.0, 0.0, 0.0], "4 coefficients k1, k2, k3, k4 of a fisheye, found 5"),
    "none": (None, "some finite numbers, found none"),
    "nan": ([math.nan, 0.0, 0.0, 0.0], r"finite numbers up to 1e\+09, found nan"),
    "inf": ([0.0, math.inf, 0.0, 0.0], r"finite numbers up to 1e\+09, found inf"),
    "turned back": (
        [-1.5, 0.0, 0.0, 0.0],
        r"a fisheye that shows rays up to each side of its pictures, .*, found \[-1.5,",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_numbers_are_named(what: str, tmp_path: Path) -> None:
    """One line from `find_cameras`, and from our own calibration."""
    values, said = WRONG[what]
    text = toml({"c0": camera_of(50)}, EQUIDISTANT)
    listed = "" if values is None else f"distortions = {values}"
    (tmp_path / "calibration.toml").write_text(text.replace("distortions = [0.0, 0.0, 0.0, 0.0]", listed))
    with pytest.raises(InputError, match=rf"calibration\.toml: c0\.distortion: expected .*{said}") as refused:
        find_cameras(tmp_path)
    assert "\n" not in str(refused.value)
    table = calibration((lens_of(camera_of(50), "c0"),))
    table["c0"]["distCoeff"] = values
    with pytest.raises(InputError, match=r"c0\.distCoeff: expected"):
        read_calibration(json.dumps(table), "calibration_full.json")


@pytest.mark.parametrize("value", ['"yes"', "2", "[]"])
def test_a_fisheye_is_one_or_not(value: str, tmp_path: Path) -> None:
    text = toml({"c0": camera_of(50)}, EQUIDISTANT)
    (tmp_path / "calibration.toml").write_text(text.replace("fisheye = true", f"fisheye = {value}"))
    with pytest.raises(InputError, match=r"c0\.fisheye: expected true or false, found"):
        find_cameras(tmp_path)


@pytest.mark.parametrize("value", ["True", "yes", '"true"', "2"])
def test_a_fisheye_of_opencvs_is_one_or_not(value: str, tmp_path: Path) -> None:
    for name, text in easymocap({"c0": camera_of(50)}).items():
        (tmp_path / name).write_text(text.replace("fisheye_c0: 1", f"fisheye_c0: {value}"))
    with pytest.raises(InputError, match=r"c0\.fisheye: expected true or false, found"):
        find_cameras(tmp_path, {"c0": (1920, 1080)})


class Bent(Clothed):
    """Filmed by fisheyes so near that the person fills a right angle."""

    @property
    def lenses(self) -> dict[str, Camera]:  # type: ignore[override]
        width, height = self.size
        focal = height / 2 / math.radians(45)
        intrinsics = np.array([[focal, 0, width / 2 + 1.5], [0, focal, height / 2 - 2.5], [0, 0, 1]])
        found = {}
        for name, one in super().lenses.items():
            pose = one.camera_from_world.copy()
            pose[2, 3] *= 0.4
            found[name] = Fisheye(intrinsics, pose, width, height, REAL)
        return found


def test_what_a_fisheye_films_is_a_pinholes(tmp_path: Path) -> None:
    """Prepared from Caliscope's file, and imported from ours: mattes are those of the pinhole, a first fit is as near as ever."""
    one = Bent(cameras=4, frames=2, size=(144, 192))
    source = filmed.film(one, tmp_path / "film", lambda cameras: {"camera_array.toml": toml(cameras, REAL)})
    said = list(Preparing(source, tmp_path / "out").run())
    kept = "4 fisheyes: undistorted to pinholes that keep 84° or more along the longer side, their middle 0.88 times"
    assert any(kept in line for line in said)
    import_capture(tmp_path / "out" / "capture" / "body", tmp_path / "imported")
    exact = filmed.exact_landmarks(one.motion)[:, :55]
    for path in (tmp_path / "out" / "capture", tmp_path / "imported"):
        capture = open_capture(path)
        rig = capture.rigs["body"]
        for view in range(4):
            for frame, vertices in enumerate(one.surfaces):
                wanted = silhouette(vertices, subject().faces, rig.views[view].camera)
                assert iou(rig.matte(view, frame) > 127, wanted) > 0.985  # half a pixel of 144×192 along the outline
        joints = [template_surface(capture.person, signals)[1] for signals in rig.signals]
        assert np.linalg.norm(joints - exact, axis=2).mean() < 0.008
