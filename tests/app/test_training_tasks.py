"""What the Training tab has the command line do: checks with pictures, captures, evaluations; and their rows to compare."""

from __future__ import annotations

import json
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.jobs.evaluations import Evaluations, evaluating
from avatarrex_studio.jobs.run_view import RunView
from avatarrex_studio.jobs.task import Progress, Task, Tasks, text_of
from avatarrex_studio.jobs.training_process import Order, TrainingProcesses
from avatarrex_studio.panels.capture_import import CaptureImport
from avatarrex_studio.panels.capture_tools import checking
from avatarrex_studio.panels.files import FileDialog
from PIL import Image

from avatarrex.errors import InputError

SAYS = (sys.executable, "-c")
ECHO = "import sys; print('\\n'.join(sys.argv[1:])); sys.exit(int(sys.argv[1]))"


def ended(tasks, seconds=30.0):
    end = time.monotonic() + seconds
    while (outcome := tasks.poll()) is None:
        assert time.monotonic() < end
        time.sleep(0.02)
    return outcome


def test_a_task_prints_ends_and_is_told_from_a_failure(tmp_path):
    tasks = Tasks((*SAYS, ECHO))
    tasks.start(Task("Two", ("0", "b"), tmp_path / "logs" / "a.log"))
    with pytest.raises(InputError, match="Two"):
        tasks.start(Task("Three", ("0",), tmp_path / "b.log"))
    outcome = ended(tasks)
    assert (outcome.code, outcome.done, outcome.text) == (0, True, "0\nb")
    tasks.start(Task("Unusable", ("1",), tmp_path / "a.log", bad=(1,)))
    assert ended(tasks).done
    tasks.start(Task("Failed", ("2",), tmp_path / "a.log", bad=(1,)))
    assert not ended(tasks).done
    tasks.close()


def test_a_task_is_cancelled_and_ends_with_the_window(tmp_path):
    sleep = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); import time; print('up', flush=True); time.sleep(60)"
    tasks = Tasks((*SAYS, sleep))
    for end in (tasks.cancel, tasks.close):
        tasks.start(Task("Long", (), tmp_path / "a.log", bad=(1, -signal.SIGINT)))
        until = time.monotonic() + 20
        while tasks.line != "up" and time.monotonic() < until:
            time.sleep(0.02)
        process = tasks._process
        end()
        assert process.wait(10) != 0
        if end == tasks.cancel:
            assert not ended(tasks).done, "what ends in the midst of an import has a code of its own"


def test_a_log_is_read_as_a_terminal_shows_it(tmp_path):
    (tmp_path / "a.log").write_bytes(b"first\n 10%|#\r 100%|##########\rlast\nend\n")
    assert text_of(tmp_path / "a.log") == "first\nlast\nend"
    assert text_of(tmp_path / "none.log") == ""
    line = "check body:  75%|███████▌  | 3/4 [00:04<00:01,  1.49s/frame]"
    assert Progress.read(line) == Progress(0.75, "check body 3/4, 00:01 left")
    assert Progress.read("100%|███| 5/5 [00:04<00:00,  1.2it/s]") == Progress(1.0, "5/5, 00:00 left")
    assert Progress.read("a: 75 pictures") is None
    (tmp_path / "a.log").write_text(f"first\n{line}\nend\n")
    assert text_of(tmp_path / "a.log") == "first\nend"


@pytest.mark.slow
def test_a_check_draws_its_sheets(tmp_path, monkeypatch):
    """The true verb on the true smallest capture: what the tab's button does, its picture and its verdict."""
    from avatarrex.capture.synthetic.make import make_capture

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    make_capture(tmp_path / "smoke", "smoke")
    task, tasks = checking(str(tmp_path / "smoke")), Tasks()
    tasks.start(task)
    outcome = ended(tasks, 240)
    assert outcome.done, outcome.text
    assert "verdict:" in outcome.text
    for path in task.pictures:
        with Image.open(path) as image:
            assert np.asarray(image.convert("RGB")).std() > 10


def evaluation(psnr):
    values = {"pictures": 3, "psnr_matte": psnr, "ssim_matte": 0.9, "iou": None, "sharpness": 1.0}
    return {
        "splits": {"train": {"avatar": {**values, "psnr_matte": 99.0}}, "test": {"avatar": values, "template": values}}
    }


def test_evaluations_become_rows_as_files_change(tmp_path):
    view = RunView(tmp_path, "mine", "finished", about={"capture": "cap"})
    task = evaluating(view, tmp_path / "avatars" / "step_00000400.avatar", True)
    assert task.words[:3] == ("evaluate", str(tmp_path / "avatars" / "step_00000400.avatar"), "cap")
    assert "--baselines" in task.words
    file = Path(task.words[task.words.index("--json") + 1])
    file.parent.mkdir()
    file.write_text("{")
    evaluations = Evaluations()
    assert evaluations.of(view) == ()
    file.write_text(json.dumps(evaluation(25.004)))
    first, second = evaluations.of(view)
    assert (first.run, first.step, first.subject, first.pictures) == ("mine", "400", "avatar", 3)
    assert first.values == {"PSNR": "25.00", "SSIM": "0.900", "IoU": "–", "Sharp": "1.00"}
    assert second.subject == "template"
    assert evaluations.of(RunView(tmp_path / "none", "none", "dead")) == ()


def test_an_order_passes_on_where_it_starts_and_force(tmp_path):
    processes = TrainingProcesses((*SAYS, "import sys; print(' '.join(sys.argv[1:]))"))
    processes.start(Order("cap", "refine", tmp_path / "run", ("face",), "before.avatar", True))
    end = time.monotonic() + 20
    while processes.paths and time.monotonic() < end:
        time.sleep(0.02)
    printed = (tmp_path / "run" / "train.log").read_text()
    assert "--recipe refine" in printed
    assert "--start before.avatar --force" in printed


def test_an_import_is_looked_at_then_done(tmp_path, monkeypatch):
    """What was said goes along, into the cache first; another source begins with guesses."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    form = CaptureImport(FileDialog())
    form.take("/a/zju.zip")
    form.said |= {"up": "-Z", "unit": "mm"}
    look, whole = form.look(form.source), form.whole(form.source, str(tmp_path / "out"))
    said = ("--unit=mm", "--up=-Z")
    assert look.words[:3] == ("capture", "import", "/a/zju.zip")
    assert look.words[4:] == (*said, "--preview", "3")
    folder = Path(look.words[3])
    assert folder.parent == tmp_path / "cache" / "avatarrex-studio" / "imports"
    assert (look.capture, look.bad, look.pictures[0]) == ("", (1,), folder / "look" / "body.png")
    assert (whole.words, whole.capture) == (
        ("capture", "import", "/a/zju.zip", str(tmp_path / "out"), *said),
        str(tmp_path / "out"),
    )
    form.take("/b")
    assert set(form.said.values()) == {""}
