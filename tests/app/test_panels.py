"""Panels with the toolkit alone, no window: what a mouse does to them comes back as commands."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from avatarrex_studio.engine.request import Request, Seen
from avatarrex_studio.jobs.task import Outcome, Task
from avatarrex_studio.jobs.watcher import Watcher
from avatarrex_studio.live.listening import Listening
from avatarrex_studio.panels import camera, keys, performance, render, scene, theme, viewport, widgets
from avatarrex_studio.panels.capture_tools import CaptureTools
from avatarrex_studio.panels.face import face_panel
from avatarrex_studio.panels.files import FileDialog
from avatarrex_studio.panels.hands import HandPanel
from avatarrex_studio.panels.joints import body_panel
from avatarrex_studio.panels.keys import chord
from avatarrex_studio.panels.motion_import import MotionImport
from avatarrex_studio.panels.poses import PosesPanel, shipped_entries
from avatarrex_studio.panels.projection import Projection
from avatarrex_studio.panels.questions import nothing
from avatarrex_studio.panels.task_report import TaskReport
from avatarrex_studio.panels.timeline import TimelinePanel
from avatarrex_studio.panels.training import TrainingPanel
from avatarrex_studio.panels.viewport import Shown, ViewportPanel, preparing
from avatarrex_studio.panels.warp_editor import HEIGHT, WarpEditor
from avatarrex_studio.session import posing
from avatarrex_studio.session.actions import ACTIONS
from avatarrex_studio.session.commands import (
    AddFigure,
    Blend,
    OrbitBy,
    PanBy,
    Pin,
    PullHandle,
    ResetGroup,
    ScaleGroup,
    Select,
    SelectFigure,
    SetExpression,
    SetHandPose,
    SetJoint,
    ZoomBy,
)
from avatarrex_studio.session.grip import places
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.recent import Recent
from avatarrex_studio.session.state import LEVELS, OrbitView, StudioState
from avatarrex_studio.session.timeline import Layer
from avatarrex_studio.session.timeline_commands import AddLayer
from avatarrex_studio.window.opening import Opening
from avatarrex_studio.window.window import Window
from ball_studio import ball_studio
from imgui_bundle import imgui
from surface.template_surface import template_surface

from avatarrex.reference.level_errors import LevelError
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.signals.library import named_pose
from avatarrex.stage.stage import COLOUR, GRADIENT, Stage


class Screen:
    """One imgui window of 400 × 3000 points and a mouse."""

    def __init__(self) -> None:
        self.io = imgui.get_io()
        self.io.display_size = imgui.ImVec2(400, 3000)
        self.io.set_ini_filename("")
        self.io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
        self.seconds = 0.1

    def frame(self, draw):
        """One interface frame; what `draw` returned."""
        self.io.delta_time = self.seconds
        imgui.new_frame()
        imgui.set_next_window_pos(imgui.ImVec2(0, 0))
        imgui.set_next_window_size(imgui.ImVec2(400, 3000))
        imgui.begin("panel", None, imgui.WindowFlags_.no_decoration)
        commands = list(draw() or ())
        imgui.end()
        imgui.render()
        return commands

    def drag(self, draw, start, end, button=0):
        """Press at `start`, move to `end`, release; all the commands."""
        commands = []
        for position, pressed in ((start, None), (start, True), (end, None), (end, None), (end, False)):
            self.io.add_mouse_pos_event(*position)
            if pressed is not None:
                self.io.add_mouse_button_event(button, pressed)
            commands += self.frame(draw)
        return commands


@pytest.fixture
def screen():
    context = imgui.create_context()
    yield Screen()
    imgui.destroy_context(context)


def reader(studio):
    """What reads motions for a timeline."""
    return Opening(studio, object.__new__(TrainingPanel))


def find(screen, draw, wanted):
    """Where the mouse must be for a drag to the right to give a command that `wanted` accepts."""
    screen.frame(draw)
    for y in range(12, 1500, 9):
        for x in (150, 250, 350):
            commands = [command for command in screen.drag(draw, (x, y), (x + 8, y)) if wanted(command)]
            if commands:
                return commands
    raise AssertionError("no such widget")


def test_every_joint_and_coefficient_has_its_slider(monkeypatch, screen):
    state, ids = StudioState(limit_joints=False), []
    real = imgui.drag_float

    def spy(label, *arguments):
        ids.append(label.removeprefix("##"))
        return real(label, *arguments)

    monkeypatch.setattr(imgui, "drag_float", spy)
    for panel in (body_panel(), HandPanel("left"), HandPanel("right"), face_panel()):
        panel.above = lambda state, group: ()
        screen.frame(lambda panel=panel: panel.draw(state))
    joints = [f"{name}.{axis}" for name in JOINT_NAMES for axis in "xyz"]
    assert sorted(ids) == sorted([*joints, *EXPRESSION_NAMES, *(f"translation.{axis}" for axis in "xyz")])


def test_a_slider_that_is_dragged_sets_its_joint_in_radians(screen):
    panel, state = body_panel(), StudioState()
    (command, *_) = find(screen, lambda: panel.draw(state), lambda command: isinstance(command, SetJoint))
    low, high = (math.degrees(bound) for bound in (-math.pi, math.pi))
    assert command.joint == "pelvis"
    assert any(command.rotation)
    assert all(low <= math.degrees(value) <= high for value in command.rotation)


def test_a_double_click_resets_a_slider(screen):
    panel = face_panel()
    panel.search = "jaw open"
    state = SetExpression("jawOpen", 0.7).apply(StudioState())
    commands = find(screen, lambda: panel.draw(state), lambda command: isinstance(command, SetExpression))
    assert commands[-1].name == "jawOpen"
    place = tuple(screen.io.mouse_pos)
    screen.seconds = 0.02
    clicks = screen.drag(lambda: panel.draw(state), place, place) + screen.drag(lambda: panel.draw(state), place, place)
    assert clicks[-1] == SetExpression("jawOpen", 0.0)


def test_the_strength_of_a_region_goes_on_from_frame_to_frame(screen):
    """A drag in five moves: the factors add up, and a drag back is no change."""
    panel = face_panel()
    find(screen, lambda: panel._strength("mouth"), lambda command: isinstance(command, ScaleGroup))
    x, y = screen.io.mouse_pos
    factors = []
    for place, pressed in ((x, None), (x, True), *((x + step, None) for step in (20, 40, 60, 30, 0)), (x, False)):
        screen.io.add_mouse_pos_event(place, y)
        if pressed is not None:
            screen.io.add_mouse_button_event(0, pressed)
        factors += [
            each.factor for each in screen.frame(lambda: panel._strength("mouth")) if isinstance(each, ScaleGroup)
        ]
    steps = np.diff([1.0, *factors])
    assert len(factors) == 5
    assert steps[:3] == pytest.approx(steps[0], abs=0.011)
    assert factors[2] > 1.15
    assert factors[-1] == pytest.approx(1.0, abs=0.011)
    assert screen.frame(lambda: panel._strength("mouth")) == []


def test_search_narrows_the_list(screen, monkeypatch):
    shown = []
    monkeypatch.setattr("avatarrex_studio.panels.joints.joint_row", lambda state, name, group: shown.append(name) or [])
    panel = body_panel()
    panel.search = "left elb"
    screen.frame(lambda: panel.draw(StudioState()))
    assert shown == ["left_elbow"]


@pytest.mark.parametrize(("width", "form"), [(600, "bend %.0f°"), (250, "%.0f°")])
def test_a_narrow_slider_shows_its_number_whole(screen, monkeypatch, width, form):
    """Without the axis, which its colour and tooltip say."""
    forms = {}
    monkeypatch.setattr(
        "avatarrex_studio.panels.joints.widgets.slider",
        lambda name, value, bounds, form, width: forms.update({name: form}),
    )

    def draw():
        imgui.begin_child("narrow", (width, 0))
        list(body_panel().draw(StudioState()))
        imgui.end_child()

    screen.frame(draw)
    assert forms["left_elbow.y"] == form


def test_the_other_panels_draw(screen, studio):
    poses = PosesPanel()
    for draw in (camera.draw, render.draw, lambda state: scene.draw(state, Recent(), nothing), poses.draw):
        assert screen.frame(lambda draw=draw: draw(studio.state)) == []
    assert screen.frame(lambda: TimelinePanel(reader(studio)).draw(studio)) == []


def test_the_playhead_crosses_the_rows_but_not_the_words_where_there_are_none(screen, studio):
    panel, accent = TimelinePanel(reader(studio)), theme.colour(theme.ACCENT)

    def lowest():
        """Of what has the playhead's colour."""
        for _ in range(2):
            screen.frame(lambda: panel.draw(studio))
        drawn = [vertex for each in imgui.get_draw_data().cmd_lists for vertex in each.vtx_buffer]
        return max(vertex.pos.y for vertex in drawn if vertex.col == accent)

    assert lowest() < 100, "on the ruler alone"
    studio.do(AddLayer(Layer("Keys")))
    assert lowest() > 2000


