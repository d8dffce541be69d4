"""Tracks of 21 hand landmarks (MediaPipe's and OpenPose's order) as joint rotations, by the directions of their bones.

    0 wrist; 1–4 thumb, 5–8 index, 9–12 middle, 13–16 ring, 17–20 pinky, each from the palm to the tip

The palm's turn is the rotation that takes the resting hand's wrist and knuckles to the landmarks (Kabsch 1976). From there each bone
is turned by the smallest rotation onto its landmarks: a finger bends as its directions do, however long its bones are, so a curl stays
the same curl in a hand of another size. Twists about a bone leave no trace in landmarks: none is read. The wrist's own turn belongs to
the camera and is left out. Letters: t frames. Unit and axes are free, but not mirrored.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.files.assets import numbers
from avatarrex.signals.direction import smallest_turn, unit
from avatarrex.signals.import_options import SIDES, ImportOptions
from avatarrex.signals.imported import Guess, ImportedMotion
from avatarrex.signals.joints import FINGERS, JOINT_NAMES, JOINT_ROWS
from avatarrex.signals.limits import FLEXION
from avatarrex.signals.rest_skeleton import rest_skeleton
from avatarrex.signals.sequence import SignalSequence, check_frames, check_rate, stack

LANDMARKS = 21
FIRST = {"thumb": 1, "index": 5, "middle": 9, "ring": 13, "pinky": 17}
"""Of each finger's four landmarks."""
PALM = ("index", "middle", "ring", "pinky")
BACKWARDS = -15.0
"""Degrees of a mean bend of the fingers below which the track is of the other hand, or of a mirrored picture."""
SMALLEST = 1e-9
"""Squared length of a palm, in whatever unit."""
LARGEST = 1e9
"""Of a coordinate, in whatever unit: what is larger is no place of a hand."""


def is_track(value: np.ndarray) -> bool:
    """Whether an array is (t, 21, 3)."""
    return value.ndim == 3 and value.shape[1:] == (LANDMARKS, 3)


def landmark_motion(
    path: Path, tracks: dict[str, np.ndarray], fps: float | None, options: ImportOptions
) -> ImportedMotion:
    """The motion of (t, 21, 3) tracks by side; one without a side is under ''. A side that is chosen is the only track's, whatever the
    file says. Raises `InputError`."""
    chosen = options.side if len(tracks) == 1 else ""
    if "" in tracks and not chosen:
        raise InputError(path, "side", "left or right in the file, or --side left|right", "nothing")
    if chosen:
        tracks = {chosen: next(iter(tracks.values()))}
    count = len(next(iter(tracks.values())))
    check_frames(count, path, "landmarks")
    pose, warnings = np.zeros((count, 55, 3)), []
    for side, track in tracks.items():
        pose[:, JOINT_ROWS[f"{side}_hand_pose"]] = hand_pose(_checked(path, side, track, count), side)
        if (bend := mean_bend(pose, side)) < BACKWARDS:
            how = "the other hand (--side), or a mirrored picture"
            warnings.append(f"the {side} hand's fingers bend backwards by {-bend:.0f}°: {how}")
    rate = options.fps or fps or 30.0
    guesses = (
        Guess("file", f"hand landmarks, {' and '.join(tracks)}", f"{count} frames"),
        Guess("hand", " and ".join(tracks), "chosen" if chosen else "the file", "side" if len(tracks) == 1 else ""),
        Guess("rate", f"{rate:g} frames a second", "chosen" if options.fps else "" if fps else "taken", "fps"),
    )
    notes = (*map(str, guesses), *(f"warning: {text}" for text in warnings))
    frames = stack(pose, np.zeros((count, 3)), None)
    return ImportedMotion(SignalSequence(frames, rate, path.name, notes), guesses, tuple(warnings), options=options)


