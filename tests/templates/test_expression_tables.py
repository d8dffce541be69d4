"""The 52 names on another face: on FLAME's layout with a known mixture of them, a jaw that turns, and no tongue."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from avatarrex_studio.cli.main import main
from face_files import JAWS, OTHERS, mixed, person_flame
from official_files import faceverse, flame, write_faceverse
from python2_pickles import write_python2

from avatarrex.errors import InputError
from avatarrex.signals.expression_map import read_expression_map
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.read import import_motion
from avatarrex.templates.model import TemplateModel, pose_template
from avatarrex.templates.official.expression_fit import fit_expressions, jaw_turns
from avatarrex.templates.official.expression_matrix import read_matrix, write_matrix
from avatarrex.templates.official.flame import read_flame
from avatarrex.templates.person import load_person

EYES = ("eyeLook", "eyeWide")
"""Names whose motions of the lids are nearly each other's: 0.01 mm tell some of them apart."""
TONGUE, OPEN = EXPRESSION_NAMES.index("tongueOut"), EXPRESSION_NAMES.index("jawOpen")
CLEAR = [k for k in OTHERS if k != TONGUE and not EXPRESSION_NAMES[k].startswith(EYES)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A models folder with the head of `face_files`."""
    made = tmp_path_factory.mktemp("flame")
    write_python2(made / "flame2023.pkl", person_flame(mixed()))
    return made


@pytest.fixture(scope="module")
def head(folder: Path) -> TemplateModel:
    return read_flame(folder / "flame2023.pkl")


def test_a_known_mixture_of_names_is_found(folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """In another size, turn and place; written as motions are read by it, of the first coefficients alone, too."""
    assert main(["models", "matrix", "flame", "--folder", str(folder)]) == 0
    said = "".join(capsys.readouterr())
    assert "poor: tongueOut 0%\n" in said
    table, mix = read_expression_map(folder / "flame_motions.csv", 100), mixed()
    away = np.linalg.norm(table.matrix - mix, axis=1)[CLEAR] / np.linalg.norm(mix, axis=1)[CLEAR]
    assert away.max() < 0.05
    assert np.abs(table.matrix[JAWS]).max() < 0.05  # its jaw turns by itself
    np.savez(tmp_path / "body.npz", body_pose=np.zeros((2, 63)), expression=np.eye(100)[[0, 1], :10])
    read = import_motion(tmp_path / "body.npz", ImportOptions(expressions=str(folder / "flame_motions.csv")))
    assert any("52 rows of flame_motions.csv, the first 10 of its 100 columns" in str(guess) for guess in read.guesses)
    shown = np.stack([frame.expression for frame in read.sequence])
    np.testing.assert_allclose(shown[:, CLEAR], np.clip(mix.T[:2, CLEAR], 0, 1), atol=0.02)
    assert main(["models", "matrix", "flame", "--folder", str(folder)]) == 2  # one that was edited stays
    text = (folder / "flame_motions.csv").read_text()
    (tmp_path / "of_another.csv").write_text(text.replace("name (ordered)", "name", 1))
    with pytest.raises(InputError, match="expected name,0,…,9 with or without bias"):
        import_motion(tmp_path / "body.npz", ImportOptions(expressions=str(tmp_path / "of_another.csv")))


def test_what_a_face_shows_of_each_name(head: TemplateModel) -> None:
    """All of what it mixes, nothing of a tongue that it has not; the jaw's by its turn, which cannot go forward."""
    default = load_person().face
    fit = fit_expressions(head, default)
    shown = dict(zip(EXPRESSION_NAMES, fit.explained))
    assert fit.explained[CLEAR].min() > 0.99
    assert shown["tongueOut"] < 0.01
    assert shown["jawOpen"] > 0.85
    assert 0.4 < shown["jawForward"] < 0.7
    seen = (default.blend_weight > 0.5) & ~default.mouth
    wanted = default.model.expression_dirs.double().numpy()[seen]
    off = wanted @ (mixed() @ fit.coefficients - np.eye(52))  # mixed: of the 52, by the coefficients of a name
    assert np.linalg.norm(off, axis=1).max(0)[CLEAR].max() < 5e-4
    assert np.linalg.norm(wanted, axis=1).max(0)[CLEAR].min() > 3e-3
    stiff = head.weights.clone()
    stiff[:, 1] += stiff[:, 2]
    stiff[:, 2] = 0
    without = fit_expressions(replace(head, weights=stiff), default)
    assert without.explained[OPEN] < 0.5
    assert "jawOpen" in without.poor()
    np.testing.assert_allclose(without.names, fit.names)


def test_a_turn_of_the_jaw(tmp_path: Path) -> None:
    """Finite differences of the posed head, pose blend shapes included."""
    model = read_flame(write_python2(tmp_path / "flame2023.pkl", flame())).double()
    step, none = 1e-5, torch.zeros(400, dtype=torch.float64)
    for axis, found in enumerate(torch.from_numpy(jaw_turns(model)).unbind(-1)):
        pose = torch.zeros(5, 3, dtype=torch.float64)
        pose[2, axis] = step
        ends = [pose_template(model, sign * pose, none[:300], none[:100]).vertices for sign in (1, -1)]
        torch.testing.assert_close((ends[0] - ends[1]) / (2 * step), found, atol=1e-6, rtol=0)


def test_a_face_that_nothing_moves_is_refused(head: TemplateModel) -> None:
    with pytest.raises(InputError, match="face: expression directions: expected some that move the face, found none"):
        fit_expressions(replace(head, expression_dirs=head.expression_dirs * 0), load_person().face)


def test_remarks_of_a_table(tmp_path: Path) -> None:
    """Shares under the names are for the reader; lines keep their numbers."""
    write_matrix(tmp_path / "m.csv", np.eye(52)[:3], np.linspace(0, 1, 52))
    text = (tmp_path / "m.csv").read_text()
    assert text.splitlines()[1].startswith("# 0%,# 2%,")
    np.testing.assert_array_equal(read_matrix(tmp_path / "m.csv"), np.eye(52)[:3])
    (tmp_path / "m.csv").write_text(text.replace("\n1,", "\nx,", 1))
    with pytest.raises(InputError, match="line 3: expected numbers"):
        read_matrix(tmp_path / "m.csv")


def test_faceverse_without_names_has_both_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_faceverse(tmp_path / "faceverse_v1.npy", faceverse(1, 0.1, (1, 1, 1))[0])
    assert main(["models", "matrix", "--folder", str(tmp_path)]) == 0
    assert read_matrix(tmp_path / "faceverse_expressions.csv", 74).shape == (74, 52)
    assert read_expression_map(tmp_path / "faceverse_motions.csv", 74).rows == 52
    with pytest.raises(InputError, match="expected name,0,…,73 with or without bias"):
        read_expression_map(tmp_path / "faceverse_expressions.csv", 74)
    (tmp_path / "faceverse_expressions.csv").unlink()
    assert main(["models", "matrix", "--folder", str(tmp_path)]) == 0, "what is missing is written"
    assert "faceverse_motions.csv: kept as it is" in "".join(capsys.readouterr())
    assert main(["models", "matrix", "--folder", str(tmp_path)]) == 2
    assert "faceverse_motions.csv: expected nothing there: edit it, or move it away" in "".join(capsys.readouterr())
    assert main(["models", "matrix", "flame", "--folder", str(tmp_path)]) == 2
    assert "FLAME: expected a file of 2020 or 2023 (`models list`), found nothing there" in "".join(capsys.readouterr())
