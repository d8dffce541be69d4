"""What `render` changes of pose, camera and background: text in, commands of a session out. Raises `InputError`.

Angles are radians unless they end in `deg` (`body.left_elbow=0,0,45deg` is in degrees altogether); camera angles are
always degrees; lengths are metres.
"""

from __future__ import annotations

import math
from argparse import Namespace
from typing import Any

from avatarrex_studio.cli.options import number
from avatarrex_studio.session import commands
from avatarrex_studio.session.commands import Command, SetCamera
from avatarrex_studio.session.posing import FACE_JOINTS, GROUPS, SHAPE_RANGE
from avatarrex_studio.session.state import Colour
from PIL import ImageColor

from avatarrex.errors import InputError
from avatarrex.signals.joints import BODY_JOINTS, EXPRESSION_NAMES, HAND_JOINTS
from avatarrex.templates.parts import HANDS

CAMERA = ("azimuth", "elevation", "distance", "fov", "x", "y", "z", "follow", "orthographic")
FARTHEST = 1e6
"""Largest number of a camera: metres or degrees that doubles still resolve to 1e-9."""
GROUP_JOINTS = {
    "body": {joint: joint for joint in BODY_JOINTS},
    **{hand: dict(zip(HAND_JOINTS, GROUPS[hand])) for hand in HANDS},
    "face": {joint: joint for joint in FACE_JOINTS},
    "root": dict.fromkeys(("orientation", "rotation", "global_orient"), "pelvis"),
}
"""What a joint is called in each group, and its own name."""
UNITS = {"deg": math.pi / 180, "rad": 1.0}


def edits(arguments: Namespace) -> tuple[Command, ...]:
    """Named poses first, single settings last."""
    return (
        *map(commands.ApplyPose, arguments.pose),
        *(command for text in arguments.hand for command in hand(text)),
        *map(commands.ApplyExpression, arguments.expression),
        *map(setting, arguments.set),
    )


def camera(text: str) -> SetCamera:
    """`azimuth=30,elevation=10,distance=2.6,fov=40`; `x`, `y`, `z` place the target, `follow=0` keeps it there.

    What is left out stays None: the target and the distance are then framed about the person (`framing.py`). A target that
    is given does not follow a motion unless `follow=1`.
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
    target = None
    if given.keys() & set("xyz"):
        target = (given.pop("x", 0.0), given.pop("y", -0.05), given.pop("z", 0.0))
    if target:
        given.setdefault("follow", 0.0)
    values: dict[str, Any] = {
        name: bool(value) if name in ("follow", "orthographic") else value for name, value in given.items()
    }
    return SetCamera(target=target, **values)


def setting(text: str) -> Command:
    """`GROUP.NAME=VALUE`: body, left_hand, right_hand, face, root, shape."""
    path, found, value = text.partition("=")
    group, dot, name = path.strip().partition(".")
    if not (found and dot):
        raise InputError("--set", text, "GROUP.NAME=VALUE, e.g. face.jawOpen=0.6", "another form")
    if group == "shape":
        if name not in tuple("0123456789"):
            raise InputError("--set", path, "shape.0 to shape.9", name)
        index, size = int(name), number("--set", path, value)
        if abs(size) > SHAPE_RANGE:
            raise InputError("--set", path, f"±{SHAPE_RANGE:g}", value)
        return commands.SetShape(index, size)
    if group not in GROUP_JOINTS:
        raise InputError("--set", path, "a group: " + ", ".join((*GROUP_JOINTS, "shape")), group)
    if group == "face" and name in EXPRESSION_NAMES:
        return commands.SetExpression(name, number("--set", path, value))
    if group == "root" and name == "translation":
        return commands.SetTranslation(vector(path, value))
    if name in GROUP_JOINTS[group]:
        return commands.SetJoint(GROUP_JOINTS[group][name], vector(path, value, angles=True))
    if group == "root":
        raise InputError("--set", path, "root.translation or root.orientation", name)
    known = ", ".join(GROUP_JOINTS[group]) + (" or a coefficient such as jawOpen" if group == "face" else "")
    raise InputError("--set", path, known, name or "nothing")


def hand(text: str) -> list[Command]:
    """`left=fist`, `right=point` or `both=relaxed`."""
    side, found, name = text.partition("=")
    if not found or side not in ("left", "right", "both"):
        raise InputError("--hand", "", "left=NAME, right=NAME or both=NAME", text)
    return [commands.SetHandPose(which, name) for which in (("left", "right") if side == "both" else (side,))]


def background(text: str) -> Colour:
    """A colour name, `#hex`, `r,g,b` (integers to 255, or decimals to 1.0), or `transparent`."""
    text = text.strip().lower()
    if text == "transparent":
        return (0.0, 0.0, 0.0, 0.0)
    if "," in text:
        values = [number("--background", "", part) for part in text.split(",")]
        scale = 1.0 if "." in text else 255.0
        if len(values) != 3 or not all(0 <= value <= scale for value in values):
            raise InputError("--background", "", "r,g,b as integers to 255 or decimals to 1.0", text)
        red, green, blue = (value / scale for value in values)
        return (red, green, blue, 1.0)
    try:
        channels = ImageColor.getrgb(text)
    except ValueError:
        expected = "a colour name, #rrggbb, r,g,b or transparent"
        raise InputError("--background", "", expected, text or "nothing") from None
    red, green, blue, alpha = (channel / 255 for channel in (*channels, 255)[:4])
    return (red, green, blue, alpha)


def vector(path: str, text: str, angles: bool = False) -> tuple[float, float, float]:
    """Three numbers; angles may end in `deg` or `rad`."""
    text, scale = text.strip(), 1.0
    if angles and text[-3:] in UNITS:
        text, scale = text[:-3], UNITS[text[-3:]]
    parts = text.split(",")
    if len(parts) != 3:
        expected = "three numbers" + (", e.g. 0,0,45deg" if angles else "")
        raise InputError("--set", path, expected, text or "nothing")
    x, y, z = (scale * number("--set", path, part) for part in parts)
    return (x, y, z)
