"""A run's avatar gets its surface at the end: stored in the last checkpoint, gone on with, and never at the avatar's cost."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from avatarrex_studio.cli import train
from avatarrex_studio.cli.main import main, parse
from capture.tiny_capture import TinyCapture
from surface.template_surface import template_surface
from tiny_recipe import TINY

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError
from avatarrex.surface.surface import Surface
from avatarrex.surface.surface_file import weights_key
from avatarrex.training import distilled
from avatarrex.training.distilled import Stopped, add_surface
from avatarrex.training.runs import checkpoint
from avatarrex.training.runs.control import Heartbeat, request
from avatarrex.training.runs.folder import Run, read_about


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    return TinyCapture.make(("body",)).folder(tmp_path_factory.mktemp("tiny") / "capture")


@pytest.fixture(scope="module")
def trained(capture, tmp_path_factory) -> Path:
    """A run that the verb trained to its end, without a surface."""
    folder = tmp_path_factory.mktemp("trained") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(train.RECIPES, "smoke", TINY)
        patch.setattr("avatarrex.training.core.held_out.PICTURES", 1)
        assert main([*words(capture, folder), "--no-surface"]) == 0
    return folder


@pytest.fixture
def run_folder(trained, tmp_path, monkeypatch) -> Path:
    """A copy of it to go on with."""
    monkeypatch.setitem(train.RECIPES, "smoke", TINY)
    return Path(shutil.copytree(trained, tmp_path / "run"))


def words(capture: Path, folder: Path) -> list[str]:
    return ["train", str(capture), "--recipe", "smoke", "--out", str(folder)]


def at_once(avatar: Avatar, work: Path, poses: int, progress) -> Surface:
    """The template, in place of a distillation."""
    work.mkdir()
    progress("mesh", 0, 1)
    for number in range(3):
        progress("poses", number, 3)
    shutil.rmtree(work)
    return replace(template_surface(), key=weights_key(avatar), meta={"poses": poses})


def last(folder: Path) -> checkpoint.Checkpoint:
    return checkpoint.found(folder / "checkpoints")[-1]


def test_a_training_without_a_surface(trained):
    assert read_about(trained)["state"] == "finished"
    assert load_avatar(last(trained).path / "avatar.avatar").surface is None


def test_provenance_says_what_of_which_capture_was_held_out(capture, trained):
    training = load_avatar(last(trained).path / "avatar.avatar").meta["training"]
    assert training["capture_key"] == open_capture(capture).key
    assert training["splits"]["body"]["test"] == {"frames": "", "cameras": []}
    assert training["pelvis"] == [0, 0, 0]


def test_a_finished_run_without_one_goes_on_with_it(capture, run_folder, monkeypatch, capsys):
    """In the checkpoint of the same step, whole, with the same weights and score; and once."""
    before, state = checkpoint.newest(run_folder / "checkpoints")
    weights = load_avatar(before.path / "avatar.avatar").state()
    monkeypatch.setattr(distilled, "distil", at_once)
    assert main([*words(capture, run_folder), "--resume"]) == 0
    after, kept = checkpoint.newest(run_folder / "checkpoints")
    avatar = load_avatar(after.path / "avatar.avatar")
    assert avatar.surface is not None
    assert all(value.equal(avatar.state()[name]) for name, value in weights.items())
    assert (after.path, after.manifest.part, after.manifest.score) == (
        before.path, before.manifest.part, before.manifest.score
    )  # fmt: skip
    assert kept.keys() == state.keys()
    assert read_about(run_folder)["state"] == "finished"
    told = capsys.readouterr()
    assert "surface: poses: 100%" in told.err
    assert told.out.splitlines()[-2:] == [f"poses  {distilled.POSES}", f"{run_folder}: finished"], "its figures, last"
    assert not (run_folder / "distil").exists()
    monkeypatch.setattr(distilled, "distil", None)
    assert main([*words(capture, run_folder), "--resume"]) == 0


@pytest.mark.parametrize(
    ("error", "code", "state", "note"),
    [
        (KeyboardInterrupt(), train.STOPPED, "stopped", ""),
        (InputError("a disk", "", "room", "none"), train.WITHOUT, "finished", "no surface: a disk: expected room"),
        (RuntimeError("of torch\nand more"), train.WITHOUT, "finished", "no surface: of torch"),
    ],
)
def test_what_ends_it_leaves_the_trained_avatar(error, code, state, note, capture, run_folder, monkeypatch, capsys):
    def fails(*_: object) -> None:
        raise error

    before = (last(run_folder).path / "avatar.avatar").read_bytes()
    monkeypatch.setattr(distilled, "distil", fails)
    assert main([*words(capture, run_folder), "--resume"]) == code
    about = read_about(run_folder)
    assert about["state"] == state
    assert about["note"].startswith(note)
    assert "\n" not in about["note"]
    assert (last(run_folder).path / "avatar.avatar").read_bytes() == before
    assert "--resume" in capsys.readouterr().out
    monkeypatch.setattr(distilled, "distil", at_once)
    assert main([*words(capture, run_folder), "--resume"]) == 0
    assert load_avatar(last(run_folder).path / "avatar.avatar").surface is not None


def test_a_viewer_sees_how_far_it_is_and_stops_it(run_folder, monkeypatch):
    seen: list[tuple[str, str, int, int]] = []

    def watched(avatar: Avatar, work: Path, poses: int, progress) -> Surface:
        for number in range(3):
            progress("poses", number, 3)
            run._heart.beat()
            beat = Heartbeat.read(run_folder)
            seen.append((beat.part, beat.pass_name, beat.step, beat.steps))
            if number == 1:
                request(run_folder, "stop")
        raise AssertionError("it was to stop")

    monkeypatch.setattr(distilled, "distil", watched)
    with Run.open(run_folder) as run:
        with pytest.raises(Stopped):
            add_surface(run)
        run.close("stopped")
    assert seen == [("surface", "poses", 0, 3), ("surface", "poses", 1, 3)]


def test_a_run_without_a_checkpoint_is_refused(tmp_path):
    with Run.create(tmp_path / "run", {}) as run, pytest.raises(InputError, match="a checkpoint with an avatar"):
        add_surface(run)


def test_the_verb_distils_unless_an_option_says_not_to():
    assert not parse(["train", "capture", "--out", "run"]).no_surface
    assert parse(["train", "capture", "--out", "run", "--no-surface"]).no_surface
