"""Which way a file's world is turned: its up from the average body over the motion, its forward from the person at first.

A file's rest pose may stand along another axis than its motion does, so the motion decides; the rest pose only where the body
is as much along another axis. Letters: t frames.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from avatarrex.errors import InputError
from avatarrex.signals.direction import unit
from avatarrex.signals.import_options import AXES, ImportOptions, axis
from avatarrex.signals.imported import Guess
from avatarrex.signals.source_motion import SourceMotion

REST_COUNTS = 0.25
"""What the rest pose's up counts beside the average body's, whose components are at most 1."""
LEVEL = 0.3
"""Least share of the hips' line that is level where it tells which way a person looks; else the shoulders' does."""


def world_axes(
    path: Path, source: SourceMotion, found: dict[str, int], rest: np.ndarray | None, options: ImportOptions
) -> tuple[np.ndarray, tuple[Guess, ...], list[str]]:
    """Rotation (3, 3) from the file's world to ours, how it was found, and warnings. Raises `InputError`.

    `rest` (3, 3): the rest pose's axes (rest_pose.py), where it is a pose.
    """
    up, guess, warnings = _up(source, found, rest, options)
    left = source.places[0, found["left_hip"]] - source.places[0, found["right_hip"]]
    if options.forward:
        forward, why = np.array(axis(options.forward)), "chosen"
        if abs(forward @ up) > 0.5:
            raise InputError(path, "forward", f"an axis across up ({axis_name(up)})", options.forward)
        name = options.forward
    else:
        level = left - (left @ up) * up
        if np.linalg.norm(level) < LEVEL * np.linalg.norm(left):
            left = source.places[0, found["left_shoulder"]] - source.places[0, found["right_shoulder"]]
            level = left - (left @ up) * up
        if not level.any():
            raise InputError(path, "hips", "a left and a right hip apart from each other", "one place for both")
        forward = np.cross(unit(level), up)
        name, why = near_axis(forward), "the person looks at the camera in the first frame"
    return world_of(up, forward), (guess, Guess("forward", name, why, "forward")), warnings


def world_of(up: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) that takes a file's `up` to +Y and its `forward`, across it, to +Z."""
    return np.stack([np.cross(up, forward), up, forward])


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