def test_the_blend_goes_from_what_was_to_the_chosen_entry(screen):
    panel, journal = PosesPanel(), Journal()
    panel.chosen = "squat"
    squat = shipped_entries("pose")["squat"]

    def draw():
        for command in (commands := list(panel.draw(journal.state))):
            journal.do(command)
        return commands

    screen.frame(draw)
    blend = find(screen, lambda: panel._blend({"squat": squat}), lambda command: isinstance(command, Blend))[-1]
    assert (blend.name, blend.start) == ("squat", StudioState().signals)
    journal.do(panel._applied(squat, 1.0))
    screen.frame(draw)
    assert panel._blended == 1.0, "it stays where it is let go, and after a click"
    assert np.array_equal(journal.state.signals.body_pose, named_pose("squat"))
    assert journal.state.signals.translation[1] < -0.2, "on the floor"
    journal.do(panel._applied(squat, 0.0))
    screen.frame(draw)
    assert journal.state.signals == StudioState().signals
    journal.do(SetExpression("jawOpen", 0.4))
    screen.frame(draw)
    assert (panel._blended, panel._start) == (0.0, journal.state.signals), "begins again at what something else has set"


def test_the_performance_panel_before_and_after_a_picture(screen, studio, clock, monkeypatch):
    said = []
    for name in ("text", "text_wrapped"):
        real = getattr(imgui, name)
        monkeypatch.setattr(imgui, name, lambda text, real=real: said.append(text) or real(text))
    assert screen.frame(lambda: performance.draw(studio)) == []
    assert "No exact picture yet." in said
    for _ in range(2):
        studio.do(OrbitBy(10.0, 0.0))
        for _ in range(20):
            clock.now += 0.05
            studio.tick((64, 48))
    said.clear()
    monkeypatch.setattr(performance, "level_errors", lambda: {"balanced": None})
    screen.frame(lambda: performance.draw(studio))
    assert "body pose unchanged: body voxels kept" in said
    assert "1.00 MiB" in said
    assert "not measured" in said
    monkeypatch.setattr(performance, "level_errors", lambda: {"balanced": LevelError(0.21, 1.5)})
    screen.frame(lambda: performance.draw(studio))
    assert said[-1] == "1.00 MiB"
    assert "mean 0.21 mm, p99 1.5 mm" in said


