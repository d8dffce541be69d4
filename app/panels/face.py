"""The Face tab: jaw and eye joints, and the 52 expression coefficients by region."""

from __future__ import annotations

import re

from avatarrex_studio.panels import widgets
from avatarrex_studio.panels.joints import joint_row
from avatarrex_studio.session import posing
from avatarrex_studio.session.commands import Command, ResetGroup, SetExpression
from avatarrex_studio.session.posing import FACE_GROUPS
from avatarrex_studio.session.state import StudioState
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.signals.joints import EXPRESSION_NAMES

LABEL = 128.0
JOINTS = posing.GROUPS["face joints"]


class FacePanel:
    """Sliders of the face."""

    def __init__(self) -> None:
        self.search = ""

    def draw(self, state: StudioState) -> list[Command]:
        """Draw the tab; the commands of this frame."""
        commands: list[Command] = []
        imgui.set_next_item_width(imgui.get_content_region_avail().x)
        _, self.search = imgui.input_text_with_hint(
            "##search.face", f"{icons.ICON_FA_MAGNIFYING_GLASS}  Search the face", self.search
        )
        words = self.search.lower().split()
        for group, names in {"face joints": JOINTS, **FACE_GROUPS}.items():
            shown = [
                name for name in names if all(word in f"{group} {_title(name, '')} {name}".lower() for word in words)
            ]
            if not shown:
                continue
            if words:
                imgui.set_next_item_open(True)
            title = "Jaw and eyes" if group == "face joints" else group.capitalize()
            is_open, pressed = widgets.group(title, f"face.{group}", posing.changed(state.signals, group))
            if pressed:
                commands.append(ResetGroup(group))
            if is_open:
                for name in shown:
                    commands += joint_row(state, name, group) if name in JOINTS else _coefficient(state, name, group)
        return commands


def _coefficient(state: StudioState, name: str, group: str) -> list[Command]:
    value = float(state.signals.expression[EXPRESSION_NAMES.index(name)])
    widgets.label(_title(name, group), value != 0, LABEL)
    new = widgets.slider(name, value, 0, 1, "%.2f", imgui.get_content_region_avail().x, tip=name)
    return [] if new is None else [SetExpression(name, new)]


def _title(name: str, group: str) -> str:
    """`mouthSmileLeft` in the group mouth → `Smile left`."""
    words = re.findall(r"[A-Z]?[a-z]+", name.removeprefix(group) or name)
    return " ".join(words).capitalize()
