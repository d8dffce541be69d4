"""The Poses tab: named body poses, hands and expressions; mirror, random and reset."""

from __future__ import annotations

import secrets

from avatarrex_studio.panels import widgets
from avatarrex_studio.session.commands import ApplyExpression, ApplyPose, Command, Mirror, Randomise, Reset, SetHandPose
from avatarrex_studio.session.state import StudioState
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.signals.library import EXPRESSIONS, HANDS, POSES

SIDES = ("both", "left", "right")
RANDOM = (
    ("body", "Body"),
    ("left_hand", "Left hand"),
    ("right_hand", "Right hand"),
    ("face", "Face"),
    ("all", "Everything"),
)


class PosesPanel:
    """Buttons for the pose library."""

    def __init__(self) -> None:
        self.side = "both"
        self.strength = 0.5

    def draw(self, state: StudioState) -> list[Command]:
        """Draw the tab; the commands of this frame."""
        commands: list[Command] = []
        width = (imgui.get_content_region_avail().x - imgui.get_style().item_spacing.x) / 2
        if imgui.button(f"{icons.ICON_FA_LEFT_RIGHT}  Mirror##poses", imgui.ImVec2(width, 0)):
            commands.append(Mirror())
        imgui.same_line()
        if imgui.button(f"{icons.ICON_FA_ROTATE_LEFT}  Reset all##poses", imgui.ImVec2(width, 0)):
            commands.append(Reset())
        if widgets.group("Body", "poses.body", False)[0]:
            name = widgets.button_grid(_named("pose", POSES), 92)
            commands += [ApplyPose(name.partition(".")[2])] if name else []
        if widgets.group("Hands", "poses.hands", False)[0]:
            for side in SIDES:
                if imgui.radio_button(f"{side.capitalize()}##hands", self.side == side):
                    self.side = side
                imgui.same_line()
            imgui.new_line()
            name = widgets.button_grid(_named("hand", HANDS), 92)
            sides = ("left", "right") if self.side == "both" else (self.side,)
            commands += [SetHandPose(side, name.partition(".")[2]) for side in sides] if name else []
        if widgets.group("Expression", "poses.expression", False)[0]:
            name = widgets.button_grid(_named("expression", EXPRESSIONS), 92)
            commands += [ApplyExpression(name.partition(".")[2])] if name else []
        if widgets.group("Random", "poses.random", False)[0]:
            commands += self._random()
        return commands

    def _random(self) -> list[Command]:
        widgets.label("Strength", False, 84)
        new = widgets.slider(
            "strength", 100 * self.strength, 5, 100, "%.0f %%", imgui.get_content_region_avail().x, rest=50
        )
        self.strength = self.strength if new is None else new / 100
        group = widgets.button_grid([(f"random.{key}", title) for key, title in RANDOM], 92)
        return [Randomise(group.partition(".")[2], self.strength, secrets.randbits(31))] if group else []


def _named(kind: str, table: dict) -> list[tuple[str, str]]:
    special = {"tpose": "T-pose", "apose": "A-pose"}
    return [(f"{kind}.{name}", special.get(name, name.replace("_", " ").capitalize())) for name in table]
