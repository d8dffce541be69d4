"""Drags as commands, rings as turns, and the screen as the world, with no window."""

from __future__ import annotations

import json

import numpy as np
import pytest
from avatarrex_studio.panels.gizmo import RADIUS, Turn, nearest_rotvec, rings
from avatarrex_studio.panels.projection import Projection
from avatarrex_studio.panels.viewport import grasped
from avatarrex_studio.session import commands, grip, posing
from avatarrex_studio.session.grip import LOOK, Grip, handle_of, places
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import OrbitView, StudioState
from avatarrex_studio.window.window import start
from imgui_bundle import imgui
from scipy.spatial.transform import Rotation

from avatarrex.signals.handles import HANDLES
from avatarrex.signals.joints import JOINT_NAMES, axis_names
from avatarrex.signals.limits import LIMITS
from avatarrex.templates.figure import Figure
from avatarrex.templates.person import load_person

BODY = load_person("default").body
PROJECTION = Projection.of(OrbitView(azimuth=30.0, elevation=10.0), imgui.ImVec2(100, 50), imgui.ImVec2(700, 650))


def figure(state):
    return Figure(BODY, state.signals)


def test_a_drag_is_one_step_that_replays_without_a_solver(monkeypatch):
    journal = Journal(start())
    hand = Grip("left_hand", figure(journal.state).skeleton, journal.state.signals)
    begin = places(hand.skeleton, figure(journal.state).posed, None)["left_hand"]
    for step in range(1, 9):
        journal.do(hand.to(journal.state, begin + np.array([0.01, 0.04, 0.02]) * step), gesture="drag 1")
    (step,) = journal.steps
    (command,) = step.commands
    assert (type(command), command.handle) == (commands.PullHandle, "left_hand")
    reached = places(hand.skeleton, figure(journal.state).posed, None)["left_hand"]
    assert reached == pytest.approx(command.target, abs=0.002)
    saved = json.loads(json.dumps(journal.to_json()))
    monkeypatch.setattr(grip, "pulled", None)
    assert Journal.from_json(saved).state == journal.state
    assert journal.undo() == start()


def test_the_gaze_is_dragged_where_something_that_looks_is_selected():
    state = start()
    skeleton = figure(state).skeleton
    assert LOOK not in places(skeleton, figure(state).posed, "left_elbow")
    ahead = places(skeleton, figure(state).posed, "head")[LOOK]
    command = Grip(LOOK, skeleton, state.signals).to(state, ahead + np.array([0.1, 0.05, 0.0]))
    assert isinstance(command, commands.LookAt)
    after = command.apply(state)
    assert places(skeleton, figure(after).posed, "head")[LOOK][0] > ahead[0] + 0.05


@pytest.mark.parametrize(
    ("part", "handle"),
    [("left_index2", "left_hand"), ("right_wrist", "right_hand"), ("left_foot", "left_foot"), ("left_ankle", "left_foot"),
     ("mouth", "head"), ("jaw", "head"), ("pelvis", "pelvis"), ("right_knee", "right_knee"), ("spine2", None), (None, None)],
)  # fmt: skip
def test_a_part_has_its_handle(part, handle):
    assert handle_of(part) == handle


def test_the_screen_and_the_world_agree():
    points = np.random.default_rng(0).normal(0, 0.5, (20, 3))
    for point, (x, y) in zip(points, PROJECTION.screen(points)):
        assert PROJECTION.world((x, y), PROJECTION.depth(point)) == pytest.approx(point, abs=1e-9)
    behind = np.asarray(PROJECTION.camera.centre) * 1.5
    assert np.isnan(PROJECTION.screen(behind)).all()


def test_rings_are_round_the_joint_and_only_their_front_is_taken():
    state = start()
    found = rings(PROJECTION, figure(state), "left_elbow")
    centre = PROJECTION.screen(figure(state).posed.position[JOINT_NAMES.index("left_elbow")])
    assert np.hypot(*(found.places - centre).reshape(-1, 2).T).max() == pytest.approx(RADIUS, rel=0.08)
    for axis in range(3):
        k = int(np.flatnonzero(found.front[axis])[5])
        assert found.at(tuple(found.places[axis, k] + 0.5)) is not None
    assert found.at(tuple(centre)) is None or np.hypot(*(found.places - centre).reshape(-1, 2).T).min() < 6
    assert rings(PROJECTION, figure(state), "mouth") is None
    assert rings(PROJECTION, figure(state), None) is None


def test_a_turn_is_about_the_joints_own_axis_and_comes_back_from_its_limit():
    """A radian a radius; past the limit the joint stays, and it follows again where the mouse is back there."""
    state = StudioState()
    turn = Turn("left_knee", 0, posing.joint(state.signals, "left_knee"), np.array([RADIUS, 0.0]), (200.0, 200.0))
    half = turn.to((200.0 + RADIUS / 2, 230.0)).apply(state)
    assert posing.joint(half.signals, "left_knee") == pytest.approx((0.5, 0, 0))
    far = turn.to((200.0 + 4 * RADIUS, 200.0)).apply(half)
    assert posing.joint(far.signals, "left_knee")[0] == LIMITS[JOINT_NAMES.index("left_knee"), 0, 1]
    back = turn.to((200.0 + RADIUS / 2, 200.0)).apply(far)
    assert posing.joint(back.signals, "left_knee") == pytest.approx((0.5, 0, 0))


