"""Which jobs are dead, how they are submitted again, and what is left of those that no queue takes."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from avatarrex_studio.cli import submit
from avatarrex_studio.cli.main import main
from avatarrex_studio.jobs import job_queue
from avatarrex_studio.jobs.job_queue import JobQueue, dead, parameters, view_of
from avatarrex_studio.jobs.submitted import Job

from avatarrex.errors import InputError
from avatarrex.training.runs.control import write_json


class Queue:
    """Takes jobs, and does nothing with them."""

    calls: list[tuple[str, dict[str, int | str], list[str]]]

    def __init__(self, where: str, folder: Path, slurm: dict[str, int | str]) -> None:
        self.where, self.slurm = where, slurm

    def submit(self, jobs: list[Job]) -> None:
        self.calls.append((self.where, self.slurm, [job.path.name for job in jobs]))


@pytest.fixture
def queue(monkeypatch, tmp_path) -> type[Queue]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(submit, "JobQueue", Queue)
    Queue.calls = []
    return Queue


def job(folder: Path, state: str, **known) -> Job:
    folder.mkdir(parents=True)
    return Job(str(folder), ("evaluate", "a", "b"), **known).written(state=state)


def beat(of: Job, age: float = 1e6) -> None:
    """Its last, of a process on another machine."""
    file = of.path / "heartbeat.json"
    write_json(file, {"time": time.time() - age, "pid": 1, "host": "another"})
    os.utime(file, (time.time() - age,) * 2)


def number(of: Job, text: str, host: str = "") -> None:
    write_json(of.path / "queued.json", {"number": text, "host": host or socket.gethostname()})


def test_at_work_by_its_own_word_alone(tmp_path):
    left = job(tmp_path / "0001-evaluate-a", "running")
    assert view_of(left, "a").state == "running", "no beat yet"
    beat(left)
    assert view_of(left, "a").state == "dead"
    beat(left, age=0.0)
    assert view_of(left, "a").state == "running"


def test_a_job_is_submitted_again_once(tmp_path, queue, capsys):
    """It waits with the heartbeat of its death; nobody takes that for a second one."""
    beat(job(tmp_path / "jobs" / "0001-evaluate-a", "running"))
    assert main(["runs", ".", "--requeue", "local"]) == 0
    assert main(["runs", ".", "--requeue", "local"]) == 0
    assert len(queue.calls) == 1
    assert "no jobs below" in capsys.readouterr().out


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="without /proc nobody knows")
@pytest.mark.parametrize("state", ["queued", "running"])
def test_a_job_whose_process_is_gone(tmp_path, state):
    left = job(tmp_path / "0001-evaluate-a", state)
    beat(left)
    with subprocess.Popen([sys.executable, "-c", "print(flush=True); input()", "submitit"], stdin=-1, stdout=-1) as one:
        assert one.stdout is not None
        one.stdout.readline()
        number(left, str(one.pid))
        assert not dead(left)
        one.kill()
    assert dead(left)
    number(left, str(os.getpid()), "another")
    assert dead(left) == (state == "running"), "of another machine's process the heart alone tells"


def test_a_number_that_another_program_has_by_now(tmp_path):
    left = job(tmp_path / "0001-evaluate-a", "queued")
    with subprocess.Popen(["sleep", "30"]) as one:
        number(left, str(one.pid))
        assert dead(left)
        one.kill()


def test_slurm_says_which_jobs_it_has(tmp_path, monkeypatch):
    """One call for an array; without accounting a queued job is not taken for dead."""
    pytest.importorskip("submitit")
    job_queue._states.cache_clear()
    rows = ["7_0|RUNNING", "7_[1-3]|PENDING", "7_4|CANCELLED by 1000", "7_4.batch|CANCELLED", "7_5|NODE_FAIL"]
    sacct = tmp_path / "sacct"
    sacct.write_text(
        "#!/bin/sh\necho call >> " + str(tmp_path / "calls") + "\nprintf 'JobID|State\\n" + "\\n".join(rows) + "\\n'\n"
    )
    sacct.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    jobs = [job(tmp_path / f"000{k}-evaluate-a", "queued", where="slurm") for k in range(7)]
    for k, one in enumerate(jobs):
        number(one, f"7_{k}")
        beat(one)
    assert [dead(one) for one in jobs] == [False, False, False, False, True, True, False]
    assert (tmp_path / "calls").read_text().count("call") == 1
    assert not dead(jobs[0].written(state="running")), "SLURM has it, and starts it again where its machine broke"
    assert dead(jobs[6].written(state="running")), "not known to SLURM: the heart tells"
    sacct.write_text("exit 1")
    job_queue._states.cache_clear()
    assert not dead(jobs[4])


def test_jobs_are_submitted_again_as_before(tmp_path, queue):
    """As one array for each choice of SLURM's options, which a detour over this machine does not lose."""
    options: dict[str, int | str] = {"partition": "cpu", "timeout_min": 60}
    for name, slurm in (("0001-a", options), ("0002-b", {}), ("0003-c", options)):
        job(tmp_path / "jobs" / name, "failed", where="slurm", slurm=slurm, at_once=3)
    assert main(["runs", ".", "--requeue", "local"]) == 0
    moved = Job.read(tmp_path / "jobs" / "0001-a")
    assert moved is not None
    assert (moved.state, moved.where, moved.at_once, moved.slurm) == ("queued", "local", 3, options)
    moved.written(state="failed")
    queue.calls.clear()
    for name in ("0002-b", "0003-c"):
        again = Job.read(tmp_path / "jobs" / name)
        assert again is not None
        again.written(state="failed")
    assert main(["runs", ".", "--requeue", "slurm"]) == 0
    assert queue.calls == [("slurm", options, ["0001-a", "0003-c"]), ("slurm", {}, ["0002-b"])]
    assert parameters("slurm", options) == {"timeout_min": 60, "slurm_partition": "cpu", "slurm_signal_delay_s": 120}
    assert parameters("local", options) == {"timeout_min": 60 * 24 * 365}


