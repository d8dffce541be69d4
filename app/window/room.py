"""The picture's room in a small window: the panels beside it give way, and have their sizes back where there is room again.

Docked panels keep their points while the window is made smaller, and the picture alone would pay: 32 points were left of it at 640 × 400.
They are narrower while a frame is laid out and drawn, not between two frames: what is kept of a layout, or when the program ends, is never
what a small window left of it.
"""

from __future__ import annotations

from avatarrex_studio.window.docking import BARE, PLACES, fit
from avatarrex_studio.window.extent import ROOMY
from imgui_bundle import hello_imgui, imgui

LEAST = (340.0, 240.0)
"""Points of width and height that the picture has at least; in a small window `SHARE` of it."""
SHARE = (0.41, 0.5)
CLOSE = 0.5
"""Points: two sizes that differ by less are one."""
Node = imgui.internal.DockNode


class Room:
    """One window's."""

    def __init__(self) -> None:
        self._lent: dict[tuple[int, int], tuple[float, float]] = {}
        """What a side has where there is room, and what it has in this frame, in which there is less; by axis and the node's id."""
        self._making = False
        """Whether the layout was to be made anew when the frame began."""

    def share(self) -> None:
        """At the beginning of the interface's frame, before anything is laid out."""
        self._making = hello_imgui.get_runner_params().docking_params.layout_reset
        if self._making:
            fit(imgui.get_main_viewport().size.x)
        self._lent = {}
        for axis in (0, 1):
            self._share(beside(BARE, axis), axis)

    def give_back(self) -> None:
        """When all is laid out. Where the user drags a side, all along its axis keep what they have; a new layout is as in a roomy window."""
        made = self._making and not hello_imgui.get_runner_params().docking_params.layout_reset
        for axis in (0, 1):
            if made:
                _enlarge(beside(BARE, axis), axis)
            else:
                self._give_back(axis)

    def _share(self, sides: list[Node], axis: int) -> None:
        whole = _whole(sides[0], axis) if sides else 0.0
        room, wanted = whole - min(LEAST[axis], SHARE[axis] * whole), sum(side.size_ref[axis] for side in sides)
        if room >= wanted:
            return
        for side in sides:
            own = side.size_ref[axis]
            given = room / wanted * own
            self._lent[axis, side.id_] = own, given
            _resize(side, axis, given)

    def _give_back(self, axis: int) -> None:
        nodes = ((_node(id), *sizes) for (of, id), sizes in self._lent.items() if of == axis)
        lent = [(side, own, given) for side, own, given in nodes if side]  # panels that are hidden have docks, too
        if all(abs(side.size_ref[axis] - given) < CLOSE for side, _, given in lent):
            for side, own, _ in lent:
                _resize(side, axis, own)


def beside(title: str, axis: int) -> list[Node]:
    """The largest docks beside a docked panel, left and right of it or above and below: each is split from one that the panel is in, too."""
    window = imgui.internal.find_window_by_name(title)
    around = {node.id_ for node in _line(window)}
    sides = {}
    for name in PLACES:
        for node in _line(imgui.internal.find_window_by_name(name)):
            parent = node.parent_node
            if node.id_ not in around and parent and parent.id_ in around and parent.split_axis == axis:
                sides[node.id_] = node
    return list(sides.values())


def _node(id: int) -> Node | None:
    """The dock of a number; None where it is gone."""
    found: Node | None = imgui.internal.dock_builder_get_node(id)
    return found


def _line(window: imgui.internal.Window | None) -> list[Node]:
    """The dock of a window and all that it is split from."""
    line, node = [], window.dock_node if window else None
    while node:
        line.append(node)
        node = node.parent_node
    return line


def _enlarge(sides: list[Node], axis: int) -> None:
    """To what they have in a window of `ROOMY`, where this one is smaller."""
    for side in sides:
        _resize(side, axis, side.size_ref[axis] * max(1.0, ROOMY[axis] / _whole(side, axis)))


def _whole(side: Node, axis: int) -> float:
    """Points of the space that all is docked in."""
    return float(imgui.internal.dock_node_get_root_node(side).size[axis])


def _resize(side: Node, axis: int, size: float) -> None:
    both = list(side.size_ref)
    both[axis] = size
    side.size_ref = imgui.ImVec2(*both)
