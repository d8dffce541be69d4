"""Keypoints as detectors write them: OpenPose's JSON, a file a picture, and MediaPipe's landmarks as JSON, a file a camera.

`keypoints/<camera>/…_keypoints.json`: people[].pose_keypoints_2d (25 or 18 triples x, y, confidence), hand_left_keypoints_2d and
hand_right_… (21), face_keypoints_2d (70, or iBUG's 68). `keypoints/<camera>.json`: a list of frames, or {"frames": […]}, each with
pose_landmarks (33 of x, y, visibility, shares of the picture's sides), left_hand_landmarks and right_hand_landmarks (21), face_landmarks
(468 or 478); also in camel case, and with `landmark` between.
Letters: t frames, c cameras, l landmarks.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from avatarrex.capture.fit.face_marks import NUMBERS, face_name
from avatarrex.capture.fit.landmarks import landmarks
from avatarrex.capture.readers.calibration import Lens
from avatarrex.errors import InputError, check
from avatarrex.files.json_text import SMALL, read_json
from avatarrex.signals.sequence import MOST_FRAMES

BODY_25 = (
    "nose",
    None,
    "right_shoulder",
    "right_elbow",
    "right_wrist",
    "left_shoulder",
    "left_elbow",
    "left_wrist",
    None,
    "right_hip",
    "right_knee",
    "right_ankle",
    "left_hip",
    "left_knee",
    "left_ankle",
    "right_eye",
    "left_eye",
    "right_ear",
    "left_ear",
    "left_big_toe",
    "left_small_toe",
    "left_heel",
    "right_big_toe",
    "right_small_toe",
    "right_heel",
)
"""OpenPose's body; its neck and middle of the hips are middles of others."""
COCO_18 = (
    "nose", None, "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist", "right_hip", "right_knee",
    "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye", "right_ear", "left_ear",
)  # fmt: skip
BODY_33: dict[int, str] = {
    0: "nose",
    2: "left_eye",
    5: "right_eye",
    7: "left_ear",
    8: "right_ear",
    11: "left_shoulder",
    12: "right_shoulder",
    13: "left_elbow",
    14: "right_elbow",
    15: "left_wrist",
    16: "right_wrist",
    23: "left_hip",
    24: "right_hip",
    25: "left_knee",
    26: "right_knee",
    27: "left_ankle",
    28: "right_ankle",
    29: "left_heel",
    30: "right_heel",
    31: "left_big_toe",
    32: "right_big_toe",
}
"""MediaPipe's body."""
HAND_21 = (
    "wrist",
    *(f"{finger}{k}" for finger in ("thumb", "index", "middle", "ring", "pinky") for k in (1, 2, 3, "_tip")),
)
"""Both detectors' hands, from the wrist outwards."""
IBUG = tuple(face_name(number) if number in NUMBERS else None for number in range(68))
"""OpenPose's face; its last two, the pupils, are not read."""
MESH: dict[int, str] = {
    row: face_name(number)
    for number, row in {
        8: 152,
        17: 70, 18: 63, 19: 105, 20: 66, 21: 107, 22: 336, 23: 296, 24: 334, 25: 293, 26: 300,
        27: 168, 28: 197, 29: 5, 30: 1, 31: 98, 32: 97, 33: 2, 34: 326, 35: 327,
        36: 33, 37: 160, 38: 158, 39: 133, 40: 153, 41: 144, 42: 362, 43: 385, 44: 387, 45: 263, 46: 373, 47: 380,
        48: 61, 49: 40, 50: 37, 51: 0, 52: 267, 53: 270, 54: 291, 55: 321, 56: 314, 57: 17, 58: 84, 59: 91,
        60: 78, 61: 81, 62: 13, 63: 311, 64: 308, 65: 402, 66: 14, 67: 178,
    }.items()
}  # fmt: skip
"""MediaPipe's face: of its 468 landmarks (478 with the irises) those that lie where iBUG's do."""
UNSAID = 0.8
"""Confidence of hands and faces in MediaPipe's files, which have none."""
CENTRE = np.array([0.5, 0.5, 0.0])
"""OpenPose has pixel centres at integers."""
Part = tuple[tuple[str | None, ...], np.ndarray]
"""Names with triples (n, 3) of column, row and confidence."""
_FRAME = re.compile(r"(\d{1,9})(?:_keypoints)?\.json")