def tracks_of(path: Path, data: Any) -> tuple[dict[str, np.ndarray], float | None]:
    """Tracks by side and frames a second of JSON: a list of frames, or an object with `left`, `right` or `landmarks`, and `fps`, `hand`.

    A frame is 21 places [x, y, z], or objects with x, y and z. Raises `InputError`.
    """
    if isinstance(data, list):
        return {"": _array(path, "landmarks", data)}, None
    fps = check_rate(data["fps"], path) if "fps" in data else None
    found = {side: _array(path, side, data[side]) for side in SIDES if side in data}
    if not found and "landmarks" in data:
        side = str(data.get("hand", ""))
        if side not in ("", *SIDES):
            raise InputError(path, "hand", "left or right", side)
        found = {side: _array(path, "landmarks", data["landmarks"])}
    return found, fps


def is_landmarks(data: Any) -> bool:
    """Whether JSON looks like hand landmarks."""
    if isinstance(data, list):
        return bool(data) and isinstance(data[0], list)
    return isinstance(data, dict) and "frames" not in data and bool({*SIDES, "landmarks"} & data.keys())


def hand_pose(track: np.ndarray, side: str) -> np.ndarray:
    """(t, 15, 3) rotation vectors of the fingers of a (t, 21, 3) track."""
    rest = rest_landmarks(side)
    palm = _palm_turn(track, rest)
    pose = np.zeros((len(track), 15, 3))
    for number, finger in enumerate(FINGERS):
        before = palm
        for bone in range(3):
            a = FIRST[finger] + bone
            turn = smallest_turn(before @ (rest[a + 1] - rest[a]), track[:, a + 1] - track[:, a]) @ before
            local = np.swapaxes(before, 1, 2) @ turn
            pose[:, 3 * number + bone] = Rotation.from_matrix(local).as_rotvec()
            before = turn
    return pose


def rest_landmarks(side: str) -> np.ndarray:
    """(21, 3) of the flat hand of the default person; a tip continues its finger's last bone."""
    joints = rest_skeleton().joints
    places = np.zeros((LANDMARKS, 3))
    places[0] = joints[JOINT_NAMES.index(f"{side}_wrist")]
    for finger, first in FIRST.items():
        for k in range(3):
            places[first + k] = joints[JOINT_NAMES.index(f"{side}_{finger}{k + 1}")]
        places[first + 3] = 2 * places[first + 2] - places[first + 1]
    return places


def mean_bend(pose: np.ndarray, side: str) -> float:
    """Degrees by which the four fingers' joints of (t, 55, 3) close on average."""
    hand = np.degrees(pose[:, JOINT_ROWS[f"{side}_hand_pose"]].reshape(len(pose), 5, 3, 3).mean((0, 2)))
    mirror = np.array([1.0, 1, 1] if side == "left" else [1.0, -1, -1])
    return float(np.mean([hand[FINGERS.index(finger)] @ (mirror * FLEXION[finger]) for finger in PALM]))


def _palm(places: np.ndarray) -> np.ndarray:
    """(t, 5, 3) directions from the wrist to the knuckles and the thumb's root."""
    columns = [FIRST["thumb"], *(FIRST[finger] for finger in PALM)]
    return unit(places[:, columns] - places[:, :1])


def _palm_turn(track: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """(t, 3, 3) that take the resting palm's directions as near as they go to the track's."""
    u, _, vt = np.linalg.svd(np.einsum("tka,kb->tab", _palm(track), _palm(rest[None])[0]))
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    return np.asarray(u @ vt)


def _checked(path: Path, side: str, track: np.ndarray, count: int) -> np.ndarray:
    """The track in double precision. Raises `InputError` for what is no track of a hand."""
    if not is_track(track) or len(track) != count or not count:
        raise InputError(path, side, f"shape ({count or 'frames'}, {LANDMARKS}, 3)", track.shape)
    track = numbers(track, path, side, LARGEST)
    size = np.square(track[:, 9] - track[:, 0]).sum(-1)
    if (size < SMALLEST).any():
        frame = int(np.argmin(size))
        raise InputError(path, side, "a palm with a length in every frame", f"none in frame {frame}")
    return track


def _array(path: Path, name: str, frames: Any) -> np.ndarray:
    """(t, 21, 3). Raises `InputError`."""
    try:
        rows = [[[p["x"], p["y"], p["z"]] if isinstance(p, dict) else p for p in frame] for frame in frames]
        return np.array(rows, np.float64)
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(path, name, f"frames of {LANDMARKS} places [x, y, z]", repr(error)) from None
