"""Several processes train as one: the same losses and gradients, one who writes, and no step lost when one is killed."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import pytest
import torch
from capture.tiny_capture import TinyCapture
from training.test_train import losses
from training.together import DIES, SAVED

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.pointmap.raycast import raycast
from avatarrex.training.core import pass_two
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.losses import Mean, batch_means
from avatarrex.training.core.process_group import ALONE, ProcessGroup
from avatarrex.training.core.stage import Stage
from avatarrex.training.core.warm_start import load_prior
from avatarrex.training.core.work import pass_of
from avatarrex.training.recipe import SMOKE
from avatarrex.training.runs.events import EventReader, event_files
from avatarrex.training.runs.folder import read_about

TESTS = Path(__file__).parents[1]
SECONDS = 900.0
"""For a training that takes one minute: its processes wait for each other for days."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return TinyCapture.make(("body", "face")).folder(tmp_path_factory.mktemp("tiny") / "capture")


def torchrun(*words, restarts: int) -> None:
    """Two processes on this machine, one thread each."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += ["--max-restarts", str(restarts), str(TESTS / "training" / "together.py"), *map(str, words)]
    paths = os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])
    one_thread = {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    with subprocess.Popen(command, env=os.environ | one_thread, stderr=subprocess.PIPE, text=True) as agent:
        try:
            _, said = agent.communicate(timeout=SECONDS)
        except subprocess.TimeoutExpired:
            agent.terminate()  # torchrun ends its processes; killed, it would leave them
            raise
    assert agent.returncode == 0, said


@pytest.mark.slow
def test_two_processes_train_as_one_and_a_killed_one_loses_nothing(folder, tmp_path):
    """Both passes; the shares of rays, samples and pixels are uneven."""
    torchrun(folder, tmp_path, restarts=1)
    one, two = tmp_path / "one", tmp_path / "two"
    alone, together = losses(one), losses(two)
    assert set(together) == set(alone)
    for tag, values in alone.items():
        assert together[tag] == pytest.approx(values, rel=1e-3, abs=1e-5), tag
        assert together[tag][min(values)] == pytest.approx(values[min(values)], rel=1e-4, abs=1e-6), tag
    assert len(read_about(two)["resumed"]) == 1
    first, second = (history(file, two) for file in event_files(two))
    assert set(first) & set(second) == set(range(SAVED, DIES)), (
        "done again after the death, and not before the checkpoint"
    )
    assert all(first[step] == second[step] for step in range(SAVED, DIES)), "bit for bit, the optimiser's state as well"
    names = [{path.name.split(".out.")[0] for path in run.iterdir()} for run in (one, two)]
    assert names[0] == names[1]
    assert len(event_files(two)) == 2, "one process writes: a file for each start"


def history(file: Path, run: Path) -> dict[int, float]:
    """The total of the loss by step, of one file of events."""
    alone = run.parent / f"alone_{file.name}"
    alone.mkdir()
    (alone / file.name).symlink_to(file)
    reader = EventReader(alone)
    while reader.poll():
        pass
    series = reader.series("body/loss/total")
    return dict(zip(series.steps.tolist(), series.values.tolist()))


@dataclass(frozen=True)
class Threaded(ProcessGroup):
    """A group of threads that add up by turns."""

    board: tuple[list[torch.Tensor], threading.Barrier] = None  # type: ignore[assignment]

    def sum(self, values: torch.Tensor) -> torch.Tensor:
        kept, barrier = self.board
        barrier.wait()
        kept.append(values.detach())
        barrier.wait()
        total = torch.stack(kept).sum(0)
        barrier.wait()
        kept.clear()
        return total


@pytest.fixture(scope="module")
def learner(folder) -> tuple[Capture, Avatar]:
    capture = open_capture(folder)
    avatar = Avatar.create(capture.person, "compact", 0)
    for part in ("body", "face"):
        assert load_prior(avatar, part)
    return capture, avatar


@pytest.mark.parametrize("part", ["face", "body"])
@pytest.mark.parametrize("number", [0, 1])
def test_gradients_of_shares_add_up(learner, part, number, monkeypatch):
    """Three processes, threads here, over two frames, or over one patch: each pass of each part, terms and gradients."""
    monkeypatch.setattr(pass_two, "raycast", partial(raycast, impl="torch"))  # an OpenGL context is of one thread
    capture, avatar = learner
    recipe = getattr(SMOKE, part)[number]
    recipe = replace(recipe, frames=2, rays=82) if number == 0 else recipe
    unseen = frozenset({"left_hand", "right_hand"}) if part == "face" else frozenset[str]()
    store = FrameStore(avatar, capture.rigs[part], part, unseen)
    store.renew(0)
    stage = Stage(part, "II" if number else "I", recipe, 0)
    losses = pass_of(stage, avatar, store, Perceptual(None, "test"), 0)
    parameters = losses.parameters()

    def found(group: ProcessGroup) -> tuple[dict[str, torch.Tensor], list[torch.Tensor]]:
        own = pass_of(stage, avatar, store, Perceptual(None, "test"), 0)
        own.group = group
        terms = own.step(3, 0.004).terms
        total = torch.stack([value for value in terms.values() if value.requires_grad]).sum()
        slopes = torch.autograd.grad(total, own.parameters(), allow_unused=True)
        return terms, [torch.zeros_like(p) if slope is None else slope for p, slope in zip(parameters, slopes)]

    for parameter in parameters:
        parameter.requires_grad_(True)
    terms, slopes = found(ALONE)
    parts: dict[int, tuple[dict[str, torch.Tensor], list[torch.Tensor]]] = {}
    board = ([], threading.Barrier(3))
    ranks = [
        threading.Thread(target=lambda r=rank: parts.update({r: found(Threaded(r, 3, board=board))}))
        for rank in range(3)
    ]
    for thread in ranks:
        thread.start()
    for thread in ranks:
        thread.join()
    for parameter in parameters:
        parameter.requires_grad_(False)
    assert set(parts) == {0, 1, 2}
    for name, value in terms.items():
        torch.testing.assert_close(sum(some[name] for some, _ in parts.values()), value, rtol=1e-4, atol=1e-7, msg=name)
    for index, slope in enumerate(slopes):
        added = sum(some[index] for _, some in parts.values())
        torch.testing.assert_close(added, slope, rtol=1e-3, atol=1e-4 * float(slope.abs().max()) + 1e-9)


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
