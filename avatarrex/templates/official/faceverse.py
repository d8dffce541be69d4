"""Faceverse as it is published, versions 1 to 4 (`.npy` of a dict): shape and expressions of a face or head (docs/formats.md).

Versions differ in unit, axes and winding, and state none of these. So all three are found: the unit by the width between the outermost
landmarks, the axes by chin, bridge, nose and sides, the winding by the surface. `FaceverseFile` says what was found. The model is ours:
metres, +Y up, the face to +Z, the person's left at +X. Its joints are those of a face here: head, jaw (which moves nothing: the mouth
opens by expressions), left and right eye. Letters: v vertices, f faces, s shape and e expression coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from avatarrex.errors import InputError
from avatarrex.files.arrays import read_array
from avatarrex.files.gate import what_is
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.model import TemplateModel
from avatarrex.templates.model_arrays import LARGEST_NUMBER, hash_arrays
from avatarrex.templates.official import expression_matrix
from avatarrex.templates.official.model_file import read_dict

VERSIONS = {(150, 74): 1, (150, 52): 2, (150, 171): 3, (156, 177): 4}
"""By how many shape and expression directions the file has."""
V3_VERTICES = 15456
"""Version 3 may have 52 directions, too, and is then told by these."""
UNITS = {"metres": 1.0, "decimetres": 0.1, "centimetres": 0.01, "millimetres": 0.001}
LARGEST = LARGEST_NUMBER / min(UNITS.values())
"""Of a file's numbers, whatever its unit."""
WIDTH = (0.09, 0.21)
"""Metres between the outermost landmarks of a face, before the ears."""
LANDMARKS = ("keypoints_68", "keypoints", "keypoints_mediapipe", "mediapipe_keypoints")
"""Lists of vertices: the first that a file has counts."""
MEDIAPIPE = 468
"""Landmarks of MediaPipe's list (478 with the irises): one so long is MediaPipe's whatever it is called, another is iBUG's 68."""
AXES = {False: (8, 27, 30, 0, 16), True: (152, 168, 1, 234, 454)}
"""Chin, bridge and tip of the nose, the person's right and left side: on iBUG's list, and (True) on MediaPipe's."""
JOINTS = ("head", "jaw", "left_eye", "right_eye")
_OWN = {name.lower(): name for name in EXPRESSION_NAMES}


@dataclass(frozen=True, eq=False)
class FaceverseFile:
    """What a file holds."""

    model: TemplateModel
    version: int
    unit: str
    """Of the file, found by the face's width."""
    turned: tuple[int, int, int]
    """Signs of x, y, z that make the file's axes ours."""
    landmarks: np.ndarray
    """Vertices of the file's list of landmarks."""
    mediapipe: bool
    """Whether the list is MediaPipe's; else it is iBUG's."""
    hash: str
    """Of all of it that decides where the face is and how it moves."""


def read_faceverse(path: str | Path) -> FaceverseFile:
    """Read a model. Raises `InputError` naming file and key."""
    fields = read_dict(path, "a Faceverse file (.npy)")
    mean = _numbers(fields, path, "meanshape").reshape(-1, 3)
    shape, expression = _directions(fields, path, "idBase", len(mean)), _directions(fields, path, "exBase", len(mean))
    counts = (shape.shape[2], expression.shape[2])
    if counts not in VERSIONS:
        known = " or ".join(f"{s} and {e}" for s, e in VERSIONS)
        raise InputError(path, "exBase", f"{known} shape and expression directions", f"{counts[0]} and {counts[1]}")
    version = 3 if len(mean) == V3_VERTICES else VERSIONS[counts]
    if counts == (150, 171):
        expression = _fifty_two(fields, path, len(mean), expression)
    landmarks, mediapipe = _landmarks(fields, path, len(mean))
    unit, signs = _unit_and_signs(mean[landmarks[list(AXES[mediapipe])]], path)
    factor = UNITS[unit] * np.array(signs)
    mean, shape, expression = mean * factor, shape * factor[:, None], expression * factor[:, None]
    named = _named(fields, path, expression)
    faces, eyes = _faces(fields, path, mean), _eyes(fields, path, mean)
    read = {"mean": mean, "expression": named[0], "faces": faces, "landmarks": landmarks, **eyes}
    if not named[1] and what_is(table := Path(path).with_name(expression_matrix.FILE)) == "a file":
        read["table"] = expression_matrix.read_matrix(table, expression.shape[2])
        named = expression @ read["table"], EXPRESSION_NAMES
    model = _model(mean, faces, shape, named, eyes)
    return FaceverseFile(model, version, unit, signs, landmarks, mediapipe, hash_arrays(read, read))


