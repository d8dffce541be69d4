"""The timeline without a window: curves, layers at a time, keys, recording, undo and replay."""

from __future__ import annotations

import json
import logging
import wave
from dataclasses import replace

import numpy as np
import pytest
from avatarrex_studio.panels.layer_menu import copied
from avatarrex_studio.panels.timescale import Timescale
from avatarrex_studio.panels.warp_editor import moved as move_point
from avatarrex_studio.panels.warp_editor import with_point
from avatarrex_studio.session import timeline_commands as edits
from avatarrex_studio.session.clips import Clips
from avatarrex_studio.session.commands import (
    ApplyExpression,
    Select,
    SetCamera,
    SetExpression,
    SetHandPose,
    SetJoint,
    SetShape,
)
from avatarrex_studio.session.evaluation import LIMITS, layers_at, state_at, view_at
from avatarrex_studio.session.figures import standing
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.keys import Key, Track, moved, with_keys
from avatarrex_studio.session.motion import Motion, driven_words
from avatarrex_studio.session.notice import NOTICE
from avatarrex_studio.session.posing import joint
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.session.take import Take
from avatarrex_studio.session.time_warp import APART, WARPS
from avatarrex_studio.session.timeline import MOST_LAYERS, PARTS, Clip, Layer, Share, Timeline
from ball import ball_engine
from ball_studio import ball_studio

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.imported import ImportedMotion
from avatarrex.signals.joints import BODY_JOINTS, EXPRESSION_NAMES
from avatarrex.signals.library import named_expression, named_hand
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence

JAW = EXPRESSION_NAMES.index("jawOpen")
ELBOW = "left_elbow"


@pytest.fixture
def motions(tmp_path):
    """Two motions of 11 frames, 10 a second: `body` bends elbows up to 1 rad and walks, `face` opens the jaw and turns the head."""
    bend = np.zeros((21, 3))
    bend[17, 1] = -1.0  # left elbow
    turn = np.zeros((21, 3))
    turn[14, 1] = 0.5  # head
    shares = np.linspace(0, 1, 11)
    body = tuple(Signals.rest().replace(body_pose=k * bend, translation=np.array([0, 0, k])) for k in shares)
    face = tuple(Signals.rest().replace(body_pose=k * turn, expression=np.eye(52)[JAW] * k) for k in shares)
    for name, frames in (("body", body), ("face", face)):
        write_json(tmp_path / f"{name}.json", SignalSequence(frames, 10.0, name))
    return {name: str(tmp_path / f"{name}.json") for name in ("body", "face")}


@pytest.fixture
def layered(studio, motions):
    """The body's motion, and the face's over it."""
    studio.open_motion(motions["body"])
    studio.add_motion(motions["face"])
    return studio


def elbow(state):
    return joint(state.signals, ELBOW)[1]


def jaw(state):
    return state.signals.expression[JAW]


def test_a_sound_comes_over_the_motion(layered, tmp_path):
    with wave.open(str(tmp_path / "a.wav"), "wb") as file:
        file.setparams((1, 2, 8000, 0, "NONE", ""))
        tone = np.sin(np.arange(8000) * 2 * np.pi * 700 / 8000) * (np.arange(8000) > 4000)
        file.writeframes((9000 * tone).astype("<i2").tobytes())
    layered.open_motion(str(tmp_path / "a.wav"))
    assert [layer.name for layer in layered.state.timeline.layers] == ["body.json", "face.json", "a.wav"]
    layered.go_to(8)
    assert jaw(layered.state) > 0.1
    assert elbow(layered.state) == pytest.approx(-0.8)
    assert joint(layered.state.signals, "head")[1] == pytest.approx(0.4)


def test_curves_pass_their_keys_and_differ_between():
    def at(time, curve):
        return Track("jawOpen", tuple(Key(t, (v,), curve) for t, v in ((0.0, 0.0), (1.0, 1.0), (2.0, 0.5)))).at(time)[0]

    for curve in ("linear", "smooth", "step"):
        assert [at(time, curve) for time in (-1.0, 0.0, 1.0, 2.0, 9.0)] == [0.0, 0.0, 1.0, 0.5, 0.5]
    assert [at(0.25, curve) for curve in ("linear", "step")] == [0.25, 0.0]
    assert at(0.5, "smooth") != at(0.5, "linear")
    fine = [at(time, "smooth") for time in np.linspace(0, 2, 201)]
    assert 0 <= min(fine) <= max(fine) <= 1, "never beyond its keys"
    assert abs(fine[101] - fine[99]) < 0.002, "level at the highest key"


