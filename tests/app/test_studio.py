"""The studio without a window: what is rendered when, playback, errors, actions. What is on screen: `test_pictures.py`."""

from __future__ import annotations

import numpy as np
import pytest
from avatarrex_studio.panels.menu import MENUS
from avatarrex_studio.session.actions import ACTIONS, action, find, menu
from avatarrex_studio.session.commands import OrbitBy, SetBackground, SetExpression, SetJoint, SetLevel, SetSignals
from avatarrex_studio.session.motion import Motion
from ball import render_ball
from ball_studio import ball_studio

from avatarrex.errors import InputError
from avatarrex.levels import DRAGGED_VOXEL, REUSE_TOLERANCE, level
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.library import named_expression, named_hand, named_pose
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.figure import Figure
from avatarrex.templates.parts import PARTS
from avatarrex.templates.person import load_person

VIEWPORT = (320, 240)


def settle(studio, clock):
    """Tick until nothing new comes; returns how often there was something."""
    new = 0
    for _ in range(400):
        clock.now += 0.05
        new += studio.tick(VIEWPORT)
        if not (studio.moving or studio.pictures.exact.busy):
            return new
    raise AssertionError("the picture never became final")


def test_a_dragged_picture_may_lag_and_be_rough_and_the_one_that_stays_may_not(clock):
    rendered = []

    def render(avatar, signals, camera, settings, previous=None):
        frame = render_ball(avatar, signals, camera, settings, previous)
        rendered.append((settings.reuse_tolerance, settings.voxel))
        frame.volume.changed = "some of it" if settings.reuse_tolerance else None
        return frame

    studio = ball_studio(clock, render)
    exact, coarse = (0.0, level("fast").voxel), (REUSE_TOLERANCE, DRAGGED_VOXEL)
    for k, name in enumerate(("fast", "balanced")):
        studio.do(SetLevel(name))
        settle(studio, clock)
        rendered.clear()
        studio.do(SetJoint("left_shoulder", (0, 0, 0.1 + 0.1 * k)))
        for _ in range(100):
            clock.now += 0.05
            studio.tick((32, 24))
        assert rendered == [coarse if name == "fast" else exact, exact]
        assert not studio.pictures.picture.work.lags


def test_nothing_is_rendered_when_nothing_changes(studio, clock):
    assert settle(studio, clock) >= 1
    picture = studio.pictures.picture
    assert picture.image.shape == (*reversed(VIEWPORT), 4)
    requests = len(studio.pictures.exact.begun)
    for background in (None, (1.0, 1.0, 1.0, 1.0)):
        if background:
            studio.do(SetBackground(background))
        for _ in range(5):
            clock.now += 1
            assert not studio.tick(VIEWPORT), "the background is not the engine's business"
    assert studio.pictures.picture is picture
    assert len(studio.pictures.exact.begun) == requests


def test_a_change_renders_small_first_and_full_in_the_end(studio, clock):
    settle(studio, clock)
    before = studio.pictures.picture.image
    studio.do(SetJoint("left_elbow", (0.0, -1.0, 0.0)))
    clock.now += 0.01
    studio.tick(VIEWPORT)
    clock.now += 0.01
    assert studio.tick(VIEWPORT)
    assert studio.pictures.picture.image.size < before.size
    assert studio.pictures.picture.work.counters["voxels_evaluated"] == 100
    settle(studio, clock)
    assert studio.pictures.picture.image.shape == before.shape
    assert not np.array_equal(studio.pictures.picture.image, before)


def test_an_error_leaves_the_last_good_picture(clock, caplog):
    def sometimes(avatar, signals, camera, settings, previous=None):
        if signals.expression.any():
            raise RuntimeError("the network has no such face")
        return render_ball(avatar, signals, camera, settings, previous)

    studio = ball_studio(clock, sometimes)
    settle(studio, clock)
    picture = studio.pictures.picture
    studio.do(SetExpression("jawOpen", 0.5))
    settle(studio, clock)
    assert "no such face" in studio.pictures.error
    assert studio.pictures.picture is picture
    assert studio.weight == 1
    studio.undo()
    settle(studio, clock)
    assert studio.pictures.error is None
    assert "no such face" in caplog.text


def test_a_value_that_cannot_be_set_changes_nothing(studio, caplog):
    before = studio.state
    studio.do(SetJoint("tail", (0.0, 0.0, 0.0)))
    assert studio.state is before
    assert "tail" in caplog.text


@pytest.fixture
def motion_file(tmp_path):
    """Ten frames at 10 a second: the body steps on, the face is still."""
    frames = tuple(
        Signals.rest().replace(translation=np.array([0.0, 0.0, 0.1 * k]), body_pose=np.full((21, 3), 0.01 * k))
        for k in range(10)
    )
    write_json(tmp_path / "steps.json", SignalSequence(frames, 10.0, "steps"))
    return tmp_path / "steps.json"


