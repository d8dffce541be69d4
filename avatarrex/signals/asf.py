"""ASF/AMC motion (Acclaim): a skeleton `.asf` and the motion `.amc` of it. What they mean for our joints: retarget.py.

A bone of an ASF begins where its parent ends and turns there: our joint is its beginning. Its rotation is C · M · C⁻¹, C its axis
at rest and M its channels, each about fixed axes one after the other. Lengths in the file's unit, angles in degrees unless it says
otherwise. The skeleton is looked for beside the motion: the same name, the beginning of its name (`07_01.amc`, `07.asf`), or
the only one of the folder.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.files.gate import read_lines, read_text
from avatarrex.signals.bvh import LARGEST_NUMBER, LONGEST_NAME, MOST_JOINTS, MOST_ROTATIONS
from avatarrex.signals.direction import unit
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import ImportedMotion
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.retarget import retarget
from avatarrex.signals.source_motion import END, SourceMotion

FPS = 120.0
"""Of CMU's and HDM05's recordings: an AMC does not say."""
SKELETON_BYTES = 2**20
"""Of an `.asf`: a hundred times CMU's."""
CHANNELS = ("rx", "ry", "rz", "tx", "ty", "tz", "l")


@dataclass
class _Bone:
    name: str
    direction: np.ndarray = field(default_factory=lambda: np.zeros(3))
    length: float = 0.0
    axis: np.ndarray = field(default_factory=lambda: np.eye(3))
    channels: tuple[str, ...] = ()
    parent: int = -1


@dataclass(frozen=True, eq=False)
class _Skeleton:
    bones: list[_Bone]
    """The root first, each after its parent."""
    to_radians: float


def read_amc(path: Path, options: ImportOptions) -> ImportedMotion:
    """Read and retarget an AMC file with the ASF beside it. Raises `InputError` naming file and line."""
    skeleton = _read_skeleton(_beside(path))
    values = _read_frames(path, skeleton)
    return retarget(path, _forward(skeleton, values), options)


def _beside(path: Path) -> Path:
    """The skeleton of a motion."""
    near = sorted(p for p in path.parent.glob("*") if p.suffix.lower() == ".asf")
    named = [p for p in near if p.stem.lower() == path.stem.lower()]
    begun = sorted((p for p in near if path.stem.lower().startswith(p.stem.lower())), key=lambda p: -len(p.stem))
    chosen = named or begun or (near if len(near) == 1 else [])
    if not chosen:
        expected = f"its skeleton beside it: {path.stem}.asf, or one .asf alone"
        raise InputError(path, "", expected, f"{len(near)} of other names" if near else "none")
    return chosen[0]


def _read_skeleton(path: Path) -> _Skeleton:
    sections = _sections(path, read_text(path, "an ASF file", "replace", SKELETON_BYTES))
    to_radians = np.pi / 180
    for _, words in sections.get("units", []):
        if words[0] == "angle" and words[1:2] == ["rad"]:
            to_radians = 1.0
    root = _Bone("root", channels=("tx", "ty", "tz", "rx", "ry", "rz"))
    for number, words in sections.get("root", []):
        if words[0] == "order":
            root.channels = _channels(path, number, words[1:])
    bones = [root, *_bones(path, sections.get("bonedata", []), to_radians)]
    if len(bones) == 1:
        raise InputError(path, ":bonedata", "bones", "none")
    ordered = _ordered(path, bones, sections.get("hierarchy", []))
    if len(ordered) == 1:
        raise InputError(path, ":hierarchy", "bones below the root", "none")
    if not any(bone.channels for bone in ordered):
        raise InputError(path, "", "channels: an order of the root or a dof of a bone", "none")
    return _Skeleton(ordered, to_radians)


def _sections(path: Path, text: str) -> dict[str, list[tuple[int, list[str]]]]:
    """Numbered lines of words, by section."""
    found: dict[str, list[tuple[int, list[str]]]] = {}
    lines: list[tuple[int, list[str]]] = []
    for number, line in enumerate(text.split("\n"), start=1):
        words = line.partition("#")[0].split()
        if words and words[0].startswith(":"):
            lines = found.setdefault(words[0][1:].lower(), [])
            words = words[1:]
        if words:
            lines.append((number, words))
    if "bonedata" not in found or "hierarchy" not in found:
        raise InputError(path, "", "an ASF file with :bonedata and :hierarchy", ", ".join(found)[:80] or "no section")
    return found


def _bones(path: Path, lines: list[tuple[int, list[str]]], to_radians: float) -> Iterator[_Bone]:
    bone: _Bone | None = None
    count = 0
    for number, (key, *rest) in lines:
        if key.lower() == "begin":
            bone, count = _Bone(""), count + 1
            if count >= MOST_JOINTS:
                raise InputError(path, f"line {number}", f"at most {MOST_JOINTS} bones", "another")
        elif key.lower() == "end" and bone is not None:
            if not bone.name:
                raise InputError(path, f"line {number}", "a bone with a name", "none")
            yield bone
            bone = None
        elif bone is None:
            raise InputError(path, f"line {number}", "begin", key[:40])
        elif key == "name":
            bone.name = " ".join(rest)[:LONGEST_NAME]
        elif key == "direction":
            bone.direction = unit(np.array(_numbers(path, number, rest, 3)))
        elif key == "length":
            bone.length = _numbers(path, number, rest, 1)[0]
        elif key == "axis":
            order = rest[3].lower() if len(rest) > 3 and sorted(rest[3].lower()) == ["x", "y", "z"] else "xyz"
            angles = np.array(_numbers(path, number, rest[:3], 3)) * to_radians
            bone.axis = Rotation.from_euler(order, angles).as_matrix()
        elif key == "dof":
            bone.channels = _channels(path, number, rest)