def test_a_rotation_takes_the_short_way():
    keys = Track(ELBOW, (Key(0.0, (0.0, 3.0, 0.0), "linear"), Key(1.0, (0.0, -3.0, 0.0), "linear")))
    assert np.abs(keys.at(0.5)) == pytest.approx([0, np.pi, 0], abs=1e-9), "over π, not through rest"
    quarter = Track(ELBOW, (Key(0.0, (0.0, 0.0, 0.0), "linear"), Key(1.0, (0.0, 1.0, 0.0))))
    assert quarter.at(0.25) == pytest.approx([0, 0.25, 0])


def test_keys_are_replaced_moved_and_recorded_over():
    tracks = with_keys((), "jawOpen", tuple(Key(t, (t,)) for t in (0.0, 0.5, 1.0)))
    assert [key.value for key in with_keys(tracks, "jawOpen", (Key(0.5, (9.0,)),))[0].keys] == [(0.0,), (9.0,), (1.0,)]
    assert [key.time for key in moved(tracks, (("jawOpen", 0.0),), 0.75)[0].keys] == [0.5, 0.75, 1.0]
    taken = with_keys(tracks, "jawOpen", (Key(0.9, (7.0,)),), since=0.2)
    assert [key.time for key in taken[0].keys] == [0.0, 0.9, 1.0], "what lay between the last key and this one is gone"


def test_layers_give_what_their_parts_weights_and_times_say(layered, motions):
    """In closed form: both motions are linear in time."""
    layered.go_to(5)
    assert (elbow(layered.state), jaw(layered.state)) == pytest.approx((-0.5, 0.5))
    assert layered.state.timeline.layers[1].parts == {"head", "mouth"}
    assert layered.state.signals.translation[2] == pytest.approx(0.5), "the face says nothing of the place"
    layered.do(edits.SetLayer("face.json", weight=0.25))
    assert jaw(layered.state) == pytest.approx(0.125)
    assert joint(layered.state.signals, "head")[1] == pytest.approx(0.25 * 0.25)
    layered.do(edits.SetLayer("face.json", weight=1.0, offset=0.2))
    assert jaw(layered.state) == pytest.approx(0.3)
    layered.do(edits.SetLayer("face.json", rate=2.0))
    assert jaw(layered.state) == pytest.approx(0.6)
    layered.do(edits.SetLayer("face.json", loop=True, rate=4.0))
    assert jaw(layered.state) == pytest.approx(4 * 0.3 - 1.1), "1.1 s: eleven frames, then again"
    layered.do(edits.SetLayer("face.json", muted=True))
    assert jaw(layered.state) == 0
    layered.do(edits.SetLayer("body.json", parts=("root",)))
    assert (elbow(layered.state), layered.state.signals.translation[2]) == pytest.approx((0, 0.5))


def test_a_group_that_is_muted_follows_the_sliders(layered):
    layered.go_to(10)
    layered.do(edits.SetShare("left arm", Share(muted=True)))
    layered.do(SetJoint(ELBOW, (0.0, -0.2, 0.0)))
    layered.go_to(4)
    assert elbow(layered.state) == pytest.approx(-0.2)
    layered.do(edits.SetShare("left arm", Share(0.5)))
    assert elbow(layered.state) == pytest.approx(-0.3), "halfway from the slider to the motion"
    layered.do(edits.SetShare("left arm", Share()))
    assert elbow(layered.state) == pytest.approx(-0.4)


def test_what_is_posed_is_below_all_layers_and_stays(layered):
    layered.do(SetExpression("browInnerUp", 0.7))
    layered.do(edits.SetLayer("face.json", parts=("head",)))
    layered.do(SetExpression("jawOpen", 0.4))
    layered.go_to(7)
    assert jaw(layered.state) == pytest.approx(0.4)
    for name in ("face.json", "body.json"):
        layered.do(edits.RemoveLayer(name))
    assert elbow(layered.state) == 0
    assert layered.state.signals.expression[EXPRESSION_NAMES.index("browInnerUp")] == pytest.approx(0.7)
    layered.undo()
    assert elbow(layered.state) == pytest.approx(-0.7)
    layered.do(edits.CloseMotion())
    assert elbow(layered.state) == pytest.approx(-0.7), "what a closed timeline showed stays"


