"""Several avatars side by side: state, commands, what is computed again, pictures of all."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.engine.live import LiveSurface
from avatarrex_studio.engine.passes import nearest, passes
from avatarrex_studio.engine.pictures import Subject
from avatarrex_studio.engine.request import Request, Seen
from avatarrex_studio.engine.staging import in_light, over_stage
from avatarrex_studio.engine.work import summed
from avatarrex_studio.engine.worker import answered
from avatarrex_studio.panels.projection import Projection
from avatarrex_studio.session import posing
from avatarrex_studio.session.commands import (
    AddFigure,
    ApplyPose,
    Command,
    OpenAvatar,
    PlaceFigure,
    RemoveFigure,
    SelectFigure,
    SetCamera,
    SetHidden,
    SetJoint,
    SetLevel,
    SetStage,
    SetTranslation,
)
from avatarrex_studio.session.evaluation import state_at
from avatarrex_studio.session.figures import MOST_FIGURES, Place, standing
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.session.timeline import Clip, Layer, Timeline
from avatarrex_studio.session.timeline_commands import (
    AddLayer,
    CloseMotion,
    RemoveLayer,
    SetFrame,
    SetLayer,
    SetTimeline,
)
from ball import render_ball
from imgui_bundle import imgui
from surface.template_surface import template_surface

from avatarrex.avatar import Avatar
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence
from avatarrex.signals.skeleton import Skeleton
from avatarrex.surface.raster import surface_geometry
from avatarrex.templates.figure import Figure as Posed
from avatarrex.templates.person import load_person

SIZE = (72, 48)
TURNED = Place(70.0, -0.4, 0.3)


def two(level: str = "balanced") -> StudioState:
    """One that waves behind one that stands, in part hidden by it."""
    state = StudioState(signals=standing(), level=level)
    for command in (
        PlaceFigure(Place(20.0, -0.3, -0.2)), ApplyPose("wave"), AddFigure("default", Place(-40.0, -0.1, 0.3)), SetCamera(distance=2.9),
    ):  # fmt: skip
        state = command.apply(state)
    return state


@pytest.fixture(scope="module")
def avatar():
    made = Avatar.create(load_person("default"), "compact")
    made.surface = template_surface()
    return made


def test_a_lone_figure_is_written_as_before():
    state = ApplyPose("wave").apply(StudioState())
    data = state.to_json()
    assert data["format"] == 5
    assert not {"place", "others", "slot"} & set(data)
    assert StudioState.from_json(json.loads(json.dumps(data))) == state
    assert two().to_json()["format"] == 6
    assert state.each() == (state,)
    assert state.each()[0] is state


def test_a_state_of_several_survives_json_and_refuses_what_cannot_be():
    state = SelectFigure(0).apply(two())
    data = json.loads(json.dumps(state.to_json()))
    assert StudioState.from_json(data) == state
    for wrong, named in (
        ({"slot": 2}, "slot"), ({"slot": "one"}, "slot"), ({"place": {"turn": 400}}, "turn"),
        ({"others": data["others"] * MOST_FIGURES}, "at most 8"), ({"others": [{"hat": 1}]}, "hat"), ({"others": 3}, "a state"),
        ({"others": [{"hidden": ["tail"]}]}, "hidden"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=named):
            StudioState.from_json({**data, **wrong})


def test_selecting_changes_what_is_edited_and_nothing_that_is_seen():
    state = two()
    first = SelectFigure(0).apply(state)
    assert (first.slot, state.slot) == (0, 1)
    assert first.figures == state.figures
    assert Subject.of(first, SIZE) == Subject.of(state, SIZE)
    assert np.array_equal(first.signals.body_pose, state.figures[0].signals.body_pose)
    edited = SetJoint("left_knee", (0.4, 0.0, 0.0)).apply(first)
    assert edited.figures[1] == state.figures[1]
    assert edited.figures[0] != state.figures[0]
    assert SelectFigure(1).apply(edited).figures == edited.figures


def test_figures_are_added_removed_and_come_back(tmp_path):
    journal = Journal(StudioState(signals=standing()))
    for command in (
        AddFigure("default"),
        AddFigure("other.avatar"),
        PlaceFigure(TURNED),
        SelectFigure(1),
        SetHidden("face", True),
    ):
        journal.do(command)
    assert [figure.place.x for figure in journal.state.figures] == [0.0, 1.0, -0.4], "each beside the others"
    assert [figure.hidden for figure in journal.state.figures] == [frozenset(), {"face"}, frozenset()]
    journal.save(tmp_path / "a.json")
    assert Journal.load(tmp_path / "a.json").state == journal.state
    before = journal.state
    for index, slot, left in ((0, 0, 2), (1, 0, 1)):
        journal.do(RemoveFigure(index))
        assert (journal.state.slot, len(journal.state.figures)) == (slot, left)
    assert journal.state.hidden == {"face"}, "the selected one stays selected"
    with pytest.raises(InputError, match="one of several"):
        journal.do(RemoveFigure(0))
    journal.undo()
    assert journal.undo() == before
    with pytest.raises(InputError, match="one of 0 to 2"):
        journal.do(SelectFigure(3))
    while journal.steps:
        journal.undo()
    assert journal.state == StudioState(signals=standing())


def test_a_place_is_a_rigid_motion_of_the_whole_body():
    """Vertices of the placed signals against vertices of the own ones, moved."""
    body = load_person("default").body
    own = standing().replace(global_orient=np.array([0.2, 0.5, -0.1]), translation=np.array([0.3, 0.1, -0.2]))
    pelvis = Posed(body, own).skeleton.joints[0]
    world = TURNED.world(pelvis)
    expected = Posed(body, own).vertices @ world[:3, :3].T + world[:3, 3]
    np.testing.assert_allclose(Posed(body, TURNED.signals(own)).vertices, expected, atol=2e-6)
    assert np.allclose(world[:3, :3] @ [0, 0, 1], [np.sin(np.radians(70)), 0, np.cos(np.radians(70))])
    assert Place().signals(own) is own


def test_a_step_of_a_motion_carries_the_view_where_the_figure_goes():
    state = PlaceFigure(Place(90.0, 0.0, 0.0)).apply(StudioState())
    went = state.show(state.timeline, state.signals.replace(translation=np.array([0.0, 0.0, 0.5])))
    assert np.subtract(went.view.target, state.view.target) == pytest.approx([0.5, 0.0, 0.0])


def test_a_figure_that_stays_is_not_computed_again(avatar):
    engine, state = Engine(avatar=avatar), two("fast")
    camera = state.view.camera(*SIZE)
    first = engine.frames(state, camera)
    assert all(frame.counters["voxels_evaluated"] and frame.counters["rays"] for frame in first)
    bent = SetJoint("left_elbow", (0.0, -0.9, 0.0)).apply(state)
    still, moved = engine.frames(bent, camera)
    assert not any(still.counters[name] for name in ("templates_posed", "voxels_evaluated", "rays", "pixels_shaded"))
    assert moved.counters["voxels_evaluated"] > 0 < moved.counters["rays"]
    again = engine.frames(SelectFigure(0).apply(bent), camera)
    assert not any(frame.counters["rays"] or frame.counters["pixels_shaded"] for frame in again)
    carried = engine.frames(PlaceFigure(Place(-40.0, 0.0, 0.3)).apply(bent), camera)
    assert not carried[1].counters["voxels_evaluated"], "a place is no pose"
    assert carried[1].counters["rays"] > 0 == carried[0].counters["rays"]


def test_an_engine_keeps_the_avatars_of_its_state():
    read = []

    def load(name, device):
        read.append(name)
        return replace(Avatar.create(load_person("default"), "compact"), meta={"name": name})

    engine = Engine(load=load, render=render_ball)
    state = AddFigure("b", Place()).apply(StudioState(avatar="a"))
    for each in (state, state, SelectFigure(0).apply(state), OpenAvatar("c").apply(state), state):
        engine.render(each, SIZE)
    assert read == ["a", "b", "c", "b"]


def test_an_engine_reads_an_avatar_again_that_was_trained_anew(tmp_path):
    """Under its path; one whose file is gone for a moment stays."""
    path, read = tmp_path / "a.avatar", []

    def load(name, device):
        read.append(name)
        return Avatar.create(load_person("default"), "compact")

    engine, state = Engine(load=load, render=render_ball), StudioState(avatar=str(path))
    path.write_bytes(b"one")
    for content, times in ((None, 1), (b"trained anew", 2), (None, 2), (b"", 3)):
        if content is not None:
            path.write_bytes(content)
        assert engine.render(state, SIZE).error is None
        assert len(read) == times
    path.unlink()
    assert engine.render(state, SIZE).error is None
    assert len(read) == 3


def test_avatars_that_nobody_shows_are_let_go_of():
    read = []
    avatars = Avatars(lambda name: read.append(name) or object.__new__(Avatar))
    for name in ("a", "b"):
        avatars.get(name)
    assert [one is not None for one in avatars.all_ready(["a", "b", "a"])] == [True] * 3
    avatars.all_ready(["a"])
    avatars.get("b")
    assert read == ["a", "b", "b"]


def test_the_exact_picture_shows_the_nearer_before_the_farther(avatar):
    engine, state = Engine(avatar=avatar), two("fast")
    frames = engine.frames(state, state.view.camera(*SIZE))
    depth, figure = nearest(frames)
    both = (frames[0].pointmap.hit & frames[1].pointmap.hit).numpy()
    assert both.sum() > 20, "one is in part hidden by the other"
    assert (figure[both] == 1).mean() > 0.9
    picture = in_light(frames, state).image.numpy()
    whole = frames[1].image[..., 3].numpy() == 1
    inside = both & whole & (figure == 1)
    assert np.array_equal(picture[inside], frames[1].image.numpy()[inside])
    alone = (frames[1].image[..., 3] == 0).numpy()
    assert np.array_equal(picture[alone], frames[0].image.numpy()[alone])
    made = passes(frames, ("depth", "mask", "position"))
    assert np.array_equal(made["depth"], depth)
    _, z = state.view.camera(*SIZE).pixels(made["position"][made["hit"]].astype(float))
    assert z == pytest.approx(depth[made["hit"]], abs=1e-4)
    assert made["mask"] == pytest.approx(picture[..., 3], abs=1e-5)
    answer = answered(engine, Request(state, SIZE)).picture
    assert np.array_equal(answer.figure, figure)
    assert answer.work.counters["rays"] == 0, "all was there"
    assert answer.work.counters["surface_triangles"] == 0
    assert summed(frames)["counters"]["rays"] == 2 * SIZE[0] * SIZE[1]


def test_a_replay_gives_the_window_s_picture(avatar, tmp_path):
    """On a stage, at an exact level and at `live`; another engine, and the other figure selected."""
    for level in ("fast", "live"):
        journal = Journal(StudioState(signals=standing()))
        for command in (
            AddFigure("default", Place(-40.0, 0.15, 0.3)), ApplyPose("wave"), SelectFigure(0), PlaceFigure(Place(20.0, -0.3, -0.2)),
            SetCamera(distance=3.4), SetStage("shown", True), SetLevel(level),
        ):  # fmt: skip
            journal.do(command)
        journal.save(tmp_path / "a.json")
        again = SelectFigure(1).apply(Journal.load(tmp_path / "a.json").state)
        first, second = (
            over_stage(in_light(Engine(avatar=avatar).frames(state, state.view.camera(*SIZE)), state), state).astype(
                int
            )
            for state in (journal.state, again)
        )
        assert np.abs(first - second).max() <= 1
        alone = RemoveFigure(1).apply(journal.state)
        other = over_stage(in_light(Engine(avatar=avatar).frames(alone, alone.view.camera(*SIZE)), alone), alone)
        assert (np.abs(other.astype(int) - first).max(-1) > 20).sum() > 50


def test_live_draws_all_of_them_and_knows_whose_a_point_is(avatar):
    live, state = LiveSurface(), two("live")
    both = live.draw([avatar, avatar], state, SIZE).read()
    image = in_light(Engine(avatar=avatar).frames(state, state.view.camera(*SIZE)), state).image.numpy()
    assert np.array_equal(both, image), "what files get"
    found = {
        live.point(column, row).figure for row in range(48) for column in range(0, 72, 5) if live.point(column, row)
    }
    assert found == {0, 1}
    frames = Engine(avatar=avatar).frames(state, state.view.camera(*SIZE))
    depth = [np.where(seen.hit, seen.depth, np.inf) for seen in (surface_geometry(f.posed, f.view) for f in frames)]
    row, column = np.argwhere(np.isfinite(depth[0]) & np.isfinite(depth[1]))[5].tolist()
    assert live.point(column, row).figure == int(depth[1][row, column] < depth[0][row, column])
    alone = live.draw([None, avatar], state, SIZE).read()
    assert alone[..., 3].sum() < both[..., 3].sum(), "one is not read yet"
    assert live.draw([None, None], state, SIZE) is None
    assert live.draw([avatar, replace(avatar, surface=None)], state, SIZE) is None


def test_a_figure_throws_its_shadow_on_the_floor_and_on_the_other(avatar):
    """By a light from the side the one is between the light and the other."""
    state = two("fast")
    for command in (
        PlaceFigure(Place(0.0, 0.25, 0.0)), SelectFigure(0), PlaceFigure(Place(0.0, -0.25, 0.0)), SetStage("shown", True),
        SetStage("azimuth", 90.0), SetStage("elevation", 25.0), SetStage("shadow", 1.0),
    ):  # fmt: skip
        state = command.apply(state)
    engine, camera = Engine(avatar=avatar), state.view.camera(*SIZE)
    together, alone = (in_light(engine.frames(each, camera), each) for each in (state, RemoveFigure(1).apply(state)))
    first = engine.frames(state, camera)[0]
    inside = (first.pointmap.hit & ~engine.frames(state, camera)[1].pointmap.hit).numpy()
    darker = together.image.numpy()[inside, :3].sum() / alone.image.numpy()[inside, :3].sum()
    assert darker < 0.95
    assert together.floor.region[2] > alone.floor.region[2] + 0.3


def write_walk(path, frames: int) -> str:
    """A motion that goes a centimetre a frame, 30 a second."""
    went = tuple(Signals.rest().replace(translation=np.array([0.0, 0.0, 0.01 * k])) for k in range(frames))
    write_json(path, SignalSequence(went, 30.0, path.stem))
    return str(path)


def test_one_playhead_moves_all_of_them(studio, tmp_path):
    """A motion of six frames and one of four, which repeats; in the journal, in a video's states, undone together."""
    studio.open_motion(write_walk(tmp_path / "long.json", 6))
    studio.do(AddFigure("default", Place(90.0, 1.0, 0.0)))
    studio.open_motion(write_walk(tmp_path / "short.json", 4))
    studio.do(SelectFigure(0))
    walked = studio.state
    studio.toggle_play()
    for frame, short in ((3, 0.03), (5, 0.01)):
        studio.go_to(frame, studio.playback.gesture)
        first, second = studio.state.figures
        assert (first.timeline.frame, first.signals.translation[2]) == (frame, pytest.approx(0.01 * frame))
        assert (second.timeline.frame, second.signals.translation[2]) == (frame, pytest.approx(short))
        assert studio.state.each()[1].signals.translation == pytest.approx([1 + short, 0, 0], abs=1e-9), (
            "to where it looks"
        )
        made = state_at(walked, frame / 30, studio.clips)
        assert made.figures == studio.state.figures
    studio.playback.playing = False
    studio.journal.save(tmp_path / "a.json")
    assert Journal.load(tmp_path / "a.json").state == studio.state
    studio.undo()
    assert studio.state.figures == walked.figures
    studio.do(SelectFigure(1))
    assert len(studio.journal.steps[-2].commands) == 1, "selected at a time, not at each frame"


