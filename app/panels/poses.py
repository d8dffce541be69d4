"""The Poses tab: the library's bodies, hands and expressions and the user's own, as cards; save, rename, delete, blend, mirror, random."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping
from functools import cache, lru_cache

from avatarrex_studio.engine.thumbnails import Sitter
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.cards import Card, Cards
from avatarrex_studio.panels.own_entries import OwnEntries
from avatarrex_studio.session.actions import words
from avatarrex_studio.session.commands import Blend, Command, Mirror, Randomise, Reset
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.session.user_library import Entry, parts_of
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.signals.driving import Signals
from avatarrex.signals.ground import on_floor
from avatarrex.signals.library import (
    EXPRESSIONS,
    HANDS,
    POSES,
    hands_of_pose,
    named_expression,
    named_hand,
    named_pose,
)
from avatarrex.templates.parts import PARTS

KINDS = {"pose": "Body", "hand": "Hands", "expression": "Expression"}
SIDES = {"both": ("left", "right"), "left": ("left",), "right": ("right",)}
RANDOM_GROUPS = {**{name: words(name).capitalize() for name in ("body", *PARTS)}, "all": "Everything"}
"""What can be random."""
SPECIAL = {"tpose": "T-pose", "apose": "A-pose", "ok": "OK"}
LABEL = 84.0


class PosesPanel:
    """The library as cards."""

    def __init__(self, cards: Cards | None = None, own: OwnEntries | None = None) -> None:
        self.cards, self.own = cards or Cards(), own or OwnEntries()
        self.kind, self.side, self.flipped, self.strength = "pose", "both", False, 0.5
        self.chosen: str | None = None
        """Id of the entry that the blend slider goes to."""
        self._blended, self._start = 0.0, Signals.rest()
        """How far the blend is, from what to the chosen entry."""
        self._made: Signals | None = None
        """The signals that this tab has set last; None: it has set some in this frame."""

    def draw(self, state: StudioState) -> Iterator[Command]:
        """Draw the tab; the commands of this frame."""
        width = (widgets.room() - imgui.get_style().item_spacing.x) / 2
        if imgui.button(f"{icons.ICON_FA_LEFT_RIGHT}  Mirror##poses", (width, 0)):
            yield Mirror()
        imgui.same_line()
        self._follow(state.signals)
        if imgui.button(f"{icons.ICON_FA_ROTATE_LEFT}  Reset all##poses", (width, 0)):
            yield Reset()
        self._choices()
        shipped, own = shipped_entries(self.kind), self.own.entries(self.kind)
        yield from self._blend({**shipped, **own})
        yield from self._cards(own, f"{self.kind}.own.", "Mine", state.signals)
        self.own.draw(state.signals, self.kind, self.side)
        yield from self._cards(shipped, f"{self.kind}.", "Library", state.signals)
        if widgets.group("Random", "poses.random", opened=False)[0]:
            yield from self._random()

    def _choices(self) -> None:
        """Which kind is shown, and how an entry is applied."""
        for kind, title in widgets.in_rows(KINDS.items()):
            if imgui.radio_button(f"{title}##kind", self.kind == kind) and self.kind != kind:
                self.kind, self.chosen = kind, None
        if self.kind == "hand":
            for side in widgets.in_rows(SIDES):
                if imgui.radio_button(f"{side.capitalize()}##hands", self.side == side):
                    self.side = side
        else:
            self.flipped = imgui.checkbox("Flipped##poses", self.flipped)[1]
            widgets.tooltip("Apply entries as in a mirror")

    def _follow(self, signals: Signals) -> None:
        """The blend begins again at `signals` that something else has set."""
        if self._made is None:
            self._made = signals
        if signals is not self._made:
            self._blended, self._start, self._made = 0.0, signals, signals

    def _blend(self, entries: Mapping[str, Entry]) -> Iterator[Command]:
        """A slider from what was before the chosen entry was clicked, or else is now, to the entry."""
        widgets.label("Blend", LABEL)
        entry = entries.get(self.chosen or "")
        imgui.begin_disabled(entry is None)
        new = widgets.slider("blend", 100 * self._blended, (0, 100), "%.0f %%")
        imgui.end_disabled()
        widgets.tooltip("Drag: between what was and the entry that was clicked last")
        if new is not None and entry is not None:
            yield self._applied(entry, new / 100)

    def _cards(self, entries: Mapping[str, Entry], key: str, title: str, signals: Signals) -> Iterator[Command]:
        if not entries or not widgets.group(title, f"poses.{key}")[0]:
            return
        titles = {} if key.endswith("own.") else {name: entry_title(name) for name in entries}
        cards = [
            Card(name, titles.get(name, entry.name), sitter(entry.kind, entry.signals))
            for name, entry in entries.items()
        ]
        clicked, menu = self.cards.draw(cards, key, self.chosen)
        if clicked:
            self.chosen, self._start = clicked, signals
            yield self._applied(entries[clicked], 1.0)
        if menu and key.endswith("own."):
            self.own.open_menu(entries[menu])

    def _applied(self, entry: Entry, amount: float) -> Command:
        """From the start of the blend towards an entry; a body stands on the floor."""
        self._blended, self._made = amount, None
        parts = parts_of(entry, self.flipped and entry.kind != "hand", SIDES[self.side])
        target = self._start.replace(**parts)
        if entry.kind == "pose":
            return Blend(entry.name, on_floor(target), (*parts, "translation"), amount, self._start)
        return Blend(entry.name, target, tuple(parts), amount, self._start)

    def _random(self) -> Iterator[Command]:
        widgets.label("Strength", LABEL)
        new = widgets.slider("strength", 100 * self.strength, (5, 100), "%.0f %%", rest=50)
        self.strength = self.strength if new is None else new / 100
        if group := widgets.button_grid(RANDOM_GROUPS, 92, "random."):
            yield Randomise(group, self.strength, secrets.randbits(31))
        widgets.paragraph("Within that share of the joint limits.", theme.MUTED)


def entry_title(name: str) -> str:
    """A name in words."""
    return SPECIAL.get(name, name.replace("_", " ").capitalize() if name.islower() else name)


@cache
def shipped_entries(kind: str) -> Mapping[str, Entry]:
    """The entries that come with the program, by name."""
    rest = Signals.rest()
    if kind == "pose":
        made = {name: rest.replace(body_pose=named_pose(name), **hands_of_pose(name)) for name in POSES}
    elif kind == "hand":
        made = {name: rest.replace(left_hand_pose=named_hand(name, "left")) for name in HANDS}
    else:
        made = {name: rest.replace(expression=named_expression(name)) for name in EXPRESSIONS}
    return {name: Entry(kind, name, signals) for name, signals in made.items()}


@lru_cache(maxsize=4000)
def sitter(kind: str, signals: Signals) -> Sitter:
    """Who sits for the picture of an entry: a standing person with that pose or face, a hand as a left one."""
    if kind == "expression":
        return Sitter(kind, signals.replace(body_pose=named_pose("stand")))
    return Sitter(kind, signals)
