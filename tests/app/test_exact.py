"""The exact engine's process: newest wins, cancelling, its death, and that it does not outlive whoever started it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.engine.exact import ExactEngine
from avatarrex_studio.engine.request import Request
from avatarrex_studio.engine.slices import SLICE, receive, send
from avatarrex_studio.engine.worker import READY, _reply
from avatarrex_studio.session.commands import OrbitBy, SetExpression
from avatarrex_studio.session.state import StudioState
from ball import ball_engine, render_ball

SIZE = (64, 48)
PATIENCE = 120.0


def slow_ball(seconds, avatar, signals, camera, settings, previous=None, between=None):
    """A ball in ten stages; an open jaw ends the process, an open eye is an error."""
    if signals.expression[0]:
        os.kill(os.getpid(), signal.SIGKILL)
    if signals.expression[1]:
        raise RuntimeError("no such eye")
    for _ in range(10):
        between()
        time.sleep(seconds / 10)
    return render_ball(avatar, signals, camera, settings, previous)


def slow_engine(seconds, *, between):
    return ball_engine(partial(slow_ball, seconds), between=between)


def no_engine(*, between):
    raise RuntimeError("no engine today")


@pytest.fixture
def exact():
    """A quick engine, ready."""
    engine = ExactEngine(partial(slow_engine, 0.05))
    engine.request(Request(StudioState(), SIZE))
    assert answers(engine, 1)[0].picture is not None
    yield engine
    engine.close()


def answers(engine, count, seconds=PATIENCE):
    """So many answers."""
    found, until = [], time.monotonic() + seconds
    while len(found) < count:
        assert time.monotonic() < until, f"{len(found)} answers of {count}"
        answer = engine.poll()
        if answer:
            found.append(answer)
        else:
            time.sleep(0.005)
    return found


def turned(degrees):
    return OrbitBy(float(degrees), 0.0).apply(StudioState())


def failing(number):
    """A state whose expression number `number` is set."""
    from avatarrex.signals.joints import EXPRESSION_NAMES

    return SetExpression(EXPRESSION_NAMES[number], 0.5).apply(StudioState())


def alive(number):
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"


def gone(number):
    until = time.monotonic() + 20
    while alive(number) and time.monotonic() < until:
        time.sleep(0.02)
    return not alive(number)


def test_a_picture_is_what_the_engine_renders_here(exact):
    state = turned(30)
    exact.request(Request(state, SIZE))
    (answer,) = answers(exact, 1)
    frame = ball_engine().render(state, SIZE).frame
    assert answer.request.state == state
    assert answer.picture.image.dtype == np.uint8
    assert np.abs(answer.picture.image / 255 - frame.image.numpy()).max() <= 0.5 / 255 + 1e-6
    assert np.array_equal(answer.picture.depth, (frame.pointmap.depth * frame.pointmap.hit).numpy())
    assert answer.picture.work.counters == {**frame.counters, "voxels_evaluated": 0}, "it remembers the frame before"
    assert answer.picture.work.memory.total == 2**20
    assert not exact.busy


def test_arrays_larger_than_a_slice_arrive_whole():
    rng = np.random.default_rng(0)
    large = rng.integers(0, 255, SLICE + 12345, np.uint8)
    message = {"large": large, "empty": large[:0], "strided": large[:1000:3], "words": "at last"}
    ours, theirs = multiprocessing.Pipe()
    sender = threading.Thread(target=lambda: (send(theirs, message), send(theirs, "next")))
    sender.start()
    got = receive(ours)
    assert got["words"] == "at last"
    assert all(np.array_equal(got[name], message[name]) for name in ("large", "empty", "strided"))
    assert got["large"].flags.writeable
    assert receive(ours) == "next"
    sender.join()
    theirs.close()
    with pytest.raises(EOFError):
        receive(ours)


def test_whoever_sleeps_is_woken_when_there_is_something_to_poll(exact):
    woken = threading.Event()
    exact.arrived = woken.set
    exact.request(Request(turned(3), SIZE))
    assert woken.wait(PATIENCE)
    assert exact.poll().picture is not None
    woken.clear()
    os.kill(exact.process, signal.SIGKILL)
    assert woken.wait(PATIENCE), "that it has died is something, too"


def test_of_pictures_that_are_not_begun_the_newest_is_rendered(exact):
    for k in range(6):
        exact.request(Request(turned(k), SIZE))
    got = answers(exact, 2)
    assert [answer.request.state for answer in got] == [turned(0), turned(5)]
    time.sleep(0.3)
    assert exact.poll() is None
    assert not exact.busy


def test_requests_and_polls_do_not_wait():
    engine = ExactEngine(partial(slow_engine, 3.0))
    try:
        longest = 0.0
        for k in range(50):
            start = time.perf_counter()
            engine.request(Request(turned(k), (1024, 768)))
            assert engine.poll() is None
            longest = max(longest, time.perf_counter() - start)
        assert engine.busy
        assert longest < 1.0, "a third of what the picture takes"
    finally:
        engine.close()


def test_a_picture_under_way_is_cancelled_between_stages():
    engine = ExactEngine(partial(slow_engine, 60.0))
    try:
        engine.request(Request(turned(1), SIZE))
        time.sleep(0.1)
        engine.request(Request(turned(2), SIZE))
        engine.cancel()
        dropped, answer = answers(engine, 2, 40.0)
        assert dropped.cancelled
        assert dropped.request.state == turned(2)
        assert answer.cancelled
        assert answer.picture is None is answer.error
        assert answer.request.state == turned(1)
        assert not engine.busy, "what was not begun is dropped"
    finally:
        engine.close()


def test_a_cancel_that_comes_late_does_not_reach_the_next_picture(exact):
    exact.request(Request(turned(1), SIZE))
    time.sleep(0.5)
    exact.cancel()
    answers(exact, 1)
    exact.request(Request(turned(2), SIZE))
    (answer,) = answers(exact, 1)
    assert answer.picture is not None


def test_an_error_comes_back_as_its_line_and_the_engine_goes_on(exact):
    exact.request(Request(failing(1), SIZE))
    (answer,) = answers(exact, 1)
    assert answer.error == "RuntimeError: no such eye"
    exact.request(Request(turned(1), SIZE))
    assert answers(exact, 1)[0].error is None


def test_files_are_all_written_and_not_cancelled(exact, tmp_path):
    for name in ("a", "b"):
        exact.request(Request(turned(1), SIZE, path=str(tmp_path / f"{name}.png")))
    exact.request(Request(turned(2), SIZE, path="/proc/c.png"))
    exact.request(Request(turned(3), SIZE))
    exact.cancel()
    dropped, *got = answers(exact, 4)
    assert dropped.cancelled
    assert not dropped.request.path
    assert [answer.error is None for answer in got] == [True, True, False]
    assert got[2].error.startswith("/proc/c.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert not exact.busy


@pytest.mark.parametrize("working", [False, True])
def test_a_process_that_dies_is_reported_and_started_again(exact, working, caplog):
    first = exact.process
    if working:
        exact.request(Request(turned(1), SIZE))
    os.kill(first, signal.SIGKILL)
    assert gone(first)
    time.sleep(0.2)
    if not working:
        assert exact.poll() is None
        assert exact.process not in (None, first), "at once, not with the next request"
        exact.request(Request(turned(1), SIZE))
    (answer,) = answers(exact, 1)
    assert answer.picture is not None
    assert exact.process != first
    (line,) = [record.getMessage() for record in caplog.records]
    assert line == "the exact engine ended (killed by SIGKILL, perhaps for want of memory); it is started again"


def test_what_ends_the_process_twice_is_given_up(exact, caplog):
    exact.request(Request(failing(0), SIZE))
    (answer,) = answers(exact, 1)
    assert "killed by SIGKILL" in answer.error
    assert len(caplog.records) == 2
    exact.request(Request(turned(1), SIZE))
    assert answers(exact, 1)[0].picture is not None


def test_an_engine_that_does_not_start_is_said_once_for_each_request(caplog):
    engine = ExactEngine(no_engine)
    try:
        engine.request(Request(StudioState(), SIZE))
        (answer,) = answers(engine, 1)
        assert "exit code 1" in answer.error
        assert engine.process is None
        time.sleep(0.2)
        assert engine.poll() is None
        assert [record.getMessage() for record in caplog.records] == ["the exact engine does not start (exit code 1)"]
    finally:
        engine.close()


def test_closing_ends_the_process_and_names_what_was_not_written(exact, caplog):
    exact.request(Request(turned(1), SIZE))
    exact.request(Request(turned(1), SIZE, path="late.png"))
    exact.close()
    assert not alive(exact.process)
    assert "not written: late.png" in caplog.text
    assert not Path("late.png").exists()


PARENT = """
import os, sys, time
sys.path.insert(0, {tests!r})
from functools import partial
from avatarrex_studio.engine.exact import ExactEngine
from avatarrex_studio.engine.request import Request
from avatarrex_studio.engine.slices import SLICE, receive, send
from avatarrex_studio.engine.worker import READY, _reply
from avatarrex_studio.session.state import StudioState
from test_exact import slow_engine
engine = ExactEngine(partial(slow_engine, {seconds}))
engine.request(Request(StudioState(), (16, 16)))
while not engine._ready:
    engine.poll()
    time.sleep(0.01)
print(engine.process, flush=True)
time.sleep(1)
os._exit(1)
"""


@pytest.mark.parametrize("seconds", [0.01, 600.0])
def test_the_process_ends_with_whoever_started_it(seconds):
    """Asleep and at work: a parent that crashes takes it along."""
    code = PARENT.format(tests=str(Path(__file__).parent), seconds=seconds)
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    number = int(parent.stdout.readline())
    assert alive(number)
    assert parent.wait(60) == 1
    parent.stdout.close()
    assert gone(number)


def test_an_answer_to_a_window_that_was_closed_ends_the_process_without_a_trace():
    context = multiprocessing.get_context("spawn")
    kept, gone = context.Pipe()
    process = context.Process(target=_reply, args=(kept, READY))
    gone.close()
    process.start()
    process.join(PATIENCE)
    assert process.exitcode == 0