def two_walks(studio, tmp_path, first: int = 6, second: int = 4):
    """Two figures that walk, the first of which is selected."""
    studio.open_motion(write_walk(tmp_path / "first.json", first))
    studio.do(AddFigure("default"))
    studio.open_motion(write_walk(tmp_path / "second.json", second))
    studio.do(SelectFigure(0))


def steps_of(studio) -> list[float]:
    """How far each has gone, centimetres."""
    return [round(100 * figure.signals.translation[2], 6) for figure in studio.state.figures]


def test_whatever_moves_the_playhead_moves_all_of_them(studio, tmp_path):
    """A motion that is read, one that is closed, a rate, and the way back over them."""
    two_walks(studio, tmp_path)
    at = Motion.read(write_walk(tmp_path / "third.json", 9))
    for command in (at.loaded(), CloseMotion()):
        studio.go_to(3)
        assert steps_of(studio) == [3, 3]
        studio.do(command)
        assert studio.state.timeline.frame == 0
        assert steps_of(studio)[1] == 0
        assert len({figure.timeline.seconds for figure in studio.state.figures}) == 1
        again = Journal.from_json(json.loads(json.dumps(studio.journal.to_json())))
        assert again.state == studio.state
        studio.undo()
        assert steps_of(studio) == [3, 3]
    studio.do(RemoveLayer("first.json"))
    studio.go_to(2)
    assert steps_of(studio)[1] == 2
    studio.do(at.layer())
    assert steps_of(studio)[1] == 0, "a first layer brings the playhead to its beginning"


