"""Faces before one camera: IMAvatar (`flame_params.json`) and NeRFace (`transforms_*.json`), the head posed in each frame.

Both move the camera about a head that stays. One camera of a capture stays, so the first frame's does, and the head moves instead:
world = C_0⁻¹ C_t x, with C_t world→camera of frame t. Letters: t frames. Metres, rotation vectors.

IMAvatar: frames of file_path, world_mat 3×4 (world→camera, OpenGL's axes, with fx negative), expression 50, pose 15 (root, neck, jaw,
eyes), bbox. NeRFace: frames of file_path, transform_matrix 4×4 (camera→world, OpenGL's axes), expression 76; intrinsics [fx, fy, cx, cy].
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.capture.importers.pictures import usual_size
from avatarrex.capture.importers.source import Reading, Source, SourceView, posed_lens, repeated
from avatarrex.capture.readers.archive import safe
from avatarrex.capture.readers.calibration import nearest_rotation
from avatarrex.capture.readers.rigs import SMPLX_PELVIS
from avatarrex.errors import InputError, check
from avatarrex.signals.joints import JOINT_NAMES, JOINT_ROWS
from avatarrex.signals.sequence import MOST_FRAMES

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Between OpenGL's camera axes and OpenCV's."""
EYES = np.array([0.0, 0.03, 0.03])
"""Between a head model's eyeballs, metres, to about a centimetre; `capture check` fits the rest to the mattes."""
RELATIVE = 20.0
"""A focal length below it is a share of the picture's size, above it pixels."""
NECK, HEAD = JOINT_NAMES.index("neck"), JOINT_NAMES.index("head")
SUFFIXES = ("", ".png", ".jpg", ".jpeg")
BACKDROPS = ("bg/00050.png", "bg/00001.png", "bg.png", "background.png")


def read_imavatar(reading: Reading) -> Source:
    """The head at the reading's root. Raises `InputError` for a file that cannot be understood."""
    data, frames, place = _frames(reading, "flame_params.json")
    rows = {
        t: found
        for t, entry in enumerate(frames)
        if (found := reading.attempt(f"frame {t}", partial(_flame_row, entry, place, t)))
    }
    reading.notes.append("expression: 50 coefficients of FLAME are kept as flame_expression and not applied")
    return _head(reading, "IMAvatar", "flame_params.json", data, frames, rows)


def read_nerface(reading: Reading) -> Source:
    """The head at the reading's root: the frames of all splits, one after the other. Raises `InputError`."""
    names = sorted(
        name
        for name in reading.archive.entries(reading.root)
        if name.startswith("transforms_") and name.endswith(".json")
    )
    data: dict[str, Any] = {}
    frames: list[Any] = []
    for name in ("transforms_train.json", "transforms_val.json", "transforms_test.json"):
        if name in names:
            more, entries, place = _frames(reading, name)
            data, frames = data or more, frames + entries
    check(frames, reading.place(), "transforms_train.json", "frames", "none")
    rows = {
        t: found
        for t, entry in enumerate(frames)
        if (found := reading.attempt(f"frame {t}", partial(_nerface_row, entry, place, t)))
    }
    reading.notes.append("expression: 76 coefficients of another face are kept as nerface_expression and not applied")
    return _head(reading, "NeRFace", names[0], data, frames, rows)


def _frames(reading: Reading, name: str) -> tuple[dict[str, Any], list[Any], str]:
    place, data = reading.place(name), reading.archive.json(reading.name(name))
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(data, dict) or not isinstance(frames, list) or not frames or len(frames) > MOST_FRAMES:
        raise InputError(place, "frames", f"a list of 1 to {MOST_FRAMES} frames", type(frames).__name__)
    return data, frames, place


def _flame_row(entry: Any, place: str, t: int) -> dict[str, np.ndarray]:
    pose, world = _numbers(entry, "pose", 15, place, t), _rigid(entry, "world_mat", 12, place, t)
    full = np.zeros((55, 3))
    full[0], full[HEAD], full[JOINT_ROWS["jaw_pose"]] = pose[:3], pose[3:6], pose[6:9]
    full[JOINT_ROWS["eye_pose"]] = pose[9:].reshape(2, 3)
    return {"pose": full, "camera": FLIP @ world, "flame_expression": _numbers(entry, "expression", 50, place, t)}


def _nerface_row(entry: Any, place: str, t: int) -> dict[str, np.ndarray]:
    world_from_camera = _rigid(entry, "transform_matrix", 16, place, t)
    camera = FLIP @ np.linalg.inv(world_from_camera)
    return {
        "pose": np.zeros((55, 3)),
        "camera": camera,
        "nerface_expression": _numbers(entry, "expression", 76, place, t),
    }