def test_smoothing_averages_a_clip_without_delay(layered):
    layered.do(edits.SetLayer("face.json", smoothing=0.2))
    layered.go_to(5)
    assert jaw(layered.state) == pytest.approx(0.5, abs=0.01), "the middle of a ramp stays"
    layered.go_to(0)
    assert jaw(layered.state) > 0.05, "its end is drawn towards its neighbours"


def test_keys_for_signals_and_the_camera(studio):
    studio.do(edits.SetTimeline(fps=10.0))
    for frame, value in ((0, 0.2), (10, 0.8)):
        studio.go_to(frame)
        studio.do(SetExpression("jawOpen", value))
        studio.do(SetCamera(azimuth=10.0 * value, target=(0.0, value, 0.0)))
        studio.set_key()
        studio.key_camera()
    assert [layer.name for layer in studio.state.timeline.layers] == ["Keys"]
    studio.do(
        edits.SetCurve("Keys", tuple((track.name, 0.0) for track in studio.state.timeline.layers[0].tracks), "linear")
    )
    studio.go_to(5)
    view = studio.state.view
    assert jaw(studio.state) == pytest.approx(0.5)
    assert (view.azimuth, view.target[1]) == pytest.approx((5.0, 0.5))
    between = state_at(studio.state, 0.25, studio.clips)
    assert (jaw(between), between.view.azimuth, between.timeline.frame) == (pytest.approx(0.35), pytest.approx(3.5), 2)
    studio.do(edits.MoveKeys("Keys", (("jawOpen", 1.0),), 1.0))
    assert jaw(studio.state) == pytest.approx(0.35)
    studio.do(edits.DeleteKeys("Keys", (("jawOpen", 2.0),)))
    assert jaw(studio.state) == pytest.approx(0.2)
    layer = studio.state.timeline.layers[0]
    assert copied(layer, (("camera.azimuth", 1.0),)) == (("camera.azimuth", 0.0, (8.0,), "smooth"),)


def test_keys_lead_the_camera_within_its_limits(studio):
    """Whatever a file says of them."""
    tracks = tuple(Track(name, (Key(0.0, (1e6,)),)) for name in ("camera.fov", "camera.elevation"))
    for weight in (1.0, 0.5):
        view = view_at(Timeline((Layer("Keys", tracks=tracks, weight=weight),)), studio.state.view, 0.0)
        assert view.elevation == LIMITS["camera.elevation"][1]
        assert view.fov == LIMITS["camera.fov"][1]


def test_what_is_changed_stays_until_the_playhead_moves(layered):
    """A command on the timeline changes what it changes; another frame shows what drives."""
    studio = layered
    studio.go_to(5)
    studio.do(SetJoint(ELBOW, (0.0, -0.9, 0.0)))
    studio.do(SetExpression("jawOpen", 0.9))
    studio.take.recording = True
    studio.do(SetExpression("jawOpen", 0.8))
    studio.take.recording = False
    assert (elbow(studio.state), jaw(studio.state)) == pytest.approx((-0.9, 0.8))
    studio.set_key()
    assert {track.name for track in studio.state.timeline.layer("Keys").tracks} == {ELBOW, "jawOpen"}
    studio.go_to(6)
    assert (elbow(studio.state), jaw(studio.state)) == pytest.approx((-0.9, 0.8))
    studio.do(edits.RemoveLayer("Keys"))
    assert (elbow(studio.state), jaw(studio.state)) == pytest.approx((-0.6, 0.6))


def test_a_drag_of_keys_shows_where_they_are(studio):
    """Moves of one drag take each other's place; what is shown is of the last."""
    studio.do(edits.AddLayer(Layer("Keys")))
    keys = tuple(("jawOpen", time, (time,), "linear") for time in (0.0, 1.0))
    studio.do(edits.SetKeys("Keys", keys))
    studio.go_to(15)
    for by in (0.2, 0.6, 1.0):
        studio.do(edits.MoveKeys("Keys", (("jawOpen", 1.0),), by), ("drag", 1))
        assert jaw(studio.state) == pytest.approx(0.5 / (1 + by))
    studio.undo()
    assert jaw(studio.state) == pytest.approx(0.5)


