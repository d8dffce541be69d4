"""The menu bar, drawn from the list of actions."""

from __future__ import annotations

import os
from collections.abc import Iterable
from itertools import groupby

from avatarrex_studio.session.actions import Action, menu
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.recent import Recent
from imgui_bundle import imgui

from avatarrex.errors import plain

MENUS = ("File", "Edit", "Pose", "View", "Motion", "Live output", "Help")
LONGEST = 48
"""Letters of a folder beside a recent file."""


def draw(journal: Journal, recent: Recent) -> Action | str | None:
    """Draw the menus; the action that was chosen, or the path to open."""
    chosen: Action | str | None = None
    for title in MENUS:
        if imgui.begin_menu(title):
            for path, entries in groupby(menu(title), lambda entry: entry.menu):
                if path == title:
                    chosen = _entries(entries, journal, recent) or chosen
                elif imgui.begin_menu(path.split("/")[1]):
                    chosen = _entries(entries, journal, recent) or chosen
                    imgui.end_menu()
            imgui.end_menu()
    return chosen


def _entries(entries: Iterable[Action], journal: Journal, recent: Recent) -> Action | str | None:
    chosen: Action | str | None = None
    for entry in entries:
        if entry.separator:
            imgui.separator()
        ticked = bool(entry.on and entry.on(journal.state))
        if imgui.menu_item(entry.title, entry.shortcut, ticked, entry.enabled(journal))[0]:
            chosen = entry
        if entry.id == "open":
            chosen = _recent(recent) or chosen
    return chosen


def _recent(recent: Recent) -> str | None:
    """What was opened last; those that are gone are grey."""
    if not imgui.begin_menu("Recent", bool(recent.paths)):
        return None
    if imgui.is_window_appearing():
        recent.look()
    chosen = None
    for path in recent.paths:
        name, place = os.path.basename(path), plain(os.path.dirname(path))
        if imgui.menu_item(f"{name}##{path}", shortened(place), False, path not in recent.gone)[0]:
            chosen = path
    imgui.end_menu()
    return chosen


def shortened(text: str) -> str:
    """A path of at most `LONGEST` letters: its end."""
    return text if len(text) <= LONGEST else "…" + text[1 - LONGEST :]
