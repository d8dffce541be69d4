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


def write_tracks(path, fps=25, **tracks):
    places = {
        side: [[dict(zip("xyz", place)) for place in frame] for frame in track.tolist()]
        for side, track in tracks.items()
    }
    path.write_text(json.dumps({"fps": fps, **places}))
    return path


def test_landmarks_of_both_hands_in_json(tmp_path):
    """Each a pose of its own, and a track read as the other hand's bends backwards."""
    tracks = {
        side: track_of(named_hand(name, side)[None].repeat(2, 0), side)
        for side, name in (("left", "fist"), ("right", "relaxed"))
    }
    read = import_motion(write_tracks(tmp_path / "hands.json", **tracks), ImportOptions(side="left"))
    assert read.sequence.fps == 25
    assert len(read.sequence) == 2
    for side, track in tracks.items():
        np.testing.assert_allclose(getattr(read.sequence[1], f"{side}_hand_pose"), hand_pose(track, side)[1], atol=1e-9)
    assert list(read.warnings) == ["not used, as nothing in this file depends on it: side"], "the file has both"


def test_a_side_that_is_chosen_turns_the_one_track(tmp_path):
    track = track_of(named_hand("fist", "right")[None], "right")
    path = write_tracks(tmp_path / "hand.json", left=track)
    assert "bend backwards" in import_motion(path).warnings[0]
    read = import_motion(path, ImportOptions(side="right"))
    np.testing.assert_allclose(read.sequence[0].right_hand_pose, hand_pose(track, "right")[0], atol=1e-9)
    assert not read.sequence[0].left_hand_pose.any()
    assert "hand: right (chosen)" in read.sequence.notes


@pytest.mark.parametrize("kind", [np.uint16, np.int16, np.int64])
def test_landmarks_in_pixels(tmp_path, kind):
    """Whole numbers are computed as any: differences of unsigned ones would wrap, squares of short ones overflow."""
    track = track_of(named_hand("fist", "right")[None], "right")
    pixels = np.round((track - track.min((0, 1))) * 1e5).astype(kind)
    np.save(tmp_path / "whole.npy", pixels)
    found = import_motion(tmp_path / "whole.npy", RIGHT).sequence[0].right_hand_pose
    np.testing.assert_allclose(found, hand_pose(pixels.astype(np.float64), "right")[0], atol=1e-9)


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


@pytest.mark.parametrize(("key", "joints"), [("hand_pose", 15), ("poses", 16)])
def test_mano_angles_joint_by_joint(tmp_path, key, joints):
    values = np.random.default_rng(0).normal(0, 0.3, (4, joints, 3))
    read = import_motion(write_mano(tmp_path / "hand.npz", **{key: values}, side="right", flat_hand_mean=True))
    np.testing.assert_allclose(np.stack([frame.right_hand_pose for frame in read.sequence]), values[:, -15:])
    for other in (14, 17):
        path = write_mano(tmp_path / "other.npz", hand_pose=np.zeros((4, other, 3)), side="right", flat_hand_mean=True)
        with pytest.raises(InputError, match=r"hand_pose: expected shape \(any, any\)"):
            import_motion(path)


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


def sides(**arrays):
    """SMPL-X's keys of left and right arrays."""
    return {f"hands_{name}{side[0]}": value for name, both in arrays.items() for side, value in both.items()}