def test_what_is_dragged_while_it_plays_becomes_keys(layered, clock):
    """One undo step of playing; keys of before that were played over are gone."""
    studio = layered
    studio.go_to(3)
    studio.take.recording = True
    studio.do(SetExpression("jawOpen", 0.9))
    studio.go_to(0)
    studio.toggle_play()
    steps = len(studio.journal.steps)
    for k in range(1, 6):
        clock.now += 0.1001
        studio.tick((32, 24))
        studio.do(SetExpression("jawOpen", 0.1 * k), ("drag", 1))
    track = studio.state.timeline.layer("Keys").track("jawOpen")
    assert [(key.time, key.value[0]) for key in track.keys] == [pytest.approx((0.1 * k, 0.1 * k)) for k in range(1, 6)]
    assert len(studio.journal.steps) == steps + 1
    studio.take.recording = False
    studio.toggle_play()
    studio.go_to(4)
    assert jaw(studio.state) == pytest.approx(0.4)
    studio.undo()
    studio.undo()
    assert [key.value[0] for key in studio.state.timeline.layer("Keys").track("jawOpen").keys] == [0.9]


def test_a_range_plays_and_repeats_at_the_timeline_s_rate(layered, clock):
    layered.do(edits.SetTimeline(span=(3, 6)))
    layered.toggle_play()
    frames = []
    for _ in range(6):
        clock.now += 0.1001
        layered.tick((32, 24))
        frames.append(layered.state.timeline.frame)
    assert frames == [4, 5, 6, 3, 4, 5], "from the range's beginning, as the playhead was before it"
    layered.do(edits.SetTimeline(loop=False))
    for _ in range(6):
        clock.now += 0.1001
        layered.tick((32, 24))
    assert (layered.state.timeline.frame, layered.playback.playing) == (6, False)
    layered.do(edits.SetTimeline(fps=20.0))
    assert (layered.state.timeline.frame, layered.state.timeline.span) == (12, (6, 12)), "the time stays"


def test_a_replay_gives_the_same_frame_without_the_files(layered, clock, tmp_path, motions):
    """Layers, keys, a camera that is led, recording, undo: the picture of the journal that was read again is the same."""
    studio = layered
    studio.do(edits.SetLayer("face.json", weight=0.7, offset=0.1, rate=1.5, smoothing=0.05))
    studio.go_to(4)
    studio.set_key()
    studio.key_camera()
    studio.take.recording = True
    studio.toggle_play()
    for k in range(4):
        clock.now += 0.1001
        studio.tick((32, 24))
        studio.do(SetJoint("left_shoulder", (0.0, 0.0, 0.1 * k)), ("drag", 3))
    studio.do(edits.SetShare("head", Share(0.5)))
    studio.undo()
    studio.redo()
    studio.save_session(str(tmp_path / "s.json"))
    for path in motions.values():
        (tmp_path / path).unlink()
    again = Journal.load(tmp_path / "s.json")
    assert again.state == studio.state
    assert StudioState.from_json(json.loads(json.dumps(again.state.to_json()))) == again.state
    engine = ball_engine()
    first, second = (engine.render(state, (40, 30)).frame.image.numpy() for state in (studio.state, again.state))
    assert np.abs(first - second).max() <= 1 / 255


def test_a_clip_that_cannot_be_read_leaves_the_others_and_without_any_the_picture(
    layered, clock, motions, tmp_path, caplog
):
    layered.go_to(5)
    (tmp_path / motions["face"]).unlink()
    layered.clips.forget()
    layered.toggle_play()
    assert layered.playback.playing
    layered.toggle_play()
    layered.go_to(8)
    assert (elbow(layered.state), jaw(layered.state)) == pytest.approx((-0.8, 0.0))
    layered.do(edits.SetLayer("body.json", weight=0.5))
    assert elbow(layered.state) == pytest.approx(-0.4)
    assert layered.clips.missing(layered.state.timeline) == {"face.json"}
    assert "face.json" in caplog.text
    (tmp_path / motions["body"]).unlink()
    layered.clips.forget()
    before = layered.state.signals
    layered.go_to(2)
    layered.do(edits.SetLayer("body.json", weight=0.1))
    layered.toggle_play()
    assert not layered.playback.playing
    assert layered.state.signals == before
    assert layers_at(layered.state.timeline, Signals.rest(), 0.5, Clips()).expression[JAW] == 0


