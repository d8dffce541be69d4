"""What a path is: every kind, and paths that are none."""

from __future__ import annotations

import json
import os
import sys
import zipfile

import pytest
from avatarrex_studio.cli import main as cli
from avatarrex_studio.jobs.file_kind import AVATAR, CAPTURE, FOREIGN, MOTION, PICTURE, RUN, SESSION, kind_of
from avatarrex_studio.jobs.opening import read_any
from avatarrex_studio.session.journal import Journal
from capture.tiny_capture import TinyCapture

from avatarrex.errors import InputError
from avatarrex.training.runs.folder import Run


def some_files(folder):
    """One of each kind, by path, as far as names and `kind` say."""
    found = {"default": AVATAR, "walk": MOTION}
    for name, kind in {
        "a.avatar": AVATAR, "avatar/avatar.json": None, "m.BVH": MOTION, "m.npz": MOTION, "signals.json": MOTION,
        "capture/calibration_full.json": None, "two/body/calibration_full.json": None, "run/run.json": None,
        "runs/first/run.json": None, "picture.png": PICTURE, "zju/inner/annots.npy": None, "hq/calibration.csv": None, "hq/rgbs/x": None,
    }.items():  # fmt: skip
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("{}")
        found.update({str(path): kind} if kind else {})
    kinds = {
        "avatar": AVATAR,
        "capture": CAPTURE,
        "two": CAPTURE,
        "run": RUN,
        "runs": RUN,
        "zju": FOREIGN,
        "hq": FOREIGN,
    }
    for name, kind in kinds.items():
        found[str(folder / name)] = kind
    Journal().save(folder / "session.json")
    with zipfile.ZipFile(folder / "capture.zip", "w") as archive:
        archive.writestr("person/face/calibration_full.json", "{}")
    with zipfile.ZipFile(folder / "face.zip", "w") as archive:
        archive.writestr("yufeng/flame_params.json", "{}")
    return {
        **found,
        str(folder / "session.json"): SESSION,
        str(folder / "capture.zip"): CAPTURE,
        str(folder / "face.zip"): FOREIGN,
    }


def test_every_kind(tmp_path):
    files = some_files(tmp_path)
    assert {path: kind_of(path) for path in files} == files


def hostile(folder):
    """Paths that are nothing to open, with what is said of each."""
    (folder / "empty").mkdir()
    (folder / "other").mkdir()
    (folder / "other" / "letter.txt").write_text("Dear …")
    (folder / "table").mkdir()
    (folder / "table" / "calibration.csv").write_text("name,w,h")
    (folder / "letter.txt").write_text("Dear …")
    (folder / "broken.json").write_text('{"kind": ')
    (folder / "cut.zip").write_bytes(b"PK\x03\x04" + bytes(40))
    with zipfile.ZipFile(folder / "letters.zip", "w") as archive:
        archive.writestr("letter.txt", "Dear …")
    with zipfile.ZipFile(folder / "out.zip", "w") as archive:
        archive.writestr("../calibration_full.json", "{}")
    os.mkfifo(folder / "pipe.json")
    os.symlink("circle", folder / "circle")
    return {
        "nothing": "nothing there", "": "nothing there", "a\0b": "null byte", "x" * 300: "too long", "circle": "symbolic links",
        "pipe.json": "no plain file", "empty": "an empty folder", "other": "a folder with letter.txt",
        "table": "a folder with calibration.csv",
        "letter.txt": "another kind of file", "broken.json": "JSON", "cut.zip": "another kind of file",
        "letters.zip": "letter.txt", "out.zip": "leads out of it", "letter.txt/run.json": "nothing there",
    }  # fmt: skip


def test_paths_that_are_none(tmp_path):
    for name, words in hostile(tmp_path).items():
        with pytest.raises(InputError, match=words) as refused:
            kind_of(f"{tmp_path}/{name}" if name else "")
        assert "\n" not in str(refused.value)


def test_what_has_to_be_imported_says_how(tmp_path, capsys):
    path = tmp_path / "a head" / "transforms_train.json"
    path.parent.mkdir()
    path.write_text("{}")
    said = (
        "a capture in the layout of NeRFace: File → Import a capture…, "
        f"or `avatarrex-studio capture import '{path.parent}' OUT`, writes it in ours"
    )
    assert cli.main(["inspect", str(path.parent)]) == 0
    assert said in capsys.readouterr().out
    assert cli.main(["open", str(path.parent)]) == 2
    assert said in capsys.readouterr().err
    with pytest.raises(InputError) as refused:
        read_any(str(path.parent), lambda name: pytest.fail("no avatar"))
    assert said in str(refused.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_what_may_not_be_read(tmp_path):
    (tmp_path / "closed").mkdir(mode=0)
    with pytest.raises(InputError, match="Permission denied"):
        kind_of(tmp_path / "closed")
    (tmp_path / "run.json").write_text("{}")
    assert kind_of(tmp_path) == RUN


def test_inspect_tells_of_captures_and_runs(tmp_path, capsys):
    with Run.create(tmp_path / "run", {"part": "body", "steps": {"body": 400}, "preset": "quick", "seed": 3}) as run:
        run.scalars(30, {"body/loss/total": 1.0})
    TinyCapture.make(("body",)).folder(tmp_path / "capture")
    assert cli.main(["inspect", str(tmp_path / "run")]) == 0
    told = capsys.readouterr().out
    assert "a run" in told
    assert "step 30 of 400" in told
    assert cli.main(["inspect", str(tmp_path / "capture")]) == 0
    assert "body: 3 frames, 3 cameras" in capsys.readouterr().out


def test_the_command_line_refuses_before_a_window(tmp_path, capsys, monkeypatch):
    """Without torch, and without a display."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    (tmp_path / "picture.png").write_bytes(b"")
    wrong = {name: words for name, words in hostile(tmp_path).items() if name and "\0" not in name}
    for name, words in {**wrong, "picture.png": "found a picture", "no.bvh": "nothing there"}.items():
        assert cli.main(["open", f"{tmp_path}/{name}"]) == 2
        said = capsys.readouterr().err
        assert words in said
        assert said.count("\n") == 1
    assert cli.main([f"{tmp_path}/no.bvh"]) == 2, "also without the verb"
    assert "no.bvh: expected an avatar" in capsys.readouterr().err
    words = json.dumps(["open", str(tmp_path / "no.bvh")])
    code = f"import sys; from avatarrex_studio.cli.main import main; main({words}); sys.exit('torch' in sys.modules)"
    assert os.spawnv(os.P_WAIT, sys.executable, [sys.executable, "-c", code]) == 0
