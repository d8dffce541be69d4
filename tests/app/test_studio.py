"""The studio without a window: what is rendered when, resolution, playback, errors, actions."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from avatarrex_studio.engine.resolution import FLOOR_PIXELS, FULL_AFTER, Activity, Resolution
from avatarrex_studio.engine.strips import Strips
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.session.actions import ACTIONS, action, find
from avatarrex_studio.session.commands import OrbitBy, SetBackground, SetExpression, SetJoint, SetLevel
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.state import StudioState
from ball import ball_engine, render_ball

from avatarrex.errors import InputError
from avatarrex.levels import DRAGGED_VOXEL, REUSE_TOLERANCE, level
from avatarrex.signals.driving import Signals
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence

VIEWPORT = (320, 240)


def settle(studio, clock):
    """Tick until nothing new comes; returns the number of pictures."""
    pictures = 0
    for _ in range(400):
        clock.now += 0.05
        pictures += studio.tick(VIEWPORT)
        if not studio.moving:
            return pictures
    raise AssertionError("the picture never became final")


def test_resolution_drops_while_moving_and_returns_at_rest():
    resolution, full = Resolution(seconds_per_pixel=2e-6), (800, 600)
    resolution.tick(0.0, True)
    moving = resolution.size(full)
    assert resolution.state is Activity.MOVING
    resolution.tick(0.01, False)
    still = resolution.size(full)
    assert resolution.state is Activity.STILL
    resolution.tick(FULL_AFTER, False)
    assert resolution.state is Activity.FULL
    assert moving[0] < still[0] < resolution.size(full)[0] == 800
    assert moving[0] * moving[1] == pytest.approx(1 / 12 / 2e-6, rel=0.02)
    assert moving[0] / moving[1] == pytest.approx(4 / 3, rel=0.02)


def test_resolution_has_hysteresis_and_a_floor():
    resolution, full = Resolution(seconds_per_pixel=1e-6), (800, 600)
    resolution.tick(0.0, True)
    first = resolution.size(full)
    resolution.seconds_per_pixel *= 1.2
    assert resolution.size(full) == first
    resolution.seconds_per_pixel *= 2
    assert resolution.size(full) < first
    resolution.seconds_per_pixel = 1.0
    assert min(resolution.size(full)) == FLOOR_PIXELS


def test_a_slow_frame_does_not_count_as_rest():
    resolution = Resolution()
    resolution.tick(0.0, True)
    resolution.measured(3.0, 1000, 3.0)
    assert resolution.tick(3.01, False) is Activity.STILL


def test_a_dragged_picture_may_lag_and_be_rough_and_the_one_that_stays_may_not(clock):
    rendered = []

    def render(avatar, signals, camera, settings, previous=None):
        frame = render_ball(avatar, signals, camera, settings, previous)
        rendered.append((settings.reuse_tolerance, settings.voxel))
        frame.volume.changed = "some of it" if settings.reuse_tolerance else None
        return frame

    studio = Studio(ball_engine(render), clock=clock)
    exact, coarse = (0.0, level("fast").voxel), (REUSE_TOLERANCE, DRAGGED_VOXEL)
    for name, first in (("fast", coarse), ("balanced", exact)):
        studio.do(SetLevel(name))
        settle(studio, clock)
        rendered.clear()
        studio.do(SetJoint("left_shoulder", (0, 0, 0.1 + first[0])))
        clock.now += 0.01
        studio.tick((32, 24))  # so small that a drag has every pixel
        assert rendered == [first]
        for _ in range(100):
            clock.now += 0.05
            studio.tick((32, 24))
        assert rendered == ([coarse, exact] if name == "fast" else [exact])
        assert not studio.work.lags
        assert not studio.work.rough


def test_nothing_is_rendered_when_nothing_changes(studio, clock):
    assert settle(studio, clock) >= 1
    assert studio.size == VIEWPORT
    image = studio.image
    for _ in range(5):
        clock.now += 1
        assert not studio.tick(VIEWPORT)
    assert studio.image is image
    studio.do(SetBackground((1.0, 1.0, 1.0, 1.0)))
    clock.now += 1
    assert not studio.tick(VIEWPORT), "the background is not the pipeline's business"


def test_a_change_renders_small_first_and_full_in_the_end(studio, clock):
    settle(studio, clock)
    before = studio.image.clone()
    studio.do(SetJoint("left_elbow", (0.0, -1.0, 0.0)))
    clock.now += 0.01
    assert studio.tick(VIEWPORT)
    assert studio.size < VIEWPORT
    assert studio.work.counters["voxels_evaluated"] == 100
    settle(studio, clock)
    assert studio.size == VIEWPORT
    assert not torch.equal(studio.image, before)


def test_strips_make_the_whole_picture():
    state, size = StudioState(), (64, 50)
    whole = ball_engine().render(state, size).frame.image
    strips = Strips(ball_engine(), state, size, torch.zeros(5, 6, 4), seconds_per_pixel=1e-4)
    steps = 0
    while not strips.finished:
        strips.step()
        steps += 1
    assert steps == 3
    assert torch.equal(strips.image, whole)


def test_an_error_leaves_the_last_good_picture(clock, caplog):
    def sometimes(avatar, signals, camera, settings, previous=None):
        if signals.expression.any():
            raise RuntimeError("the network has no such face")
        return render_ball(avatar, signals, camera, settings, previous)

    studio = Studio(ball_engine(sometimes), clock=clock)
    settle(studio, clock)
    image, frame = studio.image, studio.shot.frame
    studio.do(SetExpression("jawOpen", 0.5))
    settle(studio, clock)
    assert "no such face" in studio.shot.error
    assert studio.image is image
    assert studio.shot.frame is frame
    studio.undo()
    settle(studio, clock)
    assert studio.shot.error is None
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
        frames.append(studio.state.motion.frame)
    assert frames == [2, 5, 7, 0, 2, 5]
    assert studio.state.signals.translation[2] == pytest.approx(0.5)
    assert studio.state.signals.expression.any(), "a body motion leaves the face"
    assert len(studio.journal.steps) == 3, "a playback is one step"
    studio.undo()
    assert not studio.playback.playing
    assert studio.state.motion.frame == 0


def test_a_face_recording_leaves_the_body(motion_file):
    motion = Motion.read(motion_file)
    assert motion.driven == ("translation", "body_pose")
    with pytest.raises(InputError):
        Motion.read(motion_file.with_suffix(".fbx"))


def test_a_missing_motion_is_said_and_nothing_else(studio, caplog):
    studio.open_motion("nowhere.bvh")
    assert studio.state.motion is None
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


def test_the_engine_renders_a_part_of_the_rows():
    seen = []

    def spy(avatar, signals, camera, settings, previous=None):
        seen.append(camera)
        return render_ball(avatar, signals, camera, settings, previous)

    ball_engine(spy).render(StudioState(), (64, 48), rows=(10, 30))
    assert (seen[0].width, seen[0].height) == (64, 20)
    assert seen[0].intrinsics[1, 2] == 24 - 10


def test_a_saved_session_opens_again(studio, clock, tmp_path):
    studio.do(OrbitBy(20.0, 5.0))
    studio.save_session(str(tmp_path / "a.json"))
    other = Studio(ball_engine(), clock=clock)
    other.open_session(str(tmp_path / "a.json"))
    assert other.state == studio.state
    studio.save_image(tmp_path / "a.png", VIEWPORT)
    assert (tmp_path / "a.png").stat().st_size > 100