@pytest.mark.parametrize("timeline", [
    {"fps": 0.0}, {"frame": -1}, {"span": (5, 2)}, {"layers": (Layer("a"), Layer("a"))}, {"shares": (("tail", Share()),)},
])  # fmt: skip
def test_a_timeline_that_cannot_be_is_refused(timeline):
    with pytest.raises(InputError):
        Timeline(**timeline)


@pytest.mark.parametrize("layer", [
    {"name": " "}, {"weight": 1.5}, {"rate": 0.0}, {"parts": frozenset({"tail"})}, {"smoothing": float("nan")},
    {"warp": ((0.5, 1.1),)}, {"warp": ((0.6, 0.5), (0.5, 0.6))}, {"warp": ((0.001, 0.0),)}, {"warp": ((0.5, float("nan")),)},
])  # fmt: skip
def test_a_layer_that_cannot_be_is_refused(layer):
    with pytest.raises(InputError):
        Layer(**{"name": "a", **layer})


def test_a_range_beyond_the_end_ends_with_the_timeline():
    timeline = Timeline((Layer("a", Clip("a.json", "a", 30, 30.0)),), span=(40, 1000))
    assert timeline.played == (29, 29)
    assert timeline.change(span=(5, 1000)).played == (5, 29)


def test_each_smoothing_of_a_clip_is_its_own_and_of_the_motion_as_it_is_now():
    def motion(step):
        frames = tuple(Signals.rest().replace(translation=np.array([0.0, step * (k % 2), 0.0])) for k in range(60))
        return Motion("a.json", ImportedMotion(SignalSequence(frames, 30.0, "a")))

    clips, layer = Clips(), Layer("a", Clip("a.json", "a", 60, 30.0), smoothing=0.05)
    clips.take(motion(1.0))
    little, much = (
        np.ptp([frame.translation[1] for frame in clips.sequence(replace(layer, smoothing=width)).frames[20:40]])
        for width in (0.02, 0.2)
    )
    assert much < 0.2 * little
    before = clips.sequence(layer)
    assert clips.sequence(layer) is before
    clips.take(motion(3.0))
    assert clips.sequence(layer) is not before


def test_the_shape_has_no_keys(layered):
    """While something is recorded it is set as ever."""
    layered.take.recording = True
    layered.do(SetShape(0, 0.1))
    assert layered.state.signals.shape[0] == pytest.approx(0.1)
    assert not any(track.name == "shape" for layer in layered.state.timeline.layers for track in layer.tracks)


def test_a_clip_goes_through_its_time_by_a_curve(layered):
    """Fast first, then slowly, in each round; both ends, and what lies beyond them, stay. It is undone, saved and replayed."""
    name = layered.state.timeline.layers[0].name
    even = layered.state.timeline.layers[0]
    length = even.clip.seconds
    layered.do(edits.SetLayer(name, warp=((0.5, 0.8),)))
    layer = layered.state.timeline.layers[0]
    assert layer.seconds == even.seconds
    assert layer.local(layer.offset + 0.5 * length) == pytest.approx(0.8 * length)
    times = layer.offset + length * np.array([-0.5, 0.0, 0.25, 0.5, 1.0, 1.5])
    own = layer.local(times)
    assert own[[0, 1, 4, 5]] == pytest.approx(length * np.array([-0.5, 0.0, 1.0, 1.5]))
    assert 0.25 * length < own[2] < own[3]
    assert [layer.local(float(time)) for time in times] == pytest.approx(own)
    again = replace(layer, loop=True)
    assert again.local(again.offset + 1.5 * length) == pytest.approx(0.8 * length)
    assert Layer.from_json(json.loads(json.dumps(layer.to_json()))) == layer
    layered.undo()
    assert layered.state.timeline.layers[0] == even


def test_the_time_curve_is_edited_by_points():
    assert with_point((), (0.5, 1.4)) == ((0.5, 1.0),)
    assert with_point(((0.5, 1.0),), (0.2, 0.1)) == ((0.2, 0.1), (0.5, 1.0))
    assert with_point(((0.5, 1.0),), (0.505, 0.1)) is None
    assert move_point(((0.2, 0.1), (0.5, 1.0)), 0, (0.9, -1.0)) == ((0.5 - APART, 0.0), (0.5, 1.0))
    for warp in WARPS.values():
        Layer("a", warp=warp)


