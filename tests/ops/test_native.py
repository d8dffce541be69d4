"""Compiled loops on disk: compiled anew whenever the text that they are made of changed, and only then."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

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
