"""The picture's room in a small window: the panels beside it give way, and have their sizes back where there is room again.

Docked panels keep their points while the window is made smaller, and the picture alone would pay: 32 points were left of it at 640 × 400.
"""

from __future__ import annotations

from avatarrex_studio.window.docking import BARE, PLACES
from imgui_bundle import imgui

LEAST = (340.0, 240.0)
"""Points of width and height that the picture has at least; in a small window `SHARE` of it."""
SHARE = (0.41, 0.5)
CLOSE = 0.5
"""Points: two sizes that differ by less are one."""
Node = imgui.internal.DockNode


class Room:
    """One window's."""

    def __init__(self) -> None:
        self._wanted: dict[int, float] = {}
        """What each side had when the user, or a new layout, last gave one of them a size; by the node's id."""
        self._given: dict[int, float] = {}
        """What it was given here."""

    def share(self) -> None:
        """At the beginning of the interface's frame, before anything is laid out."""
        sides = beside(BARE)
        for axis in (0, 1):
            along = [side for side in sides if side.parent_node.split_axis == axis]
            if along:
                self._share(along, axis)

    def _share(self, sides: list[Node], axis: int) -> None:
        sizes = {side.id_: side.size_ref[axis] for side in sides}
        if any(abs(size - self._given.get(id_, 0.0)) > CLOSE for id_, size in sizes.items()):
            self._wanted.update(sizes)
        whole = imgui.internal.dock_node_get_root_node(sides[0]).size[axis]
        wanted = sum(self._wanted[side.id_] for side in sides)
        part = min(1.0, (whole - min(LEAST[axis], SHARE[axis] * whole)) / wanted) if wanted else 1.0
        for side in sides:
            given = self._given[side.id_] = part * self._wanted[side.id_]
            both = list(side.size_ref)
            both[axis] = given
            side.size_ref = imgui.ImVec2(*both)


def beside(title: str) -> list[Node]:
    """The largest docks beside a docked panel: each is split from one that the panel is in, too."""
    window = imgui.internal.find_window_by_name(title)
    around = {node.id_ for node in _line(window)}
    sides = {}
    for name in PLACES:
        for node in _line(imgui.internal.find_window_by_name(name)):
            if node.id_ not in around and node.parent_node and node.parent_node.id_ in around:
                sides[node.id_] = node
    return list(sides.values())


def _line(window: imgui.internal.Window | None) -> list[Node]:
    """The dock of a window and all that it is split from."""
    line, node = [], window.dock_node if window else None
    while node:
        line.append(node)
        node = node.parent_node
    return line
