"""A run folder: what goes in comes out bit for bit, the right checkpoints stay, damage is passed over, wishes arrive."""

from __future__ import annotations

import errno
import json
import logging
import math
import os
import time

import numpy as np
import pytest
import torch
from avatarrex_studio.cli.main import main
from tiny_run import fit

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.errors import InputError
from avatarrex.files.gate import UNFINISHED
from avatarrex.templates.person import load_person
from avatarrex.training.runs import checkpoint, control
from avatarrex.training.runs.control import Heartbeat, request
from avatarrex.training.runs.events import EventReader
from avatarrex.training.runs.folder import Run, read_about


def same(a, b):
    """Equal in value, type, nesting, dtype and every bit."""
    if isinstance(a, torch.Tensor):
        return a.dtype == b.dtype and a.shape == b.shape and a.numpy().tobytes() == b.numpy().tobytes()
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return type(b) is dict and list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and (a == b or (a != a and b != b)) and repr(a) == repr(b)


def trained_state():
    """What a training keeps: parameters, optimiser, generators, and every awkward value."""
    torch.manual_seed(1)
    model = torch.nn.Sequential(torch.nn.Conv2d(3, 4, 3), torch.nn.BatchNorm2d(4))
    optimiser = torch.optim.AdamW(model.parameters(), lr=1e-3)
    for _ in range(3):
        optimiser.zero_grad()
        model(torch.randn(2, 3, 8, 8)).square().sum().backward()
        optimiser.step()
    shared = torch.arange(6.0)
    return {
        "model": dict(model.state_dict()), "optimiser": optimiser.state_dict(), "torch": torch.get_rng_state(),
        "numpy": np.random.default_rng(3).bit_generator.state, "legacy": np.random.RandomState(4).get_state(),
        "views": [shared, shared[::2], shared.reshape(2, 3).T], "empty": torch.empty(0, 3), "zero": torch.tensor(-0.0),
        "half": torch.tensor([1.5, math.nan], dtype=torch.float16), "flags": torch.tensor([True, False]),
        "floats": [0.1, 1e-320, -0.0, math.nan, math.inf, -math.inf], "ints": (2**127 + 1, -1, True, None),
        "text": "ψ", "bytes": b"\x00\xff", "arrays": {0: np.arange(4, dtype=np.uint16), "$x": np.ones((2, 0))},
        "empties": [{}, [], (), ""],
    }  # fmt: skip


def test_a_state_comes_back_bit_for_bit(tmp_path):
    state = trained_state()
    with Run.create(tmp_path / "run", {"part": "body"}) as run:
        assert run.latest() is None
        path = run.save(12, state)
    assert path == tmp_path / "run/checkpoints/step_00000012"
    with Run.open(tmp_path / "run") as run:
        step, back = run.latest()
    assert step == 12
    assert same(state, back)
    changed = {**state, "zero": torch.tensor(0.0)}
    assert not same(changed, back), "the comparison sees one bit"


def test_the_optimiser_goes_on_as_if_nothing_had_been(tmp_path):
    fit(tmp_path / "whole", steps=20)
    fit(tmp_path / "parts", steps=10)
    fit(tmp_path / "parts", steps=20)
    whole, parts = EventReader(tmp_path / "whole"), EventReader(tmp_path / "parts")
    whole.poll(), parts.poll()
    for tag in ("body/loss/total", "body/loss/rgb", "body/heldout/psnr"):
        assert np.array_equal(whole.series(tag).values, parts.series(tag).values)
        assert len(whole.series(tag).values) >= 4


def test_what_cannot_be_kept_is_named(tmp_path):
    with Run.create(tmp_path / "run", {}) as run:
        with pytest.raises(TypeError, match=r"state\.a\[1\]\.b: a object"):
            run.save(1, {"a": [0, {"b": object()}]})
        assert run.latest() is None
        assert os.listdir(tmp_path / "run/checkpoints") == []


def test_the_last_three_and_the_best_of_each_part_stay(tmp_path):
    with Run.create(tmp_path / "run", {}) as run:
        for part, scores in (("face", (20.0, 26.0, 22.0, 21.0, 20.5)), ("body", (0.0, -1.0, -2.0, -3.0, None))):
            run.stage(part, "I", 100)
            for k, score in enumerate(scores):
                run.save(10 * k + (part == "body"), {"part": part, "k": k}, score=score)
        names = sorted(os.listdir(tmp_path / "run/checkpoints"))
        step, state = run.latest()
    assert names == ["step_00000001", "step_00000010", "step_00000021", "step_00000031", "step_00000041"]
    assert (step, state) == (41, {"part": "body", "k": 4})


