"""Motion readers on files written here, and on broken ones."""

import re
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.files.arrays import UNPACKED_BYTES
from avatarrex.signals.bvh import MOST_ROTATIONS
from avatarrex.signals.ground import lowest
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.signals.limits import random_signals
from avatarrex.signals.livelink import ANGLES
from avatarrex.signals.read import read_motion, write_json
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.person import load_person

TREE = {
    "Hips": ("", (0, 90, 0)), "Spine": ("Hips", (0, 12, 0)), "Neck": ("Spine", (0, 40, 0)), "Head": ("Neck", (0, 10, 0)),
    **{f"{s}{n}": (p and (p if p in ("Hips", "Spine") else f"{s}{p}"), (x * k, y, 0)) for s, k in (("Left", 1), ("Right", -1))
       for n, p, x, y in (("UpLeg", "Hips", 10, 0), ("Leg", "UpLeg", 0, -42), ("Foot", "Leg", 0, -42), ("Arm", "Spine", 18, 35),
                          ("ForeArm", "Arm", 28, 0), ("Hand", "ForeArm", 25, 0))},
}  # fmt: skip


def write_bvh(path: Path, frames: int = 3, knee_deg: float = 60.0) -> None:
    """A T-pose skeleton in centimetres whose left knee bends over the frames."""
    order: list[str] = []

    def block(name: str) -> list[str]:
        order.append(name)
        children = [child for child, (parent, _) in TREE.items() if parent == name]
        kind = "ROOT" if name == "Hips" else "JOINT"
        channels = "6 Xposition Yposition Zposition" if name == "Hips" else "3"
        body = ["OFFSET {} {} {}".format(*TREE[name][1]), f"CHANNELS {channels} Zrotation Xrotation Yrotation"]
        for child in children:
            body += block(child)
        return [f"{kind} {name}", "{", *body, *([] if children else ["End Site", "{", "OFFSET 0 -5 0", "}"]), "}"]

    lines = ["HIERARCHY", *block("Hips"), "MOTION", f"Frames: {frames}", "Frame Time: 0.04"]
    for frame in range(frames):
        values = [frame * 10.0, 0.0, 0.0]
        for name in order:
            values += [0.0, knee_deg * frame / (frames - 1) if name == "LeftLeg" else 0.0, 0.0]
        lines.append(" ".join(map(str, values)))
    path.write_text("\n".join(lines) + "\n")


def refused(path: Path, write: Callable[[Path], None], change: Callable[[str], str], message: str) -> None:
    """A file that is written and changed is refused with its name and the message."""
    write(path)
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=rf"{re.escape(path.name)}: .*{message}"):
        read_motion(path)


def test_bvh_bends_the_left_knee_and_scales_by_leg_length(tmp_path: Path) -> None:
    write_bvh(tmp_path / "knee.bvh")
    motion = read_motion(tmp_path / "knee.bvh")
    assert len(motion) == 3
    assert motion.fps == pytest.approx(25)
    angles = np.degrees(np.linalg.norm(motion[2].full_pose(), axis=1))
    assert angles[JOINT_NAMES.index("left_knee")] == pytest.approx(60, abs=12)
    assert angles[JOINT_NAMES.index("right_knee")] < 10
    joints = load_person().body.joint_template.double().numpy()
    scale = (np.linalg.norm(joints[1] - joints[4]) + np.linalg.norm(joints[4] - joints[7])) / 84
    assert motion[2].translation[0] == pytest.approx(20 * scale, abs=1e-6)
    assert any("centimetres" in note for note in motion.notes)
    assert np.allclose(motion[0].full_pose()[[16, 17, 18, 19]], 0, atol=0.09)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("HIERARCHY", "HIERARCHIE"), "line 1"),
        (lambda text: text[: text.index("MOTION")], "MOTION"),
        (lambda text: text.rsplit("\n", 2)[0] + "\n", "lines of motion"),
        (lambda text: text.replace("20.0 0.0", "20.0 x", 1), "expected numbers"),
        (lambda text: text.replace("20.0 0.0", "nan 0.0", 1), "finite"),
        (lambda text: text.replace("Frame Time: 0.04", "Frame Time: 0"), "frame time above 0"),
        (lambda text: text.replace("LeftLeg", "Tail"), "a joint for left_knee, found Hips, Spine"),
        (lambda text: text[: len(text) // 4], "expected"),
        (
            lambda text: text.replace("OFFSET 10 -0", "OFFSET 10", 1).replace("OFFSET 0 12 0", "OFFSET 0 12"),
            "3 finite numbers, found 2",
        ),
        (lambda text: text.replace("CHANNELS 3", "CHANNELS 4", 1), "as many channels as announced"),
        (lambda text: text.replace("Zrotation", "Wrotation", 1), "Xposition … Zrotation, found Wrotation"),
        (lambda text: text.replace("20.0 0.0", "20.0", 1), r"line \d+: expected \d+ finite numbers, found \d+"),
        (lambda text: text.replace("JOINT Spine", "ROOT Spine"), "ROOT outermost"),
    ],
)
def test_broken_bvh_is_refused_with_its_place(tmp_path: Path, change, message: str) -> None:
    refused(tmp_path / "broken.bvh", write_bvh, change, message)


