"""Toasts, questions, unsaved work and its keeping, without a window."""

from __future__ import annotations

import json
import logging
import subprocess
import sys

import pytest
from avatarrex_studio.jobs.training_process import TrainingProcesses
from avatarrex_studio.panels.questions import Questions
from avatarrex_studio.panels.toasts import FADE, MOST, SECONDS, Toasts
from avatarrex_studio.session.autosave import EVERY, Autosave
from avatarrex_studio.session.commands import ApplyPose, OrbitBy, SetExpression
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.notice import NOTICE, refusals_logged
from avatarrex_studio.window.leaving import Leaving
from ball_studio import ball_studio
from imgui_bundle import imgui

from avatarrex.errors import InputError


@pytest.fixture
def toasts(clock):
    handler, refused = Toasts(lambda *words: refused.append(words), clock), []
    handler.told = refused
    logging.getLogger().addHandler(handler)
    logging.getLogger().setLevel(logging.INFO)
    yield handler
    logging.getLogger().removeHandler(handler)


def test_the_log_becomes_toasts(toasts, clock):
    log = logging.getLogger("a")
    log.info("only for the console")
    log.log(NOTICE, "Picture written: %s", "/a/b.png")
    for _ in range(2):
        with refusals_logged():
            raise InputError("walk.npz", "poses", "165 numbers", "12")
    with refusals_logged(opening="walk.bvh"):
        raise InputError("walk.bvh", "", "a motion", "nothing there")
    try:
        raise ValueError("a cause")
    except ValueError:
        log.exception("it failed")
    picture, refusal, fault = toasts.shown
    assert (picture.title, picture.next_step) == ("Picture written: /a/b.png", "")
    assert (refusal.title, refusal.next_step, refusal.times) == (
        "walk.npz: poses: found 12",
        "Needed: 165 numbers",
        2,
    )
    assert fault.title == "it failed: ValueError: a cause"
    assert toasts.told == [("walk.bvh", "walk.bvh: found nothing there\nNeeded: a motion")]
    clock.now += SECONDS[NOTICE] - FADE / 2
    assert picture.alpha(clock.now) == pytest.approx(0.5)
    assert toasts.moving
    for number in range(9):
        log.error("error %d", number)
    assert len(toasts.shown) == MOST


def test_a_click_on_a_toast_opens_the_console_and_time_ends_it(toasts, clock):
    context = imgui.create_context()
    try:
        io = imgui.get_io()
        io.display_size = imgui.ImVec2(800, 600)
        io.set_ini_filename("")
        io.backend_flags |= imgui.BackendFlags_.renderer_has_textures

        def frame():
            imgui.new_frame()
            clicked = toasts.draw((0.0, 0.0), (800.0, 600.0))
            imgui.render()
            return clicked

        logging.getLogger("a").error("one")
        io.add_mouse_pos_event(700, 580)
        assert not any(frame() for _ in range(3))
        io.add_mouse_button_event(0, True)
        assert any([frame(), frame()])
        assert toasts.shown == []
        logging.getLogger("a").error("two")
        clock.now += SECONDS[logging.ERROR] + 1
        frame()
        assert toasts.shown == []
    finally:
        imgui.destroy_context(context)


def test_what_is_unsaved(tmp_path):
    journal = Journal()
    journal.do(OrbitBy(20.0, 0.0))
    assert not journal.unsaved, "a look is no work"
    journal.do(ApplyPose("wave"))
    assert journal.unsaved
    journal.undo()
    assert not journal.unsaved
    journal.redo()
    journal.save(tmp_path / "a.json")
    assert (journal.unsaved, journal.path) == (False, str(tmp_path / "a.json"))
    read = Journal.load(tmp_path / "a.json")
    assert (read.unsaved, read.path) == (False, journal.path)


def test_work_is_kept_every_half_minute_and_removed_when_it_is_saved(tmp_path, clock):
    journal, kept = Journal(), Autosave(tmp_path, clock)
    journal.do(ApplyPose("wave"))
    kept.tend(journal)
    assert not kept.file.exists()
    clock.now += EVERY
    kept.tend(journal)
    kept._writing.result()
    assert len(json.loads(kept.file.read_text())["session"]["steps"]) == 1
    assert Autosave(tmp_path).found() == [], "its process lives"
    journal.save(tmp_path / "a.json")
    kept.tend(journal)
    kept._writing.result()
    assert not kept.file.exists()
    kept.close()


def test_a_killed_process_leaves_its_work(tmp_path):
    code = (
        "import os, signal, sys, time\nfrom pathlib import Path\n"
        "from avatarrex_studio.session.autosave import Autosave\nfrom avatarrex_studio.session.journal import Journal\n"
        "from avatarrex_studio.session.commands import ApplyPose\n"
        "journal, times = Journal(), iter((0.0, 60.0, 60.0, 60.0))\njournal.path = 'mine.json'\n"
        "journal.do(ApplyPose('wave'))\n"
        "kept = Autosave(Path(sys.argv[1]), times.__next__)\nkept.tend(journal)\nkept._writing.result()\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path)]).returncode == -9
    (recovery,) = Autosave(tmp_path).found()
    journal, expected = recovery.read(), Journal()
    expected.do(ApplyPose("wave"))
    assert journal.state == expected.state
    assert (journal.unsaved, journal.path) == (True, "mine.json")
    recovery.discard()
    assert Autosave(tmp_path).found() == []


@pytest.mark.parametrize(
    ("answer", "left", "stopped"), [("Let it go on", 1, False), ("Stop it", 1, True), ("Cancel", 0, False)]
)
def test_a_running_training_is_a_question(tmp_path, clock, monkeypatch, answer, left, stopped):
    processes, questions, leaves, stops = TrainingProcesses(), Questions(), [], []
    monkeypatch.setattr(TrainingProcesses, "paths", [tmp_path / "run"])
    monkeypatch.setattr(processes, "stop", stops.append)
    leaving = Leaving(ball_studio(clock), processes, questions, Autosave(tmp_path, clock))
    assert not leaving.now(lambda then: then(), lambda: leaves.append(1))
    (question,) = questions.waiting
    question.answers[answer]()
    assert (len(leaves), stops) == (left, [tmp_path / "run"] if stopped else [])


@pytest.mark.parametrize(("answer", "shown", "saved"), [("Save", 1, True), ("Discard", 1, False), ("Cancel", 0, False)])
def test_unsaved_work_is_a_question_before_another_session_is_shown(tmp_path, clock, answer, shown, saved):
    studio, questions, done, saves = ball_studio(clock), Questions(), [], []
    leaving = Leaving(studio, TrainingProcesses(), questions, Autosave(tmp_path, clock))
    assert leaving.saved(saves.append, lambda: done.append(1)), "nothing is unsaved"
    studio.do(SetExpression("jawOpen", 0.3))

    def save(then):
        saves.append(1)
        then()

    assert not leaving.saved(save, lambda: done.append(1))
    (question,) = questions.waiting
    question.answers[answer]()
    assert (len(done), bool(saves)) == (shown, saved)