def test_nothing_is_left_of_jobs_that_are_not_taken(tmp_path, queue, monkeypatch, capsys):
    def refuse(*_):
        raise InputError("--submit", "slurm", "a queue that takes jobs", "invalid partition")

    monkeypatch.setattr(Queue, "submit", refuse)
    assert main(["evaluate", "a", "b", "--submit", "slurm", "--slurm", "partition=x", "--jobs", "jobs"]) == 2
    assert "invalid partition" in capsys.readouterr().err
    assert not list((tmp_path / "jobs").glob("*-*"))
    job(tmp_path / "jobs" / "0001-evaluate-a", "stopped")
    assert main(["runs", ".", "--requeue", "slurm"]) == 2
    left = Job.read(tmp_path / "jobs" / "0001-evaluate-a")
    assert left is not None
    assert left.state == "failed"
    assert "invalid partition" in view_of(left, "a").note


def test_without_submitit_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(InputError, match="cluster"):
        JobQueue("local", tmp_path, {})


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["stress"], "0001-stress"),
        (["train", "a", "--out=runs/b"], "0001-train-b"),
        (["evaluate", "me.avatar", "b"], "0001-evaluate-me"),
    ],
)
def test_names_of_jobs(tmp_path, queue, words, name):
    assert main([*words, "--submit", "local"]) == 0
    assert queue.calls == [("local", {}, [name])]
    made = Job.read(tmp_path / "runs" / "jobs" / name)
    assert made is not None
    assert made.cwd == str(tmp_path)


def test_numbers_of_jobs(tmp_path):
    """Beyond four digits, and each once, also where several are submitted at a time."""
    (tmp_path / "9999-train-a").mkdir()
    made: list[Job] = []
    one = Job("", ("train", "a", "--out", "b"))
    some = [replace(one, words=(*one.words, "--seed", str(seed))) for seed in range(20)]
    threads = [threading.Thread(target=lambda: made.extend(submit._new(some, tmp_path))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(int(made_.path.name.split("-")[0]) for made_ in made) == list(range(10000, 10080))