def test_what_was_edited_of_another_stays_where_the_playhead_does(studio, tmp_path):
    two_walks(studio, tmp_path)
    studio.do(SelectFigure(1))
    studio.do(SetTranslation((0.0, 0.5, 0.0)))
    studio.do(SelectFigure(0))
    studio.do(SetLayer("first.json", weight=0.5))
    studio.do(SetFrame(0))
    assert studio.state.figures[1].signals.translation[1] == 0.5


def frame_of(studio, frame: int) -> StudioState:
    """Of a video at 30 a second."""
    return state_at(studio.state, frame / 30, studio.clips)


def test_a_video_has_the_layers_of_all_also_at_the_playhead(studio, tmp_path):
    """An edit that has no key is in no frame, whoever was edited."""
    two_walks(studio, tmp_path)
    studio.do(SelectFigure(1))
    studio.go_to(2)
    for place, slot in enumerate((0, 1)):
        studio.do(SetTranslation((0.0, 0.5, 0.0)))
        studio.do(SelectFigure(slot))
        steps = [
            [round(100 * each.signals.translation[2], 6) for each in frame_of(studio, frame).figures]
            for frame in range(4)
        ]
        assert steps == [[0, 0], [1, 1], [2, 2], [3, 3]], place


def test_all_play_until_the_longest_ends(studio, tmp_path):
    """Whoever is selected: the shorter one holds its last frame, or begins again where it repeats."""
    two_walks(studio, tmp_path)
    for slot in (0, 1):
        studio.do(SelectFigure(slot))
        assert (studio.state.frames, studio.state.played) == (6, (0, 5))
        studio.go_to(99)
        assert studio.state.timeline.frame == 5
        assert steps_of(studio) == [5, 1]
        shown = [figure.signals for figure in studio.state.figures]
        assert [figure.signals for figure in frame_of(studio, 5).figures] == shown
        studio.go_to(2)
        assert [figure.signals for figure in frame_of(studio, 5).figures] == shown
        studio.go_to(5)
    studio.do(SetTimeline(loop=False))
    assert steps_of(studio) == [5, 3], "its last frame stays"
    studio.do(SelectFigure(0))
    studio.go_to(4)
    assert steps_of(studio) == [4, 3]
    studio.do(SetTimeline(span=(1, 3)))
    assert studio.state.played == (1, 3), "the range of the selected one"


