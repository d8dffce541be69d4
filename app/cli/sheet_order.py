"""What `avatarrex-studio sheet` was asked for, read and checked before anything is loaded or written. Needs no torch."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

from avatarrex_studio.cli import options
from avatarrex_studio.session.motion import Motion

from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable, what_is

TRUTHS = {"subject": "default", "loose": "loose"}
"""The packaged subject behind each word."""
COLUMNS, MOST = 8, 24
"""Frames of a motion where none are asked for, in one band of the sheet; and the most that a sheet holds."""
SAMPLES = range(1, 5)


@dataclass(frozen=True)
class SheetOrder:
    """A checked order."""

    avatar: str
    out: Path
    only: tuple[str, ...]
    """Of `options.SHEETS`, in their order; `motion` only where there is one."""
    truth: str | None
    """The name of a packaged subject."""
    other: str | None
    motion: Motion | None
    frames: tuple[int, ...]
    samples: int


def read_order(arguments: Namespace) -> SheetOrder:
    """Read and check the options of `sheet`. Raises `InputError`."""
    for name, value in vars(arguments).items():
        if value == "":
            place = {"avatar": "AVATAR", "out": "OUT_DIR"}.get(name, f"--{name}")
            raise InputError(place, "", "a value", "nothing")
    for avatar in filter(None, (arguments.avatar, arguments.other)):
        found = what_is(avatar)
        if avatar != "default" and found not in ("a file", "a folder"):
            raise InputError(avatar, "", "an avatar folder or an .avatar file", found)
    if arguments.truth is not None and arguments.truth not in TRUTHS:
        raise InputError("--truth", "", " or ".join(TRUTHS), arguments.truth)
    if arguments.samples not in map(str, SAMPLES):
        raise InputError("--samples", "", f"{SAMPLES[0]} to {SAMPLES[-1]}", arguments.samples)
    only = options.sheets(arguments.only) if arguments.only else options.SHEETS
    for option in ("other", "frames"):
        if getattr(arguments, option) is not None and arguments.motion is None:
            raise InputError(f"--{option}", "", "--motion FILE with it", "no motion")
    if arguments.only and "motion" in only and arguments.motion is None:
        raise InputError("--only", "motion", "--motion FILE with it", "no motion")
    motion = Motion.read(arguments.motion) if arguments.motion else None
    frames = _frames(arguments.frames, motion) if motion else ()
    out = Path(arguments.out)
    if what_is(out) not in ("a folder", "nothing there"):
        raise InputError(out, "", "a folder to write to", what_is(out))
    check_writable(out / "sheet.json")
    return SheetOrder(
        arguments.avatar,
        out,
        tuple(name for name in options.SHEETS if name in only and (motion or name != "motion")),
        TRUTHS[arguments.truth] if arguments.truth else None,
        arguments.other,
        motion,
        frames,
        int(arguments.samples),
    )


def _frames(text: str | None, motion: Motion) -> tuple[int, ...]:
    if text is None:
        shown = min(COLUMNS, len(motion))
        return tuple(k * len(motion) // shown for k in range(shown))
    chosen = tuple(options.frames(text, len(motion)))
    if len(chosen) > MOST:
        raise InputError("--frames", "", f"at most {MOST} frames on a sheet", f"{text}, {len(chosen)} frames")
    return chosen
