"""What a user does from one end to the other, in the window: every key, every broken kind of file, quitting and going on, exporting."""

from __future__ import annotations

import json
import logging
import time
import zipfile
from pathlib import Path

import driving
import glfw
import numpy as np
import pytest
import trimesh
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.engine.staging import in_light, over_stage
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels.keys import chord
from avatarrex_studio.panels.tour import STEPS
from avatarrex_studio.session.actions import ACTIONS
from avatarrex_studio.session.commands import (
    AddFigure,
    ApplyExpression,
    ApplyPose,
    Select,
    SetCamera,
    SetExpression,
    SetSignals,
    SetStage,
)
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import SizePolicy, StudioState
from avatarrex_studio.session.timeline_commands import SetFrame
from avatarrex_studio.window.docking import BARE, POSE
from avatarrex_studio.window.window import Window, start
from bad_files import AVATARS, MOTIONS, SESSIONS
from ball import ball_engine
from ball_studio import InlineExact
from capture.tiny_capture import TinyCapture
from imgui_bundle import hello_imgui, imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui
from test_export_window import export
from test_fuzz_window import small_window
from test_opening import drop, settle
from test_window import drive, rest

from avatarrex.avatar_file import load_avatar
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.library import named_expression, named_pose
from avatarrex.signals.read import READERS
from avatarrex.training.runs.folder import Run

pytestmark = pytest.mark.window
KEYED = {entry.shortcut: entry for entry in ACTIONS if entry.shortcut}
TWICE = ("Tab", "F11", "F9")
"""Keys that are pressed again, so that the next one finds the window as it was."""


def puffed(state):
    """The cheeks' coefficient."""
    return float(state.signals.expression[EXPRESSION_NAMES.index("cheekPuff")])


AFTER = {
    "Left": lambda state: state.timeline.frame == 4, "Right": lambda state: state.timeline.frame == 6,
    "1": lambda state: state.view.azimuth == 0, "Ctrl+1": lambda state: abs(state.view.azimuth) == 180,
    "3": lambda state: state.view.azimuth == -90, "Ctrl+3": lambda state: state.view.azimuth == 90,
    "7": lambda state: state.view.elevation > 80, "5": lambda state: state.view.orthographic,
    "4": lambda state: state.view.azimuth < 33, "6": lambda state: state.view.azimuth > 33,
    "Ctrl+Z": lambda state: puffed(state) == 0, "Ctrl+Shift+Z": lambda state: puffed(state) == 0.5,
    "Ctrl+R": lambda state: not state.signals.full_pose().any(), "A": lambda state: state.slot == 0,
    "N": lambda state: state.tools.shows == "normals", "D": lambda state: state.tools.shows == "depth",
    "J": lambda state: "joints" in state.tools.overlays, "Escape": lambda state: not state.tools.selected,
    "P": lambda state: state.tools.pins == {"left_hand"},
}  # fmt: skip
"""What some keys leave behind in the state that `prepared` makes."""


def footprint(window):
    """Whatever a key may change."""
    studio, panels = window.studio, hello_imgui.get_runner_params().docking_params.dockable_windows
    return (
        studio.state, studio.playback.playing, len(studio.journal.steps), imgui.get_clipboard_text(),
        imgui.is_popup_open("", imgui.PopupFlags_.any_popup), window.output.pane is None,
        hello_imgui.current_layout_name(), [each.is_visible for each in panels], len(window.questions.waiting),
        glfw.get_window_size(glfw_window_hello_imgui()), len(window.studio.pictures.exact.begun),
    )  # fmt: skip


