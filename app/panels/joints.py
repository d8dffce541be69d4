"""Body and hand tabs: every joint's rotation vector as three sliders in degrees, by limb."""

from __future__ import annotations

import math

import numpy as np
from avatarrex_studio.panels import widgets
from avatarrex_studio.session import posing
from avatarrex_studio.session.commands import Command, ResetGroup, SetJoint, SetLimits, SetTranslation
from avatarrex_studio.session.state import StudioState
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.signals.joints import BODY_GROUPS, FINGERS, JOINT_NAMES
from avatarrex.signals.limits import LIMITS

LABEL = 84.0
TURN = 180.0


class JointsPanel:
    """Sliders for the joints of `groups`: titles with joint names."""

    def __init__(self, key: str, groups: dict[str, tuple[str, ...]]) -> None:
        self.key, self.groups = key, groups
        self.search = ""

    def draw(self, state: StudioState) -> list[Command]:
        """Draw the tab; the commands of this frame."""
        commands: list[Command] = []
        width = imgui.get_content_region_avail().x
        imgui.set_next_item_width(width - 92)
        _, self.search = imgui.input_text_with_hint(
            f"##search.{self.key}", f"{icons.ICON_FA_MAGNIFYING_GLASS}  Search joints", self.search
        )
        imgui.same_line()
        toggled, limited = imgui.checkbox(f"Limits##{self.key}", state.limit_joints)
        if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip):
            imgui.set_tooltip("Keep joints within what a body can do")
        if toggled:
            commands.append(SetLimits(limited))
        words = self.search.lower().split()
        for title, names in self.groups.items():
            shown = [
                name for name in names if all(word in f"{title} {name}".lower().replace("_", " ") for word in words)
            ]
            if shown:
                commands += self._group(state, title, names, shown, bool(words))
        return commands

    def _group(
        self, state: StudioState, title: str, names: tuple[str, ...], shown: list[str], searching: bool
    ) -> list[Command]:
        commands: list[Command] = []
        marked = any(posing.changed(state.signals, name) for name in names)
        if searching:
            imgui.set_next_item_open(True)
        is_open, pressed = widgets.group(title.capitalize(), f"{self.key}.{title}", marked)
        if pressed:
            commands += [ResetGroup(name) for name in names if posing.changed(state.signals, name)]
        if is_open:
            for name in shown:
                commands += translation_row(state) if name == "translation" else joint_row(state, name, title)
        return commands


def joint_row(state: StudioState, name: str, group: str) -> list[Command]:
    """One joint: label and three sliders, ids `##joint.x` and so on."""
    rotation = posing.joint(state.signals, name)
    limits = np.degrees(LIMITS[JOINT_NAMES.index(name)]) if state.limit_joints and name != "pelvis" else None
    widgets.label(_title(name, group), any(rotation), LABEL)
    width = _third()
    commands: list[Command] = []
    for axis, letter in enumerate("xyz"):
        low, high = limits[axis] if limits is not None else (-TURN, TURN)
        if axis:
            imgui.same_line(0, 4)
        imgui.begin_disabled(bool(low == high))
        tip = f"{name} {letter}: {low:.0f}° to {high:.0f}°"
        new = widgets.slider(f"{name}.{letter}", math.degrees(rotation[axis]), low, high, "%.0f°", width, tip=tip)
        imgui.end_disabled()
        widgets.axis_mark(axis)
        if new is not None:
            x, y, z = (math.radians(new) if axis == other else value for other, value in enumerate(rotation))
            commands.append(SetJoint(name, (x, y, z)))
    return commands


def translation_row(state: StudioState) -> list[Command]:
    """The root's place, metres."""
    place = state.signals.translation
    widgets.label("Place", bool(place.any()), LABEL)
    width = _third()
    commands: list[Command] = []
    for axis, letter in enumerate("xyz"):
        if axis:
            imgui.same_line(0, 4)
        new = widgets.slider(f"translation.{letter}", float(place[axis]), -3, 3, "%.2f m", width)
        widgets.axis_mark(axis)
        if new is not None:
            moved = place.copy()
            moved[axis] = new
            commands.append(SetTranslation((float(moved[0]), float(moved[1]), float(moved[2]))))
    return commands


def body_panel() -> JointsPanel:
    """The Body tab: root and limbs."""
    return JointsPanel("body", {"root": ("pelvis", "translation"), **BODY_GROUPS})


def hand_panel(side: str) -> JointsPanel:
    """The tab of one hand, finger by finger from the thumb."""
    order = ("thumb", "index", "middle", "ring", "pinky")
    assert set(order) == set(FINGERS)
    return JointsPanel(side, {finger: tuple(f"{side}_{finger}{k}" for k in (1, 2, 3)) for finger in order})


def _third() -> float:
    return max((imgui.get_content_region_avail().x - 8) / 3, 40)


_KNUCKLES = {"1": "Knuckle", "2": "Middle", "3": "Tip"}
_THUMB = {"1": "Base", "2": "Middle", "3": "Tip"}


def _title(name: str, group: str) -> str:
    if name == "pelvis":
        return "Turn"
    if group in FINGERS:
        return (_THUMB if group == "thumb" else _KNUCKLES)[name[-1]]
    side, _, rest = name.partition("_")
    return (rest if side in group and rest else name).replace("_", " ").capitalize()