RNG = np.random.default_rng(3)
MEANS = {side: RNG.normal(0, 0.1, 45) for side in ("left", "right")}
COMPONENTS = {side: RNG.normal(0, 0.02, (45, 45)) for side in ("left", "right")}
POSE = {side: RNG.normal(0, 0.2, (3, 45)) for side in ("left", "right")}
SMPLX = sides(mean=MEANS, components=COMPONENTS)
LAYOUTS = {
    "SMPL-X": lambda hands: {"poses": np.concatenate([np.zeros((3, 75)), *hands], 1)},
    "SMPL-X, joints apart": lambda hands: {"poses": np.concatenate([np.zeros((3, 75)), *hands], 1).reshape(3, 55, 3)},
    "SMPL-H": lambda hands: {"poses": np.concatenate([np.zeros((3, 66)), *hands], 1)},
    "hands in one": lambda hands: {"pose_body": np.zeros((3, 63)), "pose_hand": np.concatenate(hands, 1)},
    "one a hand": lambda hands: {
        "body_pose": np.zeros((3, 63)), **{f"{side}_hand_pose": hand for side, hand in zip(("left", "right"), hands)},
    },
    "one a hand, joints apart": lambda hands: {
        "body_pose": np.zeros((3, 63)),
        **{f"{side}_hand_pose": hand.reshape(3, -1, 3) for side, hand in zip(("left", "right"), hands)},
    },
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(
    "said", ["in the file", "by the model", "by the model, against a flag that says flat", "not at all"]
)
def test_the_mean_is_added_in_every_layout(tmp_path, layout, said):
    body = LAYOUTS[layout](list(POSE.values()))
    options = ImportOptions()
    if said == "in the file":
        body |= {"flat_hand_mean": False, **SMPLX}
    elif said != "not at all":
        options = ImportOptions(hand_mean=str(write_mano(tmp_path / "SMPLX_NEUTRAL.npz", **SMPLX)))
        body |= {"flat_hand_mean": np.array(True)} if "flag" in said else {}
    np.savez(tmp_path / "body.npz", **body)
    read = import_motion(tmp_path / "body.npz", options)
    added = said in ("in the file", "by the model")
    for side, hand in POSE.items():
        found = np.stack([getattr(frame, f"{side}_hand_pose") for frame in read.sequence]).reshape(3, 45)
        np.testing.assert_allclose(found, hand + MEANS[side] * added, atol=1e-12)
    (guess,) = (guess for guess in read.guesses if guess.what == "hands")
    assert guess.value == ("angles, mean hand added" if added else "angles, flat hand at zero")
    assert ("does not say otherwise" in guess.why) == (said == "not at all")
    assert any("not used" in text and "hand_mean" in text for text in read.warnings) == ("against" in said)


@pytest.mark.parametrize("flat", [True, False])
def test_a_model_for_its_components_leaves_the_flag_to_the_file(tmp_path, flat):
    coefficients = RNG.normal(0, 1, (3, 12))
    options = ImportOptions(hand_mean=str(write_mano(tmp_path / "SMPLX_NEUTRAL.npz", **SMPLX)))
    body = LAYOUTS["one a hand"]([coefficients, coefficients])
    np.savez(tmp_path / "body.npz", **body, flat_hand_mean=flat)
    read = import_motion(tmp_path / "body.npz", options)
    for side in POSE:
        wanted = coefficients @ COMPONENTS[side][:12] + MEANS[side] * (not flat)
        found = np.stack([getattr(frame, f"{side}_hand_pose") for frame in read.sequence]).reshape(3, 45)
        np.testing.assert_allclose(found, wanted, atol=1e-12)
    assert not read.warnings


def one_hand(side):
    return {"hands_mean": MEANS[side], "hands_components": COMPONENTS[side]}


def test_a_model_of_one_hand_serves_that_hand_alone(tmp_path):
    """MANO_RIGHT.pkl is no left hand's, nor a body's with two; by a name that says nothing it is the sequence's hand's."""
    model, bare = (write_mano(tmp_path / f"{name}.pkl", **one_hand("right")) for name in ("MANO_RIGHT", "bright"))
    both, right = (
        LAYOUTS["one a hand"](list(POSE.values())),
        {"body_pose": np.zeros((3, 63)), "right_hand_pose": POSE["right"]},
    )
    refused = {
        "hands": both,
        "left": {"poses": np.zeros((3, 48)), "side": "left"},
        "own": {**both, "flat_hand_mean": False, **one_hand("right")},
    }
    for name, arrays in refused.items():
        path = write_mano(tmp_path / f"{name}.npz", **arrays)
        options = ImportOptions() if name == "own" else ImportOptions(hand_mean=str(model))
        with pytest.raises(InputError, match=r"hands_meanl: expected it in the file, .* found hands_"):
            import_motion(path, options)
    path = write_mano(tmp_path / "right.npz", **right)
    for named in (model, bare):
        frame = import_motion(path, ImportOptions(hand_mean=str(named))).sequence[1]
        np.testing.assert_allclose(frame.right_hand_pose.ravel(), POSE["right"][1] + MEANS["right"])
        assert not frame.left_hand_pose.any()


def test_a_body_with_a_hand_pose_is_no_hand(tmp_path):
    poses = np.zeros((3, 165))
    poses[:, 9] = 0.5
    hand = {"hand_pose": np.ones((3, 45)), "side": "left", "flat_hand_mean": True}
    for key, value in (("poses", poses), ("fullpose", poses), ("poses", poses.reshape(3, 55, 3))):
        read = import_motion(write_mano(tmp_path / "body.npz", **{key: value}, **hand))
        assert read.sequence[0].body_pose[2, 0] == 0.5
        assert not read.sequence[0].left_hand_pose.any()
    for key in ("poses", "body_pose"):
        with pytest.raises(InputError, match="poses: expected of a hand"):
            import_motion(write_mano(tmp_path / "body.pkl", **{key: poses[:, :63].tolist()}, **hand))


def test_a_rate_by_any_of_its_names(tmp_path):
    path = write_mano(tmp_path / "hand.npz", poses=np.zeros((2, 48)), side="left", mocap_frame_rate=120)
    read = import_motion(path, ImportOptions(hand_mean="flat"))
    assert read.sequence.fps == 120
    assert "rate: 120 frames a second (mocap_frame_rate)" in read.sequence.notes


LONG = [[10**30] * 48]
HANDED = {"side": "left", "flat_hand_mean": True}
MEANT = {"hand_pose": np.zeros((2, 45)), "side": "left", "flat_hand_mean": False}


@pytest.mark.parametrize(
    ("arrays", "line"),
    [
        ({"poses": [[1, 2], [3]], **HANDED}, "poses: expected an array, found"),
        ({"poses": [[0.0] * 48], "side": [["left"], "left", []], "flat_hand_mean": True}, "side: expected an array, found"),
        ({"poses": LONG, **HANDED}, "poses: expected numbers, found object"),
        ({"hand_pose": np.zeros((3, 46)), **HANDED}, "hand_pose: expected at least one frame of 1 … 45 numbers, found (3, 46)"),
        ({"hand_pose": np.zeros((3, 0)), **HANDED}, "hand_pose: expected at least one frame of 1 … 45 numbers, found (3, 0)"),
        ({"hand_pose": np.zeros((0, 45)), **HANDED}, "hand_pose: expected at least one frame"),
        ({"hand_pose": np.full((3, 45), 1e300), **HANDED}, "hand_pose: expected finite numbers up to 1000, found 1e+300"),
        ({"hand_pose": np.zeros((3, 45)), "side": "left", "flat_hand_mean": "False"}, "flat_hand_mean: expected true or false"),
        ({"hand_pose": np.zeros((3, 45)), "side": "left", "flat_hand_mean": np.zeros(0)}, "flat_hand_mean: expected true or false"),
        ({"hand_pose": np.zeros((3, 45)), "side": "left", "flat_hand_mean": np.nan}, "flat_hand_mean: expected true or false"),
        ({"hand_pose": np.zeros((2, 45)), "side": ["left", "right"], "flat_hand_mean": True}, "side: expected left or right in the file"),
        ({**MEANT, "hands_mean": np.full(45, 1e300)}, "hands_meanl: expected finite numbers up to 1000"),
        ({**MEANT, "hands_mean": np.zeros(44)}, "hands_meanl: expected shape (45,), found (44,)"),
    ],
)  # fmt: skip
def test_hands_that_are_none(tmp_path, arrays, line):
    """One line, never a trace."""
    path = write_mano(tmp_path / "hand.pkl", **arrays)
    with pytest.raises(InputError) as caught:
        import_motion(path)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_numbers_wider_than_double_precision(tmp_path):
    path = tmp_path / "wide.npz"
    for arrays, line in (
        ({"poses": np.full((2, 48), np.longdouble("1e4000")), **HANDED}, "poses: expected finite numbers up to 1000"),
        ({"poses": np.full((2, 165), np.longdouble("1e4000"))}, "poses: expected numbers of at most 64 bits"),
    ):
        np.savez(path, **arrays)
        with pytest.raises(InputError, match=line):
            import_motion(path)


def test_flags_of_a_body_that_are_none(tmp_path):
    body = {"body_pose": np.zeros((2, 63)), "left_hand_pose": np.zeros((2, 45)), "right_hand_pose": np.zeros((2, 45))}
    for value in (np.zeros(0), "False", np.array([True, False])):
        path = write_mano(tmp_path / "body.npz", **body, flat_hand_mean=value)
        with pytest.raises(InputError, match="flat_hand_mean: expected true or false"):
            import_motion(path)


@pytest.mark.parametrize(
    ("data", "line"),
    [
        ({"left": [[[0, 0, 0]] * 20]}, "left: expected shape (1, 21, 3)"),
        ({"left": [[[0, 0, 0]] * 21]}, "left: expected a palm with a length in every frame, found none in frame 0"),
        ({"left": [[[0, 0, "a"]] * 21]}, "left: expected frames of 21 places [x, y, z]"),
        ({"left": [[[0, 0, 1e160]] * 21]}, "left: expected finite numbers up to 1e+09, found 1e+160"),
        ([[[0, 0, 1]] * 21], "side: expected left or right in the file, or --side left|right"),
    ],
)  # fmt: skip
def test_tracks_that_are_none(tmp_path, data, line):
    (tmp_path / "hand.json").write_text(json.dumps(data))
    with pytest.raises(InputError) as caught:
        import_motion(tmp_path / "hand.json")
    assert line in str(caught.value)