def prepared(test, window, posed, shortcut):
    """A state in which the key has something to do."""
    while imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
        test.key_press(chord("Escape"))
        test.yield_(2)
    journal = window.studio.journal = Journal(posed)
    window.studio.playback.playing = False
    journal.do(SetExpression("cheekPuff", 0.5))  # work that is not saved
    if shortcut == "Ctrl+Shift+Z":
        journal.undo()
    other = posed.signals.replace(expression=named_expression("smirk"))
    imgui.set_clipboard_text(json.dumps(other.to_json()) if "V" in shortcut else "")
    if hello_imgui.current_layout_name() == POSE and shortcut == "F2":
        hello_imgui.switch_layout("Animate")
    test.yield_(2)


def test_every_shortcut_does_something_and_its_own(display, tmp_path, monkeypatch):
    """Each key of the sheet, pressed in a state in which it has something to do."""
    monkeypatch.chdir(tmp_path)
    run, without, others = {}, [], []

    def scenario(test):
        test.yield_(10)
        studio, does = window.studio, window._run
        studio.do(AddFigure("default"))
        studio.open_motion("walk")
        lifted = studio.state.signals.replace(body_pose=named_pose("wave"), translation=np.array([0, 0.3, 0]))
        view = SetCamera(azimuth=33.0, elevation=12.0, distance=4.4)
        for command in (SetFrame(5), SetSignals(lifted), view, Select("left_wrist")):
            studio.do(command)
        posed = studio.state
        for shortcut, entry in KEYED.items():
            prepared(test, window, posed, shortcut)
            done = []
            window._run = lambda entry, done=done: (done.append(entry.id) if entry else None, does(entry))
            before = footprint(window)
            test.key_press(chord(shortcut))
            driving.until(test, lambda done=done: done, 5.0)
            driving.until(test, lambda before=before: footprint(window) != before, 2.0)
            test.yield_(2)
            run[entry.id], window._run = done, does
            if footprint(window) == before:
                without.append(shortcut)
            if shortcut in AFTER and not AFTER[shortcut](studio.state):
                others.append(shortcut)
            if shortcut in TWICE:
                test.key_press(chord(shortcut))
                test.yield_(2)
        studio.journal = Journal(start())

    window = small_window()
    driving.drive(window, scenario, (640, 480))
    assert run == {entry.id: [entry.id] for entry in KEYED.values()}
    assert without == []
    assert others == []


def broken_files(folder):
    """A broken file of every kind that can be opened."""
    kinds = {"avatar": (AVATARS, "cut"), "weights": (AVATARS, "NaN weights"), "session": (SESSIONS, "unknown field"),
             "motion": (MOTIONS, "bvh: cut in the motion"), "signals": (MOTIONS, "json: unknown key")}  # fmt: skip
    for name, (table, fault) in kinds.items():
        file, write, _ = table[fault]
        path = folder / f"{name}{Path(file).suffix}"
        write(path)
        yield path
    for suffix in READERS:
        path = folder / f"garbage{suffix}"
        path.write_bytes(bytes(range(256)) * 8)
        yield path
    TinyCapture.make(("body",)).folder(folder / "capture")
    next((folder / "capture").rglob("calibration_full.json")).write_text("{")
    yield folder / "capture"
    with zipfile.ZipFile(folder / "capture.zip", "w") as archive:
        archive.writestr("calibration_full.json", "{")
    yield folder / "capture.zip"
    with Run.create(folder / "run", {"part": "body", "steps": {"body": 4}, "preset": "quick", "seed": 3}) as run:
        (run.save(3, {"x": 1}) / "avatar.avatar").write_bytes(b"half an avatar")
    yield folder / "run"
    (folder / "notes.txt").write_text("nothing of these")
    yield folder / "notes.txt"


def reading_window():
    """A small window that truly reads every avatar but the default one."""
    ball = ball_engine()
    avatars = Avatars(lambda name: ball.avatar(name) if name == "default" else load_avatar(name))
    journal = Journal(StudioState(size=SizePolicy(fixed=(64, 48))))
    return Window(Studio(InlineExact(ball), avatars, journal, clock=time.monotonic))


