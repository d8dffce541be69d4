"""The Face tab: jaw and eye joints, and the 52 expression coefficients by region."""

from __future__ import annotations

import re

from avatarrex_studio.panels import widgets
from avatarrex_studio.panels.joints import SignalPanel, joint_row
from avatarrex_studio.session import posing
from avatarrex_studio.session.commands import Command, ResetGroup, SetExpression
from avatarrex_studio.session.posing import FACE_GROUPS
from avatarrex_studio.session.state import StudioState

from avatarrex.signals.joints import EXPRESSION_NAMES

LABEL = 128.0
JOINTS = posing.GROUPS["face joints"]


class FacePanel(SignalPanel):
    """Sliders of the face."""

    hint = "Search the face"

    def __init__(self) -> None:
        super().__init__("face", {"face joints": JOINTS, **FACE_GROUPS})

    def _title(self, group: str) -> str:
        return "Jaw and eyes" if group == "face joints" else group.capitalize()

    def _text(self, group: str, name: str) -> str:
        return f"{group} {_words(name, '')} {name}"

    def _reset(self, group: str, changed: list[str]) -> list[Command]:
        return [ResetGroup(group)]

    def _row(self, state: StudioState, name: str, group: str) -> list[Command]:
        return joint_row(state, name, group) if name in JOINTS else _coefficient(state, name, group)


def _coefficient(state: StudioState, name: str, group: str) -> list[Command]:
    value = float(state.signals.expression[EXPRESSION_NAMES.index(name)])
    widgets.label(_words(name, group), value != 0, LABEL)
    new = widgets.slider(name, value, (0, 1), "%.2f")
    widgets.tooltip(name)
    return [] if new is None else [SetExpression(name, new)]


def _words(name: str, group: str) -> str:
    """`mouthSmileLeft` in the group mouth → `Smile left`."""
    words = re.findall(r"[A-Z]?[a-z]+", name.removeprefix(group) or name)
    return " ".join(words).capitalize()
