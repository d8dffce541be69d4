"""What the command line's option values mean: text in, commands and plain values out. Raises `InputError`.

Angles are radians unless they end in `deg` (`body.left_elbow=0,0,45deg` is in degrees altogether); camera angles are
always degrees; lengths are metres.
"""

from __future__ import annotations

import math
import re

from avatarrex_studio.session.commands import (
    Command,
    SetCamera,
    SetExpression,
    SetHandPose,
    SetJoint,
    SetShape,
    SetTranslation,
)
from avatarrex_studio.session.state import LEVELS, SIZES, Colour
from PIL import ImageColor

from avatarrex.errors import InputError
from avatarrex.signals.joints import BODY_JOINTS, EXPRESSION_NAMES, HAND_JOINTS

SHEETS = ("body", "face", "hands", "motion", "floaters")
AOVS = ("depth", "normal", "position", "mask")
CAMERA = ("azimuth", "elevation", "distance", "fov", "x", "y", "z", "follow")
FARTHEST = 1e6
"""Largest number of a camera: metres or degrees that doubles still tell apart to 1e-9."""
FACE_JOINTS = {"jaw": "jaw", "left_eye": "left_eye", "right_eye": "right_eye"}


def size(text: str) -> tuple[int, int]:
    """`N` or `WxH`, pixels."""
    match = re.fullmatch(r"([0-9]{1,9})(?:x([0-9]{1,9}))?", text.strip().lower())
    if not match:
        raise InputError("--size", "", "N or WxH, e.g. 512 or 640x480", text or "nothing")
    width, height = int(match[1]), int(match[2] or match[1])
    for side in (width, height):
        if not SIZES[0] <= side <= SIZES[1]:
            raise InputError("--size", "", f"sides of {SIZES[0]} to {SIZES[1]} pixels", text)
    return width, height


def camera(text: str) -> SetCamera:
    """`azimuth=30,elevation=10,distance=2.6,fov=40`; `x`, `y`, `z` place the target, `follow=0` keeps it there.

    What is left out stays None: the target and the distance are then framed about the person (`framing.py`).
    """
    given: dict[str, float] = {}
    for item in filter(None, text.split(",")):
        name, _, value = item.partition("=")
        if name.strip() not in CAMERA:
            raise InputError("--camera", name, "one of " + ", ".join(CAMERA), "an unknown key")
        given[name.strip()] = number("--camera", name, value)
        if abs(given[name.strip()]) > FARTHEST:
            raise InputError("--camera", name, f"a number up to {FARTHEST:g}", value)
    if not given:
        raise InputError("--camera", "", "key=value pairs, e.g. azimuth=30,distance=2.6", text or "nothing")
    place = [given.pop(axis, None) for axis in "xyz"]
    target = None
    if any(value is not None for value in place):
        target = tuple(default if value is None else value for value, default in zip(place, (0.0, -0.05, 0.0)))
    follow = given.pop("follow", None)
    return SetCamera(**given, target=target, follow=None if follow is None else bool(follow))


def setting(text: str) -> Command:
    """`GROUP.NAME=VALUE`: body, left_hand, right_hand, face, root, shape."""
    path, found, value = text.partition("=")
    group, dot, name = path.strip().partition(".")
    if not (found and dot):
        raise InputError("--set", text, "GROUP.NAME=VALUE, e.g. face.jawOpen=0.6", "another form")
    if group == "shape":
        if not name.isdigit() or int(name) > 9:
            raise InputError("--set", path, "shape.0 to shape.9", name)
        return SetShape(int(name), number("--set", path, value))
    if group == "root":
        if name == "translation":
            return SetTranslation(vector(path, value))
        if name in ("orientation", "rotation", "global_orient"):
            return SetJoint("pelvis", vector(path, value, angles=True))
        raise InputError("--set", path, "root.translation or root.orientation", name)
    if group == "face" and name in EXPRESSION_NAMES:
        return SetExpression(name, number("--set", path, value))
    joints = {
        "body": {joint: joint for joint in BODY_JOINTS},
        "left_hand": {joint: f"left_{joint}" for joint in HAND_JOINTS},
        "right_hand": {joint: f"right_{joint}" for joint in HAND_JOINTS},
        "face": FACE_JOINTS,
    }
    if group not in joints:
        raise InputError("--set", path, "a group: body, left_hand, right_hand, face, root, shape", group)
    if name not in joints[group]:
        known = ", ".join(joints[group]) + (" or a coefficient such as jawOpen" if group == "face" else "")
        raise InputError("--set", path, known, name or "nothing")
    return SetJoint(joints[group][name], vector(path, value, angles=True))