def test_every_broken_kind_of_file_gets_a_dialog_and_changes_nothing(display, tmp_path):
    """Dropped, as a layer, and as the stage's background; the cause is in the dialog, Esc closes it."""
    told, changed = {}, []
    files = list(broken_files(tmp_path))

    def scenario(test):
        test.yield_(10)
        window.studio.do(SetExpression("jawOpen", 0.4))
        before = window.studio.state

        def opened(name, way):
            way()
            settle(test, window)
            told[name] = [(each.title, each.text, list(each.answers)) for each in window.questions.waiting]
            test.yield_(4)  # until the dialog is there
            test.key_press(chord("Escape"))
            test.yield_(4)
            if window.questions.waiting or window.studio.state is not before:
                changed.append(name)
                window.questions.waiting.clear()

        logging.getLogger().addHandler(window.toasts)
        for path in files:
            opened(path.name, lambda path=path: drop(str(path)))
        opened("layer", lambda: window.opening.layer(str(tmp_path / "garbage.bvh")))
        window._stage_picture()
        opened("picture", lambda: window.files._then(str(tmp_path / "notes.txt")))
        logging.getLogger().removeHandler(window.toasts)

    window = reading_window()
    driving.drive(window, scenario, (640, 480))
    assert changed == []
    shown = {**{path.name: path.name for path in files}, "layer": "garbage.bvh", "picture": "notes.txt"}
    for name, file in shown.items():
        ((title, text, answers),) = told[name]
        assert answers == ["Close", "Open another…"]
        assert title == f"{file} cannot be opened"
        assert ": found " in text, text
        assert "Needed: " in text, text


def test_a_session_is_saved_left_and_goes_on_with_the_same_frame(display, tmp_path):
    """Pose, face, camera, stage, a second avatar and a motion's frame; in the second window and headless."""
    seen, file = {}, tmp_path / "mine.json"

    def work(test, window):
        studio = window.studio
        rest(test, window, 300)
        studio.open_motion("walk")
        for command in (
            ApplyPose("salute"), ApplyExpression("smile"), SetCamera(azimuth=25.0, elevation=8.0, distance=3.3),
            AddFigure("default"), SetExpression("jawOpen", 0.3), SetStage("exposure", 0.4),
        ):  # fmt: skip
            studio.do(command)
        studio.go_to(7)
        rest(test, window, 300)
        seen["picture"] = studio.pictures.picture.image
        window.files.folder = str(tmp_path)
        test.key_press(chord("Ctrl+S"))
        test.yield_(6)
        test.key_chars("mine")
        test.yield_(2)
        test.key_press(int(imgui.Key.enter))
        test.yield_(4)
        seen["may close"], seen["recent"] = window._may_close(), window.opening.recent.paths[0]

    def go_on(test, window):
        rest(test, window, 300)
        drop(str(file))
        settle(test, window)
        rest(test, window, 300)
        seen["again"], seen["unsaved"] = window.studio.pictures.picture.image, window.studio.journal.unsaved

    drive(ball_engine, work)
    drive(ball_engine, go_on)
    assert seen["may close"], "what is saved is left without a question"
    assert not seen["unsaved"]
    assert seen["recent"] == str(file)
    np.testing.assert_array_equal(seen["picture"], seen["again"])
    state, shown = Journal.load(file).state, seen["picture"]
    frames = ball_engine().frames(state, state.view.camera(shown.shape[1], shown.shape[0]))
    headless = 255 * in_light(frames, state).image.numpy().clip(0, 1)
    np.testing.assert_allclose(headless, shown, atol=1.0)