def read_detections(
    folder: Path,
    lenses: tuple[Lens, ...],
    frames: int = MOST_FRAMES,
    first: int | None = None,
    names: tuple[str, ...] | None = None,
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Points (t, c, l, 2) in the pictures as taken, confidence (t, c, l), and what could not be read.

    `names` are the landmarks (l): the body's, unless others are wanted. Frames are those of the longest camera, `frames` at most. `first`
    is the number in the names of files that frame 0 has; unless given, 1 where that is the lowest of all cameras' (beside videos), else 0.
    Lists begin with frame 0. Raises `InputError` where no camera has any.
    """
    wanted = {name: row for row, name in enumerate(names or landmarks().names)}
    face = any(name in wanted for name in IBUG if name)
    found: list[dict[int, tuple[np.ndarray, np.ndarray]]] = []
    problems: list[str] = []
    files = [_files(folder / lens.name) for lens in lenses]
    if first is None:
        first = int(min((min(one) for one in files if one), default=0) == 1)
    beyond = 0
    for lens, numbered in zip(lenses, files):
        entries = _of_camera(folder, lens, {number - first: path for number, path in numbered.items()}, problems, face)
        found.append({frame: _chosen(parts, wanted) for frame, parts in entries if 0 <= frame < frames})
        beyond += sum(not 0 <= number - first < frames for number in numbered)
    if beyond:
        problems.append(f"keypoints: {beyond} files of frames that have no picture")
    check(
        any(found),
        folder,
        "",
        f"keypoints of cameras {lenses[0].name}, …: CAMERA/…_keypoints.json (OpenPose) or CAMERA.json (MediaPipe)",
        problems[0] if problems else "none",
    )
    count = max(max(one, default=-1) for one in found) + 1
    points = np.zeros((count, len(lenses), len(wanted), 2))
    confidence = np.zeros(points.shape[:3])
    for view, one in enumerate(found):
        for frame, (place, sure) in one.items():
            points[frame, view], confidence[frame, view] = place, sure
    return points, confidence, problems


def _files(folder: Path) -> dict[int, Path]:
    """OpenPose's, by the number in their names."""
    names = sorted(folder.glob("*.json")) if folder.is_dir() else []
    return {int(match[1]): path for path in names if (match := _FRAME.search(path.name))}


def _of_camera(
    folder: Path, lens: Lens, files: Mapping[int, Path], problems: list[str], face: bool
) -> Iterable[tuple[int, list[Part]]]:
    """By frame: of MediaPipe's list, where there is one, else of OpenPose's `files`. Without `face` faces are not read."""
    single = folder / f"{lens.name}.json"
    entries: Iterable[tuple[int, Any, Path]] = ((frame, None, path) for frame, path in files.items())
    if single.is_file():
        try:
            entries = ((frame, entry, single) for frame, entry in enumerate(_list(single)))
        except InputError as error:
            problems.append(f"{single.name}: {error.field}: expected {error.expected}, found {error.found}")
            return
    for frame, entry, path in entries:
        try:
            yield frame, _parts(read_json(path, largest=SMALL) if path != single else entry, lens, path, face)
        except InputError as error:
            problems.append(f"{lens.name} frame {frame}: {error.field}: expected {error.expected}, found {error.found}")


def _list(path: Path) -> list[Any]:
    """MediaPipe's frames."""
    data = read_json(path)
    frames = data.get("frames") if isinstance(data, dict) else data
    if not isinstance(frames, list) or len(frames) > MOST_FRAMES:
        raise InputError(path, "frames", f"a list of at most {MOST_FRAMES}", type(frames).__name__)
    return frames


def _parts(data: Any, lens: Lens, source: Path, face: bool) -> list[Part]:
    """Of one picture; without `face` a face is not read."""
    if not isinstance(data, dict):
        return []  # nobody was found
    return list(_openpose(data, source, face) if "people" in data else _mediapipe(data, lens, source, face))


def _chosen(parts: Iterable[Part], wanted: Mapping[str, int]) -> tuple[np.ndarray, np.ndarray]:
    """(l, 2) and (l,) of the landmarks that are wanted, by name their rows."""
    points, sure = np.zeros((len(wanted), 2)), np.zeros(len(wanted))
    for names, triples in parts:
        for name, (x, y, confidence) in zip(names, triples):
            row = wanted.get(name or "", -1)
            if row >= 0 and confidence > sure[row]:
                points[row], sure[row] = (x, y), min(confidence, 1.0)
    return points, sure


def _openpose(data: Mapping[str, Any], source: Path, with_face: bool) -> Iterable[Part]:
    """Names with triples of the person whom the detector is surest of."""
    people = data["people"]
    check(isinstance(people, list), source, "people", "a list", type(people).__name__)
    somebody = [one for one in people if isinstance(one, dict)]
    if not somebody:
        return
    person = max(
        somebody, key=lambda one: _triples(one.get("pose_keypoints_2d"), source, "pose_keypoints_2d")[:, 2].sum()
    )
    body = _triples(person.get("pose_keypoints_2d"), source, "pose_keypoints_2d")
    names = {25: BODY_25, 18: COCO_18, 0: ()}.get(len(body))
    check(names is not None, source, "pose_keypoints_2d", "25 or 18 triples", len(body))
    yield names or (), body + CENTRE
    for side in ("left", "right"):
        hand = _triples(person.get(f"hand_{side}_keypoints_2d"), source, f"hand_{side}_keypoints_2d")
        if len(hand) == len(HAND_21):
            yield tuple(f"{side}_{name}" for name in HAND_21), hand + CENTRE
    face = _triples(person.get("face_keypoints_2d") if with_face else None, source, "face_keypoints_2d")
    if len(face) in (68, 70):
        yield IBUG, face[:68] + CENTRE


def _mediapipe(data: Mapping[str, Any], lens: Lens, source: Path, with_face: bool) -> Iterable[Part]:
    size = np.array([lens.camera.width, lens.camera.height, 1.0])
    body = _listed(data, "pose_landmarks", "poseLandmarks", source)
    if len(body) >= 33:
        yield tuple(BODY_33.get(k) for k in range(33)), body[:33] * size
    for side in ("left", "right"):
        hand = _listed(data, f"{side}_hand_landmarks", f"{side}HandLandmarks", source)
        if len(hand) == len(HAND_21):
            yield tuple(f"{side}_{name}" for name in HAND_21), _sure(hand) * size
    face = _listed(data, "face_landmarks", "faceLandmarks", source) if with_face else np.zeros((0, 3))
    if len(face) in (468, 478):
        yield tuple(MESH.get(row) for row in range(len(face))), _sure(face) * size


def _sure(found: np.ndarray) -> np.ndarray:
    """(n, 3) with at least the confidence `UNSAID`."""
    return np.where([False, False, True], np.maximum(found, UNSAID), found)


def _listed(data: Mapping[str, Any], name: str, camel: str, source: Path) -> np.ndarray:
    """(n, 3) x, y and visibility (hands have none: 0) of a list of landmarks."""
    value = data.get(name, data.get(camel))
    if isinstance(value, dict):
        value = value.get("landmark")
    if isinstance(value, list) and value and isinstance(value[0], list):
        value = value[0]  # of several people; the first
    if value in (None, []):
        return np.zeros((0, 3))
    try:
        found = np.array([(one["x"], one["y"], one.get("visibility", 0.0)) for one in value], dtype=np.float64)
    except (TypeError, KeyError, ValueError, AttributeError):
        raise InputError(source, name, "a list of landmarks with x and y", type(value).__name__) from None
    return _finite(found, source, name)


def _triples(value: Any, source: Path, name: str) -> np.ndarray:
    """(n, 3)."""
    try:
        found = np.array([] if value is None else value, dtype=np.float64).reshape(-1, 3)
    except (TypeError, ValueError):
        raise InputError(source, name, "triples of x, y, confidence", type(value).__name__) from None
    return _finite(found, source, name)


def _finite(found: np.ndarray, source: Path, name: str) -> np.ndarray:
    check(
        np.isfinite(found).all() and np.abs(found).max(initial=0) < 1e5,
        source,
        name,
        "finite numbers below 1e5",
        "others",
    )
    return found
