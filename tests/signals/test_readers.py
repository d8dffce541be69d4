"""Motion readers on files written here, and on broken ones."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
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


def test_bvh_bends_the_left_knee_and_scales_by_leg_length(tmp_path: Path) -> None:
    write_bvh(tmp_path / "knee.bvh")
    motion = read_motion(tmp_path / "knee.bvh")
    assert len(motion) == 3
    assert motion.fps == pytest.approx(25)
    angles = np.degrees(np.linalg.norm(motion[2].full_pose(), axis=1))
    assert angles[JOINT_NAMES.index("left_knee")] == pytest.approx(60, abs=12)
    assert angles[JOINT_NAMES.index("right_knee")] < 10
    joints = load_person().body.joint_template.double().numpy()
    scale = (joints[1] - joints[4])[1] / 42
    assert motion[2].translation[0] == pytest.approx(20 * scale, abs=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("HIERARCHY", "HIERARCHIE"), "line 1"),
        (lambda text: text[: text.index("MOTION")], "MOTION"),
        (lambda text: text.rsplit("\n", 2)[0] + "\n", "lines of motion"),
        (lambda text: text.replace("20.0 0.0", "20.0 x", 1), "expected numbers"),
        (lambda text: text.replace("20.0 0.0", "nan 0.0", 1), "finite"),
        (lambda text: text.replace("Frame Time: 0.04", "Frame Time: 0"), "frame time above 0"),
        (lambda text: text.replace("LeftLeg", "Tail"), "left_knee"),
    ],
)
def test_broken_bvh_is_refused_with_its_place(tmp_path: Path, change, message: str) -> None:
    path = tmp_path / "broken.bvh"
    write_bvh(path)
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=message):
        read_motion(path)


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
    ],
)
def test_broken_csv_is_refused(tmp_path: Path, change, message: str) -> None:
    path = tmp_path / "broken.csv"
    write_csv(path)
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=message):
        read_motion(path)


def test_smplx_and_amass_npz(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    body = rng.normal(size=(2, 63)) * 0.1
    np.savez(tmp_path / "a.npz", body_pose=body, global_orient=np.zeros((2, 3)), transl=np.ones((2, 3)))
    assert np.allclose(read_motion(tmp_path / "a.npz")[1].body_pose.ravel(), body[1])
    poses = np.zeros((3, 156))
    poses[:, 3:66] = rng.normal(size=(3, 63)) * 0.1
    np.savez(
        tmp_path / "b.npz",
        poses=poses,
        trans=np.tile([0, 0, 1.0], (3, 1)) * np.arange(3)[:, None],
        mocap_framerate=120.0,
    )
    motion = read_motion(tmp_path / "b.npz")
    assert motion.fps == 120
    assert np.allclose(motion[2].translation, [0, 2, 0])
    assert np.allclose(Rotation.from_rotvec(np.array(motion[0].global_orient)).apply([0, 0, 1]), [0, 1, 0])


def test_broken_npz_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "short.npz", poses=np.zeros((3, 72)), trans=np.zeros((3, 3)))
    with pytest.raises(InputError, match="156"):
        read_motion(tmp_path / "short.npz")
    np.savez(tmp_path / "pickled.npz", body_pose=np.array([{}], dtype=object))
    with pytest.raises(InputError, match=r"pickle"):
        read_motion(tmp_path / "pickled.npz")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "short.npz").read_bytes()[:100])
    with pytest.raises(InputError, match=r"cut\.npz"):
        read_motion(tmp_path / "cut.npz")
    with pytest.raises(InputError, match="nothing there"):
        read_motion(tmp_path / "none.bvh")


def test_json_round_trip(tmp_path: Path) -> None:
    sequence = SignalSequence((random_signals(np.random.default_rng(1)),), 24.0)
    write_json(tmp_path / "m.json", sequence)
    again = read_motion(tmp_path / "m.json")
    assert again.fps == 24
    assert again[0] == sequence[0]
