"""Anything is opened in the window: by the dialog, by dropping files on it, and from the list of recent files."""

from __future__ import annotations

import ctypes
import json
import logging
import os
import shutil
import threading
import time
from concurrent.futures import CancelledError
from functools import cache
from pathlib import Path

import driving
import glfw
import numpy as np
import pytest
from avatarrex_studio.jobs.opening import read_motion
from avatarrex_studio.jobs.training_process import TrainingProcesses
from avatarrex_studio.panels import files
from avatarrex_studio.panels.files import FileDialog
from avatarrex_studio.panels.folder import listed, places, size_words
from avatarrex_studio.panels.keys import chord
from avatarrex_studio.panels.questions import Questions, nothing
from avatarrex_studio.panels.training import TrainingPanel
from avatarrex_studio.session.autosave import Autosave
from avatarrex_studio.session.commands import AddFigure, RemoveFigure, SelectFigure, SetExpression
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.recent import MOST, Recent
from avatarrex_studio.window.leaving import Leaving
from avatarrex_studio.window.opening import Opening
from avatarrex_studio.window.window import start
from ball import ball_engine
from capture.tiny_capture import TinyCapture
from imgui_bundle import imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui
from test_window import drive, surfaced

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is
from avatarrex.signals.driving import Signals
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence
from avatarrex.training.runs.folder import Run


def read_any_avatar(name):
    """Untrained fields for every avatar that is there."""
    if name != "default" and what_is(name) == "nothing there":
        raise InputError(name, "", "an avatar folder or an .avatar file", "nothing there")
    time.sleep(0.3)
    return one_avatar()


@cache
def one_avatar():
    return surfaced("default")


@pytest.fixture
def things(tmp_path):
    """A path of each kind, by kind."""
    (tmp_path / "anna.avatar").write_bytes(b"read by `read_any_avatar`")
    frames = tuple(Signals.rest().replace(translation=np.array([0.0, 0.0, 0.01 * k])) for k in range(5))
    write_json(tmp_path / "turn.json", SignalSequence(frames, 30.0, "turn"))
    journal = Journal(start())
    journal.do(SetExpression("jawOpen", 0.7))
    journal.save(tmp_path / "session.json")
    TinyCapture.make(("body",)).folder(tmp_path / "capture")
    with Run.create(tmp_path / "run", {"part": "body", "steps": {"body": 400}, "preset": "quick", "seed": 3}) as run:
        checkpoint = run.save(30, {"x": 1})
        shutil.copy(tmp_path / "anna.avatar", checkpoint / "avatar.avatar")
    names = {
        "avatar": "anna.avatar",
        "motion": "turn.json",
        "session": "session.json",
        "capture": "capture",
        "run": "run",
    }
    return {kind: str(tmp_path / name) for kind, name in names.items()}


def drop(*paths):
    """What GLFW does when files are dropped on the window that is open: its callback, by the window's address."""
    address = ctypes.cast(ctypes.pointer(glfw_window_hello_imgui()), ctypes.POINTER(ctypes.c_long)).contents.value
    _, callback = glfw._window_drop_callback_repository[address]
    callback(None, len(paths), (ctypes.c_char_p * len(paths))(*(path.encode() for path in paths)))


def settle(test, window, seconds=30):
    """Let the window draw until everything has been opened."""
    test.yield_(3)
    driving.until(test, lambda: not (window.opening.busy or window.studio.avatars.reading), seconds)
    assert not window.opening.busy
    test.yield_(3)


def by_dialog(test, window, path):
    """Ctrl+O, the name of the file, Open."""
    window.files.folder = str(Path(path).parent)
    test.key_press(chord("Ctrl+O"))
    test.yield_(4)
    test.item_click("//Open###files/##name")
    test.key_chars_replace(Path(path).name)
    test.yield_(2)
    test.item_click("//Open###files/###answer")
    settle(test, window)


def shown(window):
    """What the window shows, by kind."""
    state, training = window.studio.state, window.training
    return {
        "avatar": (state.avatar, window.studio.avatars.ready(state.avatar) is not None),
        "motion": state.timeline.motion and state.timeline.motion.path,
        "session": round(float(state.signals.expression.max()), 3),
        "capture": (training.form.capture, not imgui.internal.find_window_by_name("Training").hidden),
        "run": training.runs.chosen,
    }


