"""Which way a file's world is turned: its up from the average body over the motion, its forward from the person at first.

`world_axes` of a skeleton's joints, `pelvis_axes` of files that store rotations of our own pelvis (SMPL).

A file's rest pose may stand along another axis than its motion does, so the motion decides; the rest pose only where the body
is as much along another axis. Letters: t frames.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.signals.direction import unit
from avatarrex.signals.import_options import AXES, ImportOptions, axis
from avatarrex.signals.imported import Guess
from avatarrex.signals.source_motion import SourceMotion

REST_COUNTS = 0.25
"""What the rest pose's up counts beside the average body's, whose components are at most 1."""
LEVEL = 0.3
"""Least share of a direction that is level where it tells which way a person looks; else another one does."""


def world_axes(
    path: Path, source: SourceMotion, found: dict[str, int], rest: np.ndarray | None, options: ImportOptions
) -> tuple[np.ndarray, tuple[Guess, ...], list[str]]:
    """Rotation (3, 3) from the file's world to ours, how it was found, and warnings. Raises `InputError`.

    `rest` (3, 3): the rest pose's axes (rest_pose.py), where it is a pose.
    """
    up, guess, warnings = _up(source, found, rest, options)

    def ahead() -> np.ndarray:
        left = source.places[0, found["left_hip"]] - source.places[0, found["right_hip"]]
        level = left - (left @ up) * up
        if np.linalg.norm(level) < LEVEL * np.linalg.norm(left):
            left = source.places[0, found["left_shoulder"]] - source.places[0, found["right_shoulder"]]
            level = left - (left @ up) * up
        if not level.any():
            raise InputError(path, "hips", "a left and a right hip apart from each other", "one place for both")
        return np.cross(unit(level), up)

    world, forward = _facing(path, up, ahead, options)
    return world, (guess, forward), warnings


def pelvis_axes(path: Path, turns: np.ndarray, options: ImportOptions) -> tuple[np.ndarray, tuple[Guess, ...]]:
    """Rotation (3, 3) from the file's world to ours and how it was found, of a pelvis' rotation vectors (t, 3).

    AMASS is Z-up, most other files are Y-up and cameras' worlds Y-down. Raises `InputError`.
    """
    pelvis = Rotation.from_rotvec(turns)
    if options.up:
        up, why = np.array(axis(options.up)), "chosen"
    else:
        mean = pelvis.apply([0.0, 1.0, 0.0]).mean(0)
        up = nearest_axis(mean)
        why = f"{100 * float(mean @ up):.0f} % of the average pelvis"
        why += "; a camera's world" if axis_name(up) == "-Y" else ""

    def ahead() -> np.ndarray:
        left, forward = pelvis[0].apply([1.0, 0.0, 0.0]), pelvis[0].apply([0.0, 0.0, 1.0])
        level = forward - (forward @ up) * up
        return unit(level if np.linalg.norm(level) > LEVEL else np.cross(left, up))

    world, forward = _facing(path, up, ahead, options)
    return world, (Guess("up", axis_name(up), why, "up"), forward)


def _facing(
    path: Path, up: np.ndarray, ahead: Callable[[], np.ndarray], options: ImportOptions
) -> tuple[np.ndarray, Guess]:
    """Rotation (3, 3) that takes a file's `up` to +Y and its forward, as chosen or as `ahead` says, to +Z."""
    if options.forward:
        forward, name, why = np.array(axis(options.forward)), options.forward, "chosen"
        if abs(forward @ up) > 0.5:
            raise InputError(path, "forward", f"an axis across up ({axis_name(up)})", options.forward)
    else:
        forward = ahead()
        name, why = near_axis(forward), "the person looks at the camera in the first frame"
    return np.stack([np.cross(up, forward), up, forward]), Guess("forward", name, why, "forward")


def average_up(places: np.ndarray, found: dict[str, int]) -> np.ndarray:
    """(3,) the mean direction of trunk and, half as much, thighs; shorter than 1 as they lean one way and another."""
    hips = (places[:, found["left_hip"]] + places[:, found["right_hip"]]) / 2
    knees = (places[:, found["left_knee"]] + places[:, found["right_knee"]]) / 2
    top = (places[:, found["left_shoulder"]] + places[:, found["right_shoulder"]]) / 2
    return np.asarray((unit(top - hips) + 0.5 * unit(hips - knees)).mean(0) / 1.5)


def _up(
    source: SourceMotion, found: dict[str, int], rest: np.ndarray | None, options: ImportOptions
) -> tuple[np.ndarray, Guess, list[str]]:
    if options.up:
        return np.array(axis(options.up)), Guess("up", options.up, "chosen", "up"), []
    mean = average_up(source.places, found)
    up = nearest_axis(mean if rest is None else mean + REST_COUNTS * rest[1])
    share = f"{100 * float(mean @ up):.0f} % of the average body"
    if rest is None or rest[1] @ up > 0.7:
        return up, Guess("up", axis_name(up), share, "up"), []
    stands = f"the rest pose stands along {axis_name(rest[1])}, the average body along {axis_name(up)}"
    warning = f"{stands}, which is taken as up: a person who lies there needs another up (--up {axis_name(rest[1])})"
    return up, Guess("up", axis_name(up), f"{share}; the rest pose stands along {axis_name(rest[1])}", "up"), [warning]


def nearest_axis(direction: np.ndarray) -> np.ndarray:
    """(3,) the axis along which a direction is most."""
    k = int(np.abs(direction).argmax())
    return np.asarray(np.eye(3)[k] * np.sign(direction[k]))


def axis_name(direction: np.ndarray) -> str:
    return AXES[int(np.argmax([np.dot(axis(name), direction) for name in AXES]))]


def near_axis(direction: np.ndarray) -> str:
    """`+Z`, or the two axes between which a direction is: `+Z 30° to +X`."""
    near = axis_name(direction)
    rest = direction - (direction @ axis(near)) * np.array(axis(near))
    angle = np.degrees(np.arctan2(np.linalg.norm(rest), direction @ axis(near)))
    return near if angle < 0.5 else f"{near}, {angle:.0f}° to {axis_name(rest)}"
