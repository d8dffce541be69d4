"""Runs as viewers see them: states, rates, time left, the table in a terminal, and trainings in their own processes."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli.main import main
from avatarrex_studio.cli.runs import table
from avatarrex_studio.jobs.run_view import RunView, duration, keep_avatar
from avatarrex_studio.jobs.runs import Runs, Watched
from avatarrex_studio.jobs.training_process import Order, TrainingProcesses, last_words
from avatarrex_studio.jobs.watcher import Watcher
from avatarrex_studio.panels.curve_data import log_ticks, smoothed, span, step_ticks, thinned
from avatarrex_studio.panels.samples import HEAT, difference

from avatarrex.errors import InputError
from avatarrex.training.runs import control
from avatarrex.training.runs.control import Heartbeat, request
from avatarrex.training.runs.events import Series, event_files
from avatarrex.training.runs.folder import Run, read_about

TINY = (sys.executable, str(Path(__file__).parents[1] / "tiny_run.py"))


def look(folder) -> dict[str, RunView]:
    runs = Runs(folder)
    while runs.poll():
        pass
    return {view.name: view for view in runs.views}


def until(condition, seconds=60.0):
    """Wait for something another process does."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.05)


def test_what_is_known_of_a_run(tmp_path):
    with Run.create(tmp_path / "a/one", {"part": "body", "steps": {"body": 400}, "preset": "quick", "seed": 3}) as run:
        for step in range(0, 100, 10):
            values = {"body/loss/total": 1 / (step + 1), "body/rate/steps_per_s": 5.0, "face/loss/rgb": 2.0}
            run.scalars(step, values)
        run.picture(90, "body/walk/render", np.zeros((4, 3, 3), np.uint8))
        run.picture(0, "body/walk/truth", np.zeros((4, 3, 3), np.uint8))
        run.save(90, {"x": 1})
        view = look(tmp_path)["a/one"]
        assert (view.state, view.part, view.step, view.steps, view.rate) == ("running", "body", 90, 400, 5.0)
        assert view.eta == pytest.approx((400 - 90) / 5)
        assert view.parts == ("body", "face")
        assert view.picture("body/walk", "truth", 90).name == "step_00000000.png"
        assert view.picture("body/walk", "render", 10).name == "step_00000090.png"
        assert view.picture("body/walk", "depth", 10) is None
        assert [path.name for path in view.checkpoints] == ["step_00000090"]
        run.stage("face", "II", 1000)
        run.scalars(7, {"face/loss/rgb": 1.5})
        view = look(tmp_path)["a/one"]
        assert (view.part, view.pass_name, view.step, view.steps) == ("face", "II", 7, 1000)
        request(run.path, "pause")
        run.control()
        assert look(tmp_path)["a/one"].state == "paused"
    view = look(tmp_path / "a/one")["one"]
    assert (view.state, view.eta, view.progress) == ("finished", None, 1.0)


def test_a_run_without_a_heartbeat_is_dead(tmp_path, monkeypatch):
    run = Run.create(tmp_path / "run", {})
    assert look(tmp_path)["run"].state == "running"
    beat = Heartbeat.read(tmp_path / "run")
    monkeypatch.setattr(control.time, "time", lambda: beat.time + 2 * control.DEAD_SECONDS)
    assert look(tmp_path)["run"].state == "dead"
    monkeypatch.undo()
    run.close()
    assert look(tmp_path)["run"].state == "finished"


def test_the_rate_without_a_report_leaves_out_a_pause(tmp_path, monkeypatch):
    moment = time.time()
    with Run.create(tmp_path / "run", {"part": "body", "steps": 1000}) as run:
        for step in range(20):
            moment += 0.25 if step != 10 else 5.0
            monkeypatch.setattr(control.time, "time", lambda: moment)  # noqa: B023
            run.scalars(step, {"body/loss/rgb": 1.0})
    assert look(tmp_path)["run"].rate == pytest.approx(4.0)


