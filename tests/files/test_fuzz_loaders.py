"""The fuzzer over every loader: a short time of it, and that it finds what is wrong."""

from __future__ import annotations

import contextlib
import importlib.util
import pickle
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from avatarrex.errors import InputError

FILES = 1000
"""Some 20 s of a processor with the making of the samples."""
PLACE = Path(__file__).parents[2] / "tools" / "fuzz_loaders.py"


@pytest.fixture(scope="module")
def tool():
    before = list(sys.path)
    sys.path.insert(0, str(PLACE.parent))
    spec = importlib.util.spec_from_file_location("fuzz_loaders", PLACE)
    module = sys.modules["fuzz_loaders"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.path[:] = before
    yield module
    del sys.modules["fuzz_loaders"]


@pytest.mark.slow
def test_every_loader_refuses_in_a_line_what_is_broken() -> None:
    """Always the same files, as many on every machine."""
    words = ["--files", str(FILES), "--seconds", "900", "--seed", "7"]
    done = subprocess.run([sys.executable, str(PLACE), *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{FILES} files" in done.stdout
    assert " 0 read wrongly" in done.stdout


def test_a_worker_that_ends_before_its_first_file_ends_the_fuzzer(
    tool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """By itself, or killed: it would be started again for ever."""
    for words in (["true"], ["sh", "-c", "kill -9 $$"]):
        monkeypatch.setattr(tool.subprocess, "Popen", started(words))
        with pytest.raises(RuntimeError, match="the worker has failed at file 5"):
            list(tool.fuzzed(0, "", tmp_path, 5))


def started(words: list[str]) -> Callable[..., subprocess.Popen]:
    """`Popen`, but of other words, and not more often than a driver that ends does."""
    times, popen = [0], subprocess.Popen

    def start(_: list[str], **others: object) -> subprocess.Popen:
        times[0] += 1
        assert times[0] < 5
        return popen(words, **others)

    return start


def unplain(_: Path) -> None:
    error = InputError("a", "", "b", "c")
    error.args = ("two\nlines",)
    raise error


WRONG: dict[str, tuple[Callable[[Path], object], str]] = {
    "another error": (lambda path: {}[str(path)], "KeyError"),
    "a refusal of two lines": (unplain, "a refusal that is no plain line"),
    "control characters printed": (lambda path: print("\x1b[2J"), "control characters are shown"),
    "control characters told": (lambda path: ["a\x9b31m"], "control characters are shown"),
}


@pytest.mark.parametrize("what", WRONG)
def test_it_sees_what_is_wrong(tool, what: str, tmp_path: Path) -> None:
    read, said = WRONG[what]
    assert said in tool.judged(read, tmp_path)[0]


def test_it_sees_what_takes_long(tool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def endless(_: Path) -> None:
        while True:
            try:
                time.sleep(0)
            except Exception:
                continue

    monkeypatch.setattr(tool, "LONGEST", 0.2)
    handler = tool.signal.signal(tool.signal.SIGPROF, tool.too_long)
    assert tool.judged(endless, tmp_path)[0].startswith("too long")
    tool.signal.signal(tool.signal.SIGPROF, handler)


def test_it_plants_code_that_runs_where_it_is_called(tool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What it plants is live: `pickle` runs it."""
    monkeypatch.chdir(tmp_path)
    assert not tool.canaries(tmp_path)
    ran = 0
    for seed in range(20):
        content = sys.modules["fuzz_bytes"].planted(b"", random.Random(seed))
        content = content[content.index(b"\n") + 1 :] if content.startswith(b"\x93NUMPY") else content
        with contextlib.suppress(Exception):
            pickle.loads(content)
        ran += tool.canaries(tmp_path)
        (tmp_path / "CANARY").unlink(missing_ok=True)
    assert ran > 10


def test_sound_refusals_and_readings_are_right(tool, tmp_path: Path) -> None:
    def refused(path: Path) -> None:
        raise InputError(path, "x", "a\x1b[2J", "b\n")

    assert tool.judged(refused, tmp_path) == ("", True)
    assert tool.judged(lambda path: ["a note"], tmp_path) == ("", False)


def test_a_seed_repeats_the_files(tool) -> None:
    files = {"a.json": b'{"a": [1, 2.5, "x"]}', "b.npy": b"\x93NUMPY\x01\x00\x10\x00{'descr': '<f8'}" + bytes(64)}
    made = [[tool.broken(files, random.Random(f"{seed} 0")) for seed in range(50)] for _ in range(2)]
    assert made[0] == made[1]
    assert sum(one != files for one in made[0]) > 45
