"""BVH motion files: the hierarchy, its channels and the motion lines. What they mean for our joints: retarget.py.

A BVH's rest pose is its offsets with every rotation zero. Offsets and root positions are in the file's own unit, angles in
degrees, in the order in which the channels stand. End sites are kept as joints without channels: they tell where the last
bone of a chain points.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.files.gate import read_lines
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import ImportedMotion
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.retarget import retarget
from avatarrex.signals.source_motion import END, SourceMotion

LARGEST_NUMBER = 1e9
"""Largest number in a file: 1000 km in millimetres, or as many turns as nobody makes."""
MOST_JOINTS = 1000
"""Ten times a body with hands, face and helpers."""
LONGEST_NAME = 200
"""Letters of the line that names a joint."""
MOST_ROTATIONS = 4_000_000
"""Frames times joints, of ours where they are more: ten minutes at 120 frames a second, 40 at 30. At its peak reading takes 530
bytes for each (retarget.py turns matrices of all frames at once): 2.0 GiB for a file of 61 538 frames of 65 joints, 76 MB, as
much as the arrays of an `.npz` may take."""
Lines = Iterator[tuple[int, str]]
"""Lines with their numbers, from 1."""


@dataclass
class _Joint:
    name: str
    parent: int
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    channels: list[str] = field(default_factory=list)


def read_bvh(path: Path, options: ImportOptions) -> ImportedMotion:
    """Read and retarget a BVH file, line by line. Raises `InputError` naming the line."""
    lines = enumerate(read_lines(path, "a BVH file", errors="replace"), start=1)
    joints = _hierarchy(path, lines)
    fps, values = _motion(path, lines, joints)
    offsets = np.stack([joint.offset for joint in joints])
    turned, places = _forward(joints, values)
    names, parents = tuple(joint.name for joint in joints), np.array([joint.parent for joint in joints])
    return retarget(path, SourceMotion("BVH", names, parents, offsets, turned, places, fps), options)


def _hierarchy(path: Path, lines: Lines) -> list[_Joint]:
    """The joints; `lines` then stands behind MOTION."""
    first = next(lines, (1, "an empty file"))[1]
    if first.strip() != "HIERARCHY":
        raise InputError(path, "line 1", "HIERARCHY", first[:40])
    joints: list[_Joint] = []
    open_: list[int] = []
    pending = False
    for number, line in lines:
        words = line.split()
        if not words:
            continue
        if words[0] == "MOTION":
            if open_ or not joints:
                wanted = f"'}}' closing {joints[open_[-1]].name}" if open_ else "a ROOT"
                raise InputError(path, f"line {number}", wanted, "MOTION")
            return joints
        if words[0] in ("ROOT", "JOINT", "End"):
            joints.append(_joint(path, number, line, joints, open_[-1] if open_ else -1))
            pending = True
        elif words[0] == "{":
            if not pending:
                raise InputError(path, f"line {number}", "a ROOT, JOINT or End Site before '{'", "'{'")
            open_.append(len(joints) - 1)
            pending = False
        elif words[0] == "}":
            if not open_:
                raise InputError(path, f"line {number}", "an open joint", "'}'")
            open_.pop()
        elif words[0] == "OFFSET" and open_:
            joints[open_[-1]].offset = np.array(_numbers(path, number, words[1:], 3))
        elif words[0] == "CHANNELS" and open_:
            joints[open_[-1]].channels = _channels(path, number, line)
        else:
            raise InputError(path, f"line {number}", "a line of the hierarchy", line.strip()[:40])
    raise InputError(path, "MOTION", "a MOTION section", "the end of the file")


def _joint(path: Path, number: int, line: str, joints: list[_Joint], parent: int) -> _Joint:
    """The joint or end site that a line opens below joint `parent`, or -1."""
    words = line.split()
    if (parent < 0) != (words[0] == "ROOT") or len(words) < 2:
        wanted = "a joint's name" if len(words) < 2 else "ROOT outermost and nowhere else"
        raise InputError(path, f"line {number}", wanted, line.strip())
    if len(line) > LONGEST_NAME:
        raise InputError(path, f"line {number}", f"a joint's name of at most {LONGEST_NAME} letters", len(line))
    if parent >= 0 and joints[parent].name.endswith(END):
        raise InputError(path, f"line {number}", "an OFFSET alone in an End Site", line.strip())
    if len(joints) == MOST_JOINTS:
        raise InputError(path, f"line {number}", f"at most {MOST_JOINTS} joints", f"another: {line.strip()}")
    return _Joint(joints[parent].name + END if words[0] == "End" else " ".join(words[1:]), parent)


def _channels(path: Path, number: int, line: str) -> list[str]:
    """The channels that a line lists."""
    count, *channels = line.split()[1:] or [""]
    if count != str(len(channels)):
        raise InputError(path, f"line {number}", "as many channels as announced", line.strip())
    for word in channels:
        if not re.fullmatch("[XYZ](position|rotation)", word):
            raise InputError(path, f"line {number}", "Xposition … Zrotation", word)
    if len(set(channels)) != len(channels):
        raise InputError(path, f"line {number}", "each channel once", line.strip())
    return channels


def _motion(path: Path, lines: Lines, joints: list[_Joint]) -> tuple[float, np.ndarray]:
    """Frames a second and (t, channels)."""

    def header(key: str) -> float:
        number, text = next(lines, (0, "the end of the file"))
        if not text.strip().startswith(key):
            raise InputError(path, f"line {number}" if number else "MOTION", key, text.strip()[:40])
        return _numbers(path, number, [text.partition(":")[2]], 1)[0]

    announced, interval = header("Frames:"), header("Frame Time:")
    count = int(announced)
    if count != announced or count < 1:
        raise InputError(path, "Frames", "a whole number above 0", announced)
    if not 1e-3 <= interval <= 1e3:
        raise InputError(path, "Frame Time", "a frame time above 0: seconds, 0.001 to 1000", interval)
    width, most = sum(len(joint.channels) for joint in joints), MOST_ROTATIONS // max(len(joints), len(JOINT_NAMES))
    rows = ((number, words) for number, line in lines if (words := line.split()))
    values, found = array("d"), 0
    for found, (number, words) in enumerate(islice(rows, count), start=1):
        if found > most:
            raise InputError(path, "Frames", f"at most {most:,} frames of {len(joints)} joints", f"{count:,}")
        values.extend(_numbers(path, number, words, width))
    if found < count:
        raise InputError(path, "Frames", f"{count} lines of motion", found)
    rate = 1 / interval
    # frame times are written with few digits: .03333 and 0.041667 mean 30 and 24; 29.97 is farther from 30 than this
    rate = float(round(rate)) if abs(rate - round(rate)) < 5e-4 * rate else rate
    return rate, np.frombuffer(values).reshape(count, width)


def _numbers(path: Path, line: int, words: list[str], count: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise InputError(path, f"line {line}", "numbers", " ".join(words)[:60]) from None
    if len(values) != count or not np.isfinite(values).all():
        found = f"{len(values)}" if len(values) != count else "NaN or Inf"
        raise InputError(path, f"line {line}", f"{count} finite numbers", found)
    if count and np.abs(values).max() > LARGEST_NUMBER:
        raise InputError(path, f"line {line}", f"numbers up to {LARGEST_NUMBER:g}", f"{max(values, key=abs):g}")
    return values


def _forward(joints: list[_Joint], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(t, j, 3, 3) global rotations and (t, j, 3) positions, the file's axes and unit."""
    turned, places = np.zeros((len(values), len(joints), 3, 3)), np.zeros((len(values), len(joints), 3))
    column = 0
    for k, joint in enumerate(joints):
        offset, turns = np.tile(joint.offset, (len(values), 1)), dict[str, int]()
        for channel in joint.channels:
            if channel.endswith("rotation"):
                turns[channel[0]] = column
            elif joint.parent < 0:
                # a root's position channels take the place of its offset, as every player does
                offset[:, "XYZ".index(channel[0])] = values[:, column]
            column += 1
        local = np.tile(np.eye(3), (len(values), 1, 1))
        if turns:
            local = Rotation.from_euler("".join(turns), values[:, [*turns.values()]], degrees=True).as_matrix()
        if joint.parent < 0:
            turned[:, k], places[:, k] = local, offset
        else:
            turned[:, k] = turned[:, joint.parent] @ local
            places[:, k] = places[:, joint.parent] + np.einsum("tab,tb->ta", turned[:, joint.parent], offset)
    return turned, places
