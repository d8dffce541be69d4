"""The Face tab: jaw and eye joints, and the 52 expression coefficients by region."""

from __future__ import annotations

from collections.abc import Iterator

from avatarrex_studio.panels import joints, widgets
from avatarrex_studio.session.actions import words
from avatarrex_studio.session.commands import Command, SetExpression
from avatarrex_studio.session.posing import FACE_GROUPS, FACE_JOINTS
from avatarrex_studio.session.state import StudioState

from avatarrex.signals.joints import EXPRESSION_NAMES

LABEL = 128.0


def face_panel() -> joints.SignalPanel:
    """Sliders of the face."""
    groups = {"jaw and eyes": FACE_JOINTS, **FACE_GROUPS}
    return joints.SignalPanel("face", groups, "Search the face", _row, limits=False)


def _row(state: StudioState, name: str, group: str) -> Iterator[Command]:
    """A joint, or a coefficient: `mouthSmileLeft` in the group mouth is titled `Smile left`."""
    if name in FACE_JOINTS:
        yield from joints.joint_row(state, name, group)
        return
    value = float(state.signals.expression[EXPRESSION_NAMES.index(name)])
    widgets.label(words(name.removeprefix(group) or name).capitalize(), LABEL, value != 0)
    new = widgets.slider(name, value, (0, 1), "%.2f")
    widgets.tooltip(name)
    if new is not None:
        yield SetExpression(name, new)
