"""BVH motion files, retargeted to the 55 joints by name and rest-pose alignment.

A BVH's rest pose is its offsets with every rotation zero. For a limb joint with our rest direction d and the file's d', the
global rotation is R_file · A with A the smallest rotation from d to d': our bone then points where the file's points, and
twist is kept. The root's path is scaled by hip height, so units do not matter.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.sequence import SignalSequence, stack
from avatarrex.templates.person import load_person

_NAMES: dict[str, tuple[str, ...]] = {
    "pelvis": ("hips", "pelvis", "root"),
    "spine1": ("lowerback", "spine", "spine1", "abdomen"),
    "spine2": ("chest", "spine1", "spine2"),
    "spine3": ("chest2", "spine2", "spine3", "upperchest"),
    "neck": ("neck", "neck1"),
    "head": ("head",),
}
_SIDED: dict[str, tuple[str, ...]] = {
    "hip": ("hip", "upleg", "thigh", "upperleg"),
    "knee": ("knee", "loleg", "leg", "shin", "lowerleg", "calf"),
    "ankle": ("ankle", "foot"),
    "foot": ("toe", "toebase", "toes"),
    "collar": ("collar", "clavicle", "shoulder"),
    "shoulder": ("shoulder", "uparm", "arm", "upperarm"),
    "elbow": ("elbow", "loarm", "forearm", "lowerarm"),
    "wrist": ("wrist", "hand"),
}
_ALIGNED = {
    "hip": "knee", "knee": "ankle", "ankle": "foot", "shoulder": "elbow", "elbow": "wrist",
}  # fmt: skip
_PARENTS = load_person().body.parents


@dataclass
class _Joint:
    name: str
    parent: int
    offset: np.ndarray
    channels: list[str]


def read_bvh(path: str | Path) -> SignalSequence:
    """Read and retarget a BVH file. Raises `InputError` naming the line."""
    path = Path(path)
    try:
        lines = path.read_text(errors="replace").splitlines()
    except OSError as error:
        raise InputError(path, "", "a readable BVH file", error.strerror) from None
    joints, start = _hierarchy(path, lines)
    fps, values = _motion(path, lines, start, sum(len(j.channels) for j in joints))
    return _retarget(path, joints, fps, values)


def _hierarchy(path: Path, lines: list[str]) -> tuple[list[_Joint], int]:
    if not lines or lines[0].strip() != "HIERARCHY":
        raise InputError(path, "line 1", "HIERARCHY", lines[0][:40] if lines else "an empty file")
    joints: list[_Joint] = []
    stack_: list[int] = []
    pending, ended = -1, False
    for number, line in enumerate(lines[1:], start=2):
        words = line.split()
        if not words:
            continue
        if words[0] == "MOTION":
            if stack_:
                raise InputError(path, f"line {number}", f"'}}' closing {joints[stack_[-1]].name}", "MOTION")
            return joints, number
        if words[0] in ("ROOT", "JOINT"):
            joints.append(_Joint(" ".join(words[1:]), stack_[-1] if stack_ else -1, np.zeros(3), []))
            pending, ended = len(joints) - 1, False
        elif words[0] == "End":
            pending, ended = stack_[-1] if stack_ else -1, True
        elif words[0] == "{":
            stack_.append(pending)
        elif words[0] == "}":
            if not stack_:
                raise InputError(path, f"line {number}", "an open joint", "'}'")
            stack_.pop()
            ended = False
        elif words[0] == "OFFSET" and joints and not ended:
            joints[-1].offset = np.array(_numbers(path, number, words[1:], 3))
        elif words[0] == "CHANNELS" and joints:
            joints[-1].channels = words[2:]
            if len(words) < 2 or words[1] != str(len(words) - 2):
                raise InputError(path, f"line {number}", "as many channels as announced", line.strip())
            for word in words[2:]:
                if not re.fullmatch("[XYZ](position|rotation)", word):
                    raise InputError(path, f"line {number}", "Xposition … Zrotation", word)
    raise InputError(path, "MOTION", "a MOTION section", "the end of the file")


def _motion(path: Path, lines: list[str], start: int, width: int) -> tuple[float, np.ndarray]:
    def header(number: int, key: str) -> float:
        text = lines[number].strip() if number < len(lines) else "the end of the file"
        if not text.startswith(key):
            raise InputError(path, f"line {number + 1}", key, text[:40])
        return _numbers(path, number + 1, [text.split(":", 1)[1]], 1)[0]

    count, interval = int(header(start, "Frames:")), header(start + 1, "Frame Time:")
    if count < 1 or not interval > 0:
        raise InputError(path, "MOTION", "at least one frame and a frame time above 0", f"{count} frames, {interval} s")
    rows = [(n, line.split()) for n, line in enumerate(lines[start + 2 :], start=start + 3) if line.strip()]
    if len(rows) < count:
        raise InputError(path, "Frames", f"{count} lines of motion", len(rows))
    return 1 / interval, np.array([_numbers(path, n, words, width) for n, words in rows[:count]])


def _numbers(path: Path, line: int, words: list[str], count: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise InputError(path, f"line {line}", "numbers", " ".join(words)[:60]) from None
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(
            path, f"line {line}", f"{count} finite numbers", f"{len(values)}" if len(values) != count else "NaN or Inf"
        )
    return values


def _find(joints: list[_Joint]) -> dict[str, int]:
    """Our joint -> the file's joint, by name."""
    spelled_out = [re.sub(r"^.*[:]", "", j.name) for j in joints]
    plain = ["" if name.startswith("__") else re.sub(r"[^a-z0-9]", "", name.lower()) for name in spelled_out]
    found: dict[str, int] = {}
    for ours, names in _NAMES.items():
        for name in names:
            if name in plain and plain.index(name) not in found.values():
                found[ours] = plain.index(name)
                break
    for side, letter in (("left", "l"), ("right", "r")):
        for part, names in _SIDED.items():
            for name in names:
                spelled = [f"{side}{name}", f"{name}{side}", f"{name}{letter}", f"{letter}{name}"]
                match = next(
                    (plain.index(s) for s in spelled if s in plain and plain.index(s) not in found.values()), None
                )
                if match is not None:
                    found[f"{side}_{part}"] = match
                    break
    return found