def test_what_the_dialog_exports_is_opened_by_other_libraries(display, tmp_path, monkeypatch):
    """A video of the motion, layers and a model; pictures are a matter of test_export_window.py."""
    video, layers = pytest.importorskip("av"), pytest.importorskip("OpenEXR")
    monkeypatch.chdir(tmp_path)
    seen, states = {}, []

    def scenario(test):
        test.yield_(10)
        window.studio.open_motion("walk")
        for frame in (10, 20, 30, 40):
            window.studio.go_to(frame)
            states.append(window.studio.state)
        small = {"size": (64, 48), "name": "mine"}
        clip = {"first": 10, "last": 49, "rate": window.studio.state.timeline.fps / 10}
        for kind, fields in {"Video": clip, "Layers": {"clear": True}, "3D model": {"first": 0, "last": 9}}.items():
            window.exports.process._make = Engine if kind == "3D model" else ball_engine  # the ball has no surface
            export(test, window, kind, **small, **fields)
            driving.until(test, lambda: window.exports.busy or window.exports.dialog.error, 5.0)
            seen[kind] = window.exports.dialog.error
            driving.until(test, lambda: not window.exports.busy, 200.0)
            test.yield_(3)

    window = small_window(make=ball_engine)
    driving.drive(window, scenario, (1000, 640))
    assert set(seen.values()) == {""}
    with video.open(str(tmp_path / "mine.mp4")) as file:
        pictures = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        assert float(file.streams.video[0].average_rate) == pytest.approx(states[0].timeline.fps / 10)
    assert [picture.shape for picture in pictures] == [(48, 64, 3)] * 4
    camera, ball = states[-1].view.camera(64, 48), ball_engine()
    rendered = [over_stage(in_light(ball.frames(state, camera), state), state) for state in states]
    far = [[np.abs(picture.astype(float) - each[..., :3]).mean() for each in rendered] for picture in pictures]
    assert np.argmin(far, axis=1).tolist() == [0, 1, 2, 3], "each is of its frame"
    with layers.File(str(tmp_path / "mine.exr"), separate_channels=True) as file:
        planes = {name: channel.pixels.astype(float) for name, channel in file.channels().items()}
    assert set(planes) == {*"RGBAZ", *(f"{name}.{axis}" for name in "NP" for axis in "XYZ")}
    (frame,) = ball.frames(states[-1], camera)
    alpha, image = planes["A"], frame.image.numpy()
    np.testing.assert_allclose(alpha, image[..., 3], atol=1e-3)
    assert (alpha.min(), alpha.max()) == (0, 1)
    encoded = image[..., 0].clip(0, 1)
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(planes["R"], linear, atol=1e-3)
    np.testing.assert_allclose(planes["Z"], frame.pointmap.depth.numpy(), atol=1e-4)
    model = trimesh.load(tmp_path / "mine.glb")
    assert 1.5 < model.extents[1] < 2.0, "metres, upright"
    assert sum(len(mesh.faces) for mesh in model.geometry.values()) > 10_000
    assert all(mesh.visual.material.baseColorTexture is not None for mesh in model.geometry.values())


def test_the_tour_shows_five_things_though_panels_are_hidden(display):
    """Help → Tour with all panels hidden: each step brings its panel, and the card stays at the picture's lower corner."""
    steps, corners = [], []

    def scenario(test):
        test.yield_(10)
        test.key_press(chord("Tab"))
        test.yield_(4)
        shown = hello_imgui.get_runner_params().docking_params.dockable_window_of_name
        assert not shown("Face").is_visible
        test.menu_click("//##MainMenuBar/Help/Tour")
        for _ in STEPS:
            test.yield_(5)
            steps.append(window.personal.tour.number)
            panel = imgui.internal.find_window_by_name(STEPS[steps[-1]].panel)
            card, picture = (imgui.internal.find_window_by_name(name) for name in ("##tour", BARE))
            if not (panel.active and not panel.hidden):
                steps.append(f"{panel.name} is not shown")
            corners.append((card.pos.x - picture.pos.x, picture.pos.y + picture.size.y - card.pos.y - card.size.y))
            test.item_click("//##tour/###tour.next")
        test.yield_(3)
        steps.append(window.personal.tour.number)

    window = small_window()
    driving.drive(window, scenario)
    assert steps == [0, 1, 2, 3, 4, None]
    assert set(corners) == {(14, 14)}
