"""Faceverse's vectors, and another face's coefficients by a table."""

from __future__ import annotations

import numpy as np
import pytest

from avatarrex.errors import InputError
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.read import import_motion

JAW, SMILE = (EXPRESSION_NAMES.index(name) for name in ("jawOpen", "mouthSmileLeft"))


@pytest.mark.parametrize("width", [486, 490])
def test_fifty_two_by_their_names(tmp_path, width):
    vectors = np.full((3, width), 9.0)
    vectors[:, 150:202] = 0
    vectors[1, 150 + JAW] = 0.7
    np.save(tmp_path / "face.npy", vectors)
    read = import_motion(tmp_path / "face.npy")
    assert read.sequence[1].expression[JAW] == pytest.approx(0.7)
    assert np.stack([frame.expression for frame in read.sequence]).sum() == pytest.approx(0.7)
    assert not read.warnings


def table(path, columns, rows):
    path.write_text("\n".join([",".join(["name", *map(str, range(columns)), "bias"]), *rows]) + "\n")
    return str(path)


def test_version_four_by_a_table(tmp_path):
    vectors = np.zeros((2, 621))
    vectors[1, 156 + 4] = 2.0
    np.save(tmp_path / "face.npy", vectors)
    with pytest.raises(InputError, match=r"Faceverse 4: expected --expressions FILE.csv with the 52 names by its 177"):
        import_motion(tmp_path / "face.npy")
    row = ",".join(["jawOpen", *("0.25" if k == 4 else "0" for k in range(177)), "0.1"])
    read = import_motion(tmp_path / "face.npy", ImportOptions(expressions=table(tmp_path / "map.csv", 177, [row])))
    assert [frame.expression[JAW] for frame in read.sequence] == pytest.approx([0.1, 0.6])


def test_a_table_of_another_version_is_refused(tmp_path):
    """An ordered basis may be cut short, as FLAME's; Faceverse's versions are others."""
    np.save(tmp_path / "face.npy", np.zeros((2, 508)))
    row = ",".join(["jawOpen", *["0.1"] * 177, "0"])
    with pytest.raises(InputError, match=r"expected name,0,…,73 with or without bias, found 178 columns"):
        import_motion(tmp_path / "face.npy", ImportOptions(expressions=table(tmp_path / "map.csv", 177, [row])))


def test_expressions_of_a_body_by_a_table(tmp_path):
    """FLAME's and SMPL-X's coefficients, which without a table belong to another face."""
    np.savez(tmp_path / "body.npz", body_pose=np.zeros((2, 63)), expression=np.array([[0.0, 0, 0], [1, -2, 0]]))
    rows = ["jawOpen,0.5,0,0,0", "mouthSmileLeft,0,-0.25,0,0"]
    options = ImportOptions(expressions=table(tmp_path / "map.csv", 3, rows))
    frame = import_motion(tmp_path / "body.npz", options).sequence[1]
    assert (frame.expression[JAW], frame.expression[SMILE]) == pytest.approx((0.5, 0.5))
    assert not import_motion(tmp_path / "body.npz").sequence[1].expression.any()


@pytest.mark.parametrize(
    ("rows", "line"),
    [
        (["jawopen,1,0,0,0"], "line 2: expected one of the 52 names, each once, found jawopen"),
        (["jawOpen,1,0"], "jawOpen: expected 4 numbers, found 2"),
        (["jawOpen,1,x,0,0"], "jawOpen: 1: expected a number up to 1e+06, found x"),
        (["jawOpen,0,0,0,0"], "expected at least one number that is not 0, found none"),
        (["jawOpen,1,0,0,0", "", "", "jawOpen,1,0,0,0"], "line 5: expected one of the 52 names, each once, found jawOpen"),
        (["jawOpen," + "1" * 200_000 + ",0,0,0"], "line 2: expected a readable CSV file, found field larger than field limit"),
    ],
)  # fmt: skip
def test_tables_that_are_refused(tmp_path, rows, line):
    np.savez(tmp_path / "body.npz", body_pose=np.zeros((2, 63)), expression=np.zeros((2, 3)))
    with pytest.raises(InputError) as caught:
        import_motion(tmp_path / "body.npz", ImportOptions(expressions=table(tmp_path / "map.csv", 3, rows)))
    assert line in str(caught.value)


def test_coefficients_that_no_face_has(tmp_path):
    """They would overflow: refused by name."""
    options = ImportOptions(expressions=table(tmp_path / "map.csv", 3, ["jawOpen,1,1,1,0"]))
    np.savez(tmp_path / "body.npz", body_pose=np.zeros((2, 63)), expression=np.full((2, 3), 1.7e308))
    with pytest.raises(
        InputError, match=r"body.npz: expression: expected finite numbers up to 1e\+06, found 1.7e\+308"
    ):
        import_motion(tmp_path / "body.npz", options)
    np.save(tmp_path / "face.npy", np.full((2, 508), -1.7e308))
    with pytest.raises(InputError, match=r"face.npy: expected finite numbers up to 1e\+06"):
        import_motion(tmp_path / "face.npy", options)
