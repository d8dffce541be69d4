"""What a machine has: each thing in words, with the next step where it is missing; the same lines in the window and on the command line."""

from __future__ import annotations

import pytest
from avatarrex_studio.cli.main import main
from avatarrex_studio.jobs import available
from avatarrex_studio.jobs.available import Ability, lines


def test_everything_missing_has_a_next_step():
    found = available.available()
    assert {"OpenGL 4.3", "GPU for networks", "Videos", "FBX", "Webcam", "Virtual camera"} <= {
        entry.name for entry in found
    }
    assert all(entry.words for entry in found)
    assert all(entry.next_step for entry in found if not entry.there)


def test_a_package_is_found_or_its_extra_named(monkeypatch):
    missing = available._package("FBX", "no_such_module", "motions in .fbx", "fbx")
    assert not missing.there
    assert missing.next_step == "pip install 'avatarrex-studio[fbx]'"
    there = available._package("Numbers", "numpy", "numbers", "none")
    assert there.there
    assert not there.next_step


def test_no_opengl(monkeypatch):
    def none():
        raise available.NoContext("nothing was tried")

    monkeypatch.setattr(available, "gl_context", none)
    entry = available._opengl()
    assert not entry.there
    assert "nothing was tried" in entry.words
    assert entry.next_step


def test_software_is_said_to_be_slow(monkeypatch):
    for name, slow in (("llvmpipe (LLVM 15)", True), ("NVIDIA H100", False)):
        monkeypatch.setattr(available, "gl_context", lambda: None)
        monkeypatch.setattr(available, "renderer_name", lambda context, name=name: name)
        entry = available._opengl()
        assert entry.there
        assert bool(entry.next_step) is slow


def test_as_lines():
    found = (Ability("One", True, "here"), Ability("Two", False, "not here", "do this"))
    assert lines(found) == ["yes  One: here", "no   Two: not here", "       do this"]


def test_inspect_without_a_path_prints_it(monkeypatch, capsys):
    monkeypatch.setattr(available, "available", lambda: (Ability("One", True, "here"),))
    assert main(["inspect"]) == 0
    assert capsys.readouterr().out == "yes  One: here\n"


@pytest.mark.parametrize("path", ["", "none.txt"])
def test_inspect_of_nothing_is_refused(path):
    assert main(["inspect", path]) == 2