def everything(test, window, way, things):
    """Open each kind in one way; what was shown after each, and after the avatar was undone."""
    window.studio.journal = Journal(start())
    window.training.form.capture, window.training.runs.chosen = "", None
    test.window_focus("//Body")
    seen = {}
    for kind in ("session", "motion", "avatar", "capture", "run"):
        way(test, window, things[kind])
        seen[kind] = shown(window)[kind]
        if kind == "avatar":
            seen["tab before"] = shown(window)["capture"][1]
            test.key_press(chord("Ctrl+Z"))
            settle(test, window)
            seen["undone"] = shown(window)["avatar"]
    return {**seen, "run's avatar": shown(window)["avatar"]}


def lost(test, window, folder):
    """Things that cannot be opened; whether they changed anything, and the dialogs about them."""
    before = window.studio.state
    logging.getLogger().addHandler(window.toasts)
    drop(str(folder / "nothing.bvh"), str(folder / "empty"), str(folder / "lost.avatar"), str(folder / "lost.json"))
    settle(test, window)
    logging.getLogger().removeHandler(window.toasts)
    told = [question.title for question in window.questions.waiting]
    while window.questions.waiting:
        test.key_press(chord("Escape"))
        test.yield_(3)
    return window.studio.state is before, told


def from_recent(test, window, things):
    """A recent file by the menu, another one that is gone."""
    window.opening.recent.add(things["motion"])
    window.opening.recent.add(things["session"])
    os.rename(things["session"], things["session"] + ".moved")
    window.studio.journal = Journal(start())
    test.menu_click("//##MainMenuBar/File/Recent/turn.json##" + things["motion"].replace("/", "\\/"))
    settle(test, window)
    return shown(window)["motion"], window.opening.recent.gone


def the_dialog_itself(test, window, folder):
    """Its entries, a key that is no shortcut while it is open, Escape; then a name to save under."""
    window.files.folder = str(folder)
    test.key_press(chord("Ctrl+O"))
    test.yield_(4)
    entries, state = [entry.name for entry in window.files._entries], window.studio.state
    test.key_press(chord("N"))
    test.yield_(2)
    kept = window.studio.state is state
    test.key_press(chord("Escape"))
    test.yield_(3)
    left = window.files.is_open
    test.key_press(chord("Ctrl+S"))
    test.yield_(4)
    test.key_chars("mine")  # the name has the focus
    test.yield_(2)
    test.item_click("//Save the session###files/###answer")
    test.yield_(3)
    return entries, kept, left


@pytest.mark.window
def test_everything_is_opened(display, things, tmp_path, caplog):
    seen = {}
    caplog.set_level(logging.INFO)
    ways = {"dialog": by_dialog, "drop": lambda test, window, path: (drop(path), settle(test, window))}
    (tmp_path / "empty").mkdir()
    session = {
        "format": 1,
        "kind": "session",
        "start": {"format": 1, "avatar": str(tmp_path / "x.avatar")},
        "steps": [],
    }
    (tmp_path / "lost.json").write_text(json.dumps(session))

    def scenario(test, window):
        settle(test, window)
        seen.update({name: everything(test, window, way, things) for name, way in ways.items()})
        seen["views"] = [view.path for view in window.training.watcher.views]
        seen["words"] = window.training.form._told[1]
        seen["unchanged"] = lost(test, window, tmp_path)
        seen["recent"] = window.opening.recent.paths[:2]
        seen["menu"] = from_recent(test, window, things)
        seen["dialog itself"] = the_dialog_itself(test, window, tmp_path)

    drive(ball_engine, scenario, (1000, 640), load=read_any_avatar)
    for name in ways:
        found = seen[name]
        assert found["session"] == pytest.approx(0.7, abs=0.01)
        assert found["motion"] == things["motion"]
        assert found["avatar"] == (things["avatar"], True)
        assert found["undone"] == ("default", True)
        assert not found["tab before"]
        assert found["capture"] == (things["capture"], True), "the Training tab comes to the front"
        assert found["run"] == Path(things["run"])
        assert found["run's avatar"] == (os.path.join(things["run"], "avatars", "step_00000030.avatar"), True)
    assert seen["views"] == [Path(things["run"])]
    assert seen["words"] == "body: 3 frames, 3 cameras"
    lost_ones = ("nothing.bvh", "empty", "lost.avatar", "lost.json")
    assert seen["unchanged"] == (True, [f"{name} cannot be opened" for name in lost_ones])
    for words in ("nothing.bvh: expected an avatar", "an empty folder", "lost.avatar: expected an avatar", "x.avatar"):
        assert words in caplog.text
    assert seen["recent"] == (things["run"], things["capture"])
    assert seen["menu"] == (things["motion"], {things["session"]})
    names = ["capture", "empty", "run", "anna.avatar", "lost.json", "turn.json"]
    assert seen["dialog itself"] == (names, True, False), "keys go to the dialog"
    assert Journal.load(tmp_path / "mine.json").state.timeline.motion.path == things["motion"]


