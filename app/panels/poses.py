"""The Poses tab: named body poses, hands and expressions; mirror, random and reset."""

from __future__ import annotations

import secrets
from collections.abc import Iterable

from avatarrex_studio.panels import widgets
from avatarrex_studio.session.commands import ApplyExpression, ApplyPose, Command, Mirror, Randomise, Reset, SetHandPose
from avatarrex_studio.session.state import StudioState
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.signals.library import EXPRESSIONS, HANDS, POSES

SIDES = ("both", "left", "right")
GROUPS = {"body": "Body", "left_hand": "Left hand", "right_hand": "Right hand", "face": "Face", "all": "Everything"}
"""What can be random."""


class PosesPanel:
    """Buttons for the pose library."""

    def __init__(self) -> None:
        self.side = "both"
        self.strength = 0.5

    def draw(self, state: StudioState) -> list[Command]:
        """Draw the tab; the commands of this frame."""
        commands: list[Command] = []
        width = (widgets.room() - imgui.get_style().item_spacing.x) / 2
        if imgui.button(f"{icons.ICON_FA_LEFT_RIGHT}  Mirror##poses", (width, 0)):
            commands.append(Mirror())
        imgui.same_line()
        if imgui.button(f"{icons.ICON_FA_ROTATE_LEFT}  Reset all##poses", (width, 0)):
            commands.append(Reset())
        if widgets.group("Body", "poses.body")[0] and (name := _library("pose.", POSES)):
            commands.append(ApplyPose(name))
        if widgets.group("Hands", "poses.hands")[0]:
            commands += self._hands()
        if widgets.group("Expression", "poses.expression")[0] and (name := _library("expression.", EXPRESSIONS)):
            commands.append(ApplyExpression(name))
        if widgets.group("Random", "poses.random")[0]:
            commands += self._random()
        return commands

    def _hands(self) -> list[Command]:
        for side in SIDES:
            if imgui.radio_button(f"{side.capitalize()}##hands", self.side == side):
                self.side = side
            imgui.same_line()
        imgui.new_line()
        name = _library("hand.", HANDS)
        sides = ("left", "right") if self.side == "both" else (self.side,)
        return [SetHandPose(side, name) for side in sides] if name else []

    def _random(self) -> list[Command]:
        widgets.label("Strength", False, 84)
        new = widgets.slider("strength", 100 * self.strength, (5, 100), "%.0f %%", rest=50)
        self.strength = self.strength if new is None else new / 100
        group = widgets.button_grid(GROUPS, 92, "random.")
        return [Randomise(group, self.strength, secrets.randbits(31))] if group else []


def _library(key: str, names: Iterable[str]) -> str | None:
    """A button for each name; the one that was pressed."""
    special = {"tpose": "T-pose", "apose": "A-pose"}
    titles = {name: special.get(name, name.replace("_", " ").capitalize()) for name in names}
    return widgets.button_grid(titles, 92, key)
