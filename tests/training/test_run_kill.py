"""Killed at any moment, during saves and writes of events, and on a full disk: at most one interval is lost."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny_run import fit

from avatarrex.errors import InputError
from avatarrex.training.runs import checkpoint, events
from avatarrex.training.runs.events import EventReader
from avatarrex.training.runs.folder import Run, read_about

EVERY = 4
KILLER = """
import json, os, random, signal, sys, time
from pathlib import Path
from tiny_run import fit
from avatarrex.training.runs import checkpoint
from avatarrex.training.runs.events import EventReader, event_files

out, dice, report = Path(sys.argv[1]), random.Random(7), []
saves = out / "checkpoints"
moments = ["any", ".new_*", ".new_*/*.safetensors", ".new_*/manifest.json", "any", ".old_*"]
for moment in [*moments, "end"]:
    files = len(event_files(out))
    child = os.fork()
    if child == 0:
        fit(out, steps=100, every=4)
        os._exit(0)
    if moment != "end":
        until = time.monotonic() + 20  # until it works
        while time.monotonic() < until and len(event_files(out)) == files:
            time.sleep(1e-3)
        time.sleep(dice.uniform(0, 0.05))
        until = time.monotonic() + dice.uniform(0, 0.05) + (moment != "any")
        while time.monotonic() < until and not (moment != "any" and list(saves.glob(moment))):
            pass
        os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    if not os.WIFSIGNALED(status):
        assert status == 0
        break
    reader = EventReader(out)
    while reader.poll():
        pass
    steps, newest = reader.series("body/loss/total").steps, checkpoint.newest(saves)
    leftovers = [path.name for path in saves.glob(".*")]
    report.append((int(steps[-1]) if len(steps) else -1, newest[0].manifest.step if newest else 0, leftovers))
print(json.dumps(report))
"""


@pytest.mark.slow
def test_killed_at_random_moments_it_ends_as_if_it_had_not_been(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1]), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", KILLER, str(tmp_path / "killed")],
        capture_output=True, text=True, env=environment, timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout.splitlines()[-1])
    assert len(report) >= 3, "killed several times before the end"
    assert all(last + 1 - saved <= EVERY for last, saved, _ in report), report
    saved = [entry[1] for entry in report]
    assert saved == sorted(saved), "nothing that was saved is lost"
    left = [name for *_, names in report for name in names]
    assert any(name.startswith(".new_") for name in left), f"some were killed in the middle of a save: {left}"
    fit(tmp_path / "whole", steps=100, every=EVERY)
    whole, killed = EventReader(tmp_path / "whole"), EventReader(tmp_path / "killed")
    for reader in (whole, killed):
        while reader.poll():
            pass
    for tag in ("body/loss/total", "body/heldout/psnr"):
        assert np.array_equal(whole.series(tag).steps, killed.series(tag).steps)
        assert np.array_equal(whole.series(tag).values, killed.series(tag).values), "bit for bit"
    assert read_about(tmp_path / "killed")["state"] == "finished"
    assert not list((tmp_path / "killed/checkpoints").glob(".*"))


def full(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("moment", ["write", "fsync", "rename"])
def test_a_full_disk_is_one_line_and_the_last_checkpoint_stays(tmp_path, monkeypatch, moment):
    with Run.create(tmp_path / "run", {}) as run:
        run.save(5, {"x": torch.arange(3)})
        with monkeypatch.context() as patch:
            if moment == "write":
                patch.setattr(checkpoint, "_put", full)
            else:
                patch.setattr(checkpoint.os, moment, full)
            with pytest.raises(InputError) as error:
                run.save(5 if moment == "rename" else 6, {"x": torch.arange(4)})
        assert "No space left on device" in str(error.value)
        assert "\n" not in str(error.value)
        assert run.latest()[1]["x"].tolist() == [0, 1, 2]
        assert os.listdir(tmp_path / "run/checkpoints") == ["step_00000005"]
        run.save(6, {"x": torch.arange(4)})
        assert run.latest()[0] == 6


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full on this system")
def test_events_on_a_full_device(tmp_path, monkeypatch):
    with Run.create(tmp_path / "run", {}) as run:
        run.scalars(1, {"a": 1.0})
        handle = os.open("/dev/full", os.O_WRONLY)
        kept, run._events._file._handle = run._events._file._handle, handle
        monkeypatch.setattr(events.os, "ftruncate", lambda *_: None)
        with pytest.raises(InputError, match="No space left on device"):
            run.scalars(2, {"a": 2.0})
        run._events._file._handle = kept
        os.close(handle)
        run.scalars(3, {"a": 3.0})
    reader = EventReader(tmp_path / "run")
    reader.poll()
    assert reader.series("a").steps.tolist() == [1, 3]


@pytest.fixture
def small_disk(tmp_path):
    """A disk of one mebibyte."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "none", str(place)]
    if os.geteuid() != 0 or subprocess.run(command, capture_output=True).returncode != 0:
        pytest.skip("mounting a small disk needs root")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_a_disk_that_really_fills(small_disk):
    """Checkpoints and events until nothing more fits; then room is made and the run goes on."""
    ballast = small_disk / "ballast"
    ballast.write_bytes(b"x" * 300_000)

    def fill(run, save):
        with run:
            for step in range(100_000):
                run.scalars(step, {f"tag/{k}": step for k in range(20)})
                if save:
                    run.save(step, {"step": step, "x": torch.zeros(25_000 + 400 * step)})

    with pytest.raises(InputError) as error:
        fill(Run.create(small_disk / "run", {}), save=True)
    assert "No space left on device" in str(error.value)
    state, reader = checkpoint.newest(small_disk / "run/checkpoints")[1], EventReader(small_disk / "run")
    assert state["step"] >= 2
    with pytest.raises(InputError, match="No space left on device"):
        fill(Run.open(small_disk / "run"), save=False)
    ballast.unlink()
    with Run.open(small_disk / "run") as run:
        assert run.latest()[1]["step"] == state["step"]
        run.scalars(200_000, {"tag/0": 7.0})
        run.save(200_000, {"step": 200_000})
    while reader.poll():
        pass
    assert not reader.notes
    assert reader.series("tag/0").steps[-1] == 200_000
