"""The tool that kills jobs and fills their disks sees what is lost; the jobs that it kills are in tools/job_kinds.py."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
COUNTS = """
import os, sys, time
from pathlib import Path
out, whole = Path(sys.argv[1]), {whole}
for number in range(20):
    file = out / f"{{number}}.txt"
    if not file.exists():
        part = out / f".{{number}}" if whole else file
        try:
            with open(part, "w") as stream:
                for line in range(64):
                    stream.write(f"{{number}} {{line}} " * 50)
                    stream.flush()
                    time.sleep(2e-4)
        except OSError as error:
            sys.exit(f"no space: {{error.strerror}}" if whole else 0)
        os.replace(part, file)
"""


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(TOOLS))
    import kill_jobs

    yield kill_jobs
    for name in ("kill_jobs", "job_kinds", "job_results"):
        del sys.modules[name]


def counting(tool: ModuleType, whole: bool):
    """A job that writes twenty files, each whole or as it comes, and passes over those that are there."""
    command = (sys.executable, "-S", "-c", COUNTS.format(whole=whole))
    return tool.Job("count", lambda out: (*command, str(out)), tool.job_results.files)


def can_mount(folder: Path) -> bool:
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "none", str(folder)]
    if os.geteuid() != 0 or subprocess.run(words, capture_output=True).returncode != 0:
        return False
    subprocess.run(["umount", str(folder)], check=True)
    return True


@pytest.mark.parametrize("whole", [True, False])
def test_what_a_kill_or_a_full_disk_loses_is_seen(tool: ModuleType, whole: bool, tmp_path: Path) -> None:
    if not can_mount(tmp_path / "try"):
        pytest.skip("mounting a disk needs root")
    place, job, row = tool.Place(tmp_path), counting(tool, whole), tool.Row("count")
    undisturbed = tool.undisturbed(job, place)
    assert (len(undisturbed.made), undisturbed.room > 2**18) == (20, True)
    tool.killed(job, undisturbed, place, row, random.Random(1), 4)
    assert row.kills == 4
    lost = list(row.wrong)
    tool.filled(job, undisturbed, place, row, 0.5)
    assert row.full == 1
    if whole:
        assert row.wrong == []
        assert row.compared >= 2
    else:
        assert any("differ" in line for line in lost), "half a file is taken for a whole one"
        assert any("ended well with 50%" in line for line in row.wrong), row.wrong
    assert " 4 " in tool.table([row])


def test_a_job_that_does_not_go_on_is_seen(tool: ModuleType, tmp_path: Path) -> None:
    if not can_mount(tmp_path / "try"):
        pytest.skip("mounting a disk needs root")
    sound = counting(tool, True)
    refuses = "import sys; from pathlib import Path; sys.exit('something else') if any(Path(sys.argv[1]).iterdir()) else None\n"
    job = tool.Job(
        "count", lambda out: (*sound.words(out)[:-2], refuses + COUNTS.format(whole=True), str(out)), sound.made
    )
    place, row = tool.Place(tmp_path), tool.Row("count")
    tool.killed(job, tool.undisturbed(job, place), place, row, random.Random(1), 1)
    assert row.wrong == ["count: does not go on after a kill: something else"]


def test_moments_are_no_difference(tool: ModuleType, tmp_path: Path) -> None:
    for name, text in (
        ("a", '{"at": 1, "steps": [{"key": "x", "said": 2}]}'),
        ("b", '{"at": 2, "steps": [{"key": "y", "said": 2}]}'),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / "prepare.json").write_text(text)
    one, two = (tool.job_results.files(tmp_path / name) for name in "ab")
    assert one == two
    (tmp_path / "b" / "prepare.json").write_text('{"at": 2, "steps": [{"key": "y", "said": 3}]}')
    assert tool.job_results.files(tmp_path / "b") != one
    assert tool.dealt(20, 6) == [4, 4, 3, 3, 3, 3]


def test_a_kind_that_is_not_there_is_refused(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tool, "jobs", lambda folder: [counting(tool, True)])
    monkeypatch.setattr(sys, "argv", ["kill_jobs.py", str(tmp_path), "--jobs", "count,cuont"])
    with pytest.raises(SystemExit) as ended:
        tool.main()
    assert ended.value.code == 2
    assert "--jobs: expected some of count, found count,cuont" in capsys.readouterr().err