def test_keys_beyond_the_end_of_a_motion_that_repeats_are_set_in_its_round(studio, tmp_path):
    """The shorter of two walks: four frames again and again. A key at its sixth frame lies at the second, and the walk goes on."""
    two_walks(studio, tmp_path)
    studio.do(SelectFigure(1))
    for recording, frame in ((False, 5), (True, 4)):
        studio.go_to(frame)
        studio.take.recording = recording
        studio.do(SetJoint("left_knee", (frame / 10, 0.0, 0.0)))
        if not recording:
            studio.set_key()
        times = [key.time for key in studio.state.timeline.layer("Keys").track("left_knee").keys]
        assert min(times) == pytest.approx((frame - 4) / 30)
        assert studio.state.timeline.frames == 4
        assert steps_of(studio) == [frame, frame - 4]
        assert posing.joint(studio.state.signals, "left_knee")[0] == pytest.approx(frame / 10)


def test_keys_beyond_the_end_of_what_does_not_repeat_lie_at_the_playhead(studio, tmp_path):
    """Of keys alone, or of a motion that holds its last frame: so the shorter one is posed along the longer one's motion."""
    studio.open_motion(write_walk(tmp_path / "long.json", 500))
    studio.do(AddFigure("default"))
    for frame, motion in ((400, ""), (450, write_walk(tmp_path / "short.json", 4))):
        if motion:
            studio.add_motion(motion)
            studio.do(SetTimeline(loop=False))
        studio.go_to(frame)
        studio.do(SetJoint("left_knee", (frame / 1000, 0.0, 0.0)))
        studio.set_key()
        assert studio.state.timeline.layer("Keys").track("left_knee").keys[-1].time == pytest.approx(frame / 30)
        assert posing.joint(studio.state.signals, "left_knee")[0] == pytest.approx(frame / 1000)


