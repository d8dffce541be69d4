"""A skeleton's motion on the 55 joints: names, axes, rest poses, size, floor.

With R the file's global rotation of a joint (zero in the file's rest pose) ours is R · A. A is the identity for pelvis, spine,
collars, feet, neck, head, jaw and eyes: these rest alike in every file. For a limb, A takes our bone's rest direction to the
file's, starting from the parent's A, so that A- and T-poses meet and twist is carried along the limb; a palm with fingers gives
its whole frame. Then every limb bone points exactly where the file's does. The chest is turned, on top, until hips to neck
points where the file's does. Letters: t frames, j joints. Rotation matrices; the file's unit, then metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.signals.ground import grounded
from avatarrex.signals.joint_names import NEEDED, ancestors, find
from avatarrex.signals.joints import FINGERS, JOINT_NAMES
from avatarrex.signals.rest_skeleton import rest_skeleton
from avatarrex.signals.sequence import SignalSequence, stack

_LIMBS = (("", "hip", "knee"), ("hip", "knee", "ankle"), ("", "shoulder", "elbow"), ("shoulder", "elbow", "wrist"))
"""Joint before, joint and joint after it."""
_INDEX = {name: j for j, name in enumerate(JOINT_NAMES)}
_STILL = np.radians(0.01)
"""A joint that never turns by more than this is at rest: exporters write 1e-5 degrees where nothing moves."""
UNITS = {"metres": 1.0, "decimetres": 0.1, "centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254, "feet": 0.3048,
         "CMU units of 1/0.45 inch": 0.0254 / 0.45}  # fmt: skip
"""Metres."""
_UNIT_SLACK = 1.3
"""A leg of 0.66 to 1.12 m: everybody above 1.4 m. Units lie farther apart than its square, but for CMU's and decimetres."""


@dataclass(frozen=True)
class SourceMotion:
    """A file's skeleton and where it goes, its own axes and unit."""

    names: tuple[str, ...]
    parents: np.ndarray
    offsets: np.ndarray
    """(j, 3) from the parent at rest."""
    turned: np.ndarray
    """(t, j, 3, 3) global rotations, the identity at rest."""
    places: np.ndarray
    """(t, j, 3) positions."""


def retarget(path: Path, source: SourceMotion, fps: float) -> SignalSequence:
    """Our signals of a file's motion. Raises `InputError` if a limb is missing."""
    found = find(source.names, source.parents)
    for name in NEEDED:
        if name not in found:
            raise InputError(path, "HIERARCHY", f"a joint for {name}", ", ".join(source.names[:12]))
    rest = np.zeros_like(source.offsets)
    for k, parent in enumerate(source.parents):
        rest[k] = source.offsets[k] + (rest[parent] if parent >= 0 else 0)
    axes = _axes(path, rest, found)
    rest, places = rest @ axes.T, source.places @ axes.T
    turned = np.einsum("ab,tjbc,dc->tjad", axes, source.turned, axes)
    ours = rest_skeleton().joints
    globals_ = _globals(turned, _alignments(rest, found, source), found)
    _straighten(globals_, places, found)
    pose = _locals(globals_)
    leg = [name for name in ("left_hip", "left_knee", "left_ankle") if name in found]
    scale = _length(ours, [_INDEX[name] for name in leg]) / max(_length(rest, [found[name] for name in leg]), 1e-12)
    hips = (places[:, found["left_hip"]] + places[:, found["right_hip"]]) / 2
    still = np.ptp(places[:, source.parents < 0, 1]) * scale < 1e-3
    path_metres, floor_note = grounded(pose, (hips - hips[0]) * scale, each=bool(still and len(hips) > 1))
    notes = (*_notes(source, found, axes, scale), floor_note)
    return SignalSequence(stack(pose, path_metres), fps, path.name, notes)


