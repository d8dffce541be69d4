"""Compiled loops on disk: compiled anew whenever the text that they are made of changed, and only then."""

from __future__ import annotations

import importlib.util
import threading
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from avatarrex.ops import native

SOURCE = """
from avatarrex.ops.native import native

@native
def twice(x):
    return 2 * x
"""


def imported(path: Path) -> ModuleType:
    """The module, as another process would see it."""
    native.source_hash.cache_clear()
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def compiled(path: Path) -> bool:
    """Whether the loop of the module was compiled, and not found on disk."""
    loop = imported(path).twice
    assert loop(3) == 6
    return not loop.stats.cache_hits


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the place of `ops`, with one file beside the loop's."""
    (tmp_path / "ops").mkdir()
    (tmp_path / "ops" / "constants.py").write_text("THIN = 1e-10\n")
    monkeypatch.setattr(native, "FOLDER", tmp_path / "ops")
    return tmp_path


def test_a_loop_is_compiled_once_and_again_when_its_folder_changes(folder: Path) -> None:
    path = folder / "loops.py"
    path.write_text(SOURCE)
    assert compiled(path)
    assert not compiled(path)
    (folder / "ops" / "constants.py").touch()
    assert not compiled(path), "the text counts, not the time"
    (folder / "ops" / "constants.py").write_text("THIN = 1e-9\n")
    assert compiled(path), "a constant of another file"
    assert not compiled(path)
    path.write_text(SOURCE + "# a remark\n")
    assert compiled(path), "the loop's own file"


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_work_is_done_once_whoever_comes(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the other threads never begin; what fails in a piece is raised."""
    monkeypatch.setattr(native.torch, "get_num_threads", lambda: threads)
    done = np.zeros(1003, int)

    def count(begin: int, end: int, done: np.ndarray) -> None:
        done[begin:end] += 1

    native.spread(count, len(done), done, few=1)
    assert (done == 1).all()
    release, pool = threading.Event(), native._pool()
    blocked = [pool.submit(release.wait, 60) for _ in range(threads - 1)]
    native.spread(count, len(done), done, few=1, pieces=7)
    assert (done == 2).all()
    release.set()
    assert all(future.result() for future in blocked)
    with pytest.raises(ValueError, match="broken"):
        native.spread(broken, len(done), few=1)


def test_few_rows_have_few_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """One for every `few`: more would be started for less than it takes to start them."""
    monkeypatch.setattr(native.torch, "get_num_threads", lambda: 16)
    pieces: list[tuple[int, int]] = []

    def note(begin: int, end: int) -> None:
        pieces.append((begin, end))

    for rows, threads in ((0, 1), (100, 1), (101, 2), (350, 4), (10_000, 16)):
        pieces.clear()
        native.spread(note, rows, few=100, pieces=1)
        assert len(pieces) == threads
        assert sum(end - begin for begin, end in pieces) == rows


def test_torch_has_one_thread_meanwhile_and_its_own_again_after_it() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        with native.torch_on_one_thread():
            assert (torch.get_num_threads(), native.threads()) == (1, 3)
            with pytest.raises(ValueError, match="broken 1 3"), native.torch_on_one_thread():
                broken(torch.get_num_threads(), native.threads())
            assert (torch.get_num_threads(), native.threads()) == (1, 3)
        assert (torch.get_num_threads(), native.threads()) == (3, 3)
        torch.set_num_threads(2)
        assert native.threads() == 2, "loops follow torch again"
    finally:
        torch.set_num_threads(before)


def broken(begin: int, end: int) -> None:
    raise ValueError(f"broken {begin} {end}")
