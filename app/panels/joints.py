"""Body and hand tabs: every joint's rotation vector as three sliders in degrees, by limb."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from avatarrex_studio.panels import widgets
from avatarrex_studio.session import posing
from avatarrex_studio.session.commands import Command, ResetGroup, SetJoint, SetLimits, SetTranslation
from avatarrex_studio.session.state import StudioState, vector
from imgui_bundle import imgui

from avatarrex.signals.joints import BODY_GROUPS, FINGERS, JOINT_NAMES
from avatarrex.signals.limits import LIMITS

LABEL = 84.0
TURN = 180.0


class SignalPanel:
    """Sliders in `groups` (names by title) under a search box; what a row is, subclasses say."""

    hint = "Search joints"
    spare = 0.0
    """Points that are left free beside the search box."""

    def __init__(self, key: str, groups: dict[str, tuple[str, ...]]) -> None:
        self.key, self.groups = key, groups
        self.search = ""

    def draw(self, state: StudioState) -> list[Command]:
        """Draw the tab; the commands of this frame."""
        self.search = widgets.search(self.key, self.hint, self.search, self.spare)
        commands = self._options(state)
        words = self.search.lower().split()
        for group, names in self.groups.items():
            shown = [name for name in names if all(word in self._text(group, name).lower() for word in words)]
            if not shown:
                continue
            if words:
                imgui.set_next_item_open(True)
            changed = [name for name in names if posing.changed(state.signals, name)]
            is_open, pressed = widgets.group(self._title(group), f"{self.key}.{group}", bool(changed))
            if pressed:
                commands += self._reset(group, changed)
            if is_open:
                for name in shown:
                    commands += self._row(state, name, group)
        return commands

    def _options(self, state: StudioState) -> list[Command]:
        """What is beside the search box."""
        return []

    def _title(self, group: str) -> str:
        return group.capitalize()

    def _text(self, group: str, name: str) -> str:
        """What a search looks in."""
        return f"{group} {name}".replace("_", " ")

    def _reset(self, group: str, changed: list[str]) -> list[Command]:
        return [ResetGroup(name) for name in changed]

    def _row(self, state: StudioState, name: str, group: str) -> list[Command]:
        return joint_row(state, name, group)


class JointsPanel(SignalPanel):
    """Joints and the place, within their limits unless told."""

    spare = 92.0

    def _options(self, state: StudioState) -> list[Command]:
        imgui.same_line()
        toggled, limited = imgui.checkbox(f"Limits##{self.key}", state.limit_joints)
        widgets.tooltip("Keep joints within what a body can do")
        return [SetLimits(limited)] if toggled else []

    def _row(self, state: StudioState, name: str, group: str) -> list[Command]:
        return translation_row(state) if name == "translation" else joint_row(state, name, group)


def joint_row(state: StudioState, name: str, group: str) -> list[Command]:
    """One joint: label and three sliders, ids `##joint.x` and so on."""
    rotation = posing.joint(state.signals, name)
    limited = state.limit_joints and name != "pelvis"
    bounds = np.degrees(LIMITS[JOINT_NAMES.index(name)]) if limited else np.tile([-TURN, TURN], (3, 1))
    degrees = tuple(map(math.degrees, rotation))
    moved = _vector_row(_joint_title(name, group), name, degrees, [(low, high) for low, high in bounds], "%.0f°")
    if moved is None:
        return []
    turned = np.array(rotation)
    turned[moved[0]] = math.radians(moved[1])
    return [SetJoint(name, vector(turned))]


def translation_row(state: StudioState) -> list[Command]:
    """The root's place, metres."""
    place = state.signals.translation.copy()
    moved = _vector_row("Place", "translation", vector(place), [(-3.0, 3.0)] * 3, "%.2f m")
    if moved is None:
        return []
    place[moved[0]] = moved[1]
    return [SetTranslation(vector(place))]


def _vector_row(
    title: str, name: str, values: tuple[float, ...], bounds: Sequence[tuple[float, float]], form: str
) -> tuple[int, float] | None:
    """A label and three sliders, x y z; the axis that was moved and its value."""
    widgets.label(title, any(values), LABEL)
    width = max((widgets.room() - 8) / 3, 40)
    moved = None
    for axis, letter in enumerate("xyz"):
        low, high = bounds[axis]
        if axis:
            imgui.same_line(0, 4)
        imgui.begin_disabled(bool(low == high))
        new = widgets.slider(f"{name}.{letter}", values[axis], (low, high), form, width)
        imgui.end_disabled()
        widgets.tooltip(f"{name} {letter}: {form % low} to {form % high}")
        widgets.axis_mark(axis)
        if new is not None:
            moved = axis, new
    return moved


def body_panel() -> JointsPanel:
    """The Body tab: root and limbs."""
    return JointsPanel("body", {"root": ("pelvis", "translation"), **BODY_GROUPS})


def hand_panel(side: str) -> JointsPanel:
    """The tab of one hand, finger by finger from the thumb."""
    order = ("thumb", "index", "middle", "ring", "pinky")
    assert set(order) == set(FINGERS)
    return JointsPanel(side, {finger: tuple(f"{side}_{finger}{k}" for k in (1, 2, 3)) for finger in order})


_KNUCKLES = {"1": "Knuckle", "2": "Middle", "3": "Tip"}
_THUMB = {"1": "Base", "2": "Middle", "3": "Tip"}


def _joint_title(name: str, group: str) -> str:
    if name == "pelvis":
        return "Turn"
    if group in FINGERS:
        return (_THUMB if group == "thumb" else _KNUCKLES)[name[-1]]
    side, _, joint = name.partition("_")
    return (joint if side in group and joint else name).replace("_", " ").capitalize()