def _axes(path: Path, rest: np.ndarray, found: dict[str, int]) -> np.ndarray:
    """Rotation from the file's axes to ours (+X left, +Y up, +Z forward), from its rest skeleton."""
    left = rest[found["left_hip"]] - rest[found["right_hip"]]
    top = rest[found.get("head", found["left_shoulder"])]
    up = top - (rest[found["left_knee"]] + rest[found["right_knee"]]) / 2
    sideways, upwards = int(np.abs(left).argmax()), int(np.abs(up).argmax())
    if sideways == upwards or not left.any() or not up.any():
        raise InputError(path, "OFFSET", "a rest pose with hips side by side, the head above the knees", "another pose")
    x, y = np.eye(3)[sideways] * np.sign(left[sideways]), np.eye(3)[upwards] * np.sign(up[upwards])
    return np.stack([x, y, np.cross(x, y)])


def _length(joints: np.ndarray, chain: list[int]) -> float:
    """Length of the bones along a chain of joints."""
    return float(np.linalg.norm(np.diff(joints[chain], axis=0), axis=1).sum())


def _alignments(rest: np.ndarray, found: dict[str, int], source: SourceMotion) -> np.ndarray:
    """(55, 3, 3): A of each joint."""
    ours = dict(zip(JOINT_NAMES, rest_skeleton().joints))
    theirs = {name: rest[k] for name, k in found.items()}
    align = dict.fromkeys(JOINT_NAMES, np.eye(3))

    def towards(start: np.ndarray, joint: str, child: str) -> np.ndarray:
        """`start`, turned the least so that our bone joint-child has the file's rest direction."""
        if joint not in theirs or child not in theirs:
            return start
        return np.asarray(_smallest(start @ (ours[child] - ours[joint]), theirs[child] - theirs[joint]) @ start)

    def palm(forearm: np.ndarray, side: str) -> np.ndarray:
        """A of a wrist: the palm's frame; without fingers the hand's direction; without either the forearm's."""
        wrist, index, middle, pinky = corners = [f"{side}_{part}" for part in ("wrist", "index1", "middle1", "pinky1")]
        if wrist not in theirs:
            return forearm
        if all(name in theirs for name in (index, middle, pinky)):
            return np.asarray(_frame(*(theirs[name] for name in corners)) @ _frame(*(ours[name] for name in corners)).T)
        far = [k for k in range(len(rest)) if found[wrist] in ancestors(k, source.parents)]
        tip = max(far, key=lambda k: float(np.linalg.norm(rest[k] - theirs[wrist])), default=found[wrist])
        return np.asarray(_smallest(forearm @ (ours[middle] - ours[wrist]), rest[tip] - theirs[wrist]) @ forearm)

    for side in ("left", "right"):
        for before, part, after in _LIMBS:
            start = align[f"{side}_{before}"] if before else np.eye(3)
            align[f"{side}_{part}"] = towards(start, f"{side}_{part}", f"{side}_{after}")
        align[f"{side}_wrist"] = palm(align[f"{side}_elbow"], side)
        for finger in FINGERS:
            first, second, third = (f"{side}_{finger}{k}" for k in (1, 2, 3))
            align[first] = towards(align[f"{side}_wrist"], first, second)
            align[second] = align[third] = towards(align[first], second, third)
    return np.stack(list(align.values()))


def _frame(wrist: np.ndarray, index: np.ndarray, middle: np.ndarray, pinky: np.ndarray) -> np.ndarray:
    """Columns along the hand, out of its back or palm (the same on both sides of a product), across it."""
    along = (middle - wrist) / max(np.linalg.norm(middle - wrist), 1e-12)
    out = np.cross(along, index - pinky)
    out /= max(float(np.linalg.norm(out)), 1e-12)
    return np.stack([along, out, np.cross(along, out)], 1)


