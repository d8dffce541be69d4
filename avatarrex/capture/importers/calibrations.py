"""Cameras as calibration programs write them: OpenCV's YAML or JSON, Caliscope's and Pose2Sim's TOML, COLMAP's text, and ours.

All become world→camera with OpenCV's axes and pixel centres at +0.5: OpenCV and what builds on it put centres at integers, so that 0.5 is
added to principal points; COLMAP puts them at +0.5. COLMAP's world has neither unit nor axes. Five coefficients of a lens are understood,
and the four of OpenCV's fisheyes where the file says `fisheye`.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.camera import Camera
from avatarrex.capture.importers.source import posed_lens
from avatarrex.capture.readers.archive import safe
from avatarrex.capture.readers.calibration import (
    LARGEST_NUMBER,
    MOST_CAMERAS,
    Lens,
    fisheye_lens,
    nearest_rotation,
    read_calibration,
)
from avatarrex.errors import InputError, check
from avatarrex.files.gate import read_text
from avatarrex.files.json_text import parse_json

LARGEST_BYTES = 2**26
NAMES = {
    "matrix": ("K", "matrix", "camera_matrix", "cameraMatrix", "intrinsics", "M", "mtx"),
    "distortion": ("D", "dist", "distortions", "distortion", "distortion_coefficients", "distCoeffs", "distCoeff"),
    "rotation": ("Rot", "R", "rotation", "rvec", "rotation_matrix", "rotation_vector"),
    "translation": ("T", "t", "translation", "tvec", "translation_vector"),
    "size": ("size", "imgSize", "image_size", "resolution"),
}
"""What programs call the same thing; the first that is there is read."""
WIDTH_HEIGHT = (("image_width", "image_height"), ("width", "height"), ("W", "H"), ("w", "h"))
COLMAP = {
    "SIMPLE_PINHOLE": "f cx cy", "PINHOLE": "fx fy cx cy", "SIMPLE_RADIAL": "f cx cy k1", "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2", "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4", "RADIAL_FISHEYE": "f cx cy k1 k2", "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
}  # fmt: skip
"""Parameters of its camera models."""
RADIAL, FISHEYE = "k1 k2 p1 p2 k3 k4 k5 k6", "k1 k2 k3 k4"
"""Their coefficients in OpenCV's order."""
FILES = (
    "calibration_full.json",
    "calibration.json",
    "calibration.toml",
    "config.toml",
    "camera_array.toml",
    "calibration.yml",
    "calibration.yaml",
)
"""Looked for in a folder, beside COLMAP's pair, `intri.yml` with `extri.yml`, and any .toml with cameras."""
SUFFIXES = (".json", ".toml", ".yml", ".yaml", ".txt")
"""Of files that may be a calibration."""
KNOWN = "calibration.json, .toml or .yml; intri.yml with extri.yml; or COLMAP's cameras.txt with images.txt"


@dataclass(frozen=True, eq=False)
class Cameras:
    """A calibration."""

    lenses: tuple[Lens, ...]
    kind: str
    scaled: bool
    """Whether its world is in some unit of length, with axes that mean something."""
    files: tuple[Path, ...]


def find_cameras(folder: Path, sizes: Mapping[str, tuple[int, int]] | None = None) -> Cameras:
    """The calibration in a folder, or in its `calibration/` or `sparse/`. Raises `InputError` where there is none.

    `sizes`: of pictures by camera, for files that do not say it.
    """
    for place in (folder, folder / "calibration", folder / "sparse", folder / "sparse" / "0"):
        if (place / "cameras.txt").is_file() and (place / "images.txt").is_file():
            files = (place / "cameras.txt", place / "images.txt")
            return Cameras(_unique(_colmap(*files), files[1]), "COLMAP", False, files)
        if (place / "intri.yml").is_file() and (place / "extri.yml").is_file():
            files = (place / "intri.yml", place / "extri.yml")
            return Cameras(_unique(_numbered(files, sizes or {}), files[0]), "OpenCV YAML", True, files)
        named = [place / name for name in FILES if (place / name).is_file()]
        several = (path for path in (*named, *sorted(place.glob("*.toml"))) if _has_cameras(path))
        single = next(several, None)
        if single is not None:
            return read_cameras(single, sizes)
        some = sorted(path for path in place.glob("*.y*ml"))
        if some:
            lenses = (_lens(path.stem, _yaml(path), path, sizes or {}, 0.5) for path in some)
            return Cameras(_unique(lenses, place), "OpenCV YAML", True, tuple(some))
    raise InputError(folder, "", KNOWN, "none of them")