def test_the_memory_of_a_long_bvh_is_what_its_limit_says(tmp_path: Path) -> None:
    """530 bytes at the peak for each frame and joint (of ours, where the file has fewer): 2 GiB for the longest."""
    write_bvh(tmp_path / "long.bvh", frames=2000)
    read_motion(tmp_path / "long.bvh")  # what is read once, and compiled
    tracemalloc.start()
    try:
        frames = len(read_motion(tmp_path / "long.bvh"))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert frames == 2000
    assert 300 < peak / (frames * 55) < 600
    assert 600 * MOST_ROTATIONS < 1.2 * UNPACKED_BYTES


def test_a_bvh_at_rest_in_another_pose_is_our_pose(tmp_path: Path) -> None:
    """The same A-posed skeleton as rest pose and as a turned T-pose: bones point the same way."""
    write_bvh(tmp_path / "t.bvh")
    turned = read_motion(tmp_path / "t.bvh")[0]
    down = {"LeftForeArm": (0, -28, 0), "LeftHand": (0, -25, 0)}
    kept = {name: TREE[name] for name in down}
    try:
        TREE.update({name: (TREE[name][0], offset) for name, offset in down.items()})
        write_bvh(tmp_path / "a.bvh")
    finally:
        TREE.update(kept)
    lowered = read_motion(tmp_path / "a.bvh")[0]
    joints = load_person().body.joint_template.double().numpy()
    bone = Rotation.from_rotvec(lowered.full_pose()[16]).apply(joints[18] - joints[16])
    assert np.allclose(bone / np.linalg.norm(bone), [0, -1, 0], atol=1e-6)
    assert np.allclose(lowered.full_pose()[17], turned.full_pose()[17])
    assert np.linalg.norm(lowered.full_pose()[18]) < 0.1


def write_csv(path: Path, rows: int = 4) -> None:
    names = [name[0].upper() + name[1:] for name in EXPRESSION_NAMES]
    lines = [",".join(["Timecode", "BlendShapeCount", *names, *ANGLES])]
    for k in range(rows):
        values = [0.0] * 61
        values[EXPRESSION_NAMES.index("jawOpen")] = k / (rows - 1)
        values[52] = 0.3
        lines.append(",".join([f"00:00:00:{k:02d}.000", "61", *map(str, values)]))
    path.write_text("\n".join(lines) + "\n")


def test_livelink_maps_columns_by_name_and_turns_the_head_left(tmp_path: Path) -> None:
    write_csv(tmp_path / "face.csv")
    motion = read_motion(tmp_path / "face.csv")
    assert motion[3].expression[EXPRESSION_NAMES.index("jawOpen")] == 1
    turned = Rotation.from_rotvec(motion[0].full_pose()[[12, 15]].sum(0)).apply([0, 0, 1])
    assert turned[0] == pytest.approx(np.sin(0.3), abs=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("JawOpen", "JawShut"), "a column jawOpen"),
        (lambda text: text[:-40], "line 5"),
        (lambda text: text.replace("0.3", "abc", 1), "HeadYaw: expected a number"),
        (lambda text: text.replace("0.3", "inf", 1), "finite"),
        (lambda text: text.split("\n")[0], "at least one frame"),
        (
            lambda text: text.replace("00:00:00:02.000", "soon"),
            "line 4: Timecode: expected hh:mm:ss:ff.fraction, found soon",
        ),
    ],
)
def test_broken_csv_is_refused(tmp_path: Path, change, message: str) -> None:
    refused(tmp_path / "broken.csv", write_csv, change, message)