def test_the_viewport_mouse(screen, studio):
    panel = ViewportPanel()

    def draw():
        return panel.draw(studio, Shown(1, 400, 3000))

    screen.frame(draw)
    (orbit,) = screen.drag(draw, (100, 100), (130, 120))
    assert isinstance(orbit, OrbitBy)
    assert (orbit.azimuth, orbit.elevation) == pytest.approx((-12, 8))
    (outside,) = screen.drag(draw, (100, 100), (-50, 100))
    assert outside.azimuth == pytest.approx(60)
    (pan,) = screen.drag(draw, (100, 100), (100, 150), button=1)
    assert isinstance(pan, PanBy)
    assert pan.up > 0 == pan.right
    screen.io.add_mouse_pos_event(100, 100)
    screen.frame(draw)
    screen.io.add_mouse_wheel_event(0, 1)
    (zoom,) = screen.frame(draw)
    assert isinstance(zoom, ZoomBy)
    assert zoom.factor < 1


def test_the_error_of_live_is_what_the_avatars_surface_says():
    surface = replace(template_surface(), meta={"live.depth_mm": 1.54, "live.depth_p99_mm": 10.1})
    assert performance.error_text("live", surface) == "mean 1.54 mm, p99 10.1 mm"
    assert performance.error_text("balanced", surface) == performance.error_text("balanced") != "not measured"
    for meta in ({}, {"errors": "not measured: no OpenGL"}):
        assert performance.error_text("live", replace(surface, meta=meta)) == "not measured"
    assert performance.error_text("live") == "not measured"


