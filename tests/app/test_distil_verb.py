"""The verb `distil` and the process in the background: what is refused, where the result goes, how far it is, how it ends."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from avatarrex_studio.cli.main import main
from avatarrex_studio.jobs.distilling import Distilling, work_folder
from avatarrex_studio.jobs.training_process import COMMAND, INTERRUPTIBLE
from surface.template_surface import template_surface

from avatarrex.avatar_file import load_avatar
from avatarrex.distil import distil as module
from avatarrex.errors import InputError
from avatarrex.files.assets import DATA
from avatarrex.files.gate import UNFINISHED
from avatarrex.surface.surface_file import weights_key

TESTS = Path(__file__).parents[1]
WORKER = """
import sys, time
from avatarrex.distil import distil as module
from avatarrex_studio.cli.main import main

def slow(avatar, work, poses, progress):
    work.mkdir(parents=True, exist_ok=True)
    progress("mesh", 0, 1)
    for number in range(poses):
        (work / f"pose_{number:03}.npz").touch()
        progress("poses", number, poses)
        time.sleep(0.05)

module.distil = slow
raise SystemExit(main())
"""


@pytest.fixture
def avatar(tmp_path: Path) -> Path:
    """A copy of the packaged avatar."""
    return Path(shutil.copy(DATA / "default.avatar", tmp_path / "me.avatar"))


@pytest.fixture
def made(monkeypatch) -> list[tuple[Path, int]]:
    """`distil` gives the template at once; where it was to work, and with how many poses."""
    calls: list[tuple[Path, int]] = []

    def at_once(avatar, work, poses, progress):
        calls.append((work, poses))
        progress("mesh", 0, 1)
        progress("poses", 2, poses)
        meta = {"seconds": 12.5, "poses": poses, "live.iou": 0.9912, "errors": "none", "rows": [1]}
        return replace(template_surface(), key=weights_key(avatar), meta=meta)

    monkeypatch.setattr(module, "distil", at_once)
    return calls


def until(done, seconds: float = 180.0) -> None:
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "too slow"
        time.sleep(0.02)


def test_in_place_with_a_table(avatar, made, capsys):
    assert main(["distil", str(avatar)]) == 0
    assert load_avatar(avatar).surface is not None
    assert sorted(os.listdir(avatar.parent)) == ["me.avatar"], "no work folder is left"
    assert made == [(avatar.parent / "me.distil" / "poses", module.POSES)]
    told = capsys.readouterr()
    expected = ["seconds   12.5", f"poses     {module.POSES}", "live.iou  0.9912", "errors    none", str(avatar)]
    assert told.out.splitlines() == expected
    assert "surface: poses: 100%" in told.err


def test_the_help_has_the_number_of_poses(capsys):
    with pytest.raises(SystemExit):
        main(["distil", "--help"])
    assert f"({module.POSES})" in capsys.readouterr().out


@pytest.mark.parametrize("out", ["other.avatar", "other"])
def test_somewhere_else(out, made, tmp_path):
    """The packaged avatar, too, which stays as it is."""
    before = (DATA / "default.avatar").read_bytes()
    assert main(["distil", "default", "--out", str(tmp_path / out), "--poses", "7"]) == 0
    assert load_avatar(tmp_path / out).surface is not None
    assert made == [(tmp_path / "other.distil" / "poses", 7)]
    assert (DATA / "default.avatar").read_bytes() == before
    assert os.listdir(tmp_path) == [out]


def test_a_folder_in_place(made, tmp_path):
    shutil.unpack_archive(DATA / "default.avatar", tmp_path / "me", "zip")
    (tmp_path / "me" / f"{UNFINISHED}x.safetensors").touch()
    assert main(["distil", str(tmp_path / "me")]) == 0
    assert load_avatar(tmp_path / "me").surface is not None
    assert not list((tmp_path / "me").glob(".*")), "what a killed process was writing"
    assert os.listdir(tmp_path) == ["me"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["default"], "--out: expected OUT.avatar with it: the packaged avatar stays as it is, found nothing"),
        (["nowhere.avatar"], "nowhere.avatar: expected an avatar folder or an .avatar file, found nothing there"),
        (["me.avatar", "--poses", "3"], "--poses: expected an integer from 4 to 999, found 3"),
        (["me.avatar", "--poses", "many"], "--poses: expected an integer from 4 to 999, found many"),
        (["me.avatar", "--out", ""], "--out: expected a value, found nothing"),
        (["me.avatar", "--out", "me.avatar/x.avatar"], "expected a folder at"),
        (["me.avatar", "--out", "/dev/null"], "/dev/null: expected a folder to write to, found no plain file"),
        (["step/me.avatar"], "--out: expected OUT.avatar with it: a checkpoint stays as it is"),
        (["full/me.avatar"], "expected a folder of a distillation, which is removed at the end, found thesis.txt"),
    ],
)
def test_what_is_refused_before_any_work(words, said, avatar, made, monkeypatch, capsys):
    monkeypatch.chdir(avatar.parent)
    for folder in ("step", "full"):
        os.mkdir(folder)
        shutil.copy(avatar, folder)
    Path("step/manifest.json").write_text("{}")
    os.mkdir("full/me.distil")
    Path("full/me.distil/thesis.txt").write_text("mine")
    assert main(["distil", *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert len(error.splitlines()) == 1
    assert not made
    assert Path("full/me.distil/thesis.txt").read_text() == "mine"
    assert avatar.read_bytes() == (DATA / "default.avatar").read_bytes()


def test_an_error_keeps_what_was_observed(avatar, made, monkeypatch, capsys):
    def ends(avatar, work, poses, progress):
        work.mkdir(parents=True)
        (work / "pose_000.npz").touch()
        raise InputError("field", "", "a surface", "none")

    monkeypatch.setattr(module, "distil", ends)
    assert main(["distil", str(avatar)]) == 2
    work = avatar.parent / "me.distil"
    assert [path.name for path in work.rglob("*")] == ["poses", "pose_000.npz"]
    assert avatar.read_bytes() == (DATA / "default.avatar").read_bytes()


def command(avatar: Path, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", WORKER, "distil", str(avatar), *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_it_goes_on_after_ctrl_c_and_after_a_kill(sent, avatar, made, capsys):
    child, poses = command(avatar, "--poses", "999"), avatar.parent / "me.distil" / "poses"
    until(lambda: (poses / "pose_003.npz").exists())
    assert main(["distil", str(avatar)]) == 2
    assert "a distillation that no other process works on, found process" in capsys.readouterr().err
    child.send_signal(sent)
    error = child.communicate(timeout=30)[1]
    if sent == signal.SIGINT:
        assert child.returncode == 130
        assert error.splitlines()[-1] == "avatarrex-studio: interrupted"
    kept = len(list(poses.glob("*.npz")))
    assert main(["distil", str(avatar)]) == 0
    assert f"me.distil: going on, {kept} observations are there" in capsys.readouterr().out
    assert load_avatar(avatar).surface is not None
    assert os.listdir(avatar.parent) == ["me.avatar"]


def test_in_the_background_with_progress_until_the_window_closes(avatar):
    background = Distilling([sys.executable, "-c", WORKER])
    assert background.progress() is None
    background.start(avatar)
    try:
        assert background.working()
        with pytest.raises(InputError, match=r"no other avatar to be distilled now, found me\.avatar"):
            background.start(avatar)
        until(lambda: background.progress() is not None and background.progress()[0] == "poses")
        assert background.progress()[2] == module.POSES
        assert os.getpriority(os.PRIO_PROCESS, background._process.pid) == 19
    finally:
        background.close()
    assert background.progress() is None
    assert not background.working()
    assert background.error == ""
    assert (avatar.parent / "me.distil/poses/pose_000.npz").exists()
    assert "interrupted" in (avatar.parent / "me.distil/distil.log").read_text()


def test_it_ends_at_once_with_a_window_that_a_shell_started_beside_itself(avatar):
    """There the signal of Ctrl+C is ignored, and what is started from there inherits that."""
    assert COMMAND[-1].startswith(INTERRUPTIBLE)
    ignoring = ["sh", "-c", 'trap "" INT; exec "$@"', "sh"]
    background = Distilling([*ignoring, sys.executable, "-c", INTERRUPTIBLE + WORKER])
    background.start(avatar)
    until(lambda: background.progress() is not None)
    background.close()
    assert "interrupted" in (avatar.parent / "me.distil/distil.log").read_text()


def test_in_the_background_to_its_end(avatar):
    words = f"import sys; sys.exit(sys.argv[1:3] != ['distil', {str(avatar)!r}])"
    background = Distilling([sys.executable, "-c", words])
    background.start(avatar)
    until(lambda: not background.working())
    assert background.error == ""


def test_in_the_background_with_an_error(avatar):
    background = Distilling([sys.executable, "-c", "raise SystemExit('a surface cannot be made')"], device="cuda:1")
    background.start(avatar)
    until(lambda: not background.working())
    assert background.error == "a surface cannot be made"
    background.start(avatar)
    until(lambda: not background.working())


def test_where_nothing_can_be_written_it_says_so(avatar, monkeypatch):
    """The work folder's place is a file; and the avatar's folder is closed to this user."""
    (avatar.parent / "me.distil").write_text("")
    with pytest.raises(InputError, match=r"heartbeat\.json: expected a folder at .*me\.distil, found a file"):
        Distilling(["false"]).start(avatar)
    (avatar.parent / "me.distil").unlink()

    def closed(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", closed)
    with pytest.raises(InputError, match="that can be written, found Permission denied"):
        Distilling(["false"]).start(avatar)


def test_the_work_folder_has_the_avatars_name(tmp_path):
    assert work_folder(tmp_path / "v1.2.avatar") == tmp_path / "v1.2.distil"
    assert work_folder(tmp_path / "v1.2") == tmp_path / "v1.2.distil"


def test_it_ends_with_a_window_that_was_killed(avatar):
    words = f"""
import sys, time
from avatarrex_studio.jobs.distilling import Distilling
background = Distilling([sys.executable, "-c", {WORKER!r}])
background.start({str(avatar)!r})
print(background._process.pid, flush=True)
time.sleep(60)
"""
    window = subprocess.Popen([sys.executable, "-c", words], stdout=subprocess.PIPE, text=True)
    distilling = int(window.stdout.readline())
    until(lambda: (avatar.parent / "me.distil/poses/pose_000.npz").exists())
    window.kill()
    window.communicate()
    until(lambda: "interrupted" in (avatar.parent / "me.distil/distil.log").read_text())
    until(lambda: not Path(f"/proc/{distilling}").exists() or "Z" in Path(f"/proc/{distilling}/stat").read_text())


def test_a_process_that_is_at_work_is_left_alone(avatar):
    background = Distilling([sys.executable, "-c", WORKER])
    background.start(avatar)
    try:
        until(lambda: background.progress() is not None)
        with pytest.raises(InputError, match="that no other process works on, found process"):
            Distilling(["false"]).start(avatar)
        assert background.working()
    finally:
        background.close()
