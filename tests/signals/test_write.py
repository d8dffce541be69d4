"""Motions that are written are read back: all signals, SMPL-X with coefficients, the face as Live Link Face has it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.limits import random_signals
from avatarrex.signals.read import read_motion
from avatarrex.signals.sequence import SignalSequence
from avatarrex.signals.write import write_motion


@pytest.fixture
def motion():
    random = np.random.default_rng(3)
    frames = tuple(random_signals(random, 0.6).replace(translation=random.uniform(-1, 1, 3)) for _ in range(61))
    return SignalSequence(frames, 60.0, "made")


def test_every_signal_comes_back(motion, tmp_path):
    write_motion(tmp_path / "a.json", motion)
    assert list(read_motion(tmp_path / "a.json")) == list(motion)


def test_smplx_comes_back(motion, tmp_path):
    write_motion(tmp_path / "a.npz", motion)
    found = read_motion(tmp_path / "a.npz")
    assert found.fps == 60
    for before, after in zip(motion, found, strict=True):
        assert np.allclose(after.full_pose(), before.full_pose(), atol=1e-12)
        assert np.allclose(after.translation, before.translation)
        assert np.allclose(after.expression, before.expression)


def test_the_face_comes_back(motion, tmp_path):
    write_motion(tmp_path / "a.csv", motion)
    found = read_motion(tmp_path / "a.csv")
    assert len(found) == len(motion)
    head, neck = JOINT_NAMES.index("head"), JOINT_NAMES.index("neck")

    def turn(signals):
        pose = signals.full_pose()
        return Rotation.from_rotvec(pose[neck]) * Rotation.from_rotvec(pose[head])

    for before, after in zip(motion, found, strict=True):
        assert np.allclose(after.expression, before.expression, atol=1e-8)
        assert (turn(before).inv() * turn(after)).magnitude() < 1e-6


def test_another_ending_is_refused(motion, tmp_path):
    with pytest.raises(InputError, match=r"\.json, \.npz, \.csv"):
        write_motion(tmp_path / "a.bvh", motion)
