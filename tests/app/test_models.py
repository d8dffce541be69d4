"""`models list|add|check` on generated files: what is there, what is missing and what to do, what does not fit together."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli.main import main
from avatarrex_studio.jobs.available import available

sys.path.insert(0, str(Path(__file__).parents[1] / "templates"))
from official_files import (
    HEAD_IDS,
    LEFT_IDS,
    RIGHT_IDS,
    faceverse,
    flame,
    mano,
    smplx,
    write_chumpy,
    write_faceverse,
    write_smplx,
)
from python2_pickles import write_python2

from avatarrex.templates.official.known_models import KNOWN, models_folder


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("AVATARREX_MODELS", str(tmp_path / "models"))
    return models_folder()


def output(capsys: pytest.CaptureFixture[str], *words: str, status: int = 0) -> str:
    assert main(["models", *words]) == status
    return "".join(capsys.readouterr())


def test_an_empty_folder_says_what_to_do(capsys) -> None:
    said = output(capsys, "list")
    for model in KNOWN:
        assert f"no   {model.title}: no {model.files[0]}: without it {model.without}" in said
        assert (
            f"Get {model.files[0]} from {model.published}; then: avatarrex-studio models add {model.files[0]}" in said
        )
    assert "no models; `avatarrex-studio models list`" in output(capsys, "check")


def test_the_page_of_what_is_available_has_the_same_lines(folder: Path) -> None:
    folder.mkdir()
    write_python2(folder / "MANO_LEFT.pkl", {})
    there = {entry.name: entry.there for entry in available()}
    assert {model.title: there[model.title] for model in KNOWN} == {
        model.title: model.name == "mano_left" for model in KNOWN
    }


def test_files_are_read_copied_and_checked_together(tmp_path: Path, folder: Path, capsys) -> None:
    files = [
        write_smplx(tmp_path / "smplx_neutral.npz", smplx()), write_chumpy(tmp_path / "MANO_LEFT.pkl", mano("left")),
        write_chumpy(tmp_path / "MANO_RIGHT.pkl", mano("right")), write_chumpy(tmp_path / "generic_model.pkl", flame()),
        write_faceverse(tmp_path / "faceverse_simple_v2.npy", faceverse(2, 0.1, (1, -1, -1))[0]),
    ]  # fmt: skip
    said = output(capsys, "add", *map(str, files))
    assert f"{folder / 'SMPLX_NEUTRAL.npz'}: SMPL-X, 10 + 10 directions, hands with components and mean" in said
    assert "MANO_LEFT.pkl: MANO, left hand, wrist closed with 16 triangles" in said
    assert (
        "Faceverse 2, 6335 vertices, in decimetres, axes turned (signs (1, -1, -1)), 52 expressions with Apple's names"
        in said
    )
    assert {path.name for path in folder.iterdir()} == {
        "SMPLX_NEUTRAL.npz", "MANO_LEFT.pkl", "MANO_RIGHT.pkl", "generic_model.pkl", "faceverse_simple_v2.npy",
    }  # fmt: skip
    said = output(capsys, "check")
    assert "MANO: the left hand has the right's shape directions: mirrored when read" in said
    assert "hands: their vertices are SMPL-X's, found on the meshes" in said
    assert "head: its vertices are SMPL-X's, found on the meshes" in said
    assert "face: laid on SMPL-X's head by its landmarks" in said
    write_python2(folder / "MANO_SMPLX_vertex_ids.pkl", {"left_hand": LEFT_IDS, "right_hand": RIGHT_IDS})
    np.save(folder / "SMPL-X__FLAME_vertex_ids.npy", HEAD_IDS)
    said = output(capsys, "check")
    assert "by MANO_SMPLX_vertex_ids.pkl" in said
    assert "by SMPL-X__FLAME_vertex_ids.npy" in said
    write_python2(folder / "MANO_SMPLX_vertex_ids.pkl", {"left_hand": RIGHT_IDS, "right_hand": LEFT_IDS})
    said = output(capsys, "check", status=1)
    assert "refused: " in said
    assert "expected vertices by which 99% of the triangles are the body's" in said


def test_a_wrong_file_is_not_added(tmp_path: Path, folder: Path, capsys) -> None:
    said = output(capsys, "add", str(write_python2(tmp_path / "model.pkl", {})), status=2)
    assert "expected a name that a model is published under: SMPLX_NEUTRAL.npz, MANO_LEFT.pkl" in said
    said = output(capsys, "add", str(write_python2(tmp_path / "MANO_LEFT.pkl", {})), status=2)
    assert "MANO_LEFT.pkl: v_template: expected the key to be there" in said
    said = output(capsys, "add", str(tmp_path / "MANO_RIGHT.pkl"), status=2)
    assert "MANO_RIGHT.pkl: expected a model's file, found nothing there" in said
    assert not folder.exists() or not list(folder.iterdir())


def test_every_file_is_read_and_one_hand_is_not_used(tmp_path: Path, folder: Path, capsys) -> None:
    """Also those that are not used, and version 3's 52 expressions; names are the publisher's, whatever the letters."""
    expressions = np.zeros((3 * 15456, 52), np.float32)
    np.save(tmp_path / "exbase_52.npy", expressions)
    fields = faceverse(3, 0.001, (1, 1, 1))[0]
    files = [write_faceverse(tmp_path / name, fields) for name in ("faceverse_v3_6_s.npy", "faceverse_v3_1.npy")]
    hand = write_chumpy(tmp_path / "MANO_LEFT.pkl", mano("left"))
    output(capsys, "add", str(hand), str(tmp_path / "exbase_52.npy"), *map(str, files))
    said = output(capsys, "check")
    assert "MANO: the left hand alone is not used: the other is missing" in said
    assert "exBase_52.npy: 52 expressions of Faceverse 3, 15456 vertices" in said
    used, unused = (line for line in said.splitlines() if line.startswith("faceverse_v3"))
    assert used.startswith("faceverse_v3_6_s.npy: Faceverse 3")
    assert unused.startswith("faceverse_v3_1.npy: Faceverse 3")
    assert (used.endswith("not used"), unused.endswith("not used")) == (False, True)
    (folder / "faceverse_v3_1.npy").write_bytes(b"none")
    assert "faceverse_v3_1.npy: " in output(capsys, "check", status=1)
    np.save(tmp_path / "exBase_52.npy", expressions[:, :51])
    said = output(capsys, "add", str(tmp_path / "exBase_52.npy"), status=2)
    assert "exBase_52.npy: exBase_52: expected shape (3 times the vertices, 52), found (46368, 51)" in said


def test_a_damaged_file_is_named_by_check(folder: Path, capsys) -> None:
    folder.mkdir()
    (folder / "MANO_LEFT.pkl").write_bytes(b"\x80\x02cos\nsystem\n.")
    said = output(capsys, "check", status=1)
    assert "refused: " in said
    assert "found the global os.system" in said
