"""Body and hand tabs: every joint's rotation vector as three sliders in degrees (or radians), by limb."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, lru_cache

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
TURN, REACH = 180.0, 3.0
"""Degrees of the root's turn, metres of its place, either way."""
HINT = "Search joints"
SPARE = 92.0
"""Points of the box beside the search."""
SPINE = {"spine1": "Lower spine", "spine2": "Mid spine", "spine3": "Upper spine"}
Bounds = tuple[tuple[float, float], ...]
"""Of three sliders, x y z: least and greatest."""
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
            shown = [name for name in names if _found(group, name, wanted)] if wanted else names
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


def _found(group: str, name: str, wanted: Sequence[str]) -> bool:
    text = f"{group} {words(name)} {name}".lower()
    return all(word in text for word in wanted)


def linked(commands: Iterable[Command], both: bool) -> Iterator[Command]:
    """`commands` whose joints turn on both sides where `both`."""
    for command in commands:
        yield replace(command, linked=True) if both and isinstance(command, SetJoint) else command


def joint_row(state: StudioState, name: str, group: str) -> Iterator[Command]:
    """One joint: label and three sliders, ids `##joint.x` and so on."""
    unit, rotation = units.angle(), posing.joint(state.signals, name)
    bounds = _bounds(name, state.limit_joints and name != "pelvis", unit.factor)
    turned = _vector_row(_joint_title(name, group), name, rotation, bounds, unit.form, unit.factor * math.degrees(1))
    if turned is not None:
        yield SetJoint(name, turned)


def translation_row(state: StudioState) -> Iterator[Command]:
    """The root's place."""
    place = vector(state.signals.translation)
    unit = units.length()
    reach = unit.factor * REACH
    moved = _vector_row("Place", "translation", place, ((-reach, reach),) * 3, unit.form, unit.factor)
    if moved is not None:
        yield SetTranslation(moved)


@cache
def _bounds(name: str, limited: bool, factor: float) -> Bounds:
    """Of a joint's sliders: degrees times `factor`."""
    degrees = np.degrees(LIMITS[JOINT_NAMES.index(name)]) if limited else np.tile([-TURN, TURN], (3, 1))
    return tuple((float(low), float(high)) for low, high in factor * degrees)


@lru_cache(4096)
def _fits(form: str, bounds: tuple[float, float], width: float, font_size: float) -> bool:
    """Whether both ends have room as text, in a font of that size."""
    return max(imgui.calc_text_size(form % end).x for end in bounds) <= width


def _vector_row(title: str, name: str, values: Vector, bounds: Bounds, form: str, unit: float = 1.0) -> Vector | None:
    """A label and three sliders, x y z, within `bounds`, of `unit` times `values`; the values where one was moved."""
    widgets.label(title, LABEL, any(values))
    width = max((widgets.room() - 8) / 3, 40)
    changed = list(values)
    for axis, (low, high) in widgets.in_rows(enumerate(bounds), 4):
        letter = "xyz"[axis]
        called = axis_names(name)[axis] if name in JOINT_NAMES else letter
        named = f"{called} {form}"
        fits = _fits(named, (low, high), width, imgui.get_font_size())
        imgui.begin_disabled(low == high)
        new = widgets.slider(f"{name}.{letter}", unit * values[axis], (low, high), named if fits else form, width)
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


@cache
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