def test_what_can_be_dragged_is_looked_for_where_somebody_points(screen, clock, monkeypatch):
    """The joints' places take milliseconds where the person moves; and nothing is named while it moves by itself."""
    studio, panel, found, places = ball_studio(clock), ViewportPanel(), [], viewport._on_screen
    monkeypatch.setattr(viewport, "_on_screen", lambda *given: found.append(places(*given)) or found[-1])

    def look():
        found.clear()
        screen.frame(lambda: panel.draw(studio, Shown(1, 400, 300)))
        return len(found)

    screen.io.add_mouse_pos_event(-10, -10)
    assert look() == look() == 0
    studio.do(Select("left_elbow"))
    assert look() == 1
    studio.do(Select(None))
    studio.do(Pin(("left_hand",), True))
    assert look() == 1
    studio.do(Pin(("left_hand",), False))
    screen.io.add_mouse_pos_event(200, 150)
    look()
    assert look() == 1
    hand = found[0]["left_hand"]
    screen.io.add_mouse_pos_event(*hand)
    assert [look(), panel.handle] == [1, "left_hand"]
    monkeypatch.setattr(Listening, "present", property(lambda listening: True))
    look()
    studio.do(SetJoint("left_shoulder", (0.0, 0.0, -0.8)))
    assert [look(), panel.handle] == [1, "left_hand"], (
        "found anew where the mouse moves: a sender moves the person in each frame"
    )
    screen.io.add_mouse_pos_event(hand[0] + 1, hand[1])
    assert [look(), panel.handle] == [1, None]


def double_click(screen, draw, place):
    commands = []
    for seconds, pressed in ((1.0, None), *((0.02, pressed) for pressed in (True, False, True, False))):
        screen.seconds = seconds
        screen.io.add_mouse_pos_event(*place)
        if pressed is not None:
            screen.io.add_mouse_button_event(0, pressed)
        commands += screen.frame(draw)
    return commands


def centred(commands):
    """The one that moves the view; a click selects, too."""
    (found,) = [command for command in commands if not isinstance(command, Select)]
    return found


