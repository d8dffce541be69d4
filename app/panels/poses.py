"""The Poses tab: named body poses, hands and expressions; mirror, random and reset."""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Iterator

from avatarrex_studio.panels import widgets
from avatarrex_studio.session.actions import words
from avatarrex_studio.session.commands import ApplyExpression, ApplyPose, Command, Mirror, Randomise, Reset, SetHandPose
from avatarrex_studio.session.state import StudioState
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.signals.library import EXPRESSIONS, HANDS, POSES
from avatarrex.templates.parts import PARTS

SIDES = {"both": ("left", "right"), "left": ("left",), "right": ("right",)}
RANDOM_GROUPS = {**{name: words(name).capitalize() for name in ("body", *PARTS)}, "all": "Everything"}
"""What can be random."""


class PosesPanel:
    """Buttons for the pose library."""

    def __init__(self) -> None:
        self.side = "both"
        self.strength = 0.5

    def draw(self, state: StudioState) -> Iterator[Command]:
        """Draw the tab; the commands of this frame."""
        width = (widgets.room() - imgui.get_style().item_spacing.x) / 2
        if imgui.button(f"{icons.ICON_FA_LEFT_RIGHT}  Mirror##poses", (width, 0)):
            yield Mirror()
        imgui.same_line()
        if imgui.button(f"{icons.ICON_FA_ROTATE_LEFT}  Reset all##poses", (width, 0)):
            yield Reset()
        if widgets.group("Body", "poses.body")[0] and (name := _library("pose.", POSES)):
            yield ApplyPose(name)
        if widgets.group("Hands", "poses.hands")[0]:
            yield from self._hands()
        if widgets.group("Expression", "poses.expression")[0] and (name := _library("expression.", EXPRESSIONS)):
            yield ApplyExpression(name)
        if widgets.group("Random", "poses.random")[0]:
            yield from self._random()

    def _hands(self) -> Iterator[Command]:
        for side in widgets.in_rows(SIDES):
            if imgui.radio_button(f"{side.capitalize()}##hands", self.side == side):
                self.side = side
        if name := _library("hand.", HANDS):
            yield from (SetHandPose(side, name) for side in SIDES[self.side])

    def _random(self) -> Iterator[Command]:
        widgets.label("Strength", 84)
        new = widgets.slider("strength", 100 * self.strength, (5, 100), "%.0f %%", rest=50)
        self.strength = self.strength if new is None else new / 100
        if group := widgets.button_grid(RANDOM_GROUPS, 92, "random."):
            yield Randomise(group, self.strength, secrets.randbits(31))


def _library(key: str, names: Iterable[str]) -> str | None:
    """A button for each name; the one that was pressed."""
    special = {"tpose": "T-pose", "apose": "A-pose"}
    titles = {name: special.get(name, words(name).capitalize()) for name in names}
    return widgets.button_grid(titles, 92, key)