def test_a_slow_motion_is_read_in_the_background_and_can_be_cancelled(studio, tmp_path, monkeypatch):
    """What waits behind it is read; of the cancelled one nothing is shown, even once it has been read."""
    going, told = threading.Event(), []

    def read(path):
        told.append(path)
        if path == "slow":
            assert going.wait(20)
        frames = tuple(Signals.rest().replace(translation=np.array([0.0, 0.0, 0.01 * k])) for k in range(5))
        write_json(tmp_path / f"{path}.json", SignalSequence(frames, 30.0, path))
        return read_motion(str(tmp_path / f"{path}.json"))

    monkeypatch.setattr("avatarrex_studio.window.opening.read_motion", read)
    monkeypatch.setattr("avatarrex_studio.window.opening.SLOW", 0.0)
    opening = Opening(studio, object.__new__(TrainingPanel))
    before = studio.avatars._threads
    opening.motion("slow")
    opening.layer("next")
    opening.tend()
    assert (opening.busy, opening.slow, opening.words) == (True, True, "opening slow…")
    assert not studio.state.timeline.layers, "nothing has waited for it"
    opening.cancel()
    for _ in range(500):
        opening.tend()
        if not opening.busy:
            break
        time.sleep(0.01)
    assert told == ["slow", "next"]
    assert studio.avatars._threads is not before, "an avatar that is read holds up no other, either"
    assert [layer.name for layer in studio.state.timeline.layers] == ["next.json"]
    going.set()
    opening.motion("last")
    for _ in range(500):
        opening.tend()
        if not opening.busy:
            break
        time.sleep(0.01)
    assert [layer.name for layer in studio.state.timeline.layers] == ["last.json"], (
        "it takes the place of the lowest clip"
    )
    opening.close()


def test_a_cancelled_session_reads_no_other_avatar(studio, things, tmp_path):
    going, read = threading.Event(), []

    def slow(name):
        read.append(name)
        assert "one" not in name or going.wait(20)
        return one_avatar()

    studio.avatars._load = slow
    journal = Journal()
    names = [str(tmp_path / f"{name}.avatar") for name in ("one", "two")]
    for name in names:
        Path(name).write_bytes(b"an avatar")
        journal.do(AddFigure(name))
    journal.save(tmp_path / "pair.json")
    opening = Opening(studio, object.__new__(TrainingPanel))
    opening.open(str(tmp_path / "pair.json"))
    while names[0] not in read:
        time.sleep(0.01)
    under_way = opening._reading[0].future
    opening.cancel()
    going.set()
    with pytest.raises(CancelledError):
        under_way.result(20)
    assert names[1] not in read
    opening.close()


def finish(opening):
    """Have all that is being read shown."""
    until = time.monotonic() + 30
    while opening.busy and time.monotonic() < until:
        opening.tend()
        time.sleep(0.01)


