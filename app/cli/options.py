"""Values that options of several verbs have: text in, checked values out. Needs no torch. Raises `InputError`."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterable
from typing import Any

from avatarrex_studio.session.state import SIZES
from PIL import ImageColor

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is
from avatarrex.levels import DEFAULT_LEVEL, LEVELS
from avatarrex.settings import DEVICE
from avatarrex.stage.stage import COLOUR, PICTURE, Stage

STAGE = ("floor", "height", "azimuth", "elevation", "softness", "shadow", "exposure", "top", "bottom", "picture")
"""Keys of `--stage`."""
PERSONS = ("default", "models")
"""Templates by name."""


def add_device(verb: argparse.ArgumentParser) -> None:
    """`--device`, where the networks run; whether it is there is seen once torch is loaded."""

    def device(word: str) -> str:
        if not DEVICE.fullmatch(word):
            raise argparse.ArgumentTypeError(f"expected cpu, cuda, cuda:1, mps or xpu, found {word or 'nothing'}")
        return word

    where = "where the networks run: cpu, cuda, cuda:1, mps, xpu … (cpu)"
    verb.add_argument("--device", default="cpu", type=device, metavar="D", help=where)


def add_person(verb: argparse.ArgumentParser, default: str | None, otherwise: str = "") -> None:
    """`--person`, the template; `default` without the option."""
    words = (
        f"template: {', or '.join(PERSONS)} for SMPL-X, MANO, Faceverse of the models folder ({default or otherwise})"
    )
    verb.add_argument("--person", default=default, choices=PERSONS, metavar="P", help=words)


def add_levels(verb: argparse.ArgumentParser) -> None:
    """`--levels`, at each of which an avatar is a subject of its own; `levels` reads it."""
    words = f"levels that the avatar is drawn at, comma separated: {','.join(LEVELS)} ({DEFAULT_LEVEL})"
    verb.add_argument("--levels", default=DEFAULT_LEVEL, metavar="L,…", help=words)


def levels(text: str) -> tuple[str, ...]:
    """Names of levels."""
    return some_of("--levels", text, LEVELS)


def add_held_out(verb: argparse.ArgumentParser, cameras: str, what: str) -> None:
    """`--held-out-frames` and `--held-out-views`; `cameras` and `what` say in the help which."""
    for option, metavar, kind in (("frames", "A:B:S", "frames"), ("views", "NAMES", cameras)):
        words = f"{kind} {what}, instead of the capture's own"
        verb.add_argument(f"--held-out-{option}", metavar=metavar, help=words)


def add_renamed(verb: argparse.ArgumentParser, option: str, old: str, **rest: Any) -> None:
    """An option that is still accepted under its `old` name, which the help does not show."""
    verb.add_argument(option, **rest)
    verb.add_argument(old, dest=option.strip("-"), default=argparse.SUPPRESS, help=argparse.SUPPRESS)


def refuse_empty(arguments: argparse.Namespace, **places: str) -> None:
    """Refuse empty values: a shell variable that was never set must not stand for the default. `places` names words."""
    for name, value in vars(arguments).items():
        if value == "":
            raise InputError(places.get(name, "--" + name.replace("_", "-")), "", "a value", "nothing")


def refuse_without_motion(arguments: argparse.Namespace, *names: str) -> None:
    """Refuse options that mean nothing without `--motion`."""
    for name in names:
        if getattr(arguments, name) is not None:
            raise InputError(f"--{name}", "", "--motion FILE with it", "no motion")


def avatar(source: str) -> str:
    """`default`, or the path of an avatar."""
    found = what_is(source)
    if source != "default" and found not in ("a file", "a folder"):
        raise InputError(source, "", "an avatar folder or an .avatar file", found)
    return source


def one_of(option: str, text: str, names: Iterable[str]) -> str:
    """A name of a list."""
    if text not in names:
        raise InputError(option, "", "one of " + ", ".join(names), text or "nothing")
    return text


def some_of(option: str, text: str, names: Iterable[str]) -> tuple[str, ...]:
    """Names of a list, comma separated."""
    chosen = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in chosen:
        if name not in names:
            raise InputError(option, "", "some of " + ",".join(names), name or "nothing")
    return chosen


def whole(option: str, text: str, low: int, high: float = math.inf, expected: str = "") -> int:
    """An integer within limits."""
    if not re.fullmatch(r"[0-9]{1,19}", text.strip()) or not low <= int(text) <= high:
        limits = f"an integer from {low}" + (f" to {high}" if high < math.inf else "")
        raise InputError(option, "", expected or limits, text or "nothing")
    return int(text)


def number(option: str, field: str, text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(option, field, "a finite number", text.strip() or "nothing")
    return value


def size(text: str) -> tuple[int, int]:
    """`N` or `WxH`, pixels."""
    match = re.fullmatch(r"([0-9]{1,9})(?:x([0-9]{1,9}))?", text.strip().lower())
    if not match:
        raise InputError("--size", "", "N or WxH, e.g. 512 or 640x480", text or "nothing")
    width, height = int(match[1]), int(match[2] or match[1])
    if not all(SIZES[0] <= side <= SIZES[1] for side in (width, height)):
        raise InputError("--size", "", f"sides of {SIZES[0]} to {SIZES[1]} pixels", text)
    return width, height


def stage(text: str, own_background: bool) -> Stage:
    """`floor=0|1,height=Y,azimuth=A,elevation=E,softness=D,shadow=S,exposure=STOPS,top=COLOUR,bottom=COLOUR,picture=FILE`.

    `own_background`: the background that other options set takes the place of the gradient. Pictures are read at once.
    """
    given: dict[str, Any] = {"backdrop": COLOUR} if own_background else {}
    for item in filter(None, text.split(",")):
        name, _, value = item.partition("=")
        name = name.strip()
        if name not in STAGE:
            raise InputError("--stage", name, "one of " + ", ".join(STAGE), "an unknown key")
        if name == "picture":
            given |= {"picture": value, "backdrop": PICTURE}
            _check_picture(value)
        elif name in ("top", "bottom"):
            given[name] = _rgb(name, value)
        else:
            given[name] = _switch(name, value) if name == "floor" else number("--stage", name, value)
    return Stage(shown=True, **given)


def _switch(name: str, text: str) -> bool:
    if text not in ("0", "1"):
        raise InputError("--stage", name, "0 or 1", text or "nothing")
    return text == "1"


def _check_picture(path: str) -> None:
    if what_is(path) != "a file":
        raise InputError("--stage", "picture", "the path of a PNG or JPEG", path or "nothing")
    from avatarrex.files.images import read_pixels

    read_pixels(path)


def _rgb(name: str, text: str) -> tuple[float, float, float]:
    """A colour name or `#rrggbb`."""
    try:
        red, green, blue = ImageColor.getrgb(text)[:3]
    except ValueError:
        raise InputError("--stage", name, "a colour name or #rrggbb", text or "nothing") from None
    return red / 255, green / 255, blue / 255


def frame(text: str, count: int, option: str = "--frame") -> int:
    """An index into a motion of `count` frames; negative from the end."""
    if not re.fullmatch(r"-?[0-9]{1,9}", text.strip()) or not -count <= int(text) < count:
        raise InputError(option, "", f"an integer from 0 to {count - 1}", text)
    return int(text) % count