@pytest.mark.parametrize("layer", [None, Layer("gone", Clip("gone.bvh", "gone", 9, 30.0))], ids=("empty", "unreadable"))
def test_the_playhead_stays_where_it_is_whoever_is_selected(studio, tmp_path, layer):
    """Also with one whom it has not moved, for its layers give nothing."""
    studio.open_motion(write_walk(tmp_path / "first.json", 20))
    studio.do(AddFigure("default"))
    if layer:
        studio.do(AddLayer(layer))
    studio.do(SelectFigure(0))
    for frame in (15, 7):
        studio.go_to(frame)
        shown = [figure.signals for figure in studio.state.figures]
        for slot in (1, 0, 1):
            studio.do(SelectFigure(slot))
            assert studio.state.timeline.frame == frame, slot
        assert [figure.signals for figure in studio.state.figures] == shown
        studio.do(SelectFigure(0))
    studio.go_to(9)
    studio.do(RemoveFigure(0))
    assert (len(studio.state.figures), studio.state.timeline.frame) == (1, 9)


def test_selecting_there_and_back_leaves_the_playhead_at_its_frame(studio, tmp_path):
    """At every frame of a rate that another's frames fall between."""
    studio.open_motion(write_walk(tmp_path / "first.json", 20))
    studio.do(AddFigure("default"))
    studio.do(SetTimeline(fps=12.0))
    studio.do(SelectFigure(0))
    for frame in range(20):
        studio.go_to(frame)
        studio.do(SelectFigure(1))
        assert abs(studio.state.timeline.seconds - frame / 30) <= 0.5 / 12 + 1e-9
        studio.do(SelectFigure(0))
        assert studio.state.timeline.frame == frame