def read_fifty_two(path: str | Path) -> np.ndarray:
    """(v, 3, 52): the expressions of a file beside version 3's. Raises `InputError`."""
    value = _numbers({"exBase_52": read_array(path)}, path, "exBase_52")
    if value.ndim != 2 or not value.size or value.shape[1] != 52 or len(value) % 3:
        raise InputError(path, "exBase_52", "shape (3 times the vertices, 52)", value.shape)
    return value.reshape(-1, 3, 52)


def _numbers(fields: dict[Any, Any], path: str | Path, key: str) -> np.ndarray:
    value = fields.get(key)
    if (
        not isinstance(value, np.ndarray)
        or value.dtype.kind not in "fiu"
        or not np.isfinite(value).all()
        or value.size % 3
    ):
        found = (
            "none"
            if value is None
            else f"{value.shape} of {value.dtype}"
            if isinstance(value, np.ndarray)
            else type(value).__name__
        )
        raise InputError(path, key, "finite numbers, three a vertex", found)  # fmt: skip
    value = value.astype(np.float64)
    if (largest := np.abs(value).max(initial=0)) > LARGEST:
        raise InputError(path, key, f"numbers up to {LARGEST:g}", f"{largest:.4g}")
    return value


def _whole_numbers(fields: dict[Any, Any], path: str | Path, key: str) -> np.ndarray:
    """(n,) int64 of an array or a list; none where the file has none."""
    value = fields.get(key, ())
    if isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and (np.abs(value.astype(float)) <= LARGEST).all():
        return value.ravel().astype(np.int64)
    if isinstance(value, list | tuple) and all(isinstance(number, int) and abs(number) <= LARGEST for number in value):
        return np.array(value, dtype=np.int64)
    found = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
    raise InputError(path, key, "a list of whole numbers", found)


def _directions(fields: dict[Any, Any], path: str | Path, key: str, vertices: int) -> np.ndarray:
    """(v, 3, n): stored as (3 v, n), xyz of a vertex after one another."""
    value = _numbers(fields, path, key)
    if not vertices or value.ndim < 2 or value.size != 3 * vertices * value.shape[-1]:
        raise InputError(path, key, f"shape ({3 * vertices}, any)", value.shape)
    return value.reshape(vertices, 3, value.shape[-1])


def _fifty_two(fields: dict[Any, Any], path: str | Path, vertices: int, others: np.ndarray) -> np.ndarray:
    """Version 3's 52 directions, in the dict or in a file beside it; without them its 171."""
    beside = Path(path).with_name("exBase_52.npy")
    if "exBase_52" not in fields and what_is(beside) == "a file":
        found = read_fifty_two(beside)
        if len(found) != vertices:
            raise InputError(beside, "", f"52 directions of {vertices} vertices", f"of {len(found)}")
        return found
    return _directions(fields, path, "exBase_52", vertices) if "exBase_52" in fields else others


def _landmarks(fields: dict[Any, Any], path: str | Path, vertices: int) -> tuple[np.ndarray, bool]:
    """A file's landmarks, and whether they are MediaPipe's."""
    for key in LANDMARKS:
        ids = _whole_numbers(fields, path, key)
        mediapipe = len(ids) >= MEDIAPIPE
        if len(ids) <= max(AXES[mediapipe]) or ("mediapipe" in key and not mediapipe):
            continue
        if ids.min() < 0 or ids.max() >= vertices:
            raise InputError(path, key, f"vertices from 0 to {vertices - 1}", f"{ids.min()} to {ids.max()}")
        return ids, mediapipe
    raise InputError(path, "keypoints", "68, 468 or 478 landmarks (one of " + ", ".join(LANDMARKS) + ")", "none")


def _unit_and_signs(points: np.ndarray, path: str | Path) -> tuple[str, tuple[int, int, int]]:
    """The unit by which the face has a face's width, and which axes point the other way."""
    chin, bridge, tip, right, left = points
    width = float(np.linalg.norm(left - right))
    units = [name for name, metres in UNITS.items() if WIDTH[0] < width * metres < WIDTH[1]]
    if not units:
        expected = f"a face {WIDTH[0] * 100:g} to {WIDTH[1] * 100:g} cm wide, in one of {', '.join(UNITS)}"
        raise InputError(path, "meanshape", expected, f"a width of {width:.4g}")
    along = ((left - right)[0], (bridge - chin)[1], (tip - (left + right) / 2)[2])
    signs = tuple(1 if value > 0 else -1 for value in along)
    if signs[0] * signs[1] * signs[2] < 0:
        raise InputError(path, "meanshape", "axes that a turn makes ours", f"a mirrored face (signs {signs})")
    return units[0], (signs[0], signs[1], signs[2])