def read_cameras(path: Path, sizes: Mapping[str, tuple[int, int]] | None = None) -> Cameras:
    """One file of all cameras. Raises `InputError` naming camera and key."""
    suffix = path.suffix.lower()
    if suffix == ".toml":
        lenses = (_lens(_called(name, entry), entry, path, sizes or {}, 0.5) for name, entry in _tables(_toml(path)))
        return Cameras(_unique(lenses, path), "TOML", True, (path,))
    if suffix in (".yml", ".yaml"):
        return Cameras(_unique(_numbered((path,), sizes or {}), path), "OpenCV YAML", True, (path,))
    text = read_text(path, "a JSON file", largest=LARGEST_BYTES)
    table = parse_json(text, path)
    check(isinstance(table, dict), path, "", "an object with one entry per camera", type(table).__name__)
    own = all(isinstance(entry, dict) and {"K", "R", "T", "imgSize"} <= set(entry) for entry in table.values())
    if own:
        return Cameras(read_calibration(text, str(path)), "AvatarReX JSON", True, (path,))
    entries = [(name, entry) for name, entry in table.items() if isinstance(entry, dict)]
    return Cameras(
        _unique((_lens(name, entry, path, sizes or {}, 0.5) for name, entry in entries), path),
        "OpenCV JSON",
        True,
        (path,),
    )


def _has_cameras(path: Path) -> bool:
    """Whether a file may be a calibration: programs' settings are TOML, too."""
    return path.suffix.lower() != ".toml" or any(_tables(_toml(path)))


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_text(path, "a TOML file", largest=LARGEST_BYTES))
    except (ValueError, RecursionError) as error:  # ValueError: also an integer of thousands of digits
        if isinstance(error, InputError):
            raise
        raise InputError(path, "", "TOML", error) from None


def _called(name: str, entry: Mapping[str, Any]) -> str:
    """A camera's own name, else its table's."""
    own = entry.get("name")
    return own if isinstance(own, str) else name


def _tables(table: dict[str, Any]) -> Iterable[tuple[str, dict[str, Any]]]:
    """Tables of cameras by name, at the top or one below."""
    for name, entry in table.items():
        if isinstance(entry, dict) and _named(entry, "matrix") is not None:
            yield name, entry
        elif isinstance(entry, dict):
            yield from (
                (inner, value)
                for inner, value in entry.items()
                if isinstance(value, dict) and _named(value, "matrix") is not None
            )


def _unique(lenses: Iterable[Lens], source: object) -> tuple[Lens, ...]:
    found = tuple(lenses)
    names = [lens.name for lens in found]
    check(0 < len(found) <= MOST_CAMERAS, source, "", f"1 to {MOST_CAMERAS} cameras", len(found))
    twice = next((name for name in names if names.count(name) > 1), None)
    check(twice is None, source, "", "each camera once", f"{twice} twice")
    return found


def _named(entry: Mapping[str, Any], what: str) -> Any:
    return next((entry[name] for name in NAMES[what] if name in entry), None)


def _lens(
    name: str, entry: Mapping[str, Any], source: Path, sizes: Mapping[str, tuple[int, int]], centre: float
) -> Lens:
    """Of one camera's entries; `centre` is added to its principal point."""
    check(
        safe(name) and "/" not in name and name.isprintable(),
        source,
        repr(name),
        "a camera's name that can name a folder",
        "another form",
    )
    matrix = _values(_named(entry, "matrix"), 9, source, f"{name}.matrix").reshape(3, 3).copy()
    sound = matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.allclose(matrix[2], [0, 0, 1])
    check(sound, source, f"{name}.matrix", "focal lengths above 0 and a last row of 0, 0, 1", matrix.tolist())
    matrix[:2, 2] += centre
    turn = _values(_named(entry, "rotation"), None, source, f"{name}.rotation")
    check(len(turn) in (3, 9), source, f"{name}.rotation", "3 (Rodrigues) or 9 numbers", len(turn))
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix() if len(turn) == 3 else turn.reshape(3, 3)
    pose[:3, :3] = nearest_rotation(pose[:3, :3], source, f"{name}.rotation")
    pose[:3, 3] = _values(_named(entry, "translation"), 3, source, f"{name}.translation")
    size, field = _size(name, entry, source, sizes), f"{name}.distortion"
    fisheye, coefficients = entry.get("fisheye", False), _named(entry, "distortion")
    check(fisheye in (True, False), source, f"{name}.fisheye", "true or false", repr(fisheye)[:60])
    if fisheye:
        return fisheye_lens(
            name, Camera(matrix, pose, *size), _values(coefficients, None, source, field), source, field
        )
    return posed_lens(name, matrix, pose, size, _distortion(coefficients, source, field))


def _size(name: str, entry: Mapping[str, Any], source: Path, sizes: Mapping[str, tuple[int, int]]) -> tuple[int, int]:
    sides = _named(entry, "size")
    pair = next(((entry[w], entry[h]) for w, h in WIDTH_HEIGHT if w in entry and h in entry), None)
    if sides is None and pair is None and name in sizes:
        return sizes[name]
    width, height = _values(sides if sides is not None else pair, 2, source, f"{name}.size")
    sound = all(1 <= side <= 16384 and side == int(side) for side in (width, height))
    check(sound, source, f"{name}.size", "integers from 1 to 16384", [width, height])
    return int(width), int(height)