def test_one_who_is_added_begins_where_the_playhead_is(studio, tmp_path):
    two_walks(studio, tmp_path)
    studio.go_to(3)
    studio.do(AddFigure("default"))
    assert {figure.timeline.seconds for figure in studio.state.figures} == {0.1}
    assert studio.state.frames == 6, "nothing of it lasts longer"
    studio.do(SetTimeline(fps=60.0))
    studio.do(AddFigure("default"))
    assert (studio.state.timeline.fps, studio.state.timeline.frame) == (60.0, 6)
    again = Journal.from_json(json.loads(json.dumps(studio.journal.to_json())))
    assert again.state == studio.state


def test_one_who_was_added_in_a_session_of_before_has_its_rate_and_frame():
    """What follows in that session counts in them."""
    state = StudioState(timeline=Timeline(fps=24.0, frame=5))
    added = Command.from_json({"command": "AddFigure", "avatar": "default", "place": None, "signals": None})
    assert (added.apply(state).timeline.fps, added.apply(state).timeline.frame) == (30.0, 0)
    for wrong in ({"fps": "fast"}, {"frame": -1}, {"frame": 1.5}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            Command.from_json({"command": "AddFigure", "avatar": "default", **wrong}).apply(state)


def test_a_playback_ends_with_the_longest(studio, clock, tmp_path):
    two_walks(studio, tmp_path, 4, 6)
    studio.do(SetTimeline(loop=False))
    studio.toggle_play()
    shown = []
    for _ in range(9):
        clock.now += 1 / 30 + 1e-6
        studio.tick((64, 64))
        shown.append((studio.state.timeline.frame, *steps_of(studio)))
    assert shown[2:6] == [(3, 3, 3), (4, 3, 4), (5, 3, 5), (5, 3, 5)]
    assert not studio.playback.playing


def test_a_frame_without_others_is_written_as_before():
    assert "others" not in SetFrame(3).to_json()
    assert Command.from_json(SetFrame(3).to_json()) == SetFrame(3)
    given = SetFrame(3, others=(None, standing()))
    assert Command.from_json(json.loads(json.dumps(given.to_json()))) == given
    with pytest.raises(InputError, match="signals of 1 figures"):
        given.apply(two())


def test_framing_covers_all_of_them(studio):
    for command in (AddFigure("default", Place(x=2.0)), SelectFigure(0)):
        studio.do(command)
    studio.frame_person((400, 300))
    camera = studio.state.view.camera(400, 300)
    for own in studio.state.each():
        points = Posed(load_person("default").body, own.signals).vertices
        pixels, _ = camera.pixels(points.astype(float))
        assert pixels.min() > 0
        assert pixels[:, 0].max() < 400


def test_tools_work_where_the_figure_stands(studio):
    """What is seen in the world is dragged, picked and looked at in the frame of the place."""
    studio.do(PlaceFigure(TURNED))
    figure, world = studio.figure, studio.world
    hand = figure.posed.position[JOINT_NAMES.index("left_wrist")]
    seen = world[:3, :3] @ hand + world[:3, 3]
    assert studio.own(tuple(seen)) == pytest.approx(tuple(hand), abs=1e-9)
    placed = Skeleton(figure.skeleton.joints, figure.skeleton.parents).posed(studio.state.each()[0].signals)
    assert placed.position[JOINT_NAMES.index("left_wrist")] == pytest.approx(seen, abs=1e-6)
    projection = Projection.of(studio.state.view, imgui.ImVec2(0, 0), imgui.ImVec2(300, 200), world)
    assert projection.screen(hand) == pytest.approx(
        studio.state.view.camera(300, 200).pixels(seen[None])[0][0], abs=1e-6
    )
    studio.surface, studio.live = SimpleNamespace(texture=SimpleNamespace(size=(9, 9))), SimpleNamespace()
    studio.live.point = lambda column, row: Seen(tuple(seen), 0)
    assert studio.part_at(0.5, 0.5).startswith("left_")
    studio.live.point = lambda column, row: Seen(tuple(seen), 1)
    assert studio.part_at(0.5, 0.5) is None, "another figure"


def test_selecting_while_something_is_recorded_makes_no_keys(studio):
    studio.do(ApplyPose("wave"))
    studio.toggle_recording()
    for command in (AddFigure("default"), SelectFigure(0)):
        studio.do(command)
    assert not any(figure.timeline.layers for figure in studio.state.figures)
    studio.do(SetJoint("left_knee", (0.4, 0.0, 0.0)))
    assert [len(figure.timeline.layers) for figure in studio.state.figures] == [1, 0]
