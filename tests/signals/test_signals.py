"""Driving signals: validation, JSON, slerp, mirror, limits."""

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from avatarrex.errors import InputError
from avatarrex.signals.driving import SHAPES, Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.signals.library import EXPRESSIONS, HANDS, POSES, mirror, named_expression, named_hand, named_pose
from avatarrex.signals.limits import LIMITS, clamp, random_signals, violations
from avatarrex.signals.sequence import SignalSequence, interpolate
from avatarrex.templates.model import pose_template
from avatarrex.templates.person import load_person


def test_json_round_trip() -> None:
    signals = random_signals(np.random.default_rng(0))
    assert Signals.from_json(signals.to_json()) == signals


@pytest.mark.parametrize("name", SHAPES)
def test_nan_is_refused_by_name(name: str) -> None:
    with pytest.raises(InputError, match=f"{name}: expected finite"):
        Signals.rest().replace(**{name: np.full(SHAPES[name], np.nan)})


def test_wrong_shape_and_unknown_field_are_refused() -> None:
    with pytest.raises(InputError, match=r"body_pose: expected shape \(21, 3\)"):
        Signals.rest().replace(body_pose=np.zeros((22, 3)))
    with pytest.raises(InputError, match="unknown field"):
        Signals.from_json({"bodypose": []})


def test_full_pose_round_trip() -> None:
    signals = random_signals(np.random.default_rng(1))
    assert np.array_equal(Signals.from_full_pose(signals.full_pose()).full_pose(), signals.full_pose())
    assert len(JOINT_NAMES) == 55
    assert len(set(EXPRESSION_NAMES)) == 52


def test_mirror_is_an_involution_and_keeps_symmetric_poses() -> None:
    signals = random_signals(np.random.default_rng(2))
    assert mirror(mirror(signals)) == signals
    star = Signals.rest().replace(body_pose=named_pose("star"))
    assert np.allclose(mirror(star).body_pose, star.body_pose)
    assert not np.allclose(mirror(signals).body_pose, signals.body_pose)


def test_interpolation_keeps_its_ends_and_turns_at_constant_speed() -> None:
    a = Signals.rest()
    b = a.replace(global_orient=np.array([0, 2.0, 0]), translation=np.array([1.0, 0, 0]))
    assert np.allclose(interpolate(a, b, 0).full_pose(), a.full_pose())
    assert np.allclose(interpolate(a, b, 1).full_pose(), b.full_pose())
    assert np.allclose(interpolate(a, b, 0.25).global_orient, [0, 0.5, 0])
    assert np.allclose(interpolate(a, b, 0.25).translation, [0.25, 0, 0])


def test_resampling_keeps_first_and_last_frame() -> None:
    rng = np.random.default_rng(3)
    sequence = SignalSequence(tuple(random_signals(rng) for _ in range(7)), 30.0)
    again = sequence.resample(50.0)
    assert len(again) == 11
    assert np.allclose(again[0].full_pose(), sequence[0].full_pose())
    assert np.allclose(again[10].full_pose(), sequence[6].full_pose())
    assert again[5] == sequence[3], "a sample on a frame is that frame"
    assert again[4] == sequence.at(4 / 50)
    odd = sequence.resample(7.0)
    assert len(odd) == 2
    assert odd[1] == sequence.at(1 / 7), "samples lie at k / fps, whether or not the last one meets the end"
    with pytest.raises(InputError, match="fps: expected a rate"):
        sequence.resample(0)


def test_a_slice_of_a_sequence_plays_as_long() -> None:
    rng = np.random.default_rng(5)
    sequence = SignalSequence(tuple(random_signals(rng) for _ in range(9)), 30.0, "walk")
    some = sequence[0:9:4]
    assert (len(some), some.fps, some.name) == (3, 7.5, "walk")
    assert some.duration == pytest.approx(sequence.duration)
    assert some[1] == sequence[4]
    with pytest.raises(InputError, match="frames: expected at least one"):
        sequence[20:]


