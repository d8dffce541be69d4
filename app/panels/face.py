"""The Face tab: expressions and visemes as macros, and below them the 52 coefficients and the face's joints by region."""

from __future__ import annotations

import secrets
from collections.abc import Iterator

from avatarrex_studio.panels import joints, widgets
from avatarrex_studio.session.actions import words
from avatarrex_studio.session.commands import Command, Randomise, ScaleGroup, SetExpression, SetFaceMacro
from avatarrex_studio.session.posing import FACE_GROUPS, FACE_JOINTS, counterpart
from avatarrex_studio.session.state import StudioState
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.avatar import Avatar
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.macros import FACE_MACROS, face_value

LABEL = 128.0
TITLES = {
    "brow": "Brows",
    "eye": "Eyes",
    "jaw": "Jaw",
    "mouth": "Mouth",
    "cheek": "Cheeks",
    "nose": "Nose",
    "tongue": "Tongue",
}
SECTIONS = {"expression": "Expressions", "brows": "Brow expressions", "eyes": "Lids and gaze", "visemes": "Visemes"}
"""Titles of the macros."""
READING = "Also tells how much of it the face shows now: what one of these does, others share"
TURNS = {"jaw": "Jaw joint", "left_eye": "Left eyeball", "right_eye": "Right eyeball"}
CARRIED = "* No picture of this avatar's training showed it: it moves as the template does"
STRENGTH = 0.5
"""Of a region that is shuffled."""


class FacePanel(joints.SignalPanel):
    """Macros, then regions."""

    def __init__(self) -> None:
        regions = {**FACE_GROUPS, "eye": (*FACE_GROUPS["eye"], *FACE_JOINTS[1:]), "jaw": (*FACE_GROUPS["jaw"], "jaw")}
        super().__init__("face", regions, "Search the face", self._row, limits=False)
        self.linked = True
        self._strong: tuple[str, float] | None = None
        """The region whose strength is dragged, and where the slider is, percent."""
        self._avatar: Avatar | None = None
        self._never_shown: tuple[str, ...] = ()

    def follow(self, avatar: Avatar | None) -> None:
        """Say of this avatar's coefficients which no picture of its training showed."""
        if avatar is not self._avatar:
            known = avatar.known_expressions if avatar is not None else None
            self._avatar, self._never_shown = avatar, known.never_shown if known is not None else ()

    def title(self, group: str) -> str:
        """A region in words."""
        return TITLES[group]

    def above(self, state: StudioState, group: str | None) -> Iterator[Command]:
        """Over all, the macros; over a region, how strong it is and a random one."""
        if group is not None:
            yield from self._strength(group)
            return
        self.linked = imgui.checkbox("Link left and right##face", self.linked)[1]
        widgets.tooltip("A coefficient of one side gives the other side the same value")
        for section, macros in FACE_MACROS.items():
            if widgets.group(SECTIONS[section], f"face.macro.{section}", opened=section == "expression")[0]:
                for macro in macros:
                    value = face_value(state.signals.expression, macro)
                    widgets.label(macro.capitalize(), LABEL, value > 0.005)
                    new = widgets.slider(f"macro.{macro}", 100 * value, (0, 100), "%.0f %%")
                    widgets.tooltip(READING)
                    if new is not None:
                        yield SetFaceMacro(macro, new / 100)

    def _strength(self, group: str) -> Iterator[Command]:
        """A slider that makes a region weaker or stronger from what it is when the drag begins, and a random one."""
        widgets.label("Strength", LABEL)
        dragged = self._strong is not None and self._strong[0] == group
        value = self._strong[1] if self._strong and dragged else 100.0
        new = widgets.slider(f"strength.{group}", value, (0, 200), "%.0f %%", widgets.room() - 34, rest=100)
        if new is not None:
            self._strong = group, new
            yield ScaleGroup(group, new / 100)
        elif dragged and not imgui.is_item_active():
            self._strong = None
        widgets.tooltip("Drag: all of this region weaker or stronger; 0 is rest")
        imgui.same_line(0, 6)
        if imgui.button(f"{icons.ICON_FA_DICE}##random.{group}", (28, 0)):
            yield Randomise(group, STRENGTH, secrets.randbits(31))
        widgets.tooltip("Something random")

    def _row(self, state: StudioState, name: str, group: str) -> Iterator[Command]:
        """A joint, or a coefficient: `mouthSmileLeft` in the group mouth is titled `Smile left`."""
        if name in FACE_JOINTS:
            yield from joints.joint_row(state, name, TURNS[name])
            return
        value = float(state.signals.expression[EXPRESSION_NAMES.index(name)])
        title = words(name.removeprefix(group) or name).capitalize() + (" *" if name in self._never_shown else "")
        widgets.label(title, LABEL, value != 0)
        new = widgets.slider(name, value, (0, 1), "%.2f")
        carried = f"\n{CARRIED}" if name in self._never_shown else ""
        widgets.tooltip(f"{words(name).capitalize()} ({name}){carried}")
        if new is not None:
            yield SetExpression(name, new, self.linked and counterpart(name) != name)


def face_panel() -> FacePanel:
    """Sliders of the face."""
    return FacePanel()