def test_of_equal_turns_the_nearest_rotation_vector_is_taken():
    """Past half a turn the slider goes on instead of jumping to the other side."""
    near = nearest_rotvec(Rotation.from_rotvec([0, 3.3, 0]), (0.0, 3.1, 0.0))
    assert near == pytest.approx((0, 3.3, 0))
    assert nearest_rotvec(Rotation.from_rotvec([0, 3.3, 0]), (0.0, -2.9, 0.0)) == pytest.approx((0, 3.3 - 2 * np.pi, 0))


def test_the_axes_of_a_joint_have_names():
    assert axis_names("left_elbow") == ("twist", "bend", "side")
    assert axis_names("right_knee") == ("bend", "twist", "side")
    assert axis_names("left_index2") == ("twist", "side", "bend")
    assert all(set(axis_names(name)) == {"bend", "twist", "side"} for name in JOINT_NAMES)


@pytest.mark.parametrize(
    ("part", "far", "taken"),
    [
        ("left_index3", 40.0, "left_hand"), ("left_wrist", 40.0, "left_hand"), ("right_ankle", 40.0, "right_foot"), ("mouth", 40.0, "head"),
        ("left_index3", 95.0, None), ("left_elbow", 5.0, None), ("pelvis", 5.0, None), (None, 5.0, None),
    ],
)  # fmt: skip
def test_hands_feet_and_head_are_taken_by_their_skin_where_their_handle_shows(part, far, taken):
    near = dict.fromkeys(HANDLES, 300.0) | {handle_of(part) or "none": far}
    assert grasped(part, near) == taken


def test_pins_stay_while_a_slider_is_dragged(studio):
    """The trunk bends under a pinned hand, a knee under pinned feet: one step of undo, which replays without a solver."""
    wrist, ball = (JOINT_NAMES.index(name) for name in ("left_wrist", "right_foot"))
    for pin, joint, turn, point in (
        ("left_hand", "spine2", (0.3, 0.1, 0.0), wrist), ("right_foot", "left_knee", (0.9, 0.0, 0.0), ball),
    ):  # fmt: skip
        studio.journal = Journal(start())
        studio.do(commands.Pin(("left_foot", "right_foot", pin), True))
        before = studio.figure.posed.position[point]
        for k in range(1, 7):
            rotation = tuple(k / 6 * value for value in turn)
            studio.do(commands.SetJoint(joint, rotation), "drag 1")
        assert posing.joint(studio.state.signals, joint) == pytest.approx(turn), "what was turned stays turned"
        assert np.linalg.norm(studio.figure.posed.position[point] - before) < 0.002
        assert len(studio.journal.steps) == 1
        again = Journal.from_json(json.loads(json.dumps(studio.journal.to_json())))
        assert again.state.signals == studio.state.signals
    studio.undo()
    studio.do(commands.Pin(("left_foot", "right_foot"), True))
    studio.do(commands.SetTranslation((0.0, -0.15, 0.0)))
    assert np.linalg.norm(studio.figure.posed.position[ball] - before) < 0.002


@pytest.mark.parametrize("recording", [False, True])
def test_pins_do_not_creep_through_a_long_drag(studio, recording):
    """The place goes down and comes back in 60 steps: pinned feet are where they were when the drag began, recorded or not."""
    ankle, feet = JOINT_NAMES.index("left_ankle"), ("left_foot", "right_foot")
    studio.journal = Journal(start())
    studio.take.recording = recording
    for gesture, x, steps in (("drag 1", 0.0, 60), ("drag 2", 0.2, 8)):
        studio.do(commands.Pin(feet, False))
        studio.do(commands.SetTranslation((x, 0.0, 0.0)))
        studio.do(commands.Pin(feet, True))
        before = studio.figure.posed.position[ankle]
        for k in range(1, steps + 1):
            studio.do(commands.SetTranslation((x, -0.3 * np.sin(np.pi * k / steps), 0.0)), gesture)
        assert np.linalg.norm(studio.figure.posed.position[ankle] - before) < 0.002


def test_a_slider_without_pins_turns_one_joint(studio):
    studio.do(commands.SetJoint("spine2", (0.3, 0.1, 0.0)))
    (step,) = studio.journal.steps
    assert "signals" not in step.commands[0].to_json()


def test_another_shape_stands_where_the_person_stood(studio):
    """In one drag, undone at once, and as a journal replays it."""
    body = studio.figure.body

    def lowest():
        return Figure(body, studio.state.signals).vertices[:, 1].min()

    studio.do(commands.SetTranslation((0.1, 0.2, 0.0)))
    low, steps = lowest(), len(studio.journal.steps)
    for value in (-0.5, -1.5, -2.0):
        studio.do(commands.SetShape(0, value), "drag")
        assert lowest() == pytest.approx(low, abs=1e-5)
    assert studio.state.signals.shape[0] == -2
    assert studio.state.signals.translation[1] < 0.15, "shorter legs"
    assert len(studio.journal.steps) == steps + 1
    again = studio.journal.steps[-1].commands
    assert len(again) == 1
    assert type(again[0]).from_json(again[0].to_json()) == again[0]
    studio.undo()
    assert (lowest(), studio.state.signals.translation[1]) == (pytest.approx(low), pytest.approx(0.2))
