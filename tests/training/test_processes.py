"""Several processes train as one: the same losses, one who writes, and no step lost when one is killed."""

from __future__ import annotations

import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import pytest
import torch
from capture.tiny_capture import TinyCapture
from training.test_train import losses
from training.together import train

from avatarrex.training.core.losses import Mean, batch_means
from avatarrex.training.core.process_group import ProcessGroup
from avatarrex.training.runs.folder import read_about

TESTS = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    return TinyCapture.make(("body", "face")).folder(tmp_path_factory.mktemp("tiny") / "capture")


def torchrun(*words, restarts=0) -> str:
    """Two processes on this machine, one thread each; what they print."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += ["--max-restarts", str(restarts), str(TESTS / "training" / "together.py"), *map(str, words)]
    paths = os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def test_two_processes_train_as_one_and_a_killed_one_loses_nothing(capture, tmp_path):
    """Both passes of both parts: shares of rays, samples and pixels are uneven. Killed after the first checkpoint of the body."""
    one, two, killed = (tmp_path / name for name in ("one", "two", "killed"))
    train(capture, one)
    torchrun(capture, two)
    torchrun(capture, killed, 3, restarts=1)
    alone, together = losses(one), losses(two)
    assert set(together) == set(alone)
    for tag, values in alone.items():
        assert together[tag] == pytest.approx(values, rel=2e-3, abs=1e-5), tag
        first = min(values)
        assert together[tag][first] == pytest.approx(values[first], rel=1e-5, abs=1e-7), tag
    assert losses(killed) == together, "bit for bit"
    assert len(read_about(killed)["resumed"]) == 1
    assert len(list(two.glob("events.out.tfevents.*"))) == 1, "the first process alone writes"
    assert {path.name for path in two.iterdir()} == {path.name for path in one.iterdir()}


@pytest.mark.parametrize(("units", "size"), [(1, 1), (1, 2), (4, 2), (4, 3), (2, 5), (3, 2)])
def test_shares_cover_every_row_once(units, size):
    rows = [[] for _ in range(units)]
    for rank in range(size):
        shares = ProcessGroup(rank, size).shares(units)
        assert sum(share.end - share.begin for share in shares) == Fraction(units, size), "as much work for each"
        for share in shares:
            rows[share.unit] += range(41)[share.rows(41)]
    assert rows == [list(range(41))] * units


def test_a_share_weighs_what_it_has(monkeypatch):
    """Of a mean over three entries a process with one of them, of little weight, has that entry's part."""
    entries, weights = torch.tensor([3.0, 5.0, 7.0]), torch.tensor([1.0, 4.0, 5.0])
    whole = float((entries * weights).sum() / weights.sum())
    split = [Mean((entries * weights)[rows].sum(), weights[rows].sum()) for rows in (slice(0, 1), slice(1, 3))]
    monkeypatch.setattr(ProcessGroup, "sum", lambda self, values: torch.tensor([[10.0]]))
    parts = [batch_means({0: {"rgb": mean}}, 1, ProcessGroup(rank, 2))["rgb"] for rank, mean in enumerate(split)]
    assert float(sum(parts)) == pytest.approx(whole)
    assert float(parts[0]) == pytest.approx(0.3)