def test_a_motion_plays_at_its_own_rate(studio, clock, motion_file):
    studio.do(SetExpression("jawOpen", 0.4))
    studio.open_motion(str(motion_file))
    studio.toggle_play()
    frames = []
    for _ in range(6):
        clock.now += 0.25
        studio.tick(VIEWPORT)
        frames.append(studio.state.timeline.frame)
    assert frames == [2, 5, 7, 0, 2, 5]
    assert studio.state.signals.translation[2] == pytest.approx(0.5)
    assert studio.state.signals.expression.any(), "a body motion leaves the face"
    assert len(studio.journal.steps) == 3, "a playback is one step"
    studio.undo()
    assert not studio.playback.playing
    assert studio.state.timeline.frame == 0


def test_a_face_recording_leaves_the_body(motion_file):
    motion = Motion.read(motion_file)
    assert motion.parts == ("root", "torso", "left arm", "right arm", "legs", "head")
    with pytest.raises(InputError):
        Motion.read(motion_file.with_suffix(".fbx"))


def test_a_missing_motion_is_said_and_nothing_else(studio, caplog):
    studio.open_motion("nowhere.bvh")
    assert not studio.state.timeline.layers
    assert "nowhere.bvh" in caplog.text


def test_actions_are_named_once_and_all_can_be_done(studio, motion_file):
    assert len({entry.id for entry in ACTIONS}) == len(ACTIONS)
    shortcuts = [entry.shortcut for entry in ACTIONS if entry.shortcut]
    assert len(set(shortcuts)) == len(shortcuts)
    assert not action("play").enabled(studio.journal)
    studio.open_motion(str(motion_file))
    for entry in ACTIONS:
        assert (entry.command is None) != (entry.effect is None), entry.id
        if entry.command:
            entry.command(studio.state).apply(studio.state)
    assert find("pose wave")[0].title == "Pose: wave"


def test_menus_have_each_entry_once_and_tick_what_is_so(studio):
    shown = [entry for title in MENUS for entry in menu(title)]
    assert len({entry.id for entry in shown}) == len(shown) == sum(bool(entry.menu) for entry in ACTIONS)

    def ticked():
        return {entry.id for entry in shown if entry.on and entry.on(studio.state)}

    parts = {f"part.{name}" for name in PARTS}
    assert ticked() == {"show.image", "level.balanced", *parts}
    for name in ("overlay.joints", "show.normals", "level.live", "part.face", "stage", "view.orthographic"):
        studio.do(action(name).command(studio.state))
    assert ticked() == {
        "overlay.joints", "show.normals", "level.live", "stage", "view.orthographic", *(parts - {"part.face"}),
    }  # fmt: skip


def test_a_saved_session_opens_again(studio, clock, tmp_path):
    studio.do(OrbitBy(20.0, 5.0))
    studio.save_session(str(tmp_path / "a.json"))
    other = ball_studio(clock)
    other.open_session(str(tmp_path / "a.json"))
    assert other.state == studio.state


def test_nothing_of_a_motion_is_left_when_the_next_is_loaded(studio, tmp_path):
    """In joints that the next leaves at rest, too; what it does not move is as it was posed, not as the one before left it."""
    bent = Signals.rest().replace(body_pose=named_pose("squat"), expression=named_expression("smile"))
    fist = {"left_hand_pose": named_hand("fist", "left")}
    for name, frame in (("a", bent), ("b", Signals.rest().replace(body_pose=named_pose("wave")))):
        write_json(tmp_path / f"{name}.json", SignalSequence((frame, frame), 24.0, name))
    studio.do(SetSignals(Signals.rest().replace(**fist)))
    studio.open_motion(str(tmp_path / "a.json"))
    studio.open_motion(str(tmp_path / "b.json"))
    found = studio.state.signals
    assert np.array_equal(found.body_pose, named_pose("wave"))
    assert not found.expression.any(), "b says nothing of the face, a's smile went with a"
    assert np.array_equal(found.left_hand_pose, fist["left_hand_pose"])


def test_the_face_is_framed_wherever_the_head_has_gone(studio, monkeypatch):
    figure = Figure(load_person().body, Signals.rest().replace(body_pose=named_pose("bow")))
    monkeypatch.setattr(type(studio), "figure", figure)
    studio.frame_face()
    lower, upper = (figure.vertices[figure.region(name)].mean(0) for name in ("mouth", "brow"))
    middle = np.asarray(studio.state.view.target)
    assert np.linalg.norm(middle - (lower + upper) / 2) < 0.1
    assert middle[2] > 0.2, "before the body, which bows"


def test_a_hand_is_framed_wherever_it_is(studio, monkeypatch):
    figure = Figure(load_person().body, Signals.rest().replace(body_pose=named_pose("wave")))
    monkeypatch.setattr(type(studio), "figure", figure)
    studio.frame_hand("right_hand")
    hand = figure.posed.position[[JOINT_NAMES.index(f"right_{name}") for name in ("wrist", "middle3")]].mean(0)
    assert np.linalg.norm(np.asarray(studio.state.view.target) - hand) < 0.05
    assert studio.state.view.distance < 1
