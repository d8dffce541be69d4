"""`avatarrex-studio sheet`: the contact sheets by which an avatar is judged, and what floats about it.

Every sheet appears whole or not at all, as soon as it is drawn; `sheet.json` comes last.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
from avatarrex_studio.cli.sheet_order import SheetOrder
from avatarrex_studio.sheets.pages import (
    Artist,
    Page,
    Scene,
    body_page,
    drawn,
    face_page,
    hands_page,
    motion_page,
    posed,
    standing,
)
from avatarrex_studio.sheets.paper import laid_out, write_jpeg
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.errors import InputError
from avatarrex.files.gate import write_text
from avatarrex.gl.context import NoContext
from avatarrex.metrics.drawing import AvatarDrawer
from avatarrex.metrics.floaters import SIZE, Floaters, find_floaters
from avatarrex.signals.driving import Signals

FORMAT = 1
PAGES = {"body": body_page, "face": face_page, "hands": hands_page}
FLOATING = ("arms_up", "squat", "run", "crossed_arms")
"""Poses of the library, besides standing, in which floaters are looked for: armpits, hips and crossing limbs at their most."""


def run(order: SheetOrder) -> int:
    """Draw what was asked for, print what floats, write `sheet.json`. Raises `InputError`."""
    avatar = load_avatar(order.avatar)
    artists = [_avatar_artist(_name(order.avatar), avatar, order.samples)]
    others = []
    if order.other:
        other = load_avatar(order.other)
        others = [_avatar_artist(_other_name(order), other, order.samples)]
    truth = [_truth_artist(order.truth)] if order.truth and set(order.only) - {"floaters"} else []
    seconds, floaters = {}, []
    for name in order.only:
        start = time.perf_counter()
        if name == "floaters":
            floaters = _floaters(avatar, _poses(order))
        elif name == "motion":
            among = [*truth, *artists, *others]
            assert order.motion is not None
            _draw(order, name, motion_page(avatar.person, len(among), order.motion, order.frames), among)
        else:
            _draw(order, name, PAGES[name](avatar.person, len(truth) + 1), truth + artists)
        seconds[name] = round(time.perf_counter() - start, 1)
    _write_report(order, floaters, seconds)
    return 0


def _draw(order: SheetOrder, name: str, page: Page, artists: list[Artist]) -> None:
    """One sheet, written and named."""
    bar = tqdm(total=page.pictures, desc=name, unit="picture")
    with bar:
        tiles = drawn(page, artists, bar.update)
    note = " · ".join(artist.name for artist in artists)
    if name == "motion" and order.motion:
        note = f"{Path(order.motion.path).name} · {note}"
    path = order.out / f"{name}.jpg"
    write_jpeg(path, laid_out(page.heading, note, tiles, page.width))
    print(path, flush=True)


def _poses(order: SheetOrder) -> dict[str, Signals]:
    """Where floaters are looked for: `FLOATING`, and the frames of the motion where there is one."""
    poses = {"stand": standing(), **{name: posed(name) for name in FLOATING}}
    if order.motion:
        name = Path(order.motion.path).name
        poses |= {f"{name} frame {frame}": order.motion.signals(frame, standing()) for frame in order.frames}
    return poses


def _floaters(avatar: Avatar, poses: dict[str, Signals]) -> list[Floaters]:
    """What floats, pose by pose."""
    found = []
    with tqdm(total=len(poses), desc="floaters", unit="pose") as bar:
        for one in find_floaters(avatar, poses, SIZE):
            found.append(one)
            bar.update()
    for one in found:
        print(one.line())
    return found


def _write_report(order: SheetOrder, floaters: list[Floaters], seconds: dict[str, float]) -> None:
    data = {
        "format": FORMAT,
        "avatar": order.avatar,
        "other": order.other,
        "truth": order.truth,
        "motion": order.motion and {"file": order.motion.path, "frames": list(order.frames)},
        "sheets": [f"{name}.jpg" for name in order.only if name != "floaters"],
        "floaters": [one.to_json() for one in floaters] if "floaters" in order.only else None,
        "seconds": seconds,
    }
    path = order.out / "sheet.json"
    write_text(path, json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    print(path)


def _avatar_artist(name: str, avatar: Avatar, samples: int) -> Artist:
    drawer = AvatarDrawer(avatar, samples)

    def draw(scene: Scene) -> np.ndarray:
        return drawer.draw(scene.signals, scene.camera).image.numpy()

    return Artist(name, draw)


def _truth_artist(subject: str) -> Artist:
    from avatarrex.capture.synthetic.subject import load_subject
    from avatarrex.capture.synthetic.subject_drawer import SubjectDrawer

    try:
        drawer = SubjectDrawer(load_subject(subject))
    except NoContext as error:
        raise InputError("--truth", "", "OpenGL 4.3 (Mesa's llvmpipe will do)", error) from None
    return Artist("ground truth", lambda scene: drawer.draw(scene.signals, scene.camera, scene.rig))


def _name(source: str) -> str:
    """What an avatar is called on paper."""
    return "default avatar" if source == "default" else Path(source).stem


def _other_name(order: SheetOrder) -> str:
    """The second avatar's, told apart from the first's."""
    name = _name(order.other or "")
    return name if name != _name(order.avatar) else f"{name} (2)"
