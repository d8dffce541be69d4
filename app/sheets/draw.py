"""Draws the contact sheets by which an avatar is judged, and looks for what floats about it.

Every sheet appears whole or not at all, as soon as it is drawn.
"""

from __future__ import annotations

import time
from functools import cache
from pathlib import Path
from typing import Any

from avatarrex_studio.session.evaluation import motion_over
from avatarrex_studio.sheets import pages
from avatarrex_studio.sheets.captured import captured_page, drawer_artist, framed, mesh_artist, photograph
from avatarrex_studio.sheets.close_ups import by_rig, close_page, close_ups
from avatarrex_studio.sheets.order import TRUTHS, SheetOrder
from avatarrex_studio.sheets.pages import Artist, Page
from avatarrex_studio.sheets.paper import laid_out, write_jpeg
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.readers.splits import with_validation
from avatarrex.errors import InputError
from avatarrex.gl.context import NoContext
from avatarrex.metrics.drawing import by_level
from avatarrex.metrics.floaters import SILHOUETTE_PIXELS, Floaters, find_floaters
from avatarrex.metrics.own_training import as_trained

FORMAT = 1
PAGES = {"body": pages.body_page, "face": pages.face_page, "hands": pages.hands_page}
FLOATING = ("arms_up", "squat", "run", "crossed_arms")
"""Poses of the library, besides standing, in which floaters are looked for: armpits, hips and crossing limbs at their most."""


def run(order: SheetOrder) -> dict[str, Any]:
    """Draw what the order names, print what floats; returns the report for `sheet.json`. Raises `InputError`."""
    avatar = load_avatar(order.avatar)
    name = _name(order.avatar)
    artists = _avatar_artists(name, avatar, order)
    captured = None
    if order.truth and set(order.only) - {"floaters"}:
        if order.truth in TRUTHS.values():
            artists.insert(0, _truth_artist(order.truth))
        else:
            captured = _Captured(order, avatar)
    others = _others(name, order)
    close: list[dict[str, Any]] = []
    seconds: dict[str, float] = {}
    floaters: list[Floaters] | None = None
    for sheet in order.only:
        start = time.perf_counter()
        if sheet == "floaters":
            floaters = _floaters(avatar, order)
        elif sheet == "motion":
            assert order.motion is not None
            among = artists + others
            page = pages.motion_page(avatar.person, len(among), order.motion, order.frames)
            _draw(order, sheet, page, among, f"{Path(order.motion.path).name} · ")
        elif sheet == "close":
            assert captured is not None
            close = captured.draw_close_ups(others + artists)
        elif captured is not None and sheet in captured.capture.rigs:
            captured.draw_rig(sheet, artists)
        else:
            _draw(order, sheet, PAGES[sheet](avatar.person, len(artists)), artists)
        seconds[sheet] = round(time.perf_counter() - start, 1)
    return {
        "format": FORMAT,
        "avatar": order.avatar,
        "levels": list(order.levels),
        "other": order.other,
        "truth": order.truth,
        "motion": order.motion and {"file": order.motion.path, "frames": list(order.frames)},
        "sheets": [f"{name}.jpg" for name in order.only if name != "floaters" and (name != "close" or close)],
        "close": close,
        "floaters": None if floaters is None else [one.to_json() for one in floaters],
        "seconds": seconds,
    }


class _Captured:
    """The sheets of a capture's own pictures, as the avatar's training split them; each rig's mesh is painted once."""

    def __init__(self, order: SheetOrder, avatar: Avatar) -> None:
        capture = with_validation(open_capture(str(order.truth), template=avatar.person.name))
        self.order = order
        self.capture, own = as_trained(avatar, order.avatar, capture)
        self.person = avatar.person if own else self.capture.person
        self.mesh = cache(self._mesh)

    def draw_rig(self, rig: str, avatars: list[Artist]) -> None:
        """What its cameras see of the person."""
        seen = self._beside([rig], avatars)
        self._draw(rig, captured_page(self.capture, self.capture.rigs[rig], len(seen)), seen)

    def draw_close_ups(self, avatars: list[Artist]) -> list[dict[str, Any]]:
        """Returns which pictures they are."""
        found = close_ups(self.capture, self.person, self.order.only == ("close",))
        if not found:
            return []
        seen = self._beside([one.rig for one in found], avatars)
        self._draw("close", close_page(self.capture, found, len(seen)), seen)
        return [one.to_json(self.capture) for one in found]

    def _beside(self, rigs: list[str], avatars: list[Artist]) -> list[Artist]:
        """The photograph, the mesh as `rigs` saw it where it is wanted, and the avatars."""
        mesh = [by_rig({rig: self.mesh(rig) for rig in rigs})] if self.order.mesh else []
        return [photograph(), *map(framed, mesh + avatars)]

    def _mesh(self, rig: str) -> Artist:
        return mesh_artist(self.capture, self.capture.rigs[rig], self.person)

    def _draw(self, name: str, page: Page, artists: list[Artist]) -> None:
        _draw(self.order, name, page, artists, f"{Path(self.capture.path).name} · ")


def _draw(order: SheetOrder, name: str, page: Page, artists: list[Artist], note: str = "") -> None:
    """One sheet, written and named."""
    with tqdm(total=page.pictures, desc=name, unit="picture") as bar:
        tiles = pages.drawn(page, artists, bar.update)
    path = order.out / f"{name}.jpg"
    note += " · ".join(artist.name for artist in artists)
    write_jpeg(path, laid_out(page.heading, note, tiles, page.width))
    print(path, flush=True)


def _floaters(avatar: Avatar, order: SheetOrder) -> list[Floaters]:
    """What floats, in `FLOATING` and in the frames of the motion where there is one; printed."""
    poses = {name: pages.posed(name) for name in ("stand", *FLOATING)}
    if order.motion:
        name, standing = Path(order.motion.path).name, poses["stand"]
        poses |= {f"{name} frame {frame}": motion_over(standing, order.motion, frame) for frame in order.frames}
    found = list(tqdm(find_floaters(avatar, poses, SILHOUETTE_PIXELS), total=len(poses), desc="floaters", unit="pose"))
    for one in found:
        print(one.line())
    return found


def _name(source: str) -> str:
    """What an avatar is called on paper."""
    return "default avatar" if source == "default" else Path(source).stem


def _avatar_artists(name: str, avatar: Avatar, order: SheetOrder) -> list[Artist]:
    """One for each level."""

    return [drawer_artist(drawer.name, drawer) for drawer in by_level(name, avatar, order.levels, order.samples)]


def _others(name: str, order: SheetOrder) -> list[Artist]:
    """Those of a second avatar, which is not called as the first one is."""
    if not order.other:
        return []
    other = _name(order.other)
    return _avatar_artists(other if other != name else f"{other} (2)", load_avatar(order.other), order)


def _truth_artist(subject: str) -> Artist:
    from avatarrex.capture.synthetic.subject import load_subject
    from avatarrex.capture.synthetic.subject_drawer import SubjectDrawer

    try:
        drawer = SubjectDrawer(load_subject(subject))
    except NoContext as error:
        raise InputError("--truth", "", "OpenGL 4.3 (Mesa's llvmpipe will do)", error) from None
    return Artist("ground truth", lambda scene: drawer.draw(scene.signals, scene.camera, scene.rig))