def _retarget(path: Path, joints: list[_Joint], fps: float, values: np.ndarray) -> SignalSequence:
    found = _find(joints)
    needed = ["pelvis", *(f"{s}_{p}" for s in ("left", "right") for p in ("hip", "knee", "shoulder", "elbow"))]
    missing = [name for name in needed if name not in found]
    if missing:
        raise InputError(path, "HIERARCHY", f"a joint for {missing[0]}", ", ".join(j.name for j in joints[:12]))
    rest = np.zeros((len(joints), 3))
    for k, joint in enumerate(joints):
        rest[k] = joint.offset + (rest[joint.parent] if joint.parent >= 0 else 0)
    axes = _axes(rest, found)
    turned, origin = _global_rotations(joints, values)
    turned = np.einsum("ab,tjbc,dc->tjad", axes, turned, axes)
    ours = load_person().body.joint_template.double().numpy()
    align = _alignments(rest @ axes.T, ours, found)
    root = turned[:, found["pelvis"]]
    globals_ = np.zeros((len(values), 55, 3, 3))
    for j, name in enumerate(JOINT_NAMES):
        if name in found:
            globals_[:, j] = turned[:, found[name]] @ align[j]
        else:
            globals_[:, j] = globals_[:, _PARENTS[j]] if _PARENTS[j] >= 0 else root
    local = globals_.copy()
    for j in range(1, 55):
        local[:, j] = np.swapaxes(globals_[:, _PARENTS[j]], 1, 2) @ globals_[:, j]
    pose = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_rotvec().reshape(-1, 55, 3)
    height = (rest[found["left_hip"]] - rest[found["left_knee"]]) @ axes.T
    scale = (ours[1] - ours[4])[1] / max(np.linalg.norm(height), 1e-9)
    hip_path = _root_path(joints, found, origin, turned, axes, rest)
    path_metres = (hip_path - hip_path[0] * np.array([1, 0, 1])) * scale
    path_metres[:, 1] += -path_metres[0, 1]
    notes = ("flat hands: the file's fingers are not read", f"scaled by {scale:.4g} from thigh length")
    return SignalSequence(stack(pose, path_metres), fps, path.name, notes)


