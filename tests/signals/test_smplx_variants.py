"""SMPL and SMPL-X motions as estimators of other makers write them: one motion, many layouts."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest
from dialects import steps
from scipy.spatial.transform import Rotation
from test_dialects import apart

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.ground import lowest
from avatarrex.signals.read import import_motion

CAMERA = Rotation.from_rotvec([np.pi, 0, 0])
"""From ours to a camera's frame: y down, away from it."""


def arrays(truth: list[Signals], turn: Rotation) -> tuple[np.ndarray, np.ndarray]:
    """(t, 165) rotation vectors and (t, 3) path in a world turned by `turn`."""
    poses = np.stack([frame.full_pose() for frame in truth])
    poses[:, 0] = (turn * Rotation.from_rotvec(poses[:, 0])).as_rotvec()
    return poses.reshape(len(truth), 165), turn.apply(np.stack([frame.translation for frame in truth]))


def matrices(poses: np.ndarray) -> np.ndarray:
    """(t, k, 3, 3)."""
    return Rotation.from_rotvec(poses.reshape(-1, 3)).as_matrix().reshape(len(poses), -1, 3, 3)


def layouts(poses: np.ndarray, path: np.ndarray) -> dict[str, dict[str, np.ndarray]]:
    """Arrays of each layout without hands, by what writes it so."""
    smpl = np.concatenate([poses[:, :66], np.zeros((len(poses), 6))], 1)
    return {
        "romp": {"smpl_thetas": smpl, "cam_trans": path, "smpl_betas": np.zeros((len(poses), 10))},
        "wham": {"pose": np.ones_like(smpl), "pose_world": smpl, "trans_world": path},
        "aist": {"smpl_poses": smpl, "smpl_trans": path},
        "hmr": {
            "global_orient": matrices(poses[:, :3]),
            "body_pose": matrices(smpl[:, 3:]),
            "transl": path,
        },
        "smplify": {"global_orient": poses[:, None, :3], "body_pose": smpl[:, 3:], "transl": path},
        "smpler": {
            "global_orient": poses[:, :3], "body_pose": poses[:, 3:66], "jaw_pose": poses[:, 66:69], "lhand_pose": poses[:, 75:120],
            "rhand_pose": poses[:, 120:165], "transl": path, "expression": np.zeros((len(poses), 10)),
        },
        "grab": {"fullpose": poses, "transl": path},
    }  # fmt: skip


NAMES = tuple(layouts(*arrays(steps(), CAMERA)))


@pytest.mark.parametrize("name", NAMES)
def test_a_layout_comes_in_as_it_was(tmp_path: Path, name: str) -> None:
    truth = steps(140.0)
    np.savez(tmp_path / "m.npz", **layouts(*arrays(truth, CAMERA))[name])
    read = import_motion(tmp_path / "m.npz")
    got = list(read.sequence)
    found = apart(got, truth)
    assert max(found.values()) < 0.1, found
    assert any(str(guess).startswith("up: -Y") and "camera" in guess.why for guess in read.guesses)
    assert got[0].global_orient[1] == pytest.approx(0, abs=1e-9), "the person looks at the camera"
    fingers = name in ("smpler", "grab")
    assert np.allclose(got[3].left_hand_pose, truth[3].left_hand_pose if fingers else 0)


@pytest.mark.parametrize("width", [265, 322, 165, 156, 72, 66])
def test_vectors_of_one_frame_a_row(tmp_path: Path, width: int) -> None:
    truth = [frame.replace(jaw_pose=np.array([0.2, 0, 0])) for frame in steps(30.0)]
    poses, path = arrays(truth, CAMERA)
    root, body, face, hands = poses[:, :3], poses[:, 3:66], poses[:, 66:75], poses[:, 75:]
    rest = np.full((len(poses), 200), 9.0)
    rows = {
        265: [face, root, body, hands, rest[:, :100]],
        322: [root, body, hands, face[:, :3], rest[:, :150], path, rest[:, :10]],
        165: [poses],
        156: [root, body, hands],
        72: [root, body, rest[:, :6] / 9],  # SMPL's hands, which are not read
        66: [root, body],
    }[width]
    np.save(tmp_path / "m.npy", np.concatenate(rows, 1).astype(np.float32))
    got = list(import_motion(tmp_path / "m.npy").sequence)
    assert max(apart(got, truth).values()) < 0.1
    fingers, jaw = width >= 156, width >= 165
    assert np.allclose(got[5].right_hand_pose, truth[5].right_hand_pose if fingers else 0, atol=1e-6)
    assert np.allclose(got[5].jaw_pose, [0.2 if jaw else 0, 0, 0], atol=1e-6)
    assert not got[5].expression.any()


def test_pca_hands_are_left_out_with_a_warning(tmp_path: Path) -> None:
    np.savez(tmp_path / "m.npz", body_pose=np.zeros((2, 63)), left_hand_pose=np.ones((2, 12)))
    read = import_motion(tmp_path / "m.npz")
    assert not read.sequence[0].left_hand_pose.any()
    assert any("left_hand_pose: 12 PCA coefficients" in text and "PCA off" in text for text in read.warnings)


def test_what_stands_is_on_the_floor(tmp_path: Path) -> None:
    """One frame in which the body sinks by 5 cm does not lift all others."""
    truth = steps()
    poses, path = arrays(truth, Rotation.identity())
    path[7, 1] -= 0.05
    np.savez(tmp_path / "m.npz", poses=poses, trans=path)
    got = import_motion(tmp_path / "m.npz").sequence
    heights = lowest(np.stack([f.full_pose() for f in got]), np.stack([f.translation for f in got]))
    assert abs(float(np.median(heights))) < 0.005
    assert heights[7] < -0.03


def header(shape: str) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (1, 1)})
    return file.getvalue().replace(b"(1, 1)", shape.encode()).ljust(128)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "expected a plain array"),
        (b"\x93NUMPY\x09\x09rubbish", "expected a plain array"),
        (header("(9, 265)"), r"a plain array .* of shape \(9, 265\), found [0-9] bytes"),
        (header("(-1, 265)"), "expected a plain array"),
    ],
)
def test_a_broken_npy_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "m.npy").write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        import_motion(tmp_path / "m.npy")
    assert re.match(r".*m\.npy: ", str(caught.value))


def test_objects_and_other_widths_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "o.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="no pickled objects"):
        import_motion(tmp_path / "o.npy")
    np.save(tmp_path / "w.npy", np.zeros((3, 100)))
    with pytest.raises(InputError, match=r"265\) TalkSHOW.*found \(3, 100\)"):
        import_motion(tmp_path / "w.npy")