def test_parts_cover_every_joint_and_coefficient_once():
    names = [name for part in PARTS.values() for name in part]
    assert len(names) == len(set(names)) == 55 + 52 + 1


def test_the_ruler_and_its_zoom():
    scale = Timescale.of_all(100.0, 500.0, 10.0)
    assert scale.time(scale.x(3.7)) == pytest.approx(3.7)
    assert scale.x(0.0) >= 100
    assert scale.x(10.0) <= 600
    near = scale.zoomed(0.1, 300.0)
    assert near.time(300.0) == pytest.approx(scale.time(300.0))
    assert [text for _, text in scale.ticks(30.0, False) if text][:3] == ["0 s", "2 s", "4 s"]
    labelled = [near.x(time) for time, text in near.ticks(30.0, True) if text]
    assert all(round(time * 30, 6).is_integer() for time, _ in near.ticks(30.0, True)), "no tick between frames"
    assert min(np.diff(labelled)) >= 52


def test_the_time_of_a_layer_of_keys_that_begins_late_goes_fast_and_repeats():
    """Keys at 1 and 3 s of its own, twice as fast, half a second later: they lie at 1 and 2 s, and again at 2 and 3."""
    keys = tuple(Key(time, (value,), "linear") for time, value in ((1.0, 0.0), (3.0, 1.0)))
    layer = Layer("Keys", tracks=(Track("jawOpen", keys),), offset=0.5, rate=2.0, loop=True)
    assert layer.seconds == (1.0, 2.0)
    assert [layer.on_timeline(own) for own in (0.0, 1.0, 3.0)] == [0.5, 1.0, 2.0]
    for seconds, value in ((1.25, 0.25), (1.75, 0.75), (2.25, 0.25), (4.5, 0.5)):
        assert layer.tracks[0].at(layer.local(seconds)) == pytest.approx([value], abs=1e-6)


def test_a_recorded_drag_is_linear_and_takes_away_only_what_it_went_over():
    take, state = Take(), StudioState()
    take.recording = True
    state = take.keyed(SetExpression("jawOpen", 0.2), state, "drag").apply(state)
    state = state.change(timeline=state.timeline.change(frame=3))
    later, again = (take.keyed(SetExpression("jawOpen", value), state, "drag") for value in (0.5, 0.6))
    assert (later.since, later.keys[0][3]) == (0.0, "linear")
    assert again.since is None, "the playhead has not moved"


def test_a_motion_leaves_hands_that_it_keeps_as_they_are_and_a_gesture_over_it_the_legs(studio, caplog):
    caplog.set_level(NOTICE)
    studio.do(SetHandPose("left", "fist"))
    studio.do(ApplyExpression("smile"))
    fist = studio.state.signals.left_hand_pose
    studio.open_motion("walk")
    studio.go_to(20)
    walking = studio.state.signals
    np.testing.assert_array_equal(walking.left_hand_pose, fist)
    blinking = walking.expression != named_expression("smile")
    assert {EXPRESSION_NAMES[k] for k in np.flatnonzero(blinking)} <= set(PARTS["lids"]), "the smile stays, cheeks too"
    assert "walk drives the whole body and lids;" in caplog.text
    studio.add_motion("wave")
    studio.go_to(50)
    both, legs = studio.state.signals, [BODY_JOINTS.index(name) for name in PARTS["legs"]]
    np.testing.assert_allclose(both.body_pose[legs], Motion.read("walk").sequence[50].body_pose[legs])
    raised = BODY_JOINTS.index("right_shoulder")
    np.testing.assert_allclose(both.body_pose[raised], Motion.read("wave").sequence[50].body_pose[raised])
    assert "wave drives right arm, right hand, lids, upper face and mouth;" in caplog.text
    studio.open_motion("idle")
    assert "idle drives the whole body and lids, below wave;" in caplog.text


def test_a_motion_of_one_frame_drives_its_hands(tmp_path):
    frame = Signals.rest().replace(left_hand_pose=named_hand("fist", "left"))
    write_json(tmp_path / "fist.json", SignalSequence((frame,), 24.0, "fist"))
    assert Motion.read(tmp_path / "fist.json").parts == ("left hand",)


