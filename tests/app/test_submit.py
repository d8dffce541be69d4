"""Jobs of their own: a command line for each value, a killed training that goes on, places, and one table of all."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from avatarrex_studio.cli.main import main
from avatarrex_studio.cli.runs import job_views
from avatarrex_studio.cli.submit import expanded
from avatarrex_studio.jobs import submitted
from avatarrex_studio.jobs.job_queue import jobs_below
from avatarrex_studio.jobs.submitted import Job, place

from avatarrex.training.runs.control import Heartbeat
from avatarrex.training.runs.folder import read_about

TINY_RUN = Path(__file__).parents[1] / "tiny_run.py"


def job(folder: Path, *words: str) -> Job:
    folder.mkdir(parents=True)
    return Job(str(folder), words).written()


@pytest.fixture
def small(monkeypatch):
    """The small training of tests in place of the program."""
    monkeypatch.setattr(submitted, "COMMAND", (sys.executable, str(TINY_RUN)))
    monkeypatch.setattr(submitted, "SECONDS", 0.05)


def killed_once(run: Path) -> None:
    """Kill the training of a run as soon as it has a checkpoint."""
    while not list((run / "checkpoints").glob("step_*")):
        time.sleep(0.05)
    beat = Heartbeat.read(run)
    assert beat is not None
    os.kill(beat.pid, signal.SIGKILL)


def test_a_training_that_is_killed_goes_on(tmp_path, small):
    begun = job(
        tmp_path / "jobs" / "0001-train-a",
        "train",
        "none",
        "--out",
        str(tmp_path / "a"),
        "--steps",
        "40",
        "--seconds",
        "0.05",
    )
    killer = threading.Thread(target=killed_once, args=(tmp_path / "a",))
    killer.start()
    assert begun() == 0
    killer.join()
    ended = Job.read(begun.path)
    assert ended is not None
    assert (ended.state, ended.code, ended.tries) == ("finished", 0, 2)
    about = read_about(tmp_path / "a")
    assert about["state"] == "finished"
    assert len(about["resumed"]) == 1, "from its checkpoint"


def test_a_failure_is_listed_with_its_log(tmp_path, small):
    wrong = job(tmp_path / "jobs" / "0001-train-a", "train", "none", "--out", str(tmp_path / "a"), "--steps", "many")
    assert wrong() == 2
    (view,) = job_views(tmp_path, ())
    assert (view.name, view.state) == ("jobs/0001-train-a", "failed")
    assert view.note.startswith(f"{wrong.log}: ")
    assert "invalid int value" in view.note
    assert [path.name for path in jobs_below(tmp_path / "jobs")] == ["0001-train-a"]


def test_as_many_places_as_are_given(tmp_path, monkeypatch):
    monkeypatch.setattr(submitted, "SECONDS", 0.01)
    inside, most, lock = [0], [0], threading.Lock()

    def work() -> None:
        with place(tmp_path, 2):
            with lock:
                inside[0] += 1
                most[0] = max(most[0], inside[0])
            time.sleep(0.1)
            with lock:
                inside[0] -= 1

    threads = [threading.Thread(target=work) for _ in range(5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [2]


def test_a_command_line_for_each_combination():
    words = ["train", "{c}.zip", "--out", "runs/{c}_{seed}", "--seed", "{seed}"]
    lines = expanded(words, ["c=anna,ben", "seed=0,1"])
    assert len(lines) == 4
    assert lines[1] == ["train", "anna.zip", "--out", "runs/anna_1", "--seed", "1"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["train", "a", "--out", "b", "--submit", "moon"], "--submit: expected one of local, slurm, found moon"),
        (["runs", "--submit", "local"], "--submit: expected one of the verbs train, evaluate"),
        (["train", "a", "--out", "b", "--submit", "local", "--over", "seed"], "--over: expected NAME=VALUE,VALUE,…, found seed"),
        (["train", "a", "--out", "b", "--submit", "local", "--over", "seed=0,1"], "--over: seed: expected {seed} in the command line"),
        (["train", "a", "--out", "b", "--submit", "local", "--slurm", "partition=x"], "--slurm: expected --submit slurm with it"),
        (["train", "a", "--out", "b", "--submit", "local", "--at-once", "0"], "--at-once: expected"),
        (["train", "a", "--submit", "local"], "--out"),
        (["train", "a", "--out", "b", "--submit", "slurm", "--slurm", "nodes=2"], "--slurm: nodes: expected nothing: a job is one process"),
        (["train", "a", "--out", "b", "--submit", "slurm", "--slurm", "ntasks_per_node=2"], "--slurm: ntasks_per_node: expected nothing"),
        (["train", "a", "--out", "b", "--submit", "slurm", "--slurm", "timeout_min=long"], "--slurm: timeout_min: expected a whole number"),
        (["evaluate", "a", "b", "--submit", "slurm"], "--submit: slurm: expected a queue that takes jobs, found Could not detect"),
    ],
)  # fmt: skip
def test_what_is_not_submitted(tmp_path, monkeypatch, capsys, words, line):
    monkeypatch.chdir(tmp_path)
    with suppress(SystemExit):
        assert main(words) == 2
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir()), "nothing is left"


def test_a_job_of_submitit(tmp_path):
    """To its end in a process of submitit's: a verb that is refused."""
    pytest.importorskip("submitit")
    words = ["render", "out.png", "--pose", "nobody", "--submit", "local", "--jobs", "jobs"]
    done = subprocess.run(
        [sys.executable, "-m", "avatarrex_studio", *words], cwd=tmp_path, capture_output=True, text=True
    )
    assert "0001-render-out: submitted" in done.stdout, done.stderr
    until = time.monotonic() + 60
    while (view := job_views(tmp_path, ())[0]).state in ("queued", "running") and time.monotonic() < until:
        time.sleep(0.1)
    assert view.state == "failed"
    assert "error: pose: " in view.note