def _smallest(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(…, 3, 3) the smallest rotation between directions; the identity where one has no length."""
    a, b = np.broadcast_arrays(start, end)
    length = np.linalg.norm(a, axis=-1, keepdims=True) * np.linalg.norm(b, axis=-1, keepdims=True)
    safe = np.maximum(length, 1e-12)
    axis, cosine = np.cross(a, b) / safe, (a * b).sum(-1, keepdims=True) / safe
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    # opposite directions have no smallest rotation: a half turn about any normal of them
    spare = np.cross(a, np.eye(3)[np.abs(a).reshape(-1, 3).sum(0).argmin()])
    spare /= np.maximum(np.linalg.norm(spare, axis=-1, keepdims=True), 1e-12)
    unit = np.where(sine > 1e-9, axis / np.maximum(sine, 1e-12), spare)
    angle = np.where(length > 1e-12, np.arctan2(sine, cosine), 0.0)
    return np.asarray(Rotation.from_rotvec((unit * angle).reshape(-1, 3)).as_matrix().reshape(*a.shape, 3))


def _globals(turned: np.ndarray, align: np.ndarray, found: dict[str, int]) -> np.ndarray:
    """(t, 55, 3, 3): ours; a joint that the file lacks follows its parent."""
    globals_ = np.zeros((len(turned), 55, 3, 3))
    for j, (name, parent) in enumerate(zip(JOINT_NAMES, rest_skeleton().parents)):
        if name in found:
            globals_[:, j] = turned[:, found[name]] @ align[j]
        else:
            globals_[:, j] = globals_[:, parent] @ (align[parent].T @ align[j])
    return globals_


def _straighten(globals_: np.ndarray, places: np.ndarray, found: dict[str, int]) -> None:
    """Turn the spine until hips to neck points where the file's does: spines differ in curve and in where they bend."""
    if "neck" not in found:
        return
    ours, parents = rest_skeleton().joints, rest_skeleton().parents
    wanted = places[:, found["neck"]] - (places[:, found["left_hip"]] + places[:, found["right_hip"]]) / 2
    chain = [_INDEX[name] for name in ("spine1", "spine2", "spine3", "neck")]
    hips = (ours[_INDEX["left_hip"]] + ours[_INDEX["right_hip"]]) / 2 - ours[0]
    # the pelvis' own share does not turn: three rounds leave less than 0.1 degrees
    for _ in range(3):
        have = -globals_[:, 0] @ hips
        for j in chain:
            have = have + globals_[:, parents[j]] @ (ours[j] - ours[parents[j]])
        globals_[:, chain[:3]] = _smallest(have, wanted)[:, None] @ globals_[:, chain[:3]]


def _locals(globals_: np.ndarray) -> np.ndarray:
    """(t, 55, 3) rotation vectors relative to the parents."""
    local = globals_.copy()
    local[:, 1:] = np.swapaxes(globals_[:, rest_skeleton().parents[1:]], 2, 3) @ globals_[:, 1:]
    pose: np.ndarray = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_rotvec().reshape(-1, 55, 3)
    pose[:, np.linalg.norm(pose, axis=2).max(0) < _STILL] = 0
    return pose


def _notes(source: SourceMotion, found: dict[str, int], axes: np.ndarray, scale: float) -> tuple[str, ...]:
    """What was decided, for the import dialog."""
    name, metres = min(UNITS.items(), key=lambda unit: abs(np.log(unit[1] / scale)))
    fits = max(metres / scale, scale / metres) < _UNIT_SLACK
    size = f"units look like {name}: {metres / scale:.2f} times our leg" if fits else "unknown units"
    notes = [f"{size}; path scaled by {scale:.4g} to our leg"]
    if not np.allclose(axes, np.eye(3)):
        letters = ["XYZ"[int(np.abs(row).argmax())] for row in axes]
        signs = ["-" if row.sum() < 0 else "+" for row in axes]
        notes.append(
            "axes turned: left, up, forward are the file's " + ", ".join(s + a for s, a in zip(signs, letters))
        )
    fingers = sum(name in found for name in JOINT_NAMES[25:])
    notes.append(
        f"{fingers} of 30 finger joints in the file" if fingers else "no finger joints in the file: flat hands"
    )
    body = [name for name in JOINT_NAMES[:25] if name not in found]
    if body:
        notes.append("not in the file, at rest: " + ", ".join(body))
    return tuple(notes)
