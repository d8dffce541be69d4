"""The tab of one hand: curl and spread of every finger and of all, over the sliders of their joints."""

from __future__ import annotations

from collections.abc import Iterator

from avatarrex_studio.panels import joints, widgets
from avatarrex_studio.session.actions import words
from avatarrex_studio.session.commands import Command, SetFingers, SetHandPose
from avatarrex_studio.session.state import StudioState
from imgui_bundle import imgui

from avatarrex.signals.joints import FINGERS
from avatarrex.signals.library import HANDS
from avatarrex.signals.macros import CURL, HAND_MACROS, SPREAD, hand_mean, hand_values

ORDER = ("thumb", "index", "middle", "ring", "pinky")
ALL = "all fingers"
READY = {words(name).capitalize(): name for name in HANDS}
"""The library's hands, by title."""
RANGES = {"curl": CURL, "spread": SPREAD}


class HandPanel(joints.SignalPanel):
    """Macros and joints, finger by finger from the thumb."""

    def __init__(self, side: str) -> None:
        assert set(ORDER) == set(FINGERS)
        fingers = {finger: tuple(f"{side}_{finger}{k}" for k in (1, 2, 3)) for finger in ORDER}
        super().__init__(side, fingers, joints.HINT, self._joint)
        self.linked = False

    def above(self, state: StudioState, group: str | None) -> Iterator[Command]:
        """The macros of a finger, or of all."""
        if group is None:
            self.linked = imgui.checkbox(f"Both hands##{self.key}", self.linked)[1]
            widgets.tooltip("What is moved here moves on the other hand, too")
            imgui.same_line(0, 12)
            widgets.fill()
            if picked := widgets.choice(f"##ready.{self.key}", READY, "Ready hands", ""):
                sides = ("left", "right") if self.linked else (self.key,)
                yield from (SetHandPose(side, READY[picked]) for side in sides)
        finger = group or "all"
        pose = state.signals.left_hand_pose if self.key == "left" else state.signals.right_hand_pose
        values = hand_values(pose, self.key)
        for macro in HAND_MACROS:
            value = hand_mean(values, (group,) if group else FINGERS, macro)
            widgets.label(f"{'All ' if not group else ''}{macro}".capitalize(), joints.LABEL, abs(value) > 0.005)
            new = widgets.slider(
                f"{self.key}.{finger}.{macro}", 100 * value, (100 * RANGES[macro][0], 100 * RANGES[macro][1]), "%.0f %%"
            )
            if new is not None:
                yield SetFingers(f"{self.key} {finger} {macro}", new / 100, self.linked)

    def _joint(self, state: StudioState, name: str, group: str) -> Iterator[Command]:
        yield from joints.linked(joints.joint_row(state, name, group), self.linked)