def _axes(rest: np.ndarray, found: dict[str, int]) -> np.ndarray:
    """Rotation from the file's axes to ours (+X left, +Y up, +Z forward), from its rest skeleton."""
    left = rest[found["left_hip"]] - rest[found["right_hip"]]
    top = rest[found.get("head", found["left_shoulder"])]
    up = top - (rest[found["left_knee"]] + rest[found["right_knee"]]) / 2
    axes = np.eye(3)[[int(np.abs(left).argmax()), int(np.abs(up).argmax())]]
    x = axes[0] * np.sign(left[np.abs(left).argmax()])
    y = axes[1] * np.sign(up[np.abs(up).argmax()])
    return np.stack([x, y, np.cross(x, y)])


def _global_rotations(joints: list[_Joint], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(t, j, 3, 3) global rotations and (t, 3) root position channels."""
    out = np.zeros((len(values), len(joints), 3, 3))
    origin = np.zeros((len(values), 3))
    column = 0
    for k, joint in enumerate(joints):
        order, angles = "", []
        for channel in joint.channels:
            if channel.endswith("position"):
                if joint.parent < 0:
                    origin[:, "XYZ".index(channel[0])] = values[:, column]
            else:
                order += channel[0]
                angles.append(values[:, column])
            column += 1
        local = np.tile(np.eye(3), (len(values), 1, 1))
        if order:
            local = Rotation.from_euler(order, np.stack(angles, -1).reshape(len(values), -1), degrees=True).as_matrix()
        out[:, k] = local if joint.parent < 0 else out[:, joint.parent] @ local
    return out, origin


def _root_path(
    joints: list[_Joint],
    found: dict[str, int],
    origin: np.ndarray,
    turned: np.ndarray,
    axes: np.ndarray,
    rest: np.ndarray,
) -> np.ndarray:
    """(t, 3) where the middle of the hips goes, our axes, file units."""
    chain, k = [], found["left_hip"]
    while joints[k].parent >= 0:
        chain.append(k)
        k = joints[k].parent
    position = origin @ axes.T
    for k in reversed(chain[1:]):
        position = position + turned[:, joints[k].parent] @ (axes @ joints[k].offset)
    return position


def _alignments(rest: np.ndarray, ours: np.ndarray, found: dict[str, int]) -> np.ndarray:
    """(55, 3, 3): the smallest rotation from our bone's rest direction to the file's; a wrist takes its forearm's."""
    align = np.tile(np.eye(3), (55, 1, 1))
    index = {name: j for j, name in enumerate(JOINT_NAMES)}
    for side in ("left", "right"):
        for part, child in _ALIGNED.items():
            a, b = f"{side}_{part}", f"{side}_{child}"
            if a in found and b in found:
                d = ours[index[b]] - ours[index[a]]
                e = rest[found[b]] - rest[found[a]]
                if np.linalg.norm(e) > 1e-9 and part != "ankle":
                    align[index[a]] = Rotation.align_vectors(e[None] / np.linalg.norm(e), d[None] / np.linalg.norm(d))[
                        0
                    ].as_matrix()
        align[index[f"{side}_wrist"]] = align[index[f"{side}_elbow"]]
    return align
