"""The motions of the synthetic capture: plausible, smooth, lively, and the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest

from avatarrex.capture.synthetic.motions import EXPRESSIONS, SENTENCE, VISEMES, body_motion, face_motion
from avatarrex.capture.synthetic.subject import load_subject
from avatarrex.signals.ground import lowest
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.signals.limits import violations
from avatarrex.signals.sequence import SignalSequence

DEEPEST = 0.035
"""Metres that a hand may press into cloth and the flesh below it."""


def poses(motion: SignalSequence) -> np.ndarray:
    """(t, 55, 3)."""
    return np.stack([signals.full_pose() for signals in motion])


@pytest.mark.parametrize("make", [body_motion, face_motion])
def test_seeds(make) -> None:  # type: ignore[no-untyped-def]
    first, again, other = make(30, 5), make(30, 5), make(30, 6)
    assert all(a == b for a, b in zip(first, again))
    assert not any(a == b for a, b in zip(first, other))
    assert len(make(1, 5)) == 1


@pytest.mark.parametrize("make", [body_motion, face_motion])
@pytest.mark.parametrize("seed", [0, 11])
def test_frames_keep_to_the_limits_and_a_short_capture_samples_the_long_one(make, seed: int) -> None:  # type: ignore[no-untyped-def]
    long, short = make(145, seed), make(37, seed)
    for signals in long:
        assert violations(signals) == ()
        assert signals.expression.min() >= 0
        assert signals.expression.max() <= 1
    for k in range(37):
        np.testing.assert_allclose(short[k].full_pose(), long[4 * k].full_pose(), atol=1e-9)
    assert short.duration == pytest.approx(long.duration)


def test_the_body_moves_smoothly_through_much_of_its_range() -> None:
    motion = body_motion(600, 0)
    pose = poses(motion)
    step = np.abs(np.diff(pose, axis=0)).max()
    assert np.degrees(step) < 18  # 15 frames a second: an arm that waves turns 250° a second
    travelled = np.degrees(np.ptp(pose, axis=0).max(-1))
    for joint, least in (
        ("left_shoulder", 110), ("right_shoulder", 110), ("left_elbow", 90), ("right_elbow", 100), ("left_hip", 80),
        ("right_hip", 80), ("left_knee", 95), ("right_knee", 95), ("spine1", 25), ("head", 30), ("left_index1", 60),
        ("right_middle2", 60), ("left_wrist", 15),
    ):  # fmt: skip
        assert travelled[JOINT_NAMES.index(joint)] > least, joint
    assert np.ptp([signals.expression for signals in motion], axis=0).max() > 0.5
    placed = np.stack([signals.translation for signals in motion])
    np.testing.assert_allclose(lowest(pose, placed), 0, atol=1e-9)
    assert np.abs(placed[:, [0, 2]]).max() < 0.2


@pytest.mark.parametrize("seed", [0, 1])
def test_hands_stay_out_of_the_body(seed: int) -> None:
    """Every eighth frame: how deep any fingertip or palm is inside head, trunk and legs with their clothes."""
    igl = pytest.importorskip("igl")
    subject = load_subject()
    owner = np.array(subject.model.joint_names)[subject.model.weights.argmax(1).numpy()]
    arm = np.array(
        [any(k in name for k in ("elbow", "wrist", "index", "middle", "ring", "pinky", "thumb")) for name in owner]
    )
    hand = np.flatnonzero(arm & (subject.solid_of_vertex == 0) & ~np.isin(owner, ["left_elbow", "right_elbow"]))[::5]
    rest = np.ascontiguousarray(subject.faces[~arm[subject.faces].any(1)])
    for signals in body_motion(80, seed)[2::8]:
        posed = subject.pose(signals)
        points = posed.vertices[hand]
        inside = igl.fast_winding_number(posed.vertices, rest, points) > 0.5
        if inside.any():
            squared = igl.point_mesh_squared_distance(points[inside], posed.vertices, rest)[0]
            assert np.sqrt(np.max(squared)) < DEEPEST


def test_the_face_shows_every_expression_and_speaks() -> None:
    motion = face_motion(400, 0)
    track = np.stack([signals.expression for signals in motion])
    for name in ("jawOpen", "mouthSmileLeft", "mouthPucker", "cheekPuff", "browDownLeft", "noseSneerRight", "eyeWideLeft",
                 "eyeBlinkRight", "mouthFunnel", "mouthFrownLeft"):  # fmt: skip
        assert track[:, EXPRESSION_NAMES.index(name)].max() > 0.5, name
    assert set(SENTENCE) == set(VISEMES)
    assert "neutral" in EXPRESSIONS
    assert not VISEMES["rest"]
    pose = poses(motion)
    assert 4 < np.degrees(np.ptp(pose[:, JOINT_NAMES.index("head")], axis=0).max()) < 30
    np.testing.assert_array_equal(pose[:, 23], pose[:, 24])
    assert np.degrees(np.ptp(pose[:, 23], axis=0).max()) > 10


def test_captures_keep_their_poses():
    """Whatever the library's entries become: figures of trainings rest on the same pictures. Sums of weighted signals."""
    expected = {"body": 27.989496349, "tunic": 27.814675366, "face": 17.208959378}
    found = {"body": body_motion(40, 0), "tunic": body_motion(40, 0, 10.0), "face": face_motion(40, 0)}
    for name, sequence in found.items():
        moved = [np.ravel([getattr(signals, field) for signals in sequence]) for field in ("translation", "expression")]
        values = np.concatenate([poses(sequence).ravel(), *moved])
        weights = np.random.default_rng(0).normal(size=values.size)
        assert weights @ values == pytest.approx(expected[name], abs=1e-6), name