def test_steps_that_begin_again_are_later_all_the_same(tmp_path):
    with Run.create(tmp_path / "run", {}) as run:
        run.save(500, {"x": 1})
        run.save(10, {"x": 2})
        assert run.latest() == (10, {"x": 2})
        run.save(10, {"x": 3})
        assert run.latest() == (10, {"x": 3})
        assert sorted(os.listdir(tmp_path / "run/checkpoints")) == ["step_00000010", "step_00000500"]


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("state.safetensors", lambda content: content[:-1]),
        ("state.safetensors", lambda content: content[:-1] + bytes([content[-1] ^ 1])),
        ("state.json", lambda content: content.replace(b"2", b"3")),
        ("state.json", lambda content: b""),
        ("manifest.json", lambda content: content[:40]),
        ("manifest.json", lambda content: content.replace(b'"step"', b'"stop"')),
        ("state.json", None),
    ],
)
def test_a_damaged_checkpoint_is_passed_over_with_a_note(tmp_path, caplog, name, damage):
    with Run.create(tmp_path / "run", {}) as run:
        for step in (1, 2):
            run.save(step, {"x": torch.full((5,), float(step)), "step": step})
    file = tmp_path / "run/checkpoints/step_00000002" / name
    if damage:
        file.write_bytes(damage(file.read_bytes()))
    else:
        file.unlink()
    with caplog.at_level(logging.WARNING), Run.open(tmp_path / "run") as run:
        step, state = run.latest()
        assert step == state["step"] == 1
        assert "step_00000002" in caplog.text
        assert len(caplog.text.strip().splitlines()) == 1
        run.save(2, {"step": 2})
        assert run.latest() == (2, {"step": 2}), "written anew over the damaged one"


def test_a_checkpoint_that_was_being_replaced_gets_its_name_back(tmp_path):
    folder = tmp_path / "run/checkpoints"
    with Run.create(tmp_path / "run", {}) as run:
        run.save(5, {"x": 1})
    os.rename(folder / "step_00000005", folder / ".old_step_00000005")
    (folder / ".new_step_00000005").mkdir()
    with Run.open(tmp_path / "run") as run:
        assert run.latest() == (5, {"x": 1})
    assert os.listdir(folder) == ["step_00000005"]


def test_an_avatar_lies_beside_the_state(tmp_path):
    avatar = Avatar.create(load_person("default"), "compact", seed=3)
    with Run.create(tmp_path / "run", {}) as run:
        path = run.save(1, {"x": 1}, avatar=avatar)
        assert run.latest() == (1, {"x": 1})
    back = load_avatar(path / "avatar.avatar")
    assert all(torch.equal(value.half(), back.state()[name].half()) for name, value in avatar.state().items()
               if value.is_floating_point())  # fmt: skip


def test_wishes_and_states(tmp_path):
    path = tmp_path / "run"
    with Run.create(path, {"part": "face", "capture": tmp_path.name, "preset": "quick", "seed": 4, "steps": 9}) as run:
        assert run.control() == "run"
        assert read_about(path)["state"] == "running"
        request(path, "pause")
        assert run.control() == "pause"
        assert read_about(path)["state"] == "paused"
        request(path, "run")
        assert run.control() == "run"
        assert read_about(path)["state"] == "running"
        (path / "control.json").write_text("{half a")
        assert run.control() == "run"
        request(path, "stop")
        assert run.control() == "stop"
    about = read_about(path)
    assert (about["state"], about["part"], about["preset"], about["seed"]) == ("stopped", "face", "quick", 4)
    assert about["config"]["steps"] == 9
    assert about["versions"]["torch"] == torch.__version__
    with Run.open(path) as run:
        assert run.control() == "run", "requested of the process before"
    about = read_about(path)
    assert about["state"] == "finished"
    assert len(about["resumed"]) == 1


def test_what_a_killed_process_was_writing_is_removed(tmp_path, monkeypatch):
    path = tmp_path / "run"
    with Run.create(path, {}) as run:
        run.picture(0, "body/render", np.zeros((2, 2, 3), np.uint8))
    (path / "samples" / "body" / f"{UNFINISHED}x.png").touch()
    with monkeypatch.context() as patch:
        for name in ("replace", "unlink"):  # killed before its end
            patch.setattr(control.os if name == "replace" else control.Path, name, full)
        with pytest.raises(InputError):
            control.write_json(path / "heartbeat.json", {})
    assert list(path.glob(".*"))
    with Run.open(path):
        assert not list(path.rglob(".*"))