def test_livelink_rate_and_gaps_come_from_the_timecode(tmp_path: Path) -> None:
    """31 rows at 30 a second of which one is missing: frame 10 lies between its neighbours."""
    path = tmp_path / "gap.csv"
    write_csv(path, 62)
    header, *rows = path.read_text().splitlines()
    rows = [f"01:00:{k // 30:02d}:{k % 30:02d}.000,{row.split(',', 1)[1]}" for k, row in enumerate(rows)]
    path.write_text("\n".join([header, *rows[:10], *rows[11:]]) + "\n")
    motion = read_motion(path)
    assert motion.fps == 30
    assert len(motion) == 62
    jaw = EXPRESSION_NAMES.index("jawOpen")
    assert motion[10].expression[jaw] == pytest.approx(10 / 61)
    assert any("61 rows resampled to 62" in note for note in motion.notes)


def test_livelink_without_head_and_with_a_column_more(tmp_path: Path) -> None:
    path = tmp_path / "old.csv"
    write_csv(path)
    path.write_text(path.read_text().replace("HeadYaw", "Mood").replace("TongueOut", "Tail"))
    motion = read_motion(path)
    assert not motion[0].body_pose.any()
    assert "not in the file, at rest: tongueOut, HeadYaw" in motion.notes
    assert "columns not read: Tail, Mood" in motion.notes


Z_UP = Rotation.from_euler("x", 90, degrees=True).as_rotvec()


def test_amass_is_turned_upright_and_put_on_the_floor(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    poses = np.zeros((3, 156))
    poses[:, :3] = Z_UP
    poses[:, 3:66] = rng.normal(size=63) * 0.1
    poses[:, 66:] = rng.normal(size=90) * 0.1
    rise = np.arange(3)[:, None] * [0, -0.5, 1.0] + [7, 8, 0.9]
    np.savez(tmp_path / "a.npz", poses=poses, trans=rise, mocap_framerate=120.0, gender=np.array({}, dtype=object))
    motion = read_motion(tmp_path / "a.npz")
    assert motion.fps == 120
    assert np.allclose(motion[0].global_orient, 0)
    assert np.allclose(motion[2].translation - motion[0].translation, [0, 2, 1])
    assert lowest(motion[0].full_pose()[None], motion[0].translation[None])[0] == pytest.approx(0, abs=1e-9)
    assert np.allclose(motion[0].body_pose.ravel(), poses[0, 3:66])
    assert np.allclose(motion[0].left_hand_pose.ravel(), poses[0, 66:111])
    assert any(note.startswith("up: +Z (100 %") for note in motion.notes)


def _roots(motion: SignalSequence) -> list[np.ndarray]:
    return [frame.global_orient.copy() for frame in motion]


def test_smplx_poses_and_parts_say_the_same(tmp_path: Path) -> None:
    poses = np.random.default_rng(1).normal(size=(2, 165)) * 0.1
    np.savez(tmp_path / "whole.npz", poses=poses, trans=np.zeros((2, 3)), mocap_frame_rate=30)
    np.savez(
        tmp_path / "parts.npz", root_orient=poses[:, :3], pose_body=poses[:, 3:66], pose_jaw=poses[:, 66:69],
        pose_eye=poses[:, 69:75], pose_hand=poses[:, 75:], trans=np.zeros((2, 3)),
    )  # fmt: skip
    whole, parts = read_motion(tmp_path / "whole.npz"), read_motion(tmp_path / "parts.npz")
    assert np.allclose(whole[1].full_pose()[1:], poses[1].reshape(55, 3)[1:])
    turns = [
        Rotation.from_rotvec(frames[1]) * Rotation.from_rotvec(frames[0]).inv()
        for frames in (poses[:, :3], _roots(whole))
    ]
    assert turns[1].magnitude() == pytest.approx(turns[0].magnitude())
    assert parts[0] == whole[0]
    assert any("no frame rate" in note for note in parts.notes)


def test_avatarrex_arrays_and_captures(tmp_path: Path) -> None:
    body, arkit = np.full((2, 63), 0.05), np.linspace(0, 1, 104).reshape(2, 52)
    place = np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 4.0]])
    arrays = {"body_pose": body, "global_orient": np.zeros((2, 3)), "transl": place, "leye_pose": np.full((2, 3), 0.1)}
    np.savez(tmp_path / "drive.npz", **arrays, expression=np.ones((2, 10)))
    motion = read_motion(tmp_path / "drive.npz")
    assert np.allclose(motion[0].body_pose.ravel(), body[0])
    assert np.allclose(motion[0].eye_pose, [[0.1] * 3, [0] * 3])
    assert np.allclose(motion[0].translation[[0, 2]], 0)
    assert any("not applied" in note for note in motion.notes)
    np.savez(tmp_path / "capture.npz", **arrays, arkit52=arkit)
    motion = read_motion(tmp_path / "capture.npz")
    assert np.array_equal(motion[1].translation, place[1])
    assert np.allclose(motion[1].expression, arkit[1])