def test_a_double_click_centres_on_what_is_under_the_mouse(screen, clock):
    """On the exact picture where it is all there is; on the surface, whatever is moving, where there is one."""
    studio, panel = ball_studio(clock), ViewportPanel()
    screen.frame(lambda: panel.draw(studio, None))
    for _ in range(20):
        clock.now += 0.05
        studio.tick(panel.size)
    width, height = panel.size
    shown = Shown(1, width, height)

    def draw():
        return panel.draw(studio, shown)

    middle = (8 + width / 2, 8 + height / 2)
    centre = centred(double_click(screen, draw, middle))
    view = studio.state.view
    camera = view.camera(width, height)
    depth = studio.pictures.picture.depth[height // 2, width // 2]
    assert camera.camera_from_world[2] @ (*centre.target, 1) == pytest.approx(depth, abs=1e-4)
    assert camera.pixels(np.array([centre.target]))[0][0] == pytest.approx((width / 2, height / 2), abs=1)
    studio.do(OrbitBy(5.0, 0.0))
    studio.surface = SimpleNamespace(texture=SimpleNamespace(size=(2 * width, 2 * height)))
    wanted = []
    studio.live = SimpleNamespace(
        ms={}, draw=lambda avatar, state, size: None, point=lambda column, row: wanted.append((column, row)) or Seen((1.0, 2.0, 3.0), 0)
    )  # fmt: skip
    centre = centred(double_click(screen, draw, middle))
    assert centre.target == (1, 2, 3)
    assert np.abs(np.array(wanted) - (width, height)).max() <= 1
    studio.live.point = lambda column, row: None
    centre = centred(double_click(screen, draw, middle))
    assert centre.target == OrbitView().moved(studio.state.signals.translation).target


def test_a_press_far_from_where_the_mouse_was_turns_nothing(screen, studio):
    """A pen or a finger comes down anywhere: place and press are of one frame."""
    panel = ViewportPanel()

    def draw():
        return panel.draw(studio, Shown(1, 400, 3000))

    screen.io.add_mouse_pos_event(300, 40)
    screen.frame(draw)
    screen.frame(draw)
    screen.io.add_mouse_pos_event(100, 100)
    screen.io.add_mouse_button_event(0, True)
    assert screen.frame(draw) == []
    screen.io.add_mouse_pos_event(110, 100)
    (orbit,) = screen.frame(draw)
    assert orbit.azimuth == pytest.approx(-4)


def test_esc_ends_the_edit_of_a_text_before_it_closes_the_window_of_how_a_motion_was_read(screen, studio):
    reading, places = MotionImport(reader(studio)), []
    reading.shown = reading._focused = True

    def draw():
        imgui.input_double("rate", 30.0)
        places.append(imgui.get_item_rect_min())
        reading.dismissed()
        return ()

    def press(key):
        for down in (True, False):
            screen.io.add_key_event(key, down)
            screen.frame(draw)

    screen.frame(draw)
    place = (places[0].x + 5, places[0].y + 5)
    screen.drag(draw, place, place)
    assert screen.io.want_text_input
    press(imgui.Key.escape)
    assert reading.shown
    press(imgui.Key.escape)
    assert not reading.shown


class Curve:
    """The time curve of a clip, 200 points wide, whose commands are done at once."""

    def __init__(self, screen, monkeypatch, warp):
        self.screen, self.layer, self.low = screen, Layer("a", warp=warp), None
        editor, button = WarpEditor(), imgui.invisible_button

        def placed(name, size):
            self.low = imgui.get_cursor_screen_pos()
            return button(name, size)

        def draw():
            commands = list(editor.draw(self.layer, 200.0))
            for command in commands:
                self.layer = replace(self.layer, warp=command.warp)
            return commands

        monkeypatch.setattr(imgui, "invisible_button", placed)
        self.draw = draw
        screen.frame(draw)

    def drag(self, *places):
        """Press at the first place of the curve, release at the last; the curve then."""
        pixels = [(self.low.x + 200 * x, self.low.y + HEIGHT * (1 - y)) for x, y in places]
        self.screen.drag(self.draw, pixels[0], pixels[-1])
        return self.layer.warp


def test_a_press_on_the_time_curve_adds_a_point_and_a_drag_moves_it(screen, monkeypatch):
    curve = Curve(screen, monkeypatch, ((0.5, 0.5),))
    assert curve.drag((0.75, 0.25))[1] == pytest.approx((0.75, 0.25), abs=0.01)
    assert curve.drag((0.25, 0.5), (0.3, 0.75))[0] == pytest.approx((0.3, 0.75), abs=0.01)
    assert curve.drag((0.5, 0.5), (0.6, 0.25))[1] == pytest.approx((0.6, 0.25), abs=0.01)
    assert len(curve.layer.warp) == 3


def test_a_press_that_adds_no_point_to_the_time_curve_drags_none(screen, monkeypatch):
    """As beside another one in time, where none has room; a plain click on one leaves it where it is."""
    warp = ((0.5, 0.2),)
    curve = Curve(screen, monkeypatch, warp)
    assert curve.drag((0.505, 0.8)) == warp
    assert curve.drag((0.505, 0.8), (0.7, 0.9)) == warp
    assert curve.drag((0.52, 0.24)) == warp


@pytest.fixture
def beside(studio):
    """A studio whose picture shows the second of two figures everywhere; the first is selected."""
    for command in (AddFigure("default"), SelectFigure(0)):
        studio.do(command)
    studio.avatars.get("default")
    studio.surface = SimpleNamespace(texture=SimpleNamespace(size=(384, 384)))
    studio.live = SimpleNamespace(point=lambda column, row: Seen((1.0, 0.0, 0.0), 1))
    return studio


@pytest.mark.parametrize(("button", "selects"), [(0, True), (1, False), (2, False)])
def test_the_left_button_alone_selects_another_avatar(screen, beside, button, selects):
    panel = ViewportPanel()

    def draw():
        return panel.draw(beside, Shown(1, 400, 3000))

    screen.frame(draw)
    commands = screen.drag(draw, (60, 60), (60, 60), button)
    assert (SelectFigure(1) in commands) == selects


@pytest.mark.parametrize(("part", "kind"), [("left_index2", PullHandle), ("left_elbow", OrbitBy), (None, OrbitBy)])
def test_a_drag_by_the_palm_moves_the_hand(screen, studio, monkeypatch, part, kind):
    """Twenty points beside the handle at the wrist; still, it is a click on that part."""
    studio.avatars.get("default")
    panel, size = ViewportPanel(), 384
    low = imgui.ImVec2(8, 8 + (2984 - size) / 2)
    figure = studio.figure
    handle = places(figure.skeleton, figure.posed, None)["left_hand"]
    x, y = Projection.of(studio.state.view, low, low + imgui.ImVec2(size, size), studio.world).screen(handle)
    monkeypatch.setattr(studio, "part_at", lambda x, y: part)

    def draw():
        return panel.draw(studio, Shown(1, size, size))

    screen.frame(draw)
    assert {type(command) for command in screen.drag(draw, (x + 20, y), (x + 30, y - 12))} == {kind}
    assert Select(part) in screen.drag(draw, (x + 20, y), (x + 20, y))


def test_keys_are_no_shortcuts_while_a_button_is_pressed(screen, studio):
    done = []
    chords = [(chord(entry.shortcut), entry) for entry in ACTIONS if entry.shortcut == "M"]
    panel = TimelinePanel(reader(studio))
    window = SimpleNamespace(
        _keys_free=True, _chords=chords, studio=studio, _run=done.append, _gesture=0, timeline=panel
    )

    def press_m():
        for down in (True, False):
            screen.io.add_key_event(imgui.Key.m, down)
            screen.frame(lambda: Window._shortcuts(window))

    screen.frame(lambda: None)
    screen.io.add_mouse_button_event(0, True)
    press_m()
    assert done == []
    screen.io.add_mouse_button_event(0, False)
    screen.frame(lambda: None)
    press_m()
    assert len(done) == 1


def test_before_the_first_picture_the_viewport_takes_no_clicks_and_says_why(screen, studio):
    panel = ViewportPanel()
    commands = screen.drag(lambda: panel.draw(studio, None), (100, 100), (160, 120))
    assert commands == []
    assert screen.drag(lambda: panel.draw(studio, Shown(1, 400, 3000)), (100, 100), (160, 120))
    studio.avatars.get("default")
    assert preparing(studio) == "Preparing default…"
    studio.pictures.exact.request(Request(studio.state, (64, 48)))
    assert preparing(studio) == "Rendering the first picture of default…"


def test_a_changed_group_offers_its_reset(screen, monkeypatch):
    state = SetJoint("left_elbow", (0.0, -0.5, 0.0)).apply(StudioState())
    monkeypatch.setattr(imgui, "small_button", lambda label: label.endswith("body.left arm"))
    panel = body_panel()
    assert screen.frame(lambda: panel.draw(state)) == [ResetGroup("left_elbow")]
    assert not posing.changed(ResetGroup("left_elbow").apply(state).signals, "all")


@pytest.mark.parametrize("shown", [True, False])
def test_a_colour_is_seen_behind_the_figure_also_on_its_stage(shown):
    state = StudioState(stage=Stage(shown=shown))

    def after(title):
        now = state
        for command in render.behind(state, render.BACKGROUNDS[title]):
            now = command.apply(now)
        return now.background, now.stage.shown, now.stage.backdrop

    assert after("White") == ((1.0, 1.0, 1.0, 1.0), shown, COLOUR if shown else GRADIENT)
    assert after("Clear") == ((0.0, 0.0, 0.0, 0.0), False, GRADIENT)


def test_a_ready_hand_is_chosen_in_the_tab_of_a_hand(screen, monkeypatch):
    monkeypatch.setattr(widgets, "choice", lambda label, *rest: "Thumbs up" if "ready" in label else None)
    panel, state = HandPanel("left"), StudioState()
    assert screen.frame(lambda: panel.draw(state)) == [SetHandPose("left", "thumbs_up")]
    panel.linked = True
    assert screen.frame(lambda: panel.draw(state)) == [SetHandPose(side, "thumbs_up") for side in ("left", "right")]


def test_every_level_has_its_words():
    assert tuple(performance.LEVEL_TEXT) == LEVELS


def test_every_effect_is_one_of_the_window(studio, tmp_path):
    assert {entry.effect for entry in ACTIONS if entry.effect} == set(Window(studio, tmp_path)._effects)


def test_every_shortcut_is_a_key_of_the_toolkit():
    chords = [keys.chord(entry.shortcut) for entry in ACTIONS if entry.shortcut]
    assert len(set(chords)) == len(chords)


@pytest.mark.parametrize(
    ("source", "out", "log"),
    [
        ("/", "", None),
        (".", "", None),
        ("./x", "", "x_imported.log"),
        ("./x", "/", None),
        ("./x", "..", None),
        ("./x", "y", "y.log"),
    ],
)
def test_a_path_without_a_name_is_typed_for_an_import(screen, monkeypatch, tmp_path, source, out, log):
    """The buttons are for paths that have one, beside which the task's log lies."""
    (tmp_path / "x").mkdir()
    monkeypatch.chdir(tmp_path)
    off = []
    monkeypatch.setattr(imgui, "begin_disabled", off.append)
    monkeypatch.setattr(imgui, "end_disabled", lambda: None)
    monkeypatch.setattr(widgets, "button_grid", lambda *_: "" if off[-1] else "whole")
    form = CaptureTools(FileDialog()).imported
    form.source, form.out = source, out
    tasks = screen.frame(lambda: filter(None, [form.draw()]))
    assert [str(task.log) for task in tasks] == ([log] if log else [])


@pytest.mark.parametrize(("capture", "out"), [("/", ""), (".", ""), ("x", "/")])
def test_a_path_without_a_name_is_typed_for_a_refinement(screen, monkeypatch, capture, out):
    tools = CaptureTools(FileDialog())
    tools.shown, tools.out = "refine", out
    off = []
    monkeypatch.setattr(imgui, "begin_disabled", off.append)
    monkeypatch.setattr(imgui, "end_disabled", lambda: None)
    screen.frame(lambda: filter(None, [tools.draw(capture)]))
    assert off == [True]


@pytest.mark.parametrize(
    ("shown", "words", "pictures"),
    [
        ("refine", ("capture", "refine", "a.zip", "a_refined"), ["refine_body.png", "refine_face.png"]),
        ("match", ("capture", "match-exposure", "a.zip", "a_matched"), []),
    ],
)
def test_a_capture_is_written_anew_beside_the_one_that_is_filled_in(screen, monkeypatch, shown, words, pictures):
    tools = CaptureTools(FileDialog())
    monkeypatch.setattr(widgets, "button_grid", lambda *_: shown)
    monkeypatch.setattr(imgui, "button", lambda *_: True)
    (task,) = screen.frame(lambda: filter(None, [tools.draw("a.zip")]))
    assert task.words == words
    assert [picture.name for picture in task.pictures] == pictures
    assert tools.shown == ""


@pytest.mark.parametrize(("code", "shown"), [(0, 1), (1, 1), (2, 0)])
def test_a_task_that_failed_shows_no_picture_of_one_before(screen, monkeypatch, tmp_path, code, shown):
    picture, drawn = tmp_path / "body.png", []
    picture.write_bytes(b"of the one before")
    report = TaskReport(object.__new__(Watcher))
    monkeypatch.setattr(report, "_draw_picture", drawn.append)
    task = Task("Look at it", ("capture", "import"), tmp_path / "look.log", (picture,), bad=(1,))
    screen.frame(lambda: report.draw(Outcome(task, code, "said")) or ())
    assert drawn == [picture] * shown