def full(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_the_end_by_an_exception_is_kept(tmp_path):
    with pytest.raises(ZeroDivisionError), Run.create(tmp_path / "a", {}):
        raise ZeroDivisionError("loss/rgb is NaN\nat step 5")
    assert (read_about(tmp_path / "a")["state"], read_about(tmp_path / "a")["note"]) == ("failed", "loss/rgb is NaN")
    with pytest.raises(KeyboardInterrupt), Run.create(tmp_path / "b", {}):
        raise KeyboardInterrupt
    assert read_about(tmp_path / "b")["state"] == "stopped"


def test_the_heart_beats_through_a_long_step(tmp_path, monkeypatch):
    monkeypatch.setattr(control, "BEAT_SECONDS", 0.05)
    with Run.create(tmp_path / "run", {}) as run:
        run.stage("body", "II", 70)
        first = Heartbeat.read(tmp_path / "run")
        time.sleep(0.4)
        beat = Heartbeat.read(tmp_path / "run")
        assert beat.time > first.time
        assert (beat.pid, beat.part, beat.pass_name, beat.steps) == (os.getpid(), "body", "II", 70)
        assert beat.alive()
        assert not beat.alive(beat.time + control.DEAD_SECONDS + 1)


def test_one_process_at_a_time(tmp_path):
    with Run.create(tmp_path / "run", {}):
        with pytest.raises(InputError, match="no other process works on"):
            Run.open(tmp_path / "run")
        with pytest.raises(InputError, match="no other process works on"):
            Run.create(tmp_path / "run", {})
    Run.open(tmp_path / "run").close()
    with pytest.raises(InputError, match="a folder without a run"):
        Run.create(tmp_path / "run", {})


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 99}', '{"format": 1, "state": "x", "config": {}}'])
def test_a_broken_run_file_is_one_line(tmp_path, text):
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(InputError) as error:
        Run.open(tmp_path)
    assert "\n" not in str(error.value)


def test_no_folder_and_bad_names(tmp_path):
    with pytest.raises(InputError, match=r"run\.json"):
        Run.open(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="a file that can be written"):
        Run.create(tmp_path / "file/run", {})
    with Run.create(tmp_path / "run", {}) as run:
        for name in ("../up", "/abs", "a//b", "", ".hidden", "a/.."):
            with pytest.raises(InputError, match="a name such as"):
                run.picture(0, name, np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(ValueError, match="is closed"):
        run.scalars(1, {"a": 1.0})


def test_order_does_not_depend_on_the_clock(tmp_path, monkeypatch):
    with Run.create(tmp_path / "run", {}) as run:
        run.scalars(1, {"a": 1.0})
    monkeypatch.setattr(time, "time", lambda: 1e9)
    with Run.open(tmp_path / "run") as run:
        run.scalars(1, {"a": 2.0})
        run.save(1, {})
    reader = EventReader(tmp_path / "run")
    reader.poll()
    assert reader.series("a").values.tolist() == [2.0]
    assert checkpoint.found(tmp_path / "run/checkpoints")[0].manifest.time == 1e9
    json.loads((tmp_path / "run/run.json").read_text())


def test_a_folder_in_use_is_refused_before_the_capture_is_read(tmp_path, capsys):
    """By `train`, new or resumed; one that is not in use, or holds no run, is refused for that."""
    out = str(tmp_path / "run")
    with Run.create(out, {}):
        for words in (["--resume"], []):
            assert main(["train", "nowhere.zip", "--out", out, *words]) == 2
            error = capsys.readouterr().err
            assert "run: expected a run that no other process works on, found process" in error
            assert len(error.splitlines()) == 1
    assert main(["train", "nowhere.zip", "--out", out]) == 2
    assert "run: expected a folder without a run (--resume goes on with one)" in capsys.readouterr().err
    assert main(["train", "nowhere.zip", "--out", str(tmp_path / "new"), "--resume"]) == 2
    assert "new: expected a run folder with run.json" in capsys.readouterr().err
    for words in (["--resume"], []):
        assert main(["train", "nowhere.zip", "--out", out if words else str(tmp_path / "new"), *words]) == 2
        assert "nowhere.zip: expected a capture" in capsys.readouterr().err
