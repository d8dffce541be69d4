"""Every hostile file ends in one line that states file, field, limit and what was found, before memory is taken."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli.runs import table
from avatarrex_studio.jobs.runs import Runs
from hostile import CASES, HERE, rows, run

from avatarrex.errors import InputError
from avatarrex.files.gate import written
from avatarrex.files.json_text import parse_json
from avatarrex.signals.read import read_motion
from avatarrex.training.runs.events import EventWriter
from avatarrex.training.runs.folder import Run

SECONDS, MIB = 10.0, 128
"""Of work and of memory for one file, on a slow machine; most are made to take gigabytes or hours."""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, object]]:
    """What came of every file, in one process whose peak of memory is its own."""
    words = [sys.executable, str(HERE / "hostile.py"), str(tmp_path_factory.mktemp("hostile"))]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", CASES)
def test_it_is_refused_in_one_line(name: str, loaded: dict[str, dict[str, object]]) -> None:
    found, pattern = loaded[name], CASES[name][2]
    assert re.search(pattern, str(found["error"])), found["error"]
    assert str(found["error"]).isprintable()
    assert float(str(found["seconds"])) < SECONDS
    assert float(str(found["mib"])) < MIB


def test_a_run_goes_on_from_the_checkpoint_before(tmp_path: Path) -> None:
    """The newest is deep, the one before of wrong kinds: the third is taken."""

    def spoil(folder: Path) -> None:
        (folder / "checkpoints" / "step_00000006" / "state.json").write_text("[" * 900)
        (folder / "checkpoints" / "step_00000004" / "manifest.json").write_text(
            '{"format": 1, "saved": "x", "files": []}'
        )

    path = run(tmp_path / "run", spoil)
    with Run.open(path) as opened:
        found = opened.latest()
    assert found is not None
    assert found[0] == 2


def test_no_control_characters_reach_a_terminal(tmp_path: Path) -> None:
    """Escape codes in a column's name, in notes and in a name."""
    lines = rows(1 / 60, 4).split("\n")
    lines = [lines[0] + ",\x1b[31mred\x07", *(line + ",0" for line in lines[1:])]
    (tmp_path / "m.csv").write_text("\n".join(lines))
    (tmp_path / "m.json").write_text(json.dumps({"frames": [{}], "name": "\x1b[2J", "notes": ["\x9b31m\nline"]}))
    for name in ("m.csv", "m.json"):
        motion = read_motion(tmp_path / name)
        assert motion.name.isprintable()
        assert all(note.isprintable() for note in motion.notes)


def test_a_run_shows_no_control_characters(tmp_path: Path) -> None:
    """Escape codes in run.json, in a heartbeat and in the names of numbers."""
    code = "\x1b[2J"

    def spoil(folder: Path) -> None:
        about = json.loads((folder / "run.json").read_text())
        about |= {"part": f"body{code}", "note": f"{code}\n", "started": "yesterday", "config": {"parts": [code]}}
        (folder / "run.json").write_text(json.dumps(about))
        beat = json.loads((folder / "heartbeat.json").read_text())
        (folder / "heartbeat.json").write_text(json.dumps({**beat, "pass_name": code}))
        events = EventWriter(folder)
        events.scalars(9, {f"body{code}/loss/total": 1.0})
        events.close()

    runs = Runs(run(tmp_path / "run", spoil))
    while runs.poll():
        pass
    assert all(line.isprintable() for line in table(runs.views))
    (view,) = runs.views
    assert "started" not in view.about
    assert "\\x1b" not in repr(view)


def test_sane_numbers_pass_the_gate() -> None:
    """Integers of 128 bits are exact, brackets in texts do not count, 64 levels are read."""
    assert parse_json(str(2**127), "x") == 2**127
    assert parse_json(json.dumps(["[" * 900, '\\"' + "{" * 90]), "x")[0] == "[" * 900
    assert parse_json("[" * 64 + "]" * 64, "x") is not None
    with pytest.raises(InputError, match="nested at most 64 deep"):
        parse_json("[" * 65 + "]" * 65, "x")
    assert np.isinf(parse_json("1" + "0" * 400, "x"))


def test_an_avatar_on_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    """Writes beyond 100 kB of a file fail; what was there stays, and no temporary file is left."""
    (tmp_path / "a.avatar").write_text("kept")
    code = f"""
import resource
import sys
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.errors import InputError
avatar = load_avatar("default")
sys.dont_write_bytecode = True  # modules would be cut off, too, and stay so
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
for name in ("a.avatar", "folder"):
    try:
        save_avatar(avatar, {str(tmp_path)!r} + "/" + name)
    except InputError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout.count("expected a file that can be written, found File too large") == 2, done.stderr
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.avatar", "folder"]
    assert (tmp_path / "a.avatar").read_text() == "kept"


def test_a_write_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), written(tmp_path / "x.txt"):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