def test_the_table(tmp_path, capsys):
    with Run.create(tmp_path / "one", {"part": "body", "steps": 100}) as run:
        run.scalars(40, {"body/loss/total": 0.25, "body/loss/rgb": 0.125, "body/heldout/psnr": 21.5,
                         "body/rate/steps_per_s": 2.0, "body/heldout/ssim": 0.9})  # fmt: skip
        run.stage("body", "I", 100)
        assert main(["runs", str(tmp_path), "--text", "--once"]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[0].split() == ["RUN", "STATE", "PART", "PASS", "STEP", "STEPS/S", "PSNR", "SSIM", "ETA", "LOSSES"]
        words = "one running body I 40/100 2 21.50 0.9000 30 s total 0.25 rgb 0.125"
        assert lines[1].split() == words.split()
    with pytest.raises(ZeroDivisionError), Run.create(tmp_path / "two", {}):
        raise ZeroDivisionError("loss/rgb is NaN")
    lines = table(list(look(tmp_path).values()), width=60)
    assert all(len(line) <= 60 for line in lines)
    coloured = table(list(look(tmp_path).values()), colour=True)[2]
    assert "\x1b[31mfailed\x1b[0m" in coloured
    assert coloured.endswith("loss/rgb is NaN")
    assert main(["runs", str(tmp_path / "nowhere"), "--text"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_no_display_is_said_in_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(["runs", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"avatarrex-studio: error: no display; without one use " \
        f"`avatarrex-studio runs {tmp_path} --text`\n"  # fmt: skip


def test_a_table_needs_no_torch(tmp_path):
    code = "import sys, avatarrex_studio.cli.runs; print('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "False\n"


def test_durations():
    seconds = (None, 0, 89, 90, 3600, 5400, 11100, 200000)
    words = ("–", "0 s", "89 s", "2 min", "60 min", "1 h 30 min", "3 h 05 min", "2 d 07 h")
    assert tuple(map(duration, seconds)) == words


@pytest.mark.parametrize("name", ["run.json", "heartbeat.json", "checkpoints/step_00000001/manifest.json", "events"])
@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"null", b"\xff\xfe\x00", b'{"format": 1, "state": [], "config": {}}',
                                     b'{"time": "x", "pid": "y", "host": 3}'])  # fmt: skip
def test_broken_files_leave_the_other_runs_alone(tmp_path, name, content, caplog):
    for run_name in ("broken", "good"):
        with Run.create(tmp_path / run_name, {"part": "body"}) as run:
            run.scalars(1, {"body/loss/total": 1.0})
            run.save(1, {})
    file = event_files(tmp_path / "broken")[0] if name == "events" else tmp_path / "broken" / name
    file.write_bytes(content)
    views = look(tmp_path)
    assert views["good"].state == "finished"
    assert views["good"].last("loss/total") == 1.0
    assert "broken" in views
    assert not [record for record in caplog.records if record.exc_info], "seen coming, not caught at the last line"
    table(list(views.values()))


def test_the_watcher_follows_and_decodes(tmp_path):
    watcher = Watcher(tmp_path)
    watcher.start()
    try:
        with Run.create(tmp_path / "run", {"part": "body"}) as run:
            pixels = np.arange(36, dtype=np.uint8).reshape(4, 3, 3)
            path = run.picture(1, "body/walk/render", pixels)
            for step in range(3):
                run.scalars(step, {"body/loss/total": float(step)})
                until(lambda: watcher.views and watcher.views[0].step == step)  # noqa: B023
        until(lambda: watcher.views[0].state == "finished")
        until(lambda: watcher.picture(path) is not None)
        assert np.array_equal(watcher.picture(path), pixels)
        path.write_bytes(path.read_bytes()[:-30])
        time.sleep(0.02)
        for _ in range(20):
            watcher.picture(path)
            time.sleep(0.02)
        assert watcher.is_alive()
        assert watcher.picture(tmp_path / "none.png") is None
    finally:
        watcher.close()
    assert not watcher.is_alive()


def test_an_avatar_is_kept_when_its_checkpoint_goes(tmp_path):
    with Run.create(tmp_path / "run", {}) as run:
        run.save(1, {})
        with pytest.raises(InputError, match="a checkpoint with an avatar"):
            keep_avatar(look(tmp_path)["run"])
        for step in range(2, 7):
            run.save(step, {})
            if step == 3:
                (run.path / "checkpoints/step_00000003/avatar.avatar").write_bytes(b"avatar")
                kept = keep_avatar(look(tmp_path)["run"])
                assert keep_avatar(look(tmp_path)["run"]) == kept
        assert not (run.path / "checkpoints/step_00000003").exists()
    assert kept.name == "step_00000003.avatar"
    assert kept.read_bytes() == b"avatar"


def test_an_avatar_is_found_though_what_was_listed_has_gone(tmp_path):
    watched = Watched(tmp_path / "run", "run")
    with Run.create(tmp_path / "run", {}) as run:
        for step in range(1, 6):
            run.save(step, {})
            if step in (1, 5):
                (run.path / f"checkpoints/step_{step:08d}/avatar.avatar").write_bytes(b"%d" % step)
            if step == 1:
                watched.poll()
    stale = watched.view
    assert stale.avatar is not None
    assert not stale.avatar.exists()
    assert keep_avatar(stale).read_bytes() == b"5"
    shutil.rmtree(tmp_path / "run/checkpoints")
    watched._listed = -1e9
    watched.poll()
    assert watched.view.avatar == stale.avatar  # the button stays, and says what is wrong when it is pressed
    with pytest.raises(InputError, match="a checkpoint with an avatar"):
        keep_avatar(watched.view)


def test_a_training_is_started_paused_resumed_and_stopped(tmp_path):
    processes = TrainingProcesses([*TINY, "--steps", "100000", "--seconds", "0.01"])
    out = tmp_path / "run"
    processes.start(Order("a capture", "smoke", out, ["body"]))
    try:
        with pytest.raises(InputError, match="started here"):
            processes.start(Order("a capture", "smoke", out))
        until(lambda: look(tmp_path).get("run") and look(tmp_path)["run"].step > 3)
        request(out, "pause")
        until(lambda: look(tmp_path)["run"].state == "paused")
        step = look(tmp_path)["run"].step
        time.sleep(0.3)
        assert look(tmp_path)["run"].step == step
        request(out, "run")
        until(lambda: look(tmp_path)["run"].step > step)
        processes.stop(out)
        until(lambda: processes.poll() or not processes.working(out))
    finally:
        for child in processes._children.values():
            child.process.kill()
    assert processes.message == "run: training ended"
    view = look(tmp_path)["run"]
    assert view.state == "stopped"
    assert view.step <= int(view.checkpoints[-1].name[5:]) <= view.step + 1


def test_a_training_that_does_not_listen_gets_the_signal(tmp_path, clock):
    deaf = "import signal, time, sys\nprint('deaf', flush=True)\ntime.sleep(60)"
    processes = TrainingProcesses([sys.executable, "-c", deaf], clock)
    processes.start(Order("a capture", "smoke", tmp_path / "run"))
    until(lambda: last_words(tmp_path / "run/train.log") == "deaf")
    processes.stop(tmp_path / "run")
    processes.poll()
    assert processes.working(tmp_path / "run")
    clock.now += 1000
    until(lambda: processes.poll() or not processes.working(tmp_path / "run"))
    assert processes.message == "run: stopped; Continue goes on from its last checkpoint"


def test_a_training_that_fails_while_it_stops_says_why(tmp_path, clock):
    full = (
        "import time\ntry:\n    print('up', flush=True)\n    time.sleep(60)\n"
        "except KeyboardInterrupt:\n    raise SystemExit('no space left')"
    )
    processes = TrainingProcesses([sys.executable, "-c", full], clock)
    processes.start(Order("a capture", "smoke", tmp_path / "run"))
    until(lambda: last_words(tmp_path / "run/train.log") == "up")
    processes.stop(tmp_path / "run")
    clock.now += 1000
    until(lambda: processes.poll() or not processes.working(tmp_path / "run"))
    assert processes.message == "run: no space left"


@pytest.mark.parametrize(("device", "said"), [("cpu", []), ("cuda:1", ["--device", "cuda:1"])])
def test_a_training_runs_where_the_window_does(tmp_path, device, said):
    echo = "import sys; words = sys.argv[sys.argv.index('--parts') + 2 :]; raise SystemExit(' '.join(['told', *words]))"
    processes = TrainingProcesses([sys.executable, "-c", echo], device=device)
    processes.start(Order("a capture", "smoke", tmp_path / "run"), resume=True)
    until(lambda: processes.poll() or not processes.working(tmp_path / "run"))
    assert processes.message == "run: " + " ".join(["told", *said, "--resume"])


def test_a_training_that_cannot_start_says_why(tmp_path):
    words = "print('12%|##', end='\\r'); raise SystemExit('avatarrex-studio: error: no such capture')"
    processes = TrainingProcesses([sys.executable, "-c", words])
    processes.start(Order("nothing", "smoke", tmp_path / "run"))
    until(lambda: processes.poll() or not processes.working(tmp_path / "run"))
    assert processes.message == "run: avatarrex-studio: error: no such capture"
    for capture, parts, match in (("", ["body"], "capture"), ("x", [], "parts")):
        with pytest.raises(InputError, match=match):
            processes.start(Order(capture, "smoke", tmp_path / "other", parts))
    Run.create(tmp_path / "old", {}).close()
    with pytest.raises(InputError, match="without a run"):
        processes.start(Order("x", "smoke", tmp_path / "old"))
    with pytest.raises(InputError, match="a folder to train in"):
        processes.start(Order("x", "smoke", tmp_path / "old/run.json/below"))


def test_ctrl_c_ends_a_training_as_stopped(tmp_path):
    child = subprocess.Popen([*TINY, str(tmp_path / "run"), "--steps", "100000", "--seconds", "0.01"],
                             stderr=subprocess.DEVNULL)  # fmt: skip
    until(lambda: look(tmp_path).get("run") and look(tmp_path)["run"].step > 3)
    os.kill(child.pid, signal.SIGINT)
    child.wait(30)
    assert read_about(tmp_path / "run")["state"] == "stopped"
    json.loads((tmp_path / "run/run.json").read_text())


def test_smoothing_has_no_bias_at_its_start():
    constant = np.full(50, 3.0)
    assert np.allclose(smoothed(constant, 0.95), 3.0)
    values = np.random.default_rng(0).normal(size=20)
    expected = [
        sum(0.7**i * values[k - i] for i in range(k + 1)) / sum(0.7**i for i in range(k + 1)) for k in range(20)
    ]
    assert np.allclose(smoothed(values, 0.7), expected)
    holed = np.insert(values, 5, np.nan)
    assert np.isnan(smoothed(holed, 0.7)[5])
    assert np.allclose(np.delete(smoothed(holed, 0.7), 5), expected)
    assert np.array_equal(smoothed(values, 0.0), values)


def test_thinning_keeps_ends_and_peaks():
    x = np.arange(100_000.0)
    y = np.sin(x / 9000)
    y[31_234], y[77_777] = 9.0, -9.0
    few_x, few_y = thinned(x, y, 1000)
    assert len(few_x) <= 1002
    assert (few_y.max(), few_y.min(), few_x[0], few_x[-1]) == (9.0, -9.0, 0.0, 99_999.0)
    assert np.array_equal(few_y, y[few_x.astype(int)])


@pytest.mark.parametrize(("low", "high", "ticks"), [
    (-0.5, 0.5, [0]), (0, 1, [0, 1]), (0, 3, [0, 1, 2, 3]), (0, 2000, [0, 500, 1000, 1500, 2000]), (130, 131.5, [130, 131]),
])  # fmt: skip
def test_ticks_of_steps_are_whole_numbers(low, high, ticks):
    assert step_ticks(low, high) == ticks
    assert [f"{tick:,.0f}" for tick in step_ticks(low, high)] == [f"{tick:,}" for tick in ticks], "never '-0'"


def test_axes():
    assert span([np.array([1.0, np.nan, 3.0])], 0.0, False) == (1.0, 3.0)
    low, high = span([np.array([1e-3, 1.0])], 0.1, True)
    assert low == pytest.approx(1e-3 / 1000**0.1)
    assert high == pytest.approx(1000**0.1)
    for values in ([], [np.array([5.0])], [np.array([0.0, 0.0])]):
        low, high = span(values, 0.06, False)
        assert low < high
    assert log_ticks(0.9e-3, 1.1) == pytest.approx([1e-3, 1e-2, 1e-1, 1])
    assert log_ticks(0.004, 0.12) == pytest.approx([0.005, 0.01, 0.02, 0.05, 0.1])
    for low, high in ((3.1, 3.4), (1e-30, 1e30), (0.5, 0.7)):
        ticks = log_ticks(low, high)
        assert 2 <= len(ticks) <= 10
        assert all(low * 0.99 <= tick <= high * 1.01 for tick in ticks)


def test_the_difference_is_black_where_there_is_none():
    truth = np.full((2, 2, 3), 100, np.uint8)
    render = truth.copy()
    render[1, 1] = 164
    heat = difference(truth, render, 4.0)
    assert (heat[0] == 0).all()
    assert heat[1, 1].tolist() == HEAT[-1].astype(int).tolist()
    assert (difference(truth, render, 1.0)[1, 1] == np.round(0.5 * 0)).sum() == 0
    assert np.array_equal(heat, difference(render, truth, 4.0))


def test_a_series_of_nothing_has_no_rate():
    empty = Series(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    view = RunView(Path("x"), "x", "running", part="body", series={"body/loss/a": empty})
    assert view.rate is None
    assert view.eta is None


def test_a_run_elsewhere_is_watched_too(tmp_path):
    for place in ("runs/inside", "elsewhere"):
        Run.create(tmp_path / place, {"part": "body", "steps": {"body": 400}, "preset": "quick", "seed": 3}).close()
    watcher = Watcher(tmp_path / "runs")
    watcher.start()
    until(lambda: watcher.views)
    assert watcher.include(tmp_path / "runs" / ".." / "runs" / "inside") == tmp_path / "runs" / "inside"
    assert watcher.others == ()
    assert watcher.include(tmp_path / "elsewhere") == tmp_path / "elsewhere"
    watcher.look_again()
    until(lambda: len(watcher.views) == 2, 1.5)  # before the folders are listed again
    assert [view.name for view in watcher.views] == ["inside", "elsewhere"]
    watcher.close()