def _named(fields: dict[Any, Any], path: str | Path, expression: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Directions in our order with their names where the file names the 52; as they are and without names elsewhere."""
    listed = fields.get("exp_name_list")
    listed = listed.ravel().tolist() if isinstance(listed, np.ndarray) else listed or ()
    if not isinstance(listed, list | tuple):
        raise InputError(path, "exp_name_list", "a list of names", type(listed).__name__)
    given = [_own(name) for name in listed]
    if len(given) < expression.shape[2] or not set(EXPRESSION_NAMES) <= set(given[: expression.shape[2]]):
        return expression, ()
    return expression[..., [given.index(name) for name in EXPRESSION_NAMES]], EXPRESSION_NAMES


def _own(name: object) -> str:
    """Our name of an expression: letters of either case, `_L` or `_R` for a side; empty where there is none."""
    if not isinstance(name, str | bytes):
        return ""
    text = name.decode("latin-1") if isinstance(name, bytes) else name
    for short, side in (("_L", "Left"), ("_R", "Right")):
        text = text.removesuffix(short) + side if text.endswith(short) else text
    return _OWN.get(text.replace("_", "").lower(), "")


def _faces(fields: dict[Any, Any], path: str | Path, vertices: np.ndarray) -> np.ndarray:
    """(f, 3), counted from 0, counter-clockwise from outside."""
    faces = _numbers(fields, path, "tri").reshape(-1, 3).astype(np.int64)
    if len(faces) and faces.min() == 1 and faces.max() == len(vertices):
        faces = faces - 1
    if not len(faces) or faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(path, "tri", f"vertices from 0 to {len(vertices) - 1}", "others")
    a, b, c = vertices[faces].swapaxes(0, 1)
    outwards = (np.cross(b - a, c - a) * ((a + b + c) / 3 - vertices.mean(0))).sum()
    return faces if outwards >= 0 else faces[:, ::-1].copy()


def _eyes(fields: dict[Any, Any], path: str | Path, mean: np.ndarray) -> dict[str, np.ndarray]:
    """Vertices of the eyeballs by name, where the file tells them: behind the skin's, one after the other."""
    ends = _whole_numbers(fields, path, "ver_inds")
    if len(ends) < 3:
        return {}
    if (np.diff(ends[:3]) <= 0).any() or ends[0] < 0 or ends[2] > len(mean):
        raise InputError(path, "ver_inds", f"ends of skin and eyes up to {len(mean)}", ends[:3].tolist())
    both = [np.arange(ends[0], ends[1]), np.arange(ends[1], ends[2])]
    both.sort(key=lambda rows: -float(mean[rows, 0].mean()))  # the person's left is at +x
    return dict(zip(("left_eye", "right_eye"), both))


def _model(
    mean: np.ndarray,
    faces: np.ndarray,
    shape: np.ndarray,
    expression: tuple[np.ndarray, tuple[str, ...]],
    eyes: dict[str, np.ndarray],
) -> TemplateModel:
    weights = np.zeros((len(mean), len(JOINTS)))
    weights[:, 0] = 1
    joints, follows = np.zeros((len(JOINTS), 3)), np.zeros((len(JOINTS), 3, shape.shape[2]))
    for name, rows in eyes.items():
        joint = JOINTS.index(name)
        weights[rows] = np.eye(len(JOINTS))[joint]
        joints[joint], follows[joint] = mean[rows].mean(0), shape[rows].mean(0)
    real = [
        torch.from_numpy(value.astype(np.float32)) for value in (mean, shape, expression[0], weights, joints, follows)
    ]
    return TemplateModel(
        v_template=real[0],
        faces=torch.from_numpy(faces),
        shapedirs=real[1],
        expression_dirs=real[2],
        weights=real[3],
        joint_template=real[4],
        joint_shapedirs=real[5],
        parents=(-1, 0, 0, 0),
        joint_names=JOINTS,
        expression_names=expression[1],
        groups={name: torch.from_numpy(rows) for name, rows in eyes.items()},
    )
