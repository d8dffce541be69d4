"""Commands are pure, undo comes back exactly, and a journal on disk gives the same state."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from avatarrex_studio.session import commands, posing, timeline_commands
from avatarrex_studio.session.commands import KINDS
from avatarrex_studio.session.figures import Place
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import OrbitView, StudioState
from avatarrex_studio.session.timeline import Clip, Feed, Layer, Share

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.joints import BODY_GROUPS, BODY_JOINTS, EXPRESSION_NAMES
from avatarrex.signals.library import named_pose
from avatarrex.signals.limits import LIMITS

STEPPING = Signals.rest().replace(translation=np.array([0.5, 0.2, 1.0]), body_pose=named_pose("walk"))
EVERY = (
    commands.SetJoint("left_elbow", (0.0, -0.5, 0.0)),
    commands.PullHandle("left_hand", (0.4, 0.2, 0.3), Signals.rest().replace(body_pose=named_pose("salute"))),
    commands.LookAt((0.0, 0.5, 2.0), Signals.rest().replace(body_pose=named_pose("bow"))),
    commands.SetTranslation((0.1, 0.2, 0.3)),
    commands.SetExpression("jawOpen", 0.6),
    commands.SetShape(2, 1.5),
    commands.SetHandPose("left", "fist"),
    commands.ApplyPose("wave"),
    commands.ApplyExpression("smile"),
    commands.Randomise("body", 0.5, 7),
    commands.Mirror(),
    commands.ResetGroup("left arm"),
    commands.SetLimits(False),
    commands.OrbitBy(30.0, 10.0),
    commands.PanBy(0.1, -0.2),
    commands.ZoomBy(0.8),
    commands.SetCamera(fov=25.0, target=(0.0, 0.5, 0.0)),
    commands.SetBackground((1.0, 1.0, 1.0, 1.0)),
    commands.SetSize(fixed=(64, 48)),
    commands.SetHidden("face", True),
    commands.SetLevel("quality"),
    commands.OpenAvatar("other"),
    commands.SetSignals(STEPPING),
    timeline_commands.LoadMotion("walk.bvh", "walk.bvh", 5, 30.0, signals=STEPPING),
    timeline_commands.SetFrame(3, signals=STEPPING.replace(translation=np.array([1.0, 0.0, 2.0]))),
    timeline_commands.AddLayer(Layer("Keys"), signals=STEPPING),
    timeline_commands.AddLayer(
        Layer("Face", Clip("f.csv", "f.csv", 9, 60.0, ImportOptions(fps=60.0)), parts=frozenset({"head"}))
    ),
    timeline_commands.AddLayer(Layer("OSC", feed=Feed("osc"))),
    timeline_commands.SetFrame(1, (("OSC", STEPPING, 0.5),), signals=STEPPING),
    timeline_commands.SetKeys(
        "Keys",
        (
            ("jawOpen", 0.5, (0.2,), "linear"),
            ("jawOpen", 1.0, (0.4,), "step"),
            ("camera.target", 0.0, (0.0, 1.0, 2.0), "smooth"),
        ),
        signals=STEPPING,
        view=OrbitView(fov=31.0),
    ),
    timeline_commands.MoveKeys("Keys", (("jawOpen", 0.5),), 0.2),
    timeline_commands.SetCurve("Keys", (("jawOpen", 0.7),), "smooth"),
    timeline_commands.DeleteKeys("Keys", (("jawOpen", 1.0),)),
    timeline_commands.SetLayer("Face", ("head", "mouth"), 0.5, True, 1.0, 2.0, True, 0.1, ((0.5, 0.25),)),
    timeline_commands.MoveLayer("Face", -1),
    timeline_commands.RenameLayer("Face", "Face 2"),
    timeline_commands.SetTimeline(24.0, (2, 40), False),
    timeline_commands.SetShare("left arm", Share(0.5, True)),
    timeline_commands.RemoveLayer("OSC"),
    timeline_commands.CloseMotion(),
    commands.Reset(),
    commands.SetFingers("left index curl", 0.5),
    commands.SetFaceMacro("smile", 0.5),
    commands.ScaleGroup("face", 0.5),
    commands.Blend("walk", STEPPING, ("body_pose",), 0.5),
    commands.PutOnFloor(),
    commands.AddFigure("default"),
    commands.PlaceFigure(Place(30.0, 1.5, -0.5)),
    commands.AddFigure("another", Place(x=-1.0), STEPPING),
    commands.SelectFigure(0),
    commands.RemoveFigure(1),
    commands.SetStage("top", (0.1, 0.2, 0.3)),
    commands.SetStage("shown", True),
)


def test_an_orthographic_view_has_no_perspective_and_the_scale_of_its_target():
    view = OrbitView(azimuth=35.0, elevation=20.0, target=(0.3, 0.1, -0.2))
    flat = commands.SetCamera(orthographic=True).apply(StudioState(view=view)).view
    assert StudioState.from_json(StudioState(view=flat).to_json()).view == flat
    perspective, parallel = view.camera(800, 1000), flat.camera(800, 1000)
    right, down, ahead = parallel.camera_from_world[:3, :3]
    target = np.array(view.target)
    for across, along in ((0.0, 0.0), (0.4, -0.7), (-0.5, 0.6)):
        point = target + across * right + along * down
        assert parallel.pixels(point)[0] == pytest.approx(perspective.pixels(point)[0], abs=0.01), "at the target"
        moved = parallel.pixels(np.stack([point - 0.5 * ahead, point + 0.5 * ahead]))[0]
        assert np.abs(moved[0] - moved[1]).max() < 0.5, "a metre farther away"
        assert np.abs(perspective.pixels(np.stack([point, point + 0.5 * ahead]))[0][1] - moved[1]).max() > 20 * (
            across != 0
        )
    panned = commands.PanBy(0.1, 0.2).apply(StudioState(view=flat)).view
    assert panned.target == pytest.approx(commands.PanBy(0.1, 0.2).apply(StudioState(view=view)).view.target)


def test_every_command_is_pure_and_tested():
    assert {type(command) for command in EVERY} == set(KINDS.values())
    state = StudioState()
    for command in EVERY:
        before = state.to_json()
        after = command.apply(state)
        assert state.to_json() == before, command
        assert after == command.apply(state), command
        state = after


def test_undo_and_redo_come_back_exactly():
    journal = Journal()
    states = [journal.state]
    for command in EVERY:
        states.append(journal.do(command))
    kept = [state for state, earlier in zip(states[1:], states) if state != earlier]
    for state in reversed([states[0], *kept[:-1]]):
        assert journal.undo() == state
    assert journal.undo() == states[0]
    for state in kept:
        assert journal.redo() == state


def test_a_drag_is_one_step_and_its_moves_are_folded():
    journal = Journal()
    for degrees in range(1, 31):
        journal.do(commands.SetJoint("left_elbow", (0.0, -math.radians(degrees), 0.0)), gesture="drag 1")
    assert len(journal.steps) == 1
    assert len(journal.steps[0].commands) == 1
    journal.do(commands.SetJoint("left_knee", (0.5, 0.0, 0.0)), gesture="drag 2")
    assert len(journal.steps) == 2
    journal.undo()
    assert posing.joint(journal.state.signals, "left_elbow")[1] == -math.radians(30)
    assert journal.undo() == StudioState()


def test_a_saved_session_replays_to_the_same_state(tmp_path):
    journal = Journal()
    for number, command in enumerate(EVERY[:-1]):
        journal.do(command, gesture=number // 3)
    for frame in range(1, 5):
        place = np.array([0.1 * frame, 0.0, 0.3 * frame])
        journal.do(timeline_commands.LoadMotion("walk.bvh", "walk", 5, 30.0, signals=STEPPING))
        journal.do(timeline_commands.SetFrame(frame, signals=STEPPING.replace(translation=place)), gesture="play")
    journal.save(tmp_path / "session.json")
    again = Journal.load(tmp_path / "session.json")
    assert again.state == journal.state
    assert len(again.steps) == len(journal.steps)
    assert [path.name for path in tmp_path.iterdir()] == ["session.json"]


def test_the_state_survives_json():
    state = StudioState()
    for command in EVERY[:-2]:
        state = command.apply(state)
    assert StudioState.from_json(json.loads(json.dumps(state.to_json()))) == state


@pytest.mark.parametrize(
    "data",
    [
        {"format": 99},
        {"format": 1, "view": {"fov": 0}},
        {"format": 1, "view": None},
        {"format": 1, "hat": 2},
        [],
        {"format": 1, "hidden": 3},
        {"format": 1, "level": "best"},
        {"format": 1, "level": ["fast"]},
        {"format": 1, "limit_joints": 1},
    ],
)
def test_a_bad_state_is_refused(data):
    with pytest.raises(InputError):
        StudioState.from_json(data)


@pytest.mark.parametrize(
    "step",
    [
        {"command": "Explode"},
        {"command": "SetJoint", "joint": "tail", "rotation": [0, 0, 0]},
        {"command": "SetJoint", "joint": "jaw", "rotation": "up"},
        {"command": "SetCamera", "fov": "wide"},
        {"command": "ZoomBy"},
        {"command": "SetLevel", "level": "best"},
        7,
    ],
)
def test_a_bad_session_is_refused(step):
    data = {**Journal().to_json(), "steps": [[step]]}
    with pytest.raises(InputError):
        Journal.from_json(data)


CHOICES = (
    commands.Select("left_index2"),
    commands.Select("mouth"),
    commands.Pin(("left_foot", "right_foot"), True),
    commands.Pin(("left_foot",), False),
    commands.ShowOverlay("joints", True),
    commands.ShowPicture("depth"),
    commands.MoveCut("x", 0.1),
)


def test_a_choice_is_no_step_and_outlives_undo_and_a_session(tmp_path):
    assert {type(command) for command in CHOICES} == set(commands.Choice.__subclasses__())
    journal = Journal()
    journal.do(commands.SetJoint("left_elbow", (0.0, -0.3, 0.0)), gesture="drag 1")
    for command in CHOICES:
        journal.do(command)
    journal.do(commands.SetJoint("left_elbow", (0.0, -0.5, 0.0)), gesture="drag 1")
    chosen = journal.state.tools
    assert (chosen.selected, chosen.pins, chosen.overlays, chosen.shows) == (
        "mouth",
        {"right_foot"},
        {"joints"},
        "depth",
    )
    assert len(journal.steps) == 1
    journal.save(tmp_path / "session.json")
    assert Journal.load(tmp_path / "session.json").state == journal.state
    journal.undo()
    assert journal.state == StudioState(tools=chosen)
    journal.redo()
    assert posing.joint(journal.state.signals, "left_elbow") == (0.0, -0.5, 0.0)
    assert journal.state.tools == chosen


@pytest.mark.parametrize("command", [
    commands.Select("tail"), commands.Pin(("tail",), True), commands.ShowOverlay("halo", True), commands.ShowPicture("x-ray"),
    commands.MoveCut("w", 0.0), commands.MoveCut("x", float("nan")),
])  # fmt: skip
def test_a_choice_of_nothing_there_is_refused(command):
    with pytest.raises(InputError):
        Journal().do(command)


def test_limits_keep_a_joint_and_can_be_lifted():
    high = LIMITS[posing.joint_index("left_knee"), 0, 1]
    state = commands.SetJoint("left_knee", (9.0, 0.0, 0.0)).apply(StudioState())
    assert posing.joint(state.signals, "left_knee")[0] == high
    state = commands.SetJoint("left_knee", (9.0, 0.0, 0.0)).apply(commands.SetLimits(False).apply(state))
    assert posing.joint(state.signals, "left_knee")[0] == 9.0


def test_groups_cover_every_joint_and_coefficient_once():
    names = [name for group in BODY_GROUPS.values() for name in group]
    assert sorted(names) == sorted(set(BODY_JOINTS))
    faces = [name for group in posing.FACE_GROUPS.values() for name in group]
    assert sorted(faces) == sorted(EXPRESSION_NAMES)


def test_reset_of_a_group_leaves_the_rest():
    state = commands.ApplyExpression("smile").apply(commands.ApplyPose("run").apply(StudioState()))
    assert posing.changed(state.signals, "left arm")
    reset = commands.ResetGroup("left arm").apply(state)
    assert not posing.changed(reset.signals, "left arm")
    assert posing.changed(reset.signals, "right arm")
    assert np.array_equal(reset.signals.expression, state.signals.expression)


def test_a_joint_goes_before_a_group_of_its_name():
    moved = posing.set_expression(posing.set_joint(Signals.rest(), "jaw", (0.2, 0.0, 0.0)), "jawOpen", 0.5)
    assert posing.changed(moved, "jaw")
    after = posing.reset(moved, "jaw")
    assert not posing.changed(after, "jaw")
    assert posing.changed(after, "jawOpen")
    head = posing.set_joint(posing.set_joint(Signals.rest(), "head", (0.1, 0.0, 0.0)), "neck", (0.1, 0.0, 0.0))
    assert posing.joint(posing.reset(head, "head"), "neck") == (0.1, 0.0, 0.0)


def test_mirror_twice_is_nothing_and_once_swaps_sides():
    state = commands.Randomise("all", 1.0, 3).apply(StudioState())
    once = commands.Mirror().apply(state)
    assert not np.array_equal(once.signals.body_pose, state.signals.body_pose)
    x, y, z = posing.joint(state.signals, "left_elbow")
    assert posing.joint(once.signals, "right_elbow") == (x, -y, -z)
    assert commands.Mirror().apply(once).signals == state.signals


def test_pan_moves_the_picture_by_its_share_of_the_height():
    state = commands.PanBy(0.25, -0.125).apply(StudioState(view=OrbitView(azimuth=40.0, elevation=25.0)))
    before = StudioState(view=OrbitView(azimuth=40.0, elevation=25.0)).view
    camera = state.view.camera(200, 200)
    x, y, z = camera.camera_from_world[:3, :3] @ np.array(before.target) + camera.camera_from_world[:3, 3]
    u, v = camera.intrinsics[0, 0] * x / z + 100, camera.intrinsics[1, 1] * y / z + 100
    assert (u, v) == pytest.approx((100 - 50, 100 - 25))


def test_a_motion_carries_the_view_over_the_ground_only():
    state = timeline_commands.LoadMotion("walk.bvh", "walk", 5, 30.0, signals=STEPPING).apply(StudioState())
    assert state.view.target == pytest.approx((0.5, -0.05, 1.0))
    still = StudioState(view=OrbitView(follow=False))
    assert timeline_commands.LoadMotion("walk.bvh", "walk", 5, 30.0, signals=STEPPING).apply(still).view == still.view
