"""Grab and move in the window: a mouse that picks, turns rings and pulls hands, as a user's does."""

from __future__ import annotations

import math

import numpy as np
import pytest
from avatarrex_studio.engine.live import LiveSurface
from avatarrex_studio.panels.gizmo import rings
from avatarrex_studio.panels.keys import chord
from avatarrex_studio.panels.projection import Projection
from avatarrex_studio.session import posing
from avatarrex_studio.session.commands import SetCamera
from avatarrex_studio.session.grip import places
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import vector
from avatarrex_studio.window.window import start
from ball import ball_engine
from imgui_bundle import imgui
from test_window import drive, surfaced

from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.limits import violations

pytestmark = pytest.mark.window


class Hand:
    """A user's hand on the mouse, in a window that shows the surface."""

    def __init__(self, test, window):
        self.test, self.studio, self.viewport = test, window.studio, window.viewport
        while self.studio.surface is None:
            test.yield_()
        test.yield_(3)
        self.picture = test.item_info("//Viewport/picture").rect_full

    @property
    def projection(self):
        return Projection.of(self.studio.state.view, self.picture.min, self.picture.max)

    def place(self, name):
        """Where a handle is on the screen."""
        figure = self.studio.figure
        return self.projection.screen(places(figure.skeleton, figure.posed, self.studio.state.tools.selected)[name])

    def middle(self, joint, child):
        """The middle of a bone on the screen."""
        position = self.studio.figure.posed.position
        return self.projection.screen(position[[JOINT_NAMES.index(joint), JOINT_NAMES.index(child)]].mean(0))

    def click(self, place):
        self.test.mouse_move_to_pos(imgui.ImVec2(*map(float, place)))
        self.test.yield_(2)
        self.test.mouse_click(0)
        self.test.yield_(4)

    def drag(self, start, *way):
        """Press at a place, move through others, let go."""
        self.test.mouse_move_to_pos(imgui.ImVec2(*map(float, start)))
        self.test.yield_(2)
        self.test.mouse_down()
        self.test.yield_()
        for place in way:
            self.test.mouse_teleport_to_pos(imgui.ImVec2(*map(float, place)))
            self.test.yield_()
        self.test.mouse_up()
        self.test.yield_(2)


def scene(*scenarios):
    """Run each `scenario(hand)` after the other in one window, each from a fresh state."""

    def all_of_them(test, window):
        for scenario in scenarios:
            window.studio.journal = Journal(start())
            test.yield_(3)
            scenario(Hand(test, window))

    drive(ball_engine, all_of_them, live=LiveSurface(), load=surfaced)


def test_what_is_dragged_follows_the_mouse_and_comes_back(display):
    """A hand; then the pelvis between two pinned feet."""
    seen = {}

    def pull_a_hand(hand):
        studio, begin = hand.studio, hand.place("left_hand")
        rest = studio.state.signals
        hand.test.mouse_move_to_pos(imgui.ImVec2(*map(float, begin)))
        hand.test.yield_(3)
        seen["under the mouse"] = hand.viewport.handle, hand.viewport.hovered
        way = [begin + np.array([3.0, -9.0]) * k for k in range(1, 11)]
        hand.drag(begin, *way)
        seen["off"] = np.hypot(*(hand.place("left_hand") - way[-1])) * metres_per_point(hand)
        seen["steps"], seen["beyond"] = len(studio.journal.steps), violations(studio.state.signals)
        seen["commands"] = [type(command).__name__ for command in studio.journal.steps[-1].commands]
        seen["moved"] = {n for n in JOINT_NAMES if posing.joint(rest, n) != posing.joint(studio.state.signals, n)}
        hand.test.key_press(chord("Ctrl+Z"))
        hand.test.yield_(3)
        dragged, seen["undone"] = studio.journal.undone[-1], studio.state.signals == rest
        hand.test.key_press(chord("Ctrl+Shift+Z"))
        hand.test.yield_(3)
        again = [type(command).__name__ for command in studio.journal.steps[-1].commands]
        seen["redone"] = (
            again == [type(command).__name__ for command in dragged.commands],
            np.hypot(*(hand.place("left_hand") - way[-1])),
        )

    def sit_down(hand):
        studio, test = hand.studio, hand.test
        feet = [hand.place(f"{side}_foot") for side in ("left", "right")]
        hand.click(feet[0])
        test.key_press(chord("P"))
        hand.click(feet[1])
        test.key_press(chord("P"))
        test.yield_(2)
        seen["pins"] = studio.state.tools.pins
        begin = hand.place("pelvis")
        way = [begin + np.array([0.0, 3.4]) * k for k in range(1, 11)]  # no more than ankles bend
        hand.drag(begin, *way)
        seen["pelvis"] = np.hypot(*(hand.place("pelvis") - way[-1]))
        seen["feet"] = max(np.hypot(*(hand.place(f"{s}_foot") - at)) for s, at in zip(("left", "right"), feet))
        seen["knee"] = math.degrees(posing.joint(studio.state.signals, "left_knee")[0])

    scene(pull_a_hand, sit_down)
    assert seen["off"] < 0.01
    assert (seen["steps"], seen["commands"], seen["beyond"]) == (1, ["PullHandle"], ())
    assert seen["moved"] == {"left_collar", "left_shoulder", "left_elbow"}
    assert seen["undone"]
    assert seen["redone"][0]
    assert seen["redone"][1] < 3
    assert seen["under the mouse"] == ("left_hand", None), "the handle is named, not what lies behind it"
    assert seen["pins"] == {"left_foot", "right_foot"}
    assert seen["pelvis"] < 3
    assert seen["feet"] < 1
    assert seen["knee"] > 40


