"""What torchrun starts again: its own training after a death, and nothing else. One process, with the store that torchrun keeps."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import pytest
import torch.distributed as dist
from avatarrex_studio.cli import train
from avatarrex_studio.cli.main import main

from avatarrex.errors import InputError
from avatarrex.training.core import process_group
from avatarrex.training.core.process_group import PeerLost
from avatarrex.training.core.work import Diverged
from avatarrex.training.runs.folder import Run, read_about

Start = Callable[[int], None]
"""The environment of torchrun's start number N."""


@pytest.fixture
def start(monkeypatch) -> Start:
    store = dist.TCPStore("127.0.0.1", 0, is_master=True, wait_for_workers=False)

    def begin(number: int, size: int = 1) -> None:
        words = {
            "TORCHELASTIC_RUN_ID": "none", "TORCHELASTIC_USE_AGENT_STORE": "True", "MASTER_ADDR": "127.0.0.1",
            "MASTER_PORT": store.port, "RANK": 0, "LOCAL_RANK": 0, "WORLD_SIZE": size, "LOCAL_WORLD_SIZE": size,
            "TORCHELASTIC_RESTART_COUNT": number,
        }  # fmt: skip
        for name, value in words.items():
            monkeypatch.setenv(name, str(value))

    return begin


def begun_before(path: Path) -> Path:
    """A run that is stopped."""
    Run.create(path, {"part": "body", "preset": "tiny", "capture": "a", "seed": 0}).close("stopped")
    return path


def test_a_refusal_stays_one(tmp_path, start, capsys):
    """The folder has a run of before: no restart goes on with it."""
    old = begun_before(tmp_path / "old")
    about = read_about(old)
    for number in (1, 2):  # in the start before a process died, before it opened a run
        start(number)
        assert main(["train", "nowhere", "--out", str(old)]) == 2
    assert capsys.readouterr().err.count("a folder without a run") == 1, "said once"
    assert read_about(old) == about


def test_its_own_run_is_gone_on_with(tmp_path, start, monkeypatch):
    found = []

    def once(arguments: argparse.Namespace, _recipe, group, _device) -> int:
        train._check_free(arguments, group)
        found.append(arguments.resume)
        config = {"part": "body", "preset": "tiny", "seed": 0, "capture_key": "a", "held_out": {}, "splits": {}}
        monkeypatch.setattr(train, "kept_recipe", lambda *_: None)
        run = train._joined_run(arguments, {**config, "start": None, "person": "default", "person_hash": "0"}, group)
        run.close("failed")
        raise PeerLost

    monkeypatch.setattr(train, "_train", once)
    for number in range(3):
        start(number)
        assert main(["train", "a", "--out", str(tmp_path / "run")]) == 2
    assert found == [False, True, True]
    assert len(read_about(tmp_path / "run")["resumed"]) == 2


@pytest.mark.parametrize(
    ("end", "code"),
    [
        (train.WITHOUT, 1),
        (InputError("a", "", "a disk with room", "none"), 2),
        (Diverged("not finite"), None),
    ],
    ids=["no surface", "input", "diverged"],
)
def test_an_end_is_not_repeated(tmp_path, start, monkeypatch, end, code):
    calls = []

    def once(*_) -> int:
        calls.append(1)
        if isinstance(end, Exception):
            raise end
        return end

    monkeypatch.setattr(train, "_train", once)
    start(0)
    if code is None:
        with pytest.raises(Diverged):
            main(["train", "a", "--out", str(tmp_path / "run")])
    else:
        assert main(["train", "a", "--out", str(tmp_path / "run")]) == code
    start(1)
    assert main(["train", "a", "--out", str(tmp_path / "run")]) == (code or 1)
    assert calls == [1]


def test_a_stop_is_no_failure_to_torchrun(tmp_path, start, monkeypatch):
    """It starts all again after any other exit code than 0. Alone it is 130."""
    monkeypatch.setattr(train, "_train", lambda *_: train.STOPPED)
    assert main(["train", "a", "--out", str(tmp_path / "run")]) == 130
    start(0)
    assert main(["train", "a", "--out", str(tmp_path / "run")]) == 0


def test_a_process_that_never_starts_is_not_waited_for(tmp_path, start, monkeypatch, capsys):
    monkeypatch.setattr(process_group, "STARTING", timedelta(seconds=0.5))
    start(0, 2)
    begun = time.monotonic()
    assert main(["train", "a", "--out", str(tmp_path / "run")]) == 2
    assert time.monotonic() - begun < 30
    assert "another process of this training has not started within" in capsys.readouterr().err
