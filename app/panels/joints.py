"""Body and hand tabs: every joint's rotation vector as three sliders in degrees (or radians), by limb."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from avatarrex_studio.panels import units, widgets
from avatarrex_studio.session import posing
from avatarrex_studio.session.actions import words
from avatarrex_studio.session.commands import Command, ResetGroup, SetJoint, SetLimits, SetTranslation
from avatarrex_studio.session.state import StudioState, Vector, vector
from imgui_bundle import imgui

from avatarrex.signals.joints import BODY_GROUPS, FINGERS, JOINT_NAMES, axis_names
from avatarrex.signals.limits import LIMITS

LABEL = 84.0
TURN = 180.0
HINT = "Search joints"
SPARE = 92.0
"""Points of the box beside the search."""
SPINE = {"spine1": "Lower spine", "spine2": "Mid spine", "spine3": "Upper spine"}
Row = Callable[[StudioState, str, str], Iterable[Command]]
"""Draws the sliders of a name in its group."""


class SignalPanel:
    """Sliders in `groups` (names by title) under a search box, drawn by `row`, and with `limits` the box that lifts them."""

    def __init__(
        self, key: str, groups: Mapping[str, tuple[str, ...]], hint: str, row: Row, limits: bool = True
    ) -> None:
        self.key, self.groups, self.hint, self.row, self.limits = key, groups, hint, row, limits
        self.search = ""
        self._revealed: str | None = None

    def reveal(self, name: str) -> bool:
        """Open the group of a name, or the group of that name, and scroll to it in the next frame; whether it is here."""
        here = name in self.groups or any(name in names for names in self.groups.values())
        if here:
            self._revealed, self.search = name, ""
        return here

    def draw(self, state: StudioState) -> Iterator[Command]:
        """Draw the tab; the commands of this frame."""
        self.search = widgets.search(self.key, self.hint, self.search, SPARE if self.limits else 0)
        if self.limits:
            imgui.same_line()
            toggled, limited = imgui.checkbox(f"Limits##{self.key}", state.limit_joints)
            widgets.tooltip("Keep joints within what a body can do")
            if toggled:
                yield SetLimits(limited)
        wanted = self.search.lower().split()
        if not wanted:
            yield from self.above(state, None)
        for group, names in self.groups.items():
            texts = {name: f"{group} {words(name)} {name}".lower() for name in names}
            shown = [name for name, text in texts.items() if all(word in text for word in wanted)]
            if not shown:
                continue
            revealed = self._revealed if self._revealed in (group, *names) else None
            if wanted or revealed:
                imgui.set_next_item_open(True)
            changed = [name for name in names if posing.changed(state.signals, name)]
            is_open, pressed = widgets.group(self.title(group), f"{self.key}.{group}", bool(changed))
            if pressed:
                yield from map(ResetGroup, changed)
            if revealed and revealed not in names:
                imgui.set_scroll_here_y(0.0)
            if is_open and not wanted:
                yield from self.above(state, group)
            for name in shown if is_open else ():
                if name == revealed:
                    imgui.set_scroll_here_y(0.35)
                if name == state.tools.selected:
                    widgets.highlight()
                yield from self.row(state, name, group)
            if revealed:
                self._revealed = None

    def title(self, group: str) -> str:
        """A group in words."""
        return group.capitalize()

    def above(self, state: StudioState, group: str | None) -> Iterable[Command]:
        """What is drawn over the rows of a group, or with None over all groups."""
        return ()


def linked(commands: Iterable[Command], both: bool) -> Iterator[Command]:
    """`commands` whose joints turn on both sides where `both`."""
    for command in commands:
        yield replace(command, linked=True) if both and isinstance(command, SetJoint) else command


def joint_row(state: StudioState, name: str, group: str) -> Iterator[Command]:
    """One joint: label and three sliders, ids `##joint.x` and so on."""
    limited = state.limit_joints and name != "pelvis"
    bounds = np.degrees(LIMITS[JOINT_NAMES.index(name)]) if limited else np.tile([-TURN, TURN], (3, 1))
    rotation = posing.joint(state.signals, name)
    unit = units.angle()
    title, factor = _joint_title(name, group), unit.factor * math.degrees(1)
    turned = _vector_row(title, name, rotation, unit.factor * bounds, unit.form, factor)
    if turned is not None:
        yield SetJoint(name, turned)


def translation_row(state: StudioState) -> Iterator[Command]:
    """The root's place."""
    place = vector(state.signals.translation)
    unit = units.length()
    moved = _vector_row(
        "Place", "translation", place, unit.factor * np.tile([-3.0, 3.0], (3, 1)), unit.form, unit.factor
    )
    if moved is not None:
        yield SetTranslation(moved)


def _vector_row(
    title: str, name: str, values: Vector, bounds: np.ndarray, form: str, unit: float = 1.0
) -> Vector | None:
    """A label and three sliders, x y z, within `bounds` (3, 2), of `unit` times `values`; the values where one was moved."""
    widgets.label(title, LABEL, any(values))
    width = max((widgets.room() - 8) / 3, 40)
    changed = list(values)
    for axis, (low, high) in widgets.in_rows(enumerate(bounds.tolist()), 4):
        letter = "xyz"[axis]
        called = axis_names(name)[axis] if name in JOINT_NAMES else letter
        named = f"{called} {form}"
        room = max(imgui.calc_text_size(named % end).x for end in (low, high)) <= width
        imgui.begin_disabled(low == high)
        new = widgets.slider(f"{name}.{letter}", unit * values[axis], (low, high), named if room else form, width)
        imgui.end_disabled()
        widgets.tooltip(f"{words(name).capitalize()}, {called}: {form % low} to {form % high}")
        widgets.axis_mark(axis)
        if new is not None:
            changed[axis] = new / unit
    return None if tuple(changed) == values else vector(changed)


def _row(state: StudioState, name: str, group: str) -> Iterator[Command]:
    yield from translation_row(state) if name == "translation" else joint_row(state, name, group)


def body_panel() -> SignalPanel:
    """The Body tab: root and limbs."""
    return SignalPanel("body", {"root": posing.GROUPS["root"], **BODY_GROUPS}, HINT, _row)


def _joint_title(name: str, group: str) -> str:
    if name == "pelvis":
        return "Turn"
    if group in FINGERS:
        return {"1": "Base" if group == "thumb" else "Knuckle", "2": "Middle", "3": "Tip"}[name[-1]]
    if name in SPINE:
        return SPINE[name]
    side, _, joint = name.partition("_")
    if name in ("jaw", "left_eye", "right_eye"):
        return group
    return words(joint if side in group and joint else name).capitalize()
