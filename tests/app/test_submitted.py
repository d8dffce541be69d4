"""A job in its process: signals, its own run and no other, and where its words are said. Fakes in place of the program."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from avatarrex_studio.jobs import submitted
from avatarrex_studio.jobs.submitted import Job
from avatarrex_studio.jobs.training_process import INTERRUPTIBLE

SAVES = """
import sys, time
from pathlib import Path
try:
    Path("ready").touch()
    time.sleep(60)
except KeyboardInterrupt:
    time.sleep(0.3)
    Path("saved").touch()
    sys.exit(130)
"""
"""A verb that works until Ctrl+C, and then takes a while."""
OPENS = """
import os, signal, sys
from pathlib import Path
print(*sys.argv[1:], flush=True)
run = Path("run", "run.json")
if "--resume" not in sys.argv and not run.exists():
    run.parent.mkdir()
    run.touch()
    os.kill(os.getpid(), signal.SIGKILL)
"""
"""A training that opens its run, dies, and ends at once when it goes on."""
DIES = """
import os, signal, sys
from pathlib import Path
print(*sys.argv[1:], flush=True)
if not Path("tried").exists():
    Path("tried").touch()
    os.kill(os.getpid(), signal.SIGKILL)
"""
"""A training that dies once, before it opens its run."""


def job(folder: Path, *words: str) -> Job:
    """Typed in `folder`."""
    path = folder / "jobs" / "0001-job"
    path.mkdir(parents=True)
    return Job(str(path), words, str(folder)).written()


def program(monkeypatch, text: str) -> None:
    monkeypatch.setattr(submitted, "COMMAND", (sys.executable, "-c", INTERRUPTIBLE + text))
    monkeypatch.setattr(submitted, "SECONDS", 0.02)


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """What takes longer fails, also where it waits for a lock."""

    def late(*_):
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def until(there: Path) -> None:
    end = time.monotonic() + 20
    while not there.exists():
        assert time.monotonic() < end, there
        time.sleep(0.02)


def gone(pid: int) -> bool:
    """Whether a process has ended, reaped or not."""
    try:
        return Path("/proc", str(pid), "stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def test_a_machine_that_is_taken_away(tmp_path, monkeypatch):
    """The signal of submitit's, in the main thread: the verb has saved and ended before the job is queued again."""
    pytest.importorskip("submitit")
    program(monkeypatch, SAVES)
    begun, queued = job(tmp_path, "render", "a"), []

    def taken(*_):
        queued.append(begun.checkpoint())
        assert (tmp_path / "saved").exists()
        raise SystemExit

    def notice():
        until(tmp_path / "ready")
        os.kill(os.getpid(), signal.SIGUSR2)

    before = signal.signal(signal.SIGUSR2, taken)
    sender = threading.Thread(target=notice)
    sender.start()
    try:
        with within(20), pytest.raises(SystemExit):
            begun()
    finally:
        sender.join()
        signal.signal(signal.SIGUSR2, before)
    assert queued[0].function.path == begun.path
    kept = Job.read(begun.path)
    assert kept is not None
    assert kept.state == "queued"


def test_a_verb_that_does_not_stop_is_killed(tmp_path, monkeypatch):
    """Before SLURM takes the machine, so that nobody works beside the job that is queued again."""
    program(monkeypatch, "")
    monkeypatch.setattr(submitted, "SAVING_SECONDS", 0.2)
    deaf = "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); print(flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", deaf], stdout=subprocess.PIPE) as child, within(20):
        assert child.stdout is not None
        child.stdout.readline()
        submitted._stop(child)
        assert child.wait() == -signal.SIGKILL


@pytest.mark.skipif(sys.platform != "linux", reason="of Linux alone")
def test_a_verb_dies_with_its_job(tmp_path):
    begun = job(tmp_path, "render", "a")
    verb = "import os, time; from pathlib import Path; Path('pid_').write_text(str(os.getpid())); os.rename('pid_', 'pid'); time.sleep(60)"
    code = "import sys; from pathlib import Path; from avatarrex_studio.jobs import submitted; "
    code += "submitted.COMMAND = (sys.executable, '-c', sys.argv[2]); submitted.Job.read(Path(sys.argv[1]))()"
    with subprocess.Popen([sys.executable, "-c", code, str(begun.path), verb]) as process:
        until(tmp_path / "pid")
        child = int((tmp_path / "pid").read_text())
        assert not gone(child)
        process.kill()
    end = time.monotonic() + 10
    while not gone(child) and time.monotonic() < end:
        time.sleep(0.02)
    assert gone(child)


def said(begun: Job) -> list[str]:
    return begun.log.read_text().splitlines()


def test_a_job_goes_on_with_its_own_run(tmp_path, monkeypatch):
    program(monkeypatch, OPENS)
    begun = job(tmp_path, "train", "a", "--out", "run")
    assert begun() == 0
    assert said(begun) == ["train a --out run", "train a --out run --resume"]
    again = Job.read(begun.path)
    assert again is not None
    again.written(state="queued", tries=0)()
    assert said(begun)[2:] == ["train a --out run --resume"], "submitted again"


def test_a_job_leaves_the_run_of_another(tmp_path, monkeypatch):
    """As without `--submit`: the verb refuses. Also after a death, and submitted again."""
    program(monkeypatch, DIES)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").touch()
    begun = job(tmp_path, "train", "a", "--out", "run")
    begun()
    again = Job.read(begun.path)
    assert again is not None
    again.written(state="queued", tries=0)()
    assert said(begun) == 3 * ["train a --out run"]


def test_words_are_said_where_they_were_typed(tmp_path, monkeypatch):
    program(monkeypatch, "import os; print(os.getcwd())")
    begun = job(tmp_path, "train", "a", "--out", "run")
    monkeypatch.chdir("/")
    assert begun() == 0
    assert said(begun) == [str(tmp_path)]
    assert begun.run == tmp_path / "run"


def test_places_are_of_this_machine_alone(tmp_path, monkeypatch):
    """A job that moved to SLURM waits for none."""
    program(monkeypatch, "")
    begun = job(tmp_path, "render", "a").written(at_once=1, where="slurm")
    with open(begun.path.parent / ".place_0", "w") as taken, within(20):
        fcntl.flock(taken, fcntl.LOCK_EX)
        assert begun() == 0
