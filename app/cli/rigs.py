"""The cameras and frames of a capture that options name. Raises `InputError`."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable
from dataclasses import replace

from avatarrex_studio.cli import options

from avatarrex.capture.readers.rigs import Capture, Rig, open_capture
from avatarrex.errors import InputError


def open_held_out(arguments: Namespace) -> Capture:
    """The capture of a training, with each rig's frames and views held out that the options name."""
    capture = open_capture(arguments.capture)
    return replace(capture, rigs={name: held_out(rig, arguments) for name, rig in capture.rigs.items()})


def held_out(rig: Rig, arguments: Namespace, views_of: str = "body") -> Rig:
    """The rig with the options' frames held out, and their views where the rig is `views_of`.

    Where cameras to train on alone are named (`--body-views`, `--face-views`), all others are held out.
    """
    frames: Iterable[int] = rig.held_out_frames
    views: Iterable[int] = rig.held_out_views
    if arguments.held_out_frames:
        frames = options.frames(arguments.held_out_frames, rig.frames, "--held-out-frames")
    if arguments.held_out_views and rig.name == views_of:
        views = cameras(rig, arguments.held_out_views, "--held-out-views")
    alone = getattr(arguments, f"{rig.name}_views", None)
    if alone:
        views = set(range(len(rig.views))) - set(cameras(rig, alone, f"--{rig.name}-views"))
    return rig.holding_out(frames, views)


def cameras(rig: Rig, text: str, option: str) -> list[int]:
    """Cameras by name or number, comma separated; a name goes before a number."""
    names = {view.name: index for index, view in enumerate(rig.views)}
    found = []
    for word in (part.strip() for part in text.split(",")):
        number = int(word) if word.isdecimal() else -1
        if word not in names and not 0 <= number < len(rig.views):
            known = f"cameras 0 to {len(rig.views) - 1} or their names, {', '.join(list(names)[:4])} …"
            raise InputError(option, "", known, word or "nothing")
        found.append(names.get(word, number))
    return found
