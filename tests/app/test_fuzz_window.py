"""A few seconds of the fuzzer in the true window, on a stand-in for the pipeline; and that it finds what fails."""

from __future__ import annotations

import importlib.util
import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from avatarrex_studio.panels import scene
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import SizePolicy, StudioState
from avatarrex_studio.window.window import Window
from ball_studio import ball_studio
from imgui_bundle import hello_imgui, imgui

pytestmark = pytest.mark.window
PLACE = Path(__file__).parents[2] / "tools" / "fuzz_window.py"


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("fuzz_window", PLACE)
    module = sys.modules["fuzz_window"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    del sys.modules["fuzz_window"]


def small_window(make=None):
    """Pictures of a few pixels: the interface is what is driven. `make()` makes the engine that exports."""
    journal = Journal(StudioState(size=SizePolicy(fixed=(64, 48))))
    return Window(ball_studio(time.monotonic, journal=journal), make=make)


@pytest.fixture
def folder(tool, tmp_path, monkeypatch):
    for name in ("AVATARREX_LIBRARY", "XDG_CACHE_HOME", "XDG_STATE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / {"AVATARREX_LIBRARY": "library"}.get(name, name[4:9].lower())))
    tool.write_files(tmp_path / "files")
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path


def test_nothing_ends_the_window(display, tool, folder):
    window = small_window()
    seen = {}

    def look():
        """What F3 does, before anything random."""
        seen.setdefault("layout", hello_imgui.current_layout_name())

    window.first_picture = look
    report = tool.fuzz(window, 5, 5.0, folder, (640, 480))
    assert report.failures == []
    assert report.answers, "at the end a key does what it should"
    assert report.actions > 5
    assert seen["layout"] == "Pose"
    assert (folder / "actions.txt").read_text().count("\n") >= report.actions


def test_a_process_that_is_stopped_is_no_failure_but_a_window_that_waits_is(tool, folder, monkeypatch):
    monkeypatch.setattr(tool, "SLOW", 0.5)
    window = small_window()
    window._frames = 10
    driver = tool.Fuzz(window, 5, 60.0, folder)

    def frame():
        driver._queue.append(lambda: None)
        driver._step()

    frame()
    with subprocess.Popen(["sh", "-c", f"sleep 1; kill -CONT {os.getpid()}"]):
        os.kill(os.getpid(), signal.SIGSTOP)
    frame()
    assert driver.report.failures == []
    time.sleep(1)
    frame()
    driver.close()
    assert len(driver.report.failures) == 1
    assert "no frame for" in driver.report.failures[0]


def test_what_fails_is_found_and_the_window_goes_on(display, tool, folder, monkeypatch, caplog):
    caplog.set_level(logging.CRITICAL)

    def broken(*_):
        imgui.begin_child("child")
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr(scene, "draw", broken)
    window = small_window()
    report = tool.fuzz(window, 7, 0.2, folder, (640, 480))
    assert report.answers
    assert any("on purpose" in failure and "seed 7" in failure for failure in report.failures)
    assert len([failure for failure in report.failures if "on purpose" in failure]) == 1