def _rigid(entry: Any, key: str, size: int, place: str, t: int) -> np.ndarray:
    """(4, 4) rotation and translation, of 12 or 16 numbers. Raises `InputError` for another matrix."""
    matrix = np.concatenate([_numbers(entry, key, size, place, t), [0.0, 0, 0, 1]])[:16].reshape(4, 4)
    field = f"frames[{t}].{key}"
    check(np.allclose(matrix[3], [0, 0, 0, 1]), place, field, "a last row of 0, 0, 0, 1", matrix[3].tolist())
    matrix[:3, :3] = nearest_rotation(matrix[:3, :3], place, field)
    return matrix


def _head(
    reading: Reading,
    layout: str,
    file: str,
    data: dict[str, Any],
    frames: list[Any],
    rows: dict[int, dict[str, np.ndarray]],
) -> Source:
    """The source of a head's frames."""
    check(rows, reading.place(file), "frames", "frames that can be read", "none")
    images = {
        t: name
        for t, entry in enumerate(frames)
        if (name := reading.attempt(f"frame {t}", partial(_image, reading, entry)))
    }
    check(images, reading.place(file), "frames", "pictures by file_path", "none")
    size = usual_size(reading.archive, map(reading.name, images.values()))
    parameters, without = repeated(rows, len(frames))
    first = parameters.pop("camera")
    start = first[min(rows)]
    parameters = {**_placed(reading, parameters.pop("pose"), np.linalg.inv(start) @ first), **parameters}
    lens = posed_lens("camera", _intrinsics(data, reading.place(file), size), start, size, np.zeros(5))
    mattes = {t: name for t, image in images.items() if (name := _matte(reading, image))}
    backdrop = (
        None if mattes else next((name for name in BACKDROPS if reading.archive.exists(reading.name(name))), None)
    )
    if backdrop:
        reading.notes.append(f"mattes: none in the files: what differs from {backdrop}")
    reading.notes.append("the camera stays where the first frame has it, and the head moves")
    return Source(layout, "face", (SourceView(lens, images, mattes),), len(frames), parameters, without, backdrop)


def _placed(reading: Reading, pose: np.ndarray, moved: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters of poses (t, 55, 3) whose world is `moved` (t, 4, 4): the model's root is our neck, its eyes ours."""
    rest = reading.person.body.joint_template.double().numpy()
    offset = EYES - rest[JOINT_ROWS["eye_pose"]].mean(0)
    root = Rotation.from_rotvec(pose[:, 0])
    neck = rest[NECK] + offset
    pelvis = root.apply(rest[0] + offset - neck) + neck
    pelvis = np.einsum("tij,tj->ti", moved[:, :3, :3], pelvis) + moved[:, :3, 3]
    orient = (Rotation.from_matrix(moved[:, :3, :3]) * root).as_rotvec()
    flat = {name: pose[:, rows].reshape(len(pose), -1) for name, rows in JOINT_ROWS.items() if name != "eye_pose"}
    return {**flat, "global_orient": orient, "transl": pelvis - SMPLX_PELVIS}


def _intrinsics(data: dict[str, Any], place: str, size: tuple[int, int]) -> np.ndarray:
    values = _numbers(data, "intrinsics", 4, place, None)
    fx, fy = np.abs(values[:2]) * (size if np.abs(values[:2]).max() < RELATIVE else (1, 1))
    cx, cy = values[2:] * (size if np.abs(values[2:]).max() <= 2 else (1, 1))
    check(fx > 0 and fy > 0, place, "intrinsics", "focal lengths other than 0", values.tolist())
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def _image(reading: Reading, entry: Any) -> str:
    path = entry.get("file_path") if isinstance(entry, dict) else None
    base = str(path).replace("\\", "/").removeprefix("./")
    names = [base + suffix for suffix in SUFFIXES if safe(base + suffix)]
    found = next((name for name in names if reading.archive.exists(reading.name(name))), None)
    if found is None:
        raise InputError(reading.place(), "file_path", "a picture that is there", repr(path)[:80])
    return found


def _matte(reading: Reading, image: str) -> str | None:
    """`mask/1.png` of `image/1.png`."""
    folder, _, last = image.rpartition("/")
    parent = folder.rpartition("/")[0]
    stem = last.rsplit(".", 1)[0]
    names = [f"{parent}/{mask}/{stem}{suffix}".lstrip("/") for mask in ("mask", "masks") for suffix in SUFFIXES[1:]]
    return next((name for name in names if reading.archive.exists(reading.name(name))), None)


def _numbers(entry: Any, key: str, size: int, place: str, t: int | None) -> np.ndarray:
    field = key if t is None else f"frames[{t}].{key}"
    try:
        value = np.array(entry[key], dtype=np.float64).ravel()
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InputError(place, field, "numbers", "none") from None
    sound = np.isfinite(value).all() and np.abs(value).max(initial=0) < 1e6 and len(value) == size
    check(sound, place, field, f"{size} finite numbers", f"{len(value)} numbers")
    return value