def test_a_motion_lands_on_the_avatar_that_it_was_opened_for(studio, tmp_path, monkeypatch, caplog):
    """Whoever is selected when it has been read stays so; also where another avatar goes meanwhile. Its own is gone: one line."""
    frames = tuple(Signals.rest().replace(translation=np.array([0.0, 0.0, 0.01 * k])) for k in range(5))
    write_json(tmp_path / "walk.json", SignalSequence(frames, 30.0, "walk"))
    going = threading.Event()
    monkeypatch.setattr(
        "avatarrex_studio.window.opening.read_motion", lambda path: going.wait(20) and read_motion(path)
    )
    opening = Opening(studio, object.__new__(TrainingPanel))
    for _ in range(2):
        studio.do(AddFigure("default"))

    def layers(begin, *meanwhile):
        going.clear()
        studio.journal.steps.clear()
        begin(str(tmp_path / "walk.json"))
        for command in meanwhile:
            studio.do(command)
        going.set()
        finish(opening)
        return studio.state.slot, [len(figure.timeline.layers) for figure in studio.state.figures]

    assert layers(opening.motion, SelectFigure(0)) == (0, [0, 0, 1])
    assert len(studio.journal.steps) == 2, "one of the selection, one of the motion"
    studio.do(SelectFigure(2))
    assert layers(opening.layer, RemoveFigure(0), SelectFigure(0)) == (0, [0, 2])
    assert layers(opening.layer, RemoveFigure(0)) == (0, [2])
    assert "walk.json: expected the avatar that it was opened for, found it has been removed" in caplog.text
    opening.close()


def test_what_a_folder_has(tmp_path):
    (tmp_path / "Zoo").mkdir()
    (tmp_path / "b.bvh").write_bytes(bytes(1234))
    (tmp_path / "a.txt").write_text("")
    (tmp_path / ".hidden").write_text("")
    os.symlink("nowhere", tmp_path / "lost")
    assert [entry.name for entry in listed(str(tmp_path))] == ["Zoo", "a.txt", "b.bvh", "lost"]
    folder, file = listed(str(tmp_path), (".bvh",))
    assert (folder.size_words, file.size_words) == ("", "1.2 kB")
    for name in ("nothing", "a.txt", "x\0"):
        with pytest.raises(InputError, match=r"a folder that can be read"):
            listed(str(tmp_path / name))
    assert str(Path.home()) in places().values()
    sizes = {
        0: "0 B",
        999: "999 B",
        1000: "1.0 kB",
        999_499: "999 kB",
        999_500: "1.0 MB",
        9.9e9: "9.9 GB",
        2e16: "20000 TB",
    }
    assert {size: size_words(int(size)) for size in sizes} == sizes


def test_recent_files_are_kept(tmp_path):
    for number in range(MOST + 3):
        (tmp_path / f"{number}.bvh").write_text("")
        Recent(tmp_path / "state" / "recent.json").add(str(tmp_path / f"{number}.bvh"))
    recent = Recent(tmp_path / "state" / "recent.json")
    recent.add(str(tmp_path / "7.bvh"))
    recent.add(str(tmp_path / "0.bvh"))
    recent.add("default")
    recent.add(str(tmp_path / "nothing"))
    names = [Path(path).name for path in recent.paths]
    assert names == [f"{number}.bvh" for number in (0, 7, 14, 13, 12, 11, 10, 9, 8, 6, 5, 4)]
    (tmp_path / "7.bvh").unlink()
    recent.look()
    assert recent.gone == {str(tmp_path / "7.bvh")}


@pytest.mark.parametrize("text", ["", "{}", "[1, null]", '["relative.bvh", "/a\\u001b[2J"]', "[" * 9000])
def test_a_broken_list_of_recent_files_is_an_empty_one(text, tmp_path):
    (tmp_path / "recent.json").write_text(text)
    assert Recent(tmp_path / "recent.json").paths == ()


def test_recent_files_that_cannot_be_written_end_nothing(tmp_path, caplog):
    (tmp_path / "state").write_text("no folder")
    (tmp_path / "a.bvh").write_text("")
    recent = Recent(tmp_path / "state" / "recent.json")
    recent.add(str(tmp_path / "a.bvh"))
    assert recent.paths == (str(tmp_path / "a.bvh"),)
    assert "recent.json" in caplog.text