ONE = np.zeros((2, 63))


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"poses": np.zeros((3, 71)), "trans": np.zeros((3, 3))}, r"poses: expected shape .*156.* found \(3, 71\)"),
        ({"poses": np.zeros((3, 165)), "trans": np.zeros((2, 3))}, r"trans: expected shape \(3, 3\), found \(2, 3\)"),
        ({"poses": np.zeros((0, 165))}, "poses: expected"),
        ({"poses": np.full((3, 165), np.nan)}, "poses: expected finite numbers, found 495 NaN"),
        ({"body_pose": np.array([{}], dtype=object)}, "body_pose: expected a plain array .no pickled"),
        (
            {"body_pose": ONE, "left_hand_pose": np.zeros((2, 46))},
            r"left_hand_pose: expected shape \(2, 45\), found \(2, 46\)",
        ),
        ({"body_pose": ONE, "transl": np.full((2, 3), np.inf)}, "transl: expected finite"),
        ({"body_pose": np.full((2, 63), "x")}, "body_pose: expected numbers"),
        ({"body_pose": ONE, "fps": 0}, "fps: expected a rate above 0"),
        ({"body_pose": ONE, "fps": [30, 30]}, "fps: expected a rate"),
        ({"betas": np.zeros(10)}, "expected poses, pose_body or body_pose, found none"),
    ],
)
def test_broken_npz_is_refused_by_its_key(tmp_path: Path, arrays: dict, message: str) -> None:
    np.savez(tmp_path / "broken.npz", **arrays)
    with pytest.raises(InputError, match=rf"broken\.npz: .*{message}"):
        read_motion(tmp_path / "broken.npz")


@pytest.mark.parametrize("keep", [0, 100, 0.5, 0.95])
def test_a_truncated_npz_is_refused(tmp_path: Path, keep: float) -> None:
    np.savez(tmp_path / "whole.npz", poses=np.zeros((20, 165)), trans=np.zeros((20, 3)))
    content = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(content[: int(keep if keep >= 1 or keep == 0 else keep * len(content))])
    with pytest.raises(InputError, match=r"cut\.npz"):
        read_motion(tmp_path / "cut.npz")


def test_missing_and_unknown_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.bvh: expected a motion file, found nothing there"):
        read_motion(tmp_path / "none.bvh")
    with pytest.raises(
        InputError, match=r"expected a motion file: .bvh, .amc, .fbx, .npz, .npy, .pkl, .csv, .wav, .json, found .c3d"
    ):
        read_motion(tmp_path / "walk.c3d")


def test_json_round_trip(tmp_path: Path) -> None:
    sequence = SignalSequence((random_signals(np.random.default_rng(1)),), 24.0, "mine", ("a note",))
    write_json(tmp_path / "m.json", sequence)
    again = read_motion(tmp_path / "m.json")
    assert (again.fps, again.name, again.notes) == (24, "mine", ("a note",))
    assert again[0] == sequence[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"frames": [', "expected a JSON file"),
        ('{"frames": []}', "frames: expected a list of at least one frame"),
        ('{"frames": {}}', "frames: expected a list of at least one frame, found dict"),
        ('{"frames": [{}], "fps": "30"}', "fps: expected a rate above 0"),
        ('{"frames": [{}], "fps": NaN}', "fps: expected a rate above 0"),
        ('{"frames": [{}, {"jaw_pose": [0, 0]}]}', r"frames\[1\]: jaw_pose: expected shape \(3,\), found \(2,\)"),
        ('{"frames": [{"jaw_pose": [0, 0, NaN]}]}', r"frames\[0\]: jaw_pose: expected finite numbers"),
        ('{"frames": [{"jaw_pose": "wide"}]}', r"frames\[0\]: jaw_pose: expected numbers"),
        ('{"frames": [{"mood": 1}]}', r"mood: expected one of .* found an unknown field"),
        ('{"frames": [{}], "version": 2}', "version: expected 1, found 2"),
        ('{"frames": [{}], "format": "gltf"}', "format: expected avatarrex-signals, found gltf"),
        ("[]", "expected an object, found list"),
    ],
)
def test_broken_json_is_refused_by_its_field(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "broken.json").write_text(text)
    with pytest.raises(InputError, match=rf"broken\.json: .*{message}"):
        read_motion(tmp_path / "broken.json")
