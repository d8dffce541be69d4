"""ZJU-MoCap: `annots.npy`, `{new_params|params}/N.npy`, `mask_cihp/` or `mask/`; SMPL bodies.

annots: {'cams': {K, D, R, T}, 'ims': [{'ims': [path of each camera]}]}, T in millimetres, calibrated by OpenCV (pixel centres at integers).
Parameters: poses (1, 72) without a root, Rh and Th (1, 3), shapes: x = R(Rh) x_model + Th, about the origin and not about the pelvis.
"""

from __future__ import annotations

import re
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.capture.importers.pictures import usual_size
from avatarrex.capture.importers.source import Reading, Source, SourceView, posed_lens, repeated
from avatarrex.capture.readers.archive import safe
from avatarrex.capture.readers.calibration import MOST_CAMERAS, ROTATION_SLACK, Lens
from avatarrex.capture.readers.rigs import SMPLX_PELVIS
from avatarrex.errors import InputError, check
from avatarrex.files.pickles import read_pickle

SMPL_PELVIS = np.array([-0.0018, -0.2233, 0.0282])
"""J_0 of the neutral SMPL template, metres, to 0.1 mm."""
PARAMETERS, MATTES = ("new_params", "params"), ("mask_cihp", "mask")
LARGEST_ANNOTS, LARGEST_PARAMETERS = 2**28, 2**20
"""Bytes of annots.npy (half a million names of pictures) and of one frame's parameters."""


def read_zju(reading: Reading) -> Source:
    """The capture at the reading's root. Raises `InputError` for a calibration or a list of pictures that cannot be understood."""
    place = reading.place("annots.npy")
    annots = _read(reading, "annots.npy", "a dict of cams and ims", LARGEST_ANNOTS)
    check({"cams", "ims"} <= set(annots), place, "", "a dict of cams and ims", sorted(map(str, annots)))
    images = _images(annots["ims"], place)
    lenses = _lenses(reading, annots["cams"], images, place)
    views = tuple(
        SourceView(lens, paths, _mattes(reading, paths)) for lens, paths in zip(lenses, images) if lens is not None
    )
    check(views, place, "cams", "a camera with a picture that can be read", "none")
    count = len(annots["ims"])
    rows = _parameters(reading, count)
    parameters, without = repeated(rows, count)
    return Source("ZJU-MoCap", "body", views, count, parameters, without)


def _read(reading: Reading, file: str, expected: str, largest: int) -> dict[Any, Any]:
    """The dictionary that NumPy has pickled."""
    place = reading.place(file)
    values = read_pickle(reading.archive.read(reading.name(file), largest), expected, largest, place)
    check(isinstance(values, dict), place, "", expected, type(values).__name__)
    return dict(values)


def _images(frames: Any, place: str) -> list[dict[int, str]]:
    """Paths by frame, for each camera."""
    found: list[dict[int, str]] = []
    for frame, entry in enumerate(_listed(frames, place, "ims")):
        listed = _listed(entry.get("ims") if isinstance(entry, dict) else None, place, f"ims[{frame}]")
        check(all(isinstance(path, str) for path in listed), place, f"ims[{frame}]", "paths", "something else")
        check(len(listed) <= MOST_CAMERAS, place, f"ims[{frame}]", f"at most {MOST_CAMERAS} cameras", len(listed))
        found += [{} for _ in listed[len(found) :]]
        for view, path in enumerate(str(path).replace("\\", "/") for path in listed):
            check(safe(path), place, f"ims[{frame}]", "paths inside the capture", path)
            found[view][frame] = path
    return found


def _listed(values: Any, place: str, field: str) -> list[Any]:
    """What a list or an array holds, at least one thing."""
    found = list(values) if isinstance(values, list) or (isinstance(values, np.ndarray) and values.ndim) else []
    check(found, place, field, "a list", type(values).__name__)
    return found


def _lenses(reading: Reading, cams: Any, images: list[dict[int, str]], place: str) -> list[Lens | None]:
    """Cameras in the file's unit; None for one without a picture that can be read."""
    check(isinstance(cams, dict), place, "cams", "a dict of K, D, R, T", type(cams).__name__)
    arrays = {key: _stack(cams.get(key), place, key) for key in ("K", "D", "R", "T")}
    count = min(map(len, arrays.values()))
    check(len(images) <= count, place, "cams", f"{len(images)} cameras, as ims has", count)
    lenses: list[Lens | None] = []
    for view, (name, paths) in enumerate(zip(_names(images), images)):
        size = reading.attempt(
            f"camera {name}", partial(usual_size, reading.archive, map(reading.name, paths.values()))
        )
        if size is None:
            lenses.append(None)
            continue
        intrinsics, turn = arrays["K"][view].reshape(3, 3).copy(), arrays["R"][view].reshape(3, 3)
        check(
            np.abs(turn.T @ turn - np.eye(3)).max() < ROTATION_SLACK and np.linalg.det(turn) > 0,
            place, f"cams.R[{view}]", "a rotation, world to camera", turn.tolist(),
        )  # fmt: skip
        intrinsics[:2, 2] += 0.5
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, arrays["T"][view].ravel()
        lenses.append(posed_lens(name, intrinsics, pose, size, np.resize(arrays["D"][view].ravel(), 5)))
    reading.notes.append("pixel centres: the calibration is OpenCV's, at integers: 0.5 added to the principal points")
    return lenses


