"""FBX by Blender in a process of its own: what comes back of it, what it may not do, and words where it is missing.

`test_blender_refuses_rubbish` runs where `bpy` is installed.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from dialects import DIALECTS, steps, write
from test_dialects import MOST, apart

from avatarrex.errors import InputError
from avatarrex.signals import bvh, fbx, fbx_scene
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.read import import_motion
from avatarrex.signals.retarget import retarget
from avatarrex.signals.source_motion import SourceMotion

STAND_IN = """
import sys
from pathlib import Path
import numpy as np
arrays = dict(np.load({made!r}))
{change}
np.savez(sys.argv[2], **arrays)
"""


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Arrays as fbx_scene.py writes them, of a bundle of bones; `bpy` seems to be there."""
    write(tmp_path / "m.bvh", DIALECTS["game engine bundle"], steps(140.0))
    seen: list[SourceMotion] = []
    with monkeypatch.context() as patch:
        patch.setattr(
            bvh, "retarget", lambda path, source, options: seen.append(source) or retarget(path, source, options)
        )
        bvh.read_bvh(tmp_path / "m.bvh", ImportOptions())
    (source,) = seen
    np.savez(
        tmp_path / "made.npz", names=np.array(source.names), parents=source.parents, rest=source.rest, turned=source.turned,
        places=source.places, fps=source.fps,
    )  # fmt: skip
    monkeypatch.setattr(fbx, "find_spec", lambda name: True)
    (tmp_path / "m.fbx").write_bytes(b"Kaydara FBX Binary")
    return tmp_path / "made.npz"


def by(monkeypatch: pytest.MonkeyPatch, made: Path, change: str = "") -> Path:
    """The FBX file, read by a process that writes `made` after a change to its arrays."""
    script = made.with_name("scene.py")
    script.write_text(STAND_IN.format(made=str(made), change=change))
    monkeypatch.setattr(fbx_scene, "__file__", str(script))
    return made.with_name("m.fbx")


def test_what_blender_says_is_retargeted(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = import_motion(by(monkeypatch, made))
    assert max(apart(list(read.sequence), steps(140.0)).values()) < MOST
    assert str(read.guesses[0]).startswith("file: FBX")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("sys.exit(1)", "expected an FBX file with a moving skeleton, found Blender ended"),
        ("Path(sys.argv[3]).write_text('no skeleton'); sys.exit(1)", "moving skeleton, found no skeleton"),
        ("import os; os.abort()", "found Blender ended"),
        ("arrays['places'] *= np.nan", "places: expected numbers up to 1e"),
        ("arrays['names'] = np.full(1001, 'x')", "at most 1000 bones"),
        ("arrays['fps'] = 0", "fps: expected a rate above 0"),
    ],
)
def test_what_blender_may_not_do(made: Path, monkeypatch: pytest.MonkeyPatch, change: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        import_motion(by(monkeypatch, made, change))


def test_blender_has_its_time_and_is_announced(
    made: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = by(monkeypatch, made, "import time; time.sleep(30)")
    with (
        caplog.at_level("INFO"),
        pytest.raises(InputError, match=r"an FBX file that Blender reads in 0.5 s, found a slower"),
    ):
        import_motion(path, fbx_seconds=0.5)
    assert "m.fbx: reading through Blender, 0.5 s at most" in caplog.text


def test_a_missing_blender_is_named_with_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fbx, "find_spec", lambda name: None)
    (tmp_path / "m.fbx").write_bytes(b"Kaydara FBX Binary")
    with pytest.raises(
        InputError, match=r"m.fbx: expected Blender as a Python module .*avatarrex-studio\[fbx\].* found no bpy"
    ):
        import_motion(tmp_path / "m.fbx")


@pytest.mark.skipif(find_spec("bpy") is None, reason="bpy is not installed (pip install 'avatarrex-studio[fbx]')")
def test_blender_refuses_rubbish(tmp_path: Path) -> None:
    (tmp_path / "m.fbx").write_bytes(b"Kaydara FBX Binary  \0" + b"\xff" * 500)
    with pytest.raises(InputError, match="an FBX file with a moving skeleton"):
        import_motion(tmp_path / "m.fbx")
