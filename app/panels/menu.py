"""The menu bar, drawn from the list of actions."""

from __future__ import annotations

from avatarrex_studio.session.actions import Action, menu
from avatarrex_studio.session.journal import Journal
from imgui_bundle import imgui

MENUS = ("File", "Edit", "Pose", "View", "Motion", "Help")


def draw(journal: Journal) -> Action | None:
    """Draw the menus; the action that was chosen."""
    chosen = None
    for title in MENUS:
        if imgui.begin_menu(title):
            for entry in menu(title):
                if entry.separator:
                    imgui.separator()
                if imgui.menu_item(entry.title, entry.shortcut, False, entry.enabled(journal))[0]:
                    chosen = entry
            imgui.end_menu()
    return chosen