def _names(images: list[dict[int, str]]) -> list[str]:
    """Of cameras: their folders' where each has its own, else their numbers."""
    first = [next(iter(paths.values())) for paths in images]
    names = [re.sub(r"[^\w.-]+", "_", path.split("/")[-2]) if "/" in path else "" for path in first]
    return (
        names if all(names) and len(set(names)) == len(names) else [f"camera{view:02d}" for view in range(len(first))]
    )


def _stack(values: Any, place: str, key: str) -> np.ndarray:
    """(c, n) numbers of all cameras."""
    entries, count = _listed(values, place, f"cams.{key}"), {"K": 9, "D": 5, "R": 9, "T": 3}[key]
    check(len(entries) <= MOST_CAMERAS, place, f"cams.{key}", f"at most {MOST_CAMERAS} cameras", len(entries))
    return np.stack([flat_numbers(value, count, place, f"cams.{key}[{view}]") for view, value in enumerate(entries)])


def _mattes(reading: Reading, paths: dict[int, str]) -> dict[int, str]:
    """By frame, those that are there."""
    found = {}
    for frame, path in paths.items():
        stem = path.rsplit(".", 1)[0]
        names = [f"{folder}/{stem}.png" for folder in MATTES]
        names += [f"{folder}/{stem.removeprefix('images/')}.png" for folder in MATTES]
        there = next((name for name in names if reading.archive.exists(reading.name(name))), None)
        if there is not None:
            found[frame] = there
    return found


def _parameters(reading: Reading, count: int) -> dict[int, dict[str, np.ndarray]]:
    """By frame, in SMPL-X's joints; one that cannot be read is a problem."""
    folder = next((name for name in PARAMETERS if reading.archive.entries(reading.name(name))), None)
    if folder is None:
        return {}
    there = {
        int(name[:-4]) for name in reading.archive.entries(reading.name(folder)) if re.fullmatch(r"\d{1,9}\.npy", name)
    }
    first = 1 if 0 not in there and count in there else 0
    if first:
        reading.notes.append(f"{folder}: files are numbered from 1")
    rows = {}
    for frame in range(count):
        file = f"{folder}/{frame + first}.npy"
        found = reading.attempt(f"frame {frame}, {file}", partial(_frame, reading, file))
        if found is not None:
            rows[frame] = found
    return rows


def _frame(reading: Reading, file: str) -> dict[str, np.ndarray]:
    values = _read(reading, file, "a dict of poses, Rh, Th", LARGEST_PARAMETERS)
    sizes = {"poses": 72, "Rh": 3, "Th": 3}
    arrays = {key: flat_numbers(values.get(key), size, reading.place(file), key) for key, size in sizes.items()}
    turn, poses = Rotation.from_rotvec(arrays["Rh"]), arrays["poses"]
    if poses[:3].any():
        turn = turn * Rotation.from_rotvec(poses[:3])
    pelvis = Rotation.from_rotvec(arrays["Rh"]).apply(SMPL_PELVIS) + arrays["Th"]
    return {"global_orient": turn.as_rotvec(), "body_pose": poses[3:66], "transl": pelvis - SMPLX_PELVIS}


def flat_numbers(value: Any, count: int, source: str, field: str) -> np.ndarray:
    """(count,) float64 of numbers nested somehow; lists that repeat each other a billion times are not followed. Raises `InputError`."""
    waiting, found = [value], []
    for _ in range(4 * count + 4):
        if not waiting:
            break
        item = waiting.pop()
        if isinstance(item, list | tuple) and len(item) <= count:
            waiting.extend(reversed(item))
        elif isinstance(item, int | float | np.generic | np.ndarray) and np.size(item) <= count:
            found.append(np.ravel(item))
        else:
            raise InputError(source, field, f"{count} numbers", type(item).__name__)
    flat = np.concatenate(found) if found else np.zeros(0)
    if waiting or len(flat) != count or flat.dtype.kind not in "fiu" or not np.isfinite(flat).all():
        raise InputError(source, field, f"{count} finite numbers", f"{len(flat)} of {flat.dtype}")
    return np.asarray(flat, np.float64)
