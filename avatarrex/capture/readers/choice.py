"""Frames and cameras of a rig chosen by words, e.g. those kept from training. Raises `InputError`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

from avatarrex.errors import InputError

if TYPE_CHECKING:  # torch, which a wrong option is refused without
    from avatarrex.capture.readers.rigs import Rig


def frames(text: str, count: int, option: str = "--frames") -> tuple[int, ...]:
    """`A:B:S` as a slice of a motion of `count` frames, B not included; several of them, comma separated."""
    return tuple(dict.fromkeys(frame for part in text.split(",") for frame in _slice(part, count, option)))


def _slice(text: str, count: int, option: str) -> range:
    parts = text.split(":")
    if not 2 <= len(parts) <= 3 or not all(re.fullmatch(r"\s*(-?[0-9]{1,9})?\s*", part) for part in parts):
        raise InputError(option, "", "A:B or A:B:S, e.g. 0:120:4", text or "nothing")
    start, stop, step = (int(part) if part.strip() else None for part in [*parts, ""][:3])
    if step == 0:
        raise InputError(option, "", "a step other than 0", text)
    chosen = range(count)[start:stop:step]
    if not chosen:
        raise InputError(option, "", f"some of the {count} frames of the motion", text)
    return chosen


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


def held_out(rig: Rig, some_frames: str | None, some_views: str | None) -> Rig:
    """The rig with these frames and views kept from training, instead of its own, where they are given."""
    kept: Iterable[int] = frames(some_frames, rig.frames, "--held-out-frames") if some_frames else rig.held_out_frames
    views = cameras(rig, some_views, "--held-out-views") if some_views else rig.held_out_views
    return rig.holding_out(kept, views)