def _ordered(path: Path, bones: list[_Bone], lines: list[tuple[int, list[str]]]) -> list[_Bone]:
    """Bones with their parents, each after its own; those that no line of the hierarchy names are left out."""
    named = {bone.name: bone for bone in bones}
    ordered, place = [bones[0]], {bones[0].name: 0}
    for number, (parent, *children) in lines:
        if parent in ("begin", "end"):
            continue
        for child in children:
            if parent not in place or child not in named or child in place:
                raise InputError(path, f"line {number}", "bones below one that stands above", f"{parent} {child}"[:80])
            named[child].parent, place[child] = place[parent], len(ordered)
            ordered.append(named[child])
    return ordered


def _read_frames(path: Path, skeleton: _Skeleton) -> np.ndarray:
    """(t, channels) of all bones in order."""
    starts, width = {}, 0
    for bone in skeleton.bones:
        starts[bone.name] = (width, len(bone.channels))
        width += len(bone.channels)
    most = MOST_ROTATIONS // max(len(skeleton.bones), len(JOINT_NAMES))
    values, frame = array("d"), np.zeros(width)
    count, seen = 0, False
    for number, line in enumerate(read_lines(path, "an AMC file", errors="replace"), start=1):
        words = line.partition("#")[0].split()
        if not words or words[0].startswith(":"):
            continue
        if len(words) == 1 and words[0].isdecimal():
            if seen:
                values.extend(frame)
            count, seen = count + 1, True
            if count > most:
                raise InputError(
                    path, f"line {number}", f"at most {most:,} frames of {len(skeleton.bones)} bones", "more"
                )
        elif not seen:
            raise InputError(path, f"line {number}", "a frame's number", " ".join(words)[:40])
        elif words[0] in starts:
            start, length = starts[words[0]]
            frame[start : start + length] = _numbers(path, number, words[1:], length)
        else:
            raise InputError(path, f"line {number}", "a bone of the skeleton", words[0][:40])
    if not seen:
        raise InputError(path, "", "an AMC file with frames", "none")
    values.extend(frame)
    return np.frombuffer(values).reshape(-1, width)


def _forward(skeleton: _Skeleton, values: np.ndarray) -> SourceMotion:
    """Joints at the beginnings of the bones, ends where no bone goes on."""
    bones, t = skeleton.bones, len(values)
    parents, turned, places = [], np.zeros((t, len(bones), 3, 3)), np.zeros((t, len(bones), 3))
    offsets, column = np.zeros((len(bones), 3)), 0
    for k, bone in enumerate(bones):
        local, path = _local(bone, values[:, column : column + len(bone.channels)], skeleton.to_radians)
        column += len(bone.channels)
        parents.append(bone.parent)
        if k == 0:
            turned[:, 0], places[:, 0] = local, path
            continue
        before = bones[bone.parent]
        offsets[k] = before.direction * before.length
        turned[:, k] = turned[:, bone.parent] @ local
        places[:, k] = places[:, bone.parent] + turned[:, bone.parent] @ offsets[k]
    ends = [k for k in range(1, len(bones)) if k not in parents]
    tails = np.stack([bones[k].direction * bones[k].length for k in ends])
    names = (*(bone.name for bone in bones), *(bones[k].name + END for k in ends))
    far = places[:, ends] + np.einsum("tkab,kb->tka", turned[:, ends], tails)
    return SourceMotion(
        "ASF/AMC", names, np.array([*parents, *ends]), np.concatenate([offsets, tails]),
        np.concatenate([turned, turned[:, ends]], 1), np.concatenate([places, far], 1), FPS,
    )  # fmt: skip


def _local(bone: _Bone, values: np.ndarray, to_radians: float) -> tuple[np.ndarray, np.ndarray]:
    """(t, 3, 3) rotations of a bone against its parent and (t, 3) its path, of its channels."""
    turns = [(name[1], k) for k, name in enumerate(bone.channels) if name[0] == "r"]
    path = np.zeros((len(values), 3))
    for k, name in enumerate(bone.channels):
        if name[0] == "t":
            path[:, "xyz".index(name[1])] = values[:, k]
    matrices = np.tile(np.eye(3), (len(values), 1, 1))
    if turns:
        order, columns = "".join(letter for letter, _ in turns), [k for _, k in turns]
        matrices = Rotation.from_euler(order, values[:, columns] * to_radians).as_matrix()
    return bone.axis @ matrices @ bone.axis.T, path


def _channels(path: Path, number: int, words: list[str]) -> tuple[str, ...]:
    channels = tuple(word.lower() for word in words)
    if any(word not in CHANNELS for word in channels) or len(set(channels)) != len(channels):
        raise InputError(path, f"line {number}", "each of rx … tz once", " ".join(words)[:60])
    return channels


def _numbers(path: Path, line: int, words: list[str], count: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise InputError(path, f"line {line}", "numbers", " ".join(words)[:60]) from None
    if len(values) != count or not all(abs(value) <= LARGEST_NUMBER for value in values):
        expected = f"{count} finite numbers up to {LARGEST_NUMBER:g}"
        raise InputError(path, f"line {line}", expected, " ".join(words)[:60] or "none")
    return values