def test_what_a_name_in_the_dialog_means(tmp_path, monkeypatch):
    dialog = FileDialog()
    dialog.folder = str(tmp_path)
    for kind, save, typed, path in (
        ("any", False, "", None), ("any", False, "a.bvh", "a.bvh"), ("any", False, "/b.bvh", "/b.bvh"), ("session", False, "", None),
        ("session", True, "", None), ("session", True, "mine", "mine.json"), ("session", True, "mine.txt", "mine.txt"),
    ):  # fmt: skip
        (dialog.save if save else dialog.open)(kind, "Title", lambda path: None)
        dialog.name = typed
        assert dialog._path() == (None if path is None else os.path.join(tmp_path, path))
    (tmp_path / "avatar.json").write_text("{}")
    dialog.open("any", "Title", lambda path: None)
    assert dialog._path() == str(tmp_path), "a folder that is an avatar"
    monkeypatch.setattr(files, "kind_of", None)
    assert dialog._path() == str(tmp_path), "found out once, not in every frame"


def test_a_session_takes_the_place_of_unsaved_work_only_once_that_is_decided(studio, things):
    waiting = []
    opening = Opening(studio, object.__new__(TrainingPanel), waiting.append)
    studio.avatars._load = lambda name: one_avatar()
    studio.do(SetExpression("jawOpen", 0.2))
    before = studio.state
    opening.open(things["session"])
    finish(opening)
    assert studio.state is before
    waiting[0]()
    assert studio.state.signals.expression.max() == pytest.approx(0.7)
    opening.close()


@pytest.mark.parametrize(
    ("answer", "first", "last"),
    [("Discard", (2, 0.7), (1, 0.4)), ("Cancel", (2, 0.2), (2, 0.2)), ("", (2, 0.2), (2, 0.2))],
)
def test_what_was_opened_after_a_session_waits_until_that_is_decided(studio, things, tmp_path, answer, first, last):
    """An avatar comes into the session that is there then; a second session gets its question, too. No answer: Esc."""
    questions = Questions()
    leaving = Leaving(studio, TrainingProcesses(), questions, Autosave(tmp_path))
    opening = Opening(
        studio,
        object.__new__(TrainingPanel),
        lambda then: then() if leaving.saved(nothing, then) else None,
        lambda: bool(questions.waiting),
    )
    studio.avatars._load = lambda name: one_avatar()
    journal = Journal(start())
    journal.do(SetExpression("jawOpen", 0.4))
    journal.save(tmp_path / "second.json")
    studio.do(SetExpression("jawOpen", 0.2))

    def answered():
        until = time.monotonic() + 30
        while not questions.waiting and time.monotonic() < until:
            opening.tend()
            time.sleep(0.01)
        before = studio.state
        for reading in opening._reading:
            reading.future.result(30)
        opening.tend()
        assert (studio.state is before, len(questions.waiting)) == (True, 1)
        questions._end(questions.waiting[0].answers.get(answer, nothing))

    def found():
        figures = studio.state.figures
        return len(figures), pytest.approx(figures[0].signals.expression.max())

    opening.open(things["session"])
    opening.add(things["avatar"])
    opening.open(str(tmp_path / "second.json"))
    answered()
    opening.tend()
    assert found() == first
    answered()
    finish(opening)
    assert found() == last
    opening.close()


@pytest.mark.window
def test_the_dialog_goes_into_a_folder_that_is_nothing_and_takes_what_is_typed_at_once(display, things, tmp_path):
    seen, plain = {}, tmp_path / "plain"
    plain.mkdir()

    def scenario(test, window):
        settle(test, window)
        window.files.folder = str(tmp_path)
        test.key_press(chord("Ctrl+O"))
        test.yield_(4)
        test.key_chars(plain.name)
        test.key_press(int(imgui.Key.enter))
        test.yield_(4)
        seen["gone into"] = window.files.is_open, window.files.folder, window.files.name
        test.key_press(int(imgui.Key.escape))
        test.yield_(3)

    drive(ball_engine, scenario, (1000, 640), load=read_any_avatar)
    assert seen["gone into"] == (True, str(plain), "")