def metres_per_point(hand):
    """At the person's distance."""
    projection = hand.projection
    return projection.scale * hand.studio.state.view.distance / projection.camera.intrinsics[0, 0]


def test_what_is_clicked_is_selected_and_its_rings_and_sliders_are_one(display):
    """A click selects the forearm, a ring turns it, the slider shows that; a slider that is set moves the rings.

    Then a finger and the mouth.
    """
    seen = {}

    def turn(hand):
        studio, test = hand.studio, hand.test
        test.window_focus("//Face")
        hand.click(hand.middle("left_elbow", "left_wrist"))
        seen["selected"] = studio.state.tools.selected
        seen["shown"] = test.item_info("//Body/##left_elbow.y").rect_clipped.get_height()
        ringed = rings(hand.projection, studio.figure, "left_elbow")
        begin = ringed.places[1, longest(ringed, 1)]
        axis, tangent = ringed.at(tuple(begin))
        before = posing.joint(studio.state.signals, "left_elbow")
        ahead = tangent / np.hypot(*tangent)
        hand.drag(begin, *(begin - 6.0 * k * ahead for k in range(1, 8)))
        seen["axis"], seen["steps"] = axis, len(studio.journal.steps)
        after = posing.joint(studio.state.signals, "left_elbow")
        seen["bent"] = math.degrees(before[1] - after[1])
        test.item_input_value("//Body/##left_elbow.y", -80.0)
        test.yield_(2)
        seen["typed"] = math.degrees(posing.joint(studio.state.signals, "left_elbow")[1])
        turned = rings(hand.projection, studio.figure, "left_elbow")
        seen["followed"] = np.abs(turned.places - ringed.places).max()
        test.key_press(chord("Ctrl+Z"))
        test.key_press(chord("Ctrl+Z"))
        test.yield_(2)
        seen["undone"] = posing.joint(studio.state.signals, "left_elbow") == before
        seen["still selected"] = studio.state.tools.selected

    def pick(hand):
        studio, test = hand.studio, hand.test
        place = studio.figure.posed.position[JOINT_NAMES.index("left_index2")]
        studio.do(SetCamera(distance=0.6, target=vector(place), azimuth=90.0))
        test.yield_(4)
        hand.click(hand.middle("left_index2", "left_index3"))
        seen["finger"] = studio.state.tools.selected
        seen["tip"] = test.item_info("//Left hand/##left_index2.z").rect_clipped.get_height()
        studio.do(SetCamera(azimuth=0.0))
        test.key_press(chord("F"))
        test.yield_(4)
        mouth = studio.figure.vertices[studio.figure.region("mouth")].astype(float).mean(0)
        hand.click(hand.projection.screen(mouth))
        seen["mouth"] = studio.state.tools.selected
        test.key_press(chord("J"))
        test.yield_(3)
        seen["joints"] = studio.state.tools.overlays
        hand.click(np.array([hand.picture.min.x + 20, hand.picture.min.y + 20]))
        seen["nothing"], seen["done"] = (
            studio.state.tools.selected,
            [type(s.commands[0]).__name__ for s in studio.journal.steps],
        )

    scene(turn, pick)
    assert seen["selected"] == seen["still selected"] == "left_elbow"
    assert seen["shown"] > 10, "its slider is scrolled to"
    assert (seen["axis"], seen["steps"]) == (1, 1)
    assert 20 < seen["bent"] < 90
    assert seen["typed"] == pytest.approx(-80, abs=0.1)
    assert seen["followed"] > 5
    assert seen["undone"]
    assert seen["finger"] == "left_index2"
    assert seen["tip"] > 10
    assert seen["mouth"] == "mouth"
    assert seen["joints"] == {"joints"}
    assert seen["nothing"] is None
    assert set(seen["done"]) == {"SetCamera"}, "what is selected is no step of undo"


def longest(ringed, axis):
    """A point of a ring's front half that is far from the other rings."""
    others = np.concatenate([ringed.places[k] for k in range(3) if k != axis])
    gaps = np.hypot(*(ringed.places[axis][:, None] - others).T).min(0)
    return int(np.where(ringed.front[axis], gaps, -1).argmax())