def test_limits_are_mirrored_and_clamping_reaches_them() -> None:
    left, right = JOINT_NAMES.index("left_shoulder"), JOINT_NAMES.index("right_shoulder")
    assert np.allclose(LIMITS[right, 1], -LIMITS[left, 1, ::-1])
    wild = Signals.rest().replace(body_pose=np.full((21, 3), 3.0))
    assert "left_elbow" in violations(wild)
    assert violations(clamp(wild)) == ()


@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_random_signals_stay_within_limits(scale: float) -> None:
    rng = np.random.default_rng(4)
    assert all(violations(random_signals(rng, scale)) == () for _ in range(20))


def test_every_name_gives_something_of_its_own() -> None:
    poses = [named_pose(name).tobytes() for name in POSES]
    assert len(set(poses)) == len(poses)
    for side in ("left", "right"):
        assert len({named_hand(name, side).tobytes() for name in HANDS}) == len(HANDS)
    assert len({named_expression(name).tobytes() for name in EXPRESSIONS}) == len(EXPRESSIONS)
    with pytest.raises(InputError, match=r"one of squat, .*\bbow\b") as refused:
        named_pose("sqat")
    assert all(name in str(refused.value) for name in POSES)


def test_named_poses_and_hands_keep_to_the_limits() -> None:
    for name in POSES:
        assert violations(Signals.rest().replace(body_pose=named_pose(name))) == (), name
    for name in HANDS:
        hands = {f"{side}_hand_pose": named_hand(name, side) for side in ("left", "right")}
        assert violations(Signals.rest().replace(**hands)) == (), name


def skin(signals: Signals, *joints: str) -> np.ndarray:
    """Vertices of the default person that move most with one of the joints, metres."""
    body = load_person().body
    values = (
        torch.tensor(np.array(v), dtype=torch.float32) for v in (signals.full_pose(), signals.shape, np.zeros(52))
    )
    owner = body.weights.argmax(1)
    chosen = torch.isin(owner, torch.tensor([JOINT_NAMES.index(name) for name in joints]))
    return pose_template(body, *values).vertices[chosen].numpy()


TOUCHES = {
    "hands_on_hips": (("left_wrist", "left_index1"), ("pelvis", "spine1")),
    "think": (("right_index2", "right_middle2"), ("head", "jaw")),
    "clasped_hands": (("left_middle1", "left_middle2"), ("right_middle1", "right_middle2")),
    "crossed_arms": (("left_elbow",), ("right_elbow",)),
    "salute": (("right_index3", "right_middle3"), ("head",)),
}


@pytest.mark.parametrize("name", TOUCHES)
def test_poses_that_touch_touch(name: str) -> None:
    """Nearest points of bare skin within 2.5 cm: a T-shirt and its folds lie between on the clothed subject."""
    signals = Signals.rest().replace(body_pose=named_pose(name))
    one, other = (cKDTree(skin(signals, *joints)) for joints in TOUCHES[name])
    assert one.query(other.data)[0].min() < 0.025


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_pinch_closes_and_a_fist_hides_its_fingers(side: str) -> None:
    pinch = Signals.rest().replace(**{f"{side}_hand_pose": named_hand("pinch", side)})
    thumb, index = (skin(pinch, f"{side}_{finger}3") for finger in ("thumb", "index"))
    assert cKDTree(thumb).query(index)[0].min() < 0.003
    fist = Signals.rest().replace(**{f"{side}_hand_pose": named_hand("fist", side)})
    reach = np.abs(skin(fist, *(f"{side}_{finger}3" for finger in ("index", "middle", "ring", "pinky")))[:, 0]).max()
    assert reach < np.abs(skin(fist, f"{side}_middle1")[:, 0]).max()
    across = skin(fist, f"{side}_thumb3")[:, 2].min()
    assert across < skin(fist, f"{side}_index2")[:, 2].mean(), "the thumb lies across the fingers"
