"""Hands of other makers: MANO's angles and coefficients, flags that are never guessed, tracks of landmarks."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

from avatarrex.errors import InputError
from avatarrex.signals.direction import degrees_between
from avatarrex.signals.hand_landmarks import FIRST, hand_pose, rest_landmarks
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.joints import FINGERS, HAND_JOINTS, JOINT_NAMES, JOINT_ROWS
from avatarrex.signals.library import named_hand
from avatarrex.signals.read import import_motion
from avatarrex.signals.rest_skeleton import rest_skeleton

RIGHT = ImportOptions(side="right", hand_mean="flat")


def track_of(hand: np.ndarray, side: str, lengths: float = 1.0) -> np.ndarray:
    """(t, 21, 3) of (t, 15, 3) rotation vectors by forward kinematics, every bone of a finger `lengths` times as long."""
    pose = np.zeros((len(hand), 55, 3))
    pose[:, JOINT_ROWS[f"{side}_hand_pose"]] = hand
    turned, places = rest_skeleton().posed(pose)
    rest, track = rest_landmarks(side), np.zeros((len(hand), 21, 3))
    track[:, 0] = places[:, JOINT_NAMES.index(f"{side}_wrist")]
    for finger, first in FIRST.items():
        track[:, first] = places[:, JOINT_NAMES.index(f"{side}_{finger}1")]
        for bone in range(3):
            turn = turned[:, JOINT_NAMES.index(f"{side}_{finger}{bone + 1}")]
            track[:, first + bone + 1] = track[:, first + bone] + lengths * turn @ (
                rest[first + bone + 1] - rest[first + bone]
            )
    return track


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("name", ["fist", "point", "relaxed", "victory"])
def test_landmarks_give_the_bones_back(side, name):
    """In another camera and unit; a hand whose fingers are longer by half has the same angles."""
    hand = named_hand(name, side)[None]
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    found = hand_pose(300 * track_of(hand, side) @ turn.T + 7, side)
    again = track_of(found, side)
    for first in FIRST.values():
        bones, wanted = (np.diff(track[:, first : first + 4], axis=1) for track in (again, track_of(hand, side)))
        assert degrees_between(bones, wanted).max() < 0.1
    np.testing.assert_allclose(hand_pose(track_of(hand, side, 1.5), side), found, atol=1e-6)


def test_a_mirrored_track_is_warned_of(tmp_path):
    track = track_of(named_hand("fist", "left")[None].repeat(3, 0), "left")
    np.save(tmp_path / "hand.npy", track * [-1.0, 1, 1])
    (warning,) = import_motion(tmp_path / "hand.npy", ImportOptions(side="left")).warnings
    assert "bend backwards" in warning
    assert not import_motion(tmp_path / "hand.npy", ImportOptions(side="right")).warnings


def test_landmarks_of_both_hands_in_json(tmp_path):
    hands = {side: named_hand("fist", side)[None].repeat(2, 0) for side in ("left", "right")}
    tracks = {
        side: [[dict(zip("xyz", place)) for place in frame] for frame in track_of(hand, side).tolist()]
        for side, hand in hands.items()
    }
    (tmp_path / "hands.json").write_text(json.dumps({"fps": 25, **tracks}))
    sequence = import_motion(tmp_path / "hands.json").sequence
    assert sequence.fps == 25
    assert len(sequence) == 2
    for side in hands:
        bent = getattr(sequence[1], f"{side}_hand_pose")
        assert np.abs(bent).max() > 0.8, "a fist"


def write_mano(path, **arrays):
    if path.suffix == ".pkl":
        path.write_bytes(pickle.dumps(arrays, protocol=2))
    else:
        np.savez(path, **arrays)
    return path


@pytest.mark.parametrize("ending", [".npz", ".pkl"])
def test_mano_angles(tmp_path, ending):
    values = np.random.default_rng(0).normal(0, 0.3, (4, 48))
    path = write_mano(
        tmp_path / f"hand{ending}", poses=values, side="left", flat_hand_mean=True, betas=np.ones(10), fps=20
    )
    read = import_motion(path)
    assert read.sequence.fps == 20
    np.testing.assert_allclose(
        np.stack([frame.left_hand_pose for frame in read.sequence]).reshape(4, 45), values[:, 3:]
    )
    assert not any(frame.right_hand_pose.any() or frame.body_pose.any() for frame in read.sequence)
    assert HAND_JOINTS[::3] == tuple(f"{finger}1" for finger in FINGERS), "MANO's order is ours"


def test_mano_coefficients_and_mean_of_the_file_or_of_a_model(tmp_path):
    rng = np.random.default_rng(0)
    mean, components, values = rng.normal(0, 0.1, 45), rng.normal(0, 0.3, (45, 45)), rng.normal(0, 1, (4, 15))
    wanted = values[:, 3:] @ components[:12] + mean
    model = {"hands_mean": mean, "hands_components": components}
    own = write_mano(tmp_path / "own.npz", poses=values, is_right=np.array(1), flat_hand_mean=False, **model)
    bare = write_mano(tmp_path / "bare.npz", poses=values, is_right=np.array(1))
    chosen = ImportOptions(hand_mean=str(write_mano(tmp_path / "MANO_RIGHT.pkl", **model)))
    for read in (import_motion(own), import_motion(bare, chosen)):
        found = np.stack([frame.right_hand_pose for frame in read.sequence]).reshape(4, 45)
        np.testing.assert_allclose(found, wanted, atol=1e-12)
        assert "mean hand added" in " ".join(read.sequence.notes)


@pytest.mark.parametrize(
    ("arrays", "options", "line"),
    [
        ({"poses": np.zeros((2, 48)), "flat_hand_mean": True}, {}, "side: expected left or right in the file, or --side left|right"),
        ({"poses": np.zeros((2, 48)), "side": "left"}, {}, "flat_hand_mean: expected it in the file, or --hand-mean flat"),
        ({"poses": np.zeros((2, 48)), "side": "left", "flat_hand_mean": False}, {}, "hands_meanl: expected it in the file"),
        ({"poses": np.zeros((2, 9)), "side": "left"}, {"hand_mean": "flat"}, "hands_componentsl: expected it in the file"),
        ({"hand_pose": np.full((2, 45), np.nan), "side": "left"}, {"hand_mean": "flat"}, "hand_pose: expected finite numbers"),
    ],
)  # fmt: skip
def test_what_a_hand_does_not_say_is_not_guessed(tmp_path, arrays, options, line):
    path = write_mano(tmp_path / "hand.npz", **arrays)
    with pytest.raises(InputError) as caught:
        import_motion(path, ImportOptions(**options))
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_bodys_hands_by_their_flags(tmp_path):
    """SMPL-X with the mean hand still to be added: with the file's mean, and as a choice against the file."""
    rng = np.random.default_rng(0)
    mean = rng.normal(0, 0.2, 45)
    body = {
        "body_pose": np.zeros((3, 63)),
        "left_hand_pose": np.zeros((3, 45)),
        "hands_meanl": mean,
        "flat_hand_mean": False,
    }
    np.savez(tmp_path / "body.npz", **body)
    np.testing.assert_allclose(import_motion(tmp_path / "body.npz").sequence[0].left_hand_pose.ravel(), mean)
    flat = import_motion(tmp_path / "body.npz", ImportOptions(hand_mean="flat"))
    assert not flat.sequence[0].left_hand_pose.any()
    assert any("flat hand at zero" in guess.value and guess.why == "chosen" for guess in flat.guesses)


@pytest.mark.parametrize(
    ("data", "line"),
    [
        ({"left": [[[0, 0, 0]] * 20]}, "left: expected shape (1, 21, 3)"),
        ({"left": [[[0, 0, 0]] * 21]}, "left: expected a palm with a length in every frame, found none in frame 0"),
        ({"left": [[[0, 0, "a"]] * 21]}, "left: expected frames of 21 places [x, y, z]"),
        ([[[0, 0, 1]] * 21], "side: expected left or right in the file, or --side left|right"),
    ],
)  # fmt: skip
def test_tracks_that_are_none(tmp_path, data, line):
    (tmp_path / "hand.json").write_text(json.dumps(data))
    with pytest.raises(InputError) as caught:
        import_motion(tmp_path / "hand.json")
    assert line in str(caught.value)