def test_set_key_over_a_motion_keys_what_was_posed_and_no_relaxed_hand(clock):
    studio = ball_studio(clock, journal=Journal(StudioState(signals=standing())))
    studio.open_motion("walk")
    studio.go_to(20)
    studio.do(SetExpression("jawOpen", 0.5))
    studio.do(SetJoint("left_index1", (0.0, 0.0, -0.4)))
    studio.set_key()
    assert {track.name for track in studio.state.timeline.layers[-1].tracks} == {"jawOpen", "left_index1"}


def test_set_key_over_a_motion_without_its_file_keys_what_was_posed_and_says_what_not(
    studio, motions, tmp_path, caplog
):
    """Else the pose that the motion gave last would be keys for ever, also over the file when it is there again."""
    studio.open_motion(motions["body"])
    studio.go_to(5)
    moved = (tmp_path / "body.json").rename(tmp_path / "moved.json")
    studio.clips.forget()
    studio.do(SetExpression("jawOpen", 0.9))
    assert studio.clips.silent(studio.state.timeline)
    before = studio.state.signals
    caplog.clear()
    studio.set_key()
    (line,) = caplog.messages
    assert line.startswith("no keys of what body.json drives (")
    assert "cannot be read; select a part" in line
    keys = studio.state.timeline.layers[-1]
    assert {track.name for track in keys.tracks} == {"jawOpen"}
    assert studio.state.signals == before
    studio.do(Select(ELBOW))
    studio.set_key()
    assert {track.name for track in studio.state.timeline.layers[-1].tracks} == {"jawOpen", ELBOW}
    assert len(caplog.messages) == 1
    studio.undo()
    moved.rename(tmp_path / "body.json")
    studio.clips.retry()
    studio.go_to(3)
    assert elbow(studio.state) == pytest.approx(-0.3), "the motion drives as before"


def test_the_body_of_a_session_of_before_is_torso_arms_and_legs_and_its_expression_lids_too():
    layer = Layer.from_json({"name": "a", "parts": ["body", "mouth"]})
    assert layer.parts == {"torso", "left arm", "right arm", "legs", "mouth"}
    assert Layer.from_json({"name": "a", "parts": ["expression"]}).parts == {"lids", "upper face"}
    assert driven_words(layer.parts) == "torso, left arm, right arm, legs and mouth"
    assert driven_words(()) == "nothing"


def test_a_clip_that_is_added_shows_its_frame_and_no_mixture_with_what_was_posed(studio, motions):
    studio.open_motion(motions["body"])
    studio.go_to(5)
    studio.do(SetJoint("right_knee", (0.7, 0.0, 0.0)))
    assert joint(studio.state.signals, "right_knee")[0] == pytest.approx(0.7)
    studio.add_motion(motions["face"])
    added = studio.state.signals
    studio.go_to(6)
    studio.go_to(5)
    assert studio.state.signals == added


def test_a_new_name_of_a_clip_leaves_what_was_posed(layered):
    layered.go_to(5)
    layered.do(SetJoint(ELBOW, (0.0, -0.9, 0.0)))
    layered.do(edits.RenameLayer("body.json", "Walk"))
    assert elbow(layered.state) == pytest.approx(-0.9)


def test_the_first_key_over_a_clip_without_its_file_changes_only_what_it_keys(studio, motions, tmp_path):
    """Without any layer what the sliders say is shown again."""
    studio.open_motion(motions["body"])
    studio.go_to(5)
    (tmp_path / "body.json").unlink()
    studio.clips.forget()
    studio.do(SetExpression("jawOpen", 0.9))
    before = studio.state.signals
    studio.do(edits.AddLayer(Layer("Keys")))
    assert studio.state.signals == before
    studio.do(edits.SetKeys("Keys", (("jawOpen", 0.5, (0.4,), "linear"),)))
    assert (elbow(studio.state), jaw(studio.state)) == pytest.approx((-0.5, 0.4))
    for name in ("Keys", "body.json"):
        studio.do(edits.RemoveLayer(name))
    assert (elbow(studio.state), jaw(studio.state)) == pytest.approx((0.0, 0.9))


def test_a_layer_too_many_is_refused_and_nothing_more_is_said_of_it(studio, motions, caplog):
    for k in range(MOST_LAYERS):
        studio.do(edits.AddLayer(Layer(f"Keys {k}")))
    with caplog.at_level(logging.INFO):
        studio.add_motion(motions["face"])
    assert f"{MOST_LAYERS}" in caplog.text
    assert "drives" not in caplog.text