def hand(text: str) -> list[Command]:
    """`left=fist`, `right=point` or `both=relaxed`."""
    side, found, name = text.partition("=")
    if not found or side not in ("left", "right", "both"):
        raise InputError("--hand", "", "left=NAME, right=NAME or both=NAME", text)
    return [SetHandPose(which, name) for which in (("left", "right") if side == "both" else (side,))]


def background(text: str) -> Colour:
    """A colour name, `#hex`, `r,g,b` (integers to 255, or decimals to 1.0), or `transparent`."""
    text = text.strip().lower()
    if text == "transparent":
        return (0.0, 0.0, 0.0, 0.0)
    expected = "a colour name, #rrggbb, r,g,b or transparent"
    if "," in text:
        parts = text.split(",")
        values = [number("--background", "", part) for part in parts]
        scale = 1.0 if "." in text else 255.0
        if len(values) != 3 or not all(0 <= value <= scale for value in values):
            raise InputError("--background", "", "r,g,b as integers to 255 or decimals to 1.0", text)
        red, green, blue = (value / scale for value in values)
        return (red, green, blue, 1.0)
    try:
        channels = ImageColor.getrgb(text)
    except ValueError:
        raise InputError("--background", "", expected, text or "nothing") from None
    red, green, blue = (channel / 255 for channel in channels[:3])
    return (red, green, blue, channels[3] / 255 if len(channels) == 4 else 1.0)


def level(text: str) -> str:
    """The name of a level."""
    if text not in LEVELS:
        raise InputError("--level", "", "one of " + ", ".join(LEVELS), text)
    return text


def aovs(text: str) -> tuple[str, ...]:
    """Names of passes, comma separated."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in AOVS:
            raise InputError("--aov", "", "some of " + ",".join(AOVS), name or "nothing")
    return names


def sheets(text: str) -> tuple[str, ...]:
    """Names of contact sheets, comma separated."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in SHEETS:
            raise InputError("--only", "", "some of " + ",".join(SHEETS), name or "nothing")
    return names


def frame(text: str, count: int, option: str = "--frame") -> int:
    """An index into a motion of `count` frames; negative from the end."""
    if not re.fullmatch(r"-?[0-9]{1,9}", text.strip()) or not -count <= int(text) < count:
        raise InputError(option, "", f"an integer from 0 to {count - 1}", text)
    return int(text) % count


def frames(text: str, count: int) -> tuple[int, ...]:
    """`A:B:S` as a slice of a motion of `count` frames, B not included; several of them, comma separated."""
    return tuple(dict.fromkeys(frame for part in text.split(",") for frame in _slice(part, count)))


def _slice(text: str, count: int) -> range:
    parts = text.split(":")
    if not 2 <= len(parts) <= 3 or not all(re.fullmatch(r"\s*(-?[0-9]{1,9})?\s*", part) for part in parts):
        raise InputError("--frames", "", "A:B or A:B:S, e.g. 0:120:4", text or "nothing")
    start, stop, step = (int(part) if part.strip() else None for part in [*parts, ""][:3])
    if step == 0:
        raise InputError("--frames", "", "a step other than 0", text)
    chosen = range(count)[start:stop:step]
    if not chosen:
        raise InputError("--frames", "", f"some of the {count} frames of the motion", text)
    return chosen


def vector(path: str, text: str, angles: bool = False) -> tuple[float, float, float]:
    """Three numbers; angles may end in `deg` or `rad`."""
    text, scale = text.strip(), 1.0
    for unit, factor in (("deg", math.pi / 180), ("rad", 1.0)):
        if angles and text.endswith(unit):
            text, scale = text.removesuffix(unit), factor
    parts = text.split(",")
    if len(parts) != 3:
        raise InputError(
            "--set", path, "three numbers, e.g. 0,0,45deg" if angles else "three numbers", text or "nothing"
        )
    x, y, z = (scale * number("--set", path, part) for part in parts)
    return (x, y, z)


def number(option: str, field: str, text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(option, field, "a finite number", text.strip() or "nothing")
    return value