def _distortion(values: Any, source: Path, field: str) -> np.ndarray:
    found = np.zeros(0) if values is None else _values(values, None, source, field)
    sound = (len(found) > 3 or not found.any()) and not found[5:].any()
    check(sound, source, field, "4 or 5 coefficients k1, k2, p1, p2, k3", len(found))
    return np.pad(found[:5], (0, max(5 - len(found), 0)))


def _values(value: Any, count: int | None, source: Path, field: str) -> np.ndarray:
    if isinstance(value, dict):  # OpenCV's matrix in JSON
        value = value.get("data")
    try:
        found = np.array(value, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError, OverflowError):
        raise InputError(source, field, "numbers", type(value).__name__) from None
    expected = f"{count or 'some'} finite numbers"
    check(
        value is not None and count in (None, len(found)),
        source,
        field,
        expected,
        "none" if value is None else len(found),
    )
    wild = found[~(np.abs(found) <= LARGEST_NUMBER)]
    check(not len(wild), source, field, f"{expected} up to {LARGEST_NUMBER:g}", f"{wild[0]:g}" if len(wild) else "")
    return found


def _numbered(files: tuple[Path, ...], sizes: Mapping[str, tuple[int, int]]) -> Iterable[Lens]:
    """Cameras of EasyMocap's pair, whose keys end in the camera's name: `K_01`, `dist_01`, `Rot_01` or `R_01`, `T_01`."""
    table = {key: value for path in files for key, value in _yaml(path).items()}
    names = [key.partition("_")[2] for key in table if key.startswith("K_")]
    if not names:
        yield _lens(files[0].stem, table, files[0], sizes, 0.5)
    for name in names:
        entry = {key.removesuffix(f"_{name}"): value for key, value in table.items() if key.endswith(f"_{name}")}
        yield _lens(name, entry, files[0], sizes, 0.5)


_ENTRY = re.compile(r"^([A-Za-z_][\w.-]*)\s*:[ \t]*(.*)$", re.MULTILINE)
_DATA = re.compile(r"data\s*:\s*\[([^\]]*)\]")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def _yaml(path: Path) -> dict[str, Any]:
    """Matrices and numbers of a file of OpenCV's FileStorage, by key: what of YAML it writes."""
    text = read_text(path, "a YAML file", largest=LARGEST_BYTES)
    found: dict[str, Any] = {}
    entries = list(_ENTRY.finditer(text))
    for entry, after in zip(entries, [*(e.start() for e in entries[1:]), len(text)]):
        key, first, body = entry[1], entry[2].strip(), text[entry.start(2) : after]
        data = _DATA.search(body)
        if data is not None or first.startswith("["):
            found[key] = [
                float(number)
                for number in _NUMBER.findall(data[1] if data else body.partition("[")[2].partition("]")[0])
            ]
        elif _NUMBER.fullmatch(first):
            found[key] = float(first)
        elif "fisheye" in key:
            found[key] = {"true": True, "false": False}.get(first, first)
    return found


def _colmap(cameras: Path, images: Path) -> Iterable[Lens]:
    """A camera for each image: its name is the image's folder, or its name without a suffix."""
    models = {}
    for number, line in _lines(cameras):
        words = line.split()
        check(
            len(words) > 4 and words[1] in COLMAP,
            cameras,
            f"line {number}",
            f"a camera of {', '.join(COLMAP)}",
            line[:80],
        )
        names = COLMAP[words[1]].split()
        values = _values(words[4:], len(names), cameras, f"line {number}")
        size = _values(words[2:4], 2, cameras, f"line {number}")
        models[words[0]] = (dict(zip(names, values)), size, words[1].endswith("FISHEYE"))
    for number, line in list(_lines(images, blank=True))[::2]:
        words = line.split(maxsplit=9)
        check(
            len(words) == 10 and words[8] in models,
            images,
            f"line {number}",
            "ID QW QX QY QZ TX TY TZ CAMERA NAME",
            line[:80],
        )
        values = _values(words[1:8], 7, images, f"line {number}")
        check(np.linalg.norm(values[:4]) > 1e-6, images, f"line {number}", "a quaternion", values[:4].tolist())
        model, size, fisheye = models[words[8]]
        f = model.get("f")
        entry = {
            "K": [model.get("fx", f), 0, model["cx"], 0, model.get("fy", f), model["cy"], 0, 0, 1],
            "D": [model.get(key, 0.0) for key in (FISHEYE if fisheye else RADIAL).split()], "fisheye": fisheye,
            "R": Rotation.from_quat(values[[1, 2, 3, 0]]).as_matrix(),
            "T": values[4:], "size": size,
        }  # fmt: skip
        folder, _, last = words[9].replace("\\", "/").rpartition("/")
        yield _lens(folder.rpartition("/")[2] or last.rsplit(".", 1)[0], entry, images, {}, 0.0)


def _lines(path: Path, blank: bool = False) -> Iterable[tuple[int, str]]:
    """Lines that are no comment; blank ones only with `blank` (images without points have one)."""
    for number, line in enumerate(read_text(path, "a text file", largest=LARGEST_BYTES).splitlines(), 1):
        if not line.startswith("#") and (blank or line.strip()):
            yield number, line
