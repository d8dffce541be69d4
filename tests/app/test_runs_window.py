"""The progress viewer under Xvfb: it follows a run that another process trains, and the Training tab steers one."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from avatarrex_studio.jobs.training_process import TrainingProcesses
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.window.runs_window import RunsWindow
from avatarrex_studio.window.window import Window, start
from ball_studio import ball_studio
from driving import drive, until
from imgui_bundle import icons_fontawesome_6 as icons

from avatarrex.training.runs.events import event_files

pytestmark = pytest.mark.window
TINY = (sys.executable, str(Path(__file__).parents[1] / "tiny_run.py"))


def wait(test, condition, seconds=90):
    """Let the window draw until something has happened."""
    assert until(test, condition, seconds)


def views(panel):
    return {view.name: view for view in panel.watcher.views}


def test_the_viewer_follows_live_runs_and_stands_broken_files(display, tmp_path):
    command = [*TINY, str(tmp_path / "live"), "--steps", "100000", "--seconds", "0.02"]
    done = subprocess.run([*TINY, str(tmp_path / "done"), "--steps", "12"], capture_output=True)
    assert done.returncode == 0
    child = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    window, seen = RunsWindow(tmp_path), {}
    panel = window.panel

    def scenario(test):
        wait(test, lambda: "live" in views(panel) and views(panel)["live"].step > 6)
        wait(test, lambda: len(panel.plots.samples._textures) == 6)
        seen["first"], seen["states"] = views(panel)["live"].step, {v.name: v.state for v in views(panel).values()}
        wait(test, lambda: views(panel)["live"].step > seen["first"] + 10)
        with open(event_files(tmp_path / "done")[0], "ab") as file:
            file.write(b"\x20\x00\x00\x00\x00\x00")  # half a record
        (tmp_path / "half").mkdir()
        (tmp_path / "half/run.json").write_text('{"format": 1, "config"')
        (tmp_path / "half/events.out.tfevents.1.x").write_bytes(b"\x07" * 100)
        wait(test, lambda: "half" in views(panel))
        test.item_click("**/By time")
        step = views(panel)["live"].step
        wait(test, lambda: views(panel)["live"].step > step + 5)
        seen["notes"] = {v.name: v.note for v in views(panel).values()}
        child.kill()
        child.wait()
        wait(test, lambda: views(panel)["live"].state == "dead")

    try:
        drive(window, scenario)
    finally:
        child.kill()
        child.wait()
    assert seen["states"] == {"live": "running", "done": "finished"}
    assert seen["notes"] == {"live": "", "done": "", "half": "run.json cannot be read"}
    assert panel.plots.curves.by_time
    assert not panel.watcher.is_alive()


def test_the_training_tab_starts_pauses_resumes_stops_and_shows(display, tmp_path):
    window = Window(ball_studio(time.monotonic, journal=Journal(start())), tmp_path / "runs")
    panel = window.training
    command = [*TINY, "--steps", "100000", "--seconds", "0.02", "--avatar"]
    panel.processes = TrainingProcesses(command)
    seen = {}

    def state():
        return views(panel)["one"].state if "one" in views(panel) else None

    def press(test, wanted):
        """A button of the run, by its id."""
        title = panel._buttons(views(panel)["one"])[wanted]
        test.item_click(f"**/{title}##{wanted}")

    def scenario(test):
        test.yield_(6)
        test.window_focus("//Training")
        test.yield_(3)
        form = panel.form
        form.capture, form.out, form.recipe = "captures/me.zip", str(tmp_path / "runs/one"), "smoke"
        test.item_click(f"**/{icons.ICON_FA_PLAY}  Start training")
        wait(test, lambda: state() == "running")
        seen["watched"] = window._resting_fps()
        press(test, "pause")
        wait(test, lambda: state() == "paused")
        seen["paused"] = views(panel)["one"].step
        press(test, "resume")
        wait(test, lambda: state() == "running" and views(panel)["one"].step > seen["paused"] + 3)
        wait(test, lambda: views(panel)["one"].avatar is not None)
        test.yield_(3)  # until the button that this brings is drawn, and those beside it have moved
        press(test, "load")
        wait(test, lambda: window.studio.state.avatar != "default")
        seen["avatar"] = window.studio.state.avatar
        press(test, "stop")
        wait(test, lambda: state() == "stopped")
        wait(test, lambda: not panel.processes.working(tmp_path / "runs/one"))
        seen["rests"] = window._resting_fps()

    try:
        drive(window, scenario)
    finally:
        for child in panel.processes._children.values():
            child.process.kill()
    assert seen["avatar"].startswith(str(tmp_path / "runs/one/avatars/step_"))
    assert os.path.isfile(seen["avatar"])
    assert panel.processes.message == "one: training ended"
    assert seen["rests"] < 0.5 <= seen["watched"], "where nothing goes on, the interface is hardly drawn"
    assert views(panel)["one"].about["preset"] == "smoke"
