"""`avatarrex-studio evaluate`: an avatar against a capture, as a table, JSON and a contact sheet."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from avatarrex_studio.cli import options

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.capture.readers.rigs import Capture, Rig, open_capture
from avatarrex.errors import InputError
from avatarrex.files.gate import write_text
from avatarrex.files.images import write_png
from avatarrex.metrics.baselines import baselines
from avatarrex.metrics.drawing import AvatarDrawer, Drawer
from avatarrex.metrics.evaluate import evaluate, observations
from avatarrex.metrics.face_region import face_alone
from avatarrex.metrics.measures import Networks
from avatarrex.metrics.report import contact_sheet, table, to_json

SHEET = 8
"""Pictures on a contact sheet."""


def run(arguments: argparse.Namespace) -> int:
    """Evaluate, print the table, write what was asked for. Raises `InputError` before any work for a wrong option."""
    size, samples = _whole("--size", arguments.size, 32, 8192, "pixels of the longer side"), arguments.samples
    samples = _whole("--samples", samples, 1, 8, "samples along a pixel's side") or 1
    for path in (arguments.json, arguments.sheet):
        if path is not None and Path(path).is_dir():
            raise InputError(path, "", "a file to write", "a folder")
    if arguments.sheet is not None and Path(arguments.sheet).suffix.lower() != ".png":
        raise InputError(arguments.sheet, "", "OUT.png", Path(arguments.sheet).suffix or "no extension")
    networks = Networks.load(*(Path(x) if x else None for x in (arguments.vgg, arguments.lpips, arguments.inception)))
    avatar, capture = load_avatar(arguments.avatar, arguments.device), open_capture(arguments.capture)
    rig = held_out(capture, arguments)
    frames = _frames(arguments.frames, rig) if arguments.frames else None
    views = views_of(rig, arguments.views, "--views") if arguments.views else None
    for note in (*capture.notes, *_other_body(avatar, capture)):
        print(note, file=sys.stderr)
    start = time.perf_counter()
    subjects: list[Drawer] = [AvatarDrawer(avatar, samples)]
    if arguments.baselines:
        subjects += baselines(capture.person, observations(rig))
    if arguments.face_only:
        if size is not None:
            raise InputError(
                "--size", "", "the pictures' own with --face-only: its mattes are cut pixel by pixel", size
            )
        rig, subjects = face_alone(capture.person, rig, subjects)
        capture = replace(capture, ground_truth=None)
    sheet = SHEET if arguments.sheet else 0
    found = evaluate(capture, rig, subjects, networks, frames, views, size, sheet, progress=True)
    print(table(found))
    if arguments.json:
        data = to_json(found, arguments.avatar, str(arguments.capture), time.perf_counter() - start)
        write_text(arguments.json, json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
        print(arguments.json)
    if arguments.sheet:
        write_png(arguments.sheet, contact_sheet(found))
        print(arguments.sheet)
    return 0


def _frames(text: str, rig: Rig) -> tuple[int, ...]:
    """All that are held out, or as listed."""
    return tuple(sorted(rig.held_out_frames)) if text == "held-out" else options.frames(text, rig.frames)


def held_out(capture: Capture, arguments: argparse.Namespace) -> Rig:
    """The rig that is asked for, with the options' frames and views held out where they say so."""
    name = arguments.rig or ("body" if "body" in capture.rigs else next(iter(capture.rigs)))
    if name not in capture.rigs:
        raise InputError(capture.path, "--rig", "one of " + ", ".join(capture.rigs), name)
    rig = capture.rigs[name]
    frames: Iterable[int] = rig.held_out_frames
    views: Iterable[int] = rig.held_out_views
    if arguments.held_out_frames:
        frames = options.frames(arguments.held_out_frames, rig.frames)
    if arguments.held_out_views:
        views = views_of(rig, arguments.held_out_views, "--held-out-views")
    return rig.holding_out(frames, views)


def views_of(rig: Rig, text: str, option: str) -> list[int]:
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


def _whole(option: str, text: str | None, low: int, high: int, what: str) -> int | None:
    if text is None:
        return None
    if not text.isdecimal() or not low <= int(text) <= high:
        raise InputError(option, "", f"{low} to {high} {what}", text or "nothing")
    return int(text)


def _other_body(avatar: Avatar, capture: Capture) -> list[str]:
    if avatar.person.hash == capture.person.hash:
        return []
    return ["avatar: made on another body than the capture's; it is posed on its own"]
