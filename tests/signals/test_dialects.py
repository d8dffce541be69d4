"""Every dialect brings the motion that it was written from: directions, uprightness, facing, floor."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dialects import DIALECTS, FRAMES, INDEX, steps, write, write_asf
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.signals.direction import degrees_between, unit
from avatarrex.signals.driving import Signals
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import ImportedMotion
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.library import named_pose
from avatarrex.signals.limits import LIMITS
from avatarrex.signals.read import import_motion
from avatarrex.signals.rest_skeleton import rest_skeleton
from avatarrex.signals.sequence import SignalSequence

MOST = 5.0
"""Degrees."""
AWAY = 140.0
"""Degrees that the fixtures look away from the camera."""


class Posed:
    """A motion's joints, turned about the vertical so that the hips of the first frame face the camera."""

    def __init__(self, frames: list[Signals]) -> None:
        turned, places = rest_skeleton().posed(np.stack([frame.full_pose() for frame in frames]))
        left = unit((places[0, INDEX["left_hip"]] - places[0, INDEX["right_hip"]]) * [1, 0, 1])
        self._heading = np.stack([left, [0, 1, 0], np.cross(left, [0, 1, 0])])
        self._turned, self._places = turned, places

    def bones(self, *bones: tuple[str, str]) -> np.ndarray:
        """(bones, t, 3) of both sides."""
        names = [(f"{side}_{a}", f"{side}_{b}") for side in ("left", "right") for a, b in bones]
        return np.stack([(self._places[:, INDEX[b]] - self._places[:, INDEX[a]]) @ self._heading.T for a, b in names])

    def head(self) -> np.ndarray:
        """(2, t, 3) its up and forward."""
        return np.stack([self._turned[:, INDEX["head"], :, axis] @ self._heading.T for axis in (1, 2)])


def apart(got: list[Signals], truth: list[Signals]) -> dict[str, float]:
    """Largest angle in degrees of limbs, hands and feet (as their bones point) and of the head (up, forward)."""
    mine, theirs = Posed(got), Posed(truth)
    bones = {
        "limbs": (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")),
        "hands": (("wrist", "middle1"),),
        "feet": (("ankle", "foot"),),
    }
    angles = {
        part: float(degrees_between(mine.bones(*names), theirs.bones(*names)).max()) for part, names in bones.items()
    }
    return {**angles, "head": float(degrees_between(mine.head(), theirs.head()).max())}


@pytest.mark.parametrize("name", DIALECTS)
def test_a_dialect_comes_in_as_it_was(tmp_path: Path, name: str) -> None:
    truth = steps(AWAY)
    write(tmp_path / "m.bvh", DIALECTS[name], truth)
    read = import_motion(tmp_path / "m.bvh")
    found = apart(list(read.sequence), truth)
    assert max(found.values()) < MOST, found
    assert max(largest for _, largest in read.errors.values()) < MOST, read.errors


def test_a_bundle_s_limbs_are_turned_as_their_hinges_bend(tmp_path: Path) -> None:
    """Legs that are turned out by 35 degrees and arms about themselves: no bone's direction shows it, knees and elbows do."""
    turned = {
        "left_hip": [0, 0.6, 0],
        "right_hip": [0, -0.6, 0],
        "left_shoulder": [0.5, 0, 0],
        "right_shoulder": [0.5, 0, 0],
    }
    truth = []
    for frame in steps():
        pose = frame.full_pose()
        for name, turn in turned.items():
            pose[INDEX[name]] = (Rotation.from_rotvec(pose[INDEX[name]]) * Rotation.from_rotvec(turn)).as_rotvec()
        truth.append(Signals.from_full_pose(pose, translation=frame.translation))
    write(tmp_path / "m.bvh", DIALECTS["game engine bundle"], truth)
    got = import_motion(tmp_path / "m.bvh").sequence
    for name in (*turned, "left_knee", "right_elbow"):
        turns = [Rotation.from_rotvec([frame.full_pose()[INDEX[name]] for frame in motion]) for motion in (got, truth)]
        assert np.degrees((turns[0].inv() * turns[1]).magnitude()).max() < MOST, name


def test_feet_that_rest_turned_out_point_where_they_point(tmp_path: Path) -> None:
    write(tmp_path / "m.bvh", replace(DIALECTS["mixamo"], feet=(0.1, 0.3)), steps())
    assert import_motion(tmp_path / "m.bvh").errors["feet"][1] < 1


def test_a_hand_that_the_file_lacks_is_not_measured(tmp_path: Path) -> None:
    """Wrists without fingers, their end sites at the wrists: nothing says where the hands point."""
    kept = {ours: theirs for ours, theirs in DIALECTS["mixamo"].names.items() if ours in JOINT_NAMES[:25]}
    write(tmp_path / "m.bvh", replace(DIALECTS["mixamo"], names=kept), steps())
    assert "hands" in import_motion(tmp_path / "m.bvh").errors
    text, count = re.subn(
        r"(Hand\n(?:(?!JOINT).)*?End Site\s+\{\s+OFFSET)[^\n]*",
        r"\1 0 0 0",
        (tmp_path / "m.bvh").read_text(),
        flags=re.DOTALL,
    )
    assert count == 2
    (tmp_path / "m.bvh").write_text(text)
    assert list(import_motion(tmp_path / "m.bvh").errors) == ["hips", "limbs", "feet", "head"]


def test_an_asf_comes_in_as_it_was(tmp_path: Path) -> None:
    truth = steps(AWAY)
    read = import_motion(write_asf(tmp_path, "07", truth))
    assert max(apart(list(read.sequence), truth).values()) < MOST
    assert read.sequence.fps == 120


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("asf", lambda text: "", r"an ASF file with :bonedata and :hierarchy, found no section"),
        (
            "asf",
            lambda text: text.replace("to_lfemur lfemur", "lfemur lfemur"),
            "bones below one that stands above, found lfemur",
        ),
        ("asf", lambda text: text.replace("length 0", "length x"), r"line \d+: expected numbers"),
        ("amc", lambda text: text.replace("lfemur", "tail"), "expected a bone of the skeleton, found tail"),
        ("amc", lambda text: text.replace("lfemur ", "lfemur nan ", 1), r"line \d+: expected 3 finite numbers"),
        ("amc", lambda text: text[:26], "expected an AMC file with frames, found none"),
    ],
)
def test_a_broken_asf_or_amc_is_refused(tmp_path: Path, file: str, change: Callable[[str], str], message: str) -> None:
    motion = write_asf(tmp_path, "07", steps()[:2])
    path = next(tmp_path.glob(f"*.{file}"))
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=message):
        import_motion(motion)


def test_an_amc_without_its_skeleton_says_so(tmp_path: Path) -> None:
    (tmp_path / "07_01.amc").write_text("1\n")
    with pytest.raises(InputError, match=r"its skeleton beside it: 07_01.asf, or one .asf alone, found none"):
        import_motion(tmp_path / "07_01.amc")


def mixamo(folder: Path, **options: object) -> ImportedMotion:
    write(folder / "m.bvh", DIALECTS["mixamo"], steps())
    return import_motion(folder / "m.bvh", ImportOptions(**options))


def test_the_person_looks_at_the_camera_unless_told(tmp_path: Path) -> None:
    write(tmp_path / "m.bvh", DIALECTS["mixamo"], steps(AWAY))

    def facing(**options: str) -> float:
        first = import_motion(tmp_path / "m.bvh", ImportOptions(**options)).sequence[0]
        ahead = rest_skeleton().posed(first.full_pose()[None])[0][0, 0, :, 2]
        return float(np.degrees(np.arctan2(ahead[0], ahead[2])))

    assert facing() == pytest.approx(0, abs=1)
    assert facing(forward="+Z") == pytest.approx(AWAY, abs=1)
    assert facing(forward="-Z") == pytest.approx(AWAY - 180, abs=1)


def test_up_that_is_wrong_warns_with_the_remedy(tmp_path: Path) -> None:
    read = mixamo(tmp_path, up="+Z")
    assert any("the mean body lies" in text and "--up" in text for text in read.warnings)
    assert not mixamo(tmp_path).warnings


def test_a_joint_past_its_limit_warns_with_the_remedy(tmp_path: Path) -> None:
    truth = [f.replace(body_pose=_knee_back(f.body_pose)) for f in steps()]
    write(tmp_path / "m.bvh", DIALECTS["mixamo"], truth)
    warnings = import_motion(tmp_path / "m.bvh").warnings
    assert any("past its limit: left_knee by" in text and "--map" in text for text in warnings)


def _knee_back(pose: np.ndarray) -> np.ndarray:
    bent = pose.copy()
    bent[3, 0] = -1.4
    return bent


def test_a_map_renames_joints_and_drops_them(tmp_path: Path) -> None:
    write(tmp_path / "m.bvh", DIALECTS["mixamo"], steps())
    text = (tmp_path / "m.bvh").read_text().replace("mixamorig:LeftLeg", "mixamorig:Tail")
    (tmp_path / "m.bvh").write_text(text)
    with pytest.raises(InputError, match="a joint for left_knee"):
        import_motion(tmp_path / "m.bvh")
    chosen = ImportOptions(joints=(("left_knee", "mixamorig:Tail"), ("head", "")))
    got = import_motion(tmp_path / "m.bvh", chosen)
    assert apart(list(got.sequence), steps())["limbs"] < MOST
    assert not got.sequence[4].body_pose[14].any(), "the head rests"
    with pytest.raises(InputError, match=r"head: expected a joint of the file: .*found Nose"):
        import_motion(tmp_path / "m.bvh", ImportOptions(joints=(("head", "Nose"),)))


def test_unit_rate_and_floor_are_what_was_chosen(tmp_path: Path) -> None:
    read = mixamo(tmp_path, unit="cm", fps=60.0, floor="file")
    assert read.sequence.fps == 60
    assert {guess.option for guess in read.guesses if guess.why.startswith("chosen")} == {"unit", "fps", "floor"}
    doubled = mixamo(tmp_path, unit="0.02").sequence
    rise = [np.ptp([frame.translation[1] for frame in motion]) for motion in (read.sequence, doubled)]
    assert rise[1] == pytest.approx(2 * rise[0])


SITTING = {
    f"{side}_{part}": (angle, 0.0, 0.0) for side in ("left", "right") for part, angle in (("hip", -1.5), ("knee", 1.5))
}


def test_a_rest_pose_is_read_as_chosen(tmp_path: Path) -> None:
    """A rest pose that sits is guessed as a bundle of bones, one that stands as a person's: the other may be chosen."""
    for dialect, guessed, rest, value in (
        (replace(DIALECTS["mixamo"], rest_pose=SITTING), "a bundle of bones", "pose", "a person's"),
        (DIALECTS["mixamo"], "a person's", "bones", "a bundle of bones"),
    ):
        write(tmp_path / "m.bvh", dialect, steps())
        free, chosen = (import_motion(tmp_path / "m.bvh", ImportOptions(rest=option)) for option in ("", rest))
        lines = [next(guess for guess in read.guesses if guess.option == "rest") for read in (free, chosen)]
        assert [line.value for line in lines] == [guessed, value]
        assert [line.why.startswith("chosen") for line in lines] == [False, True]
        assert not chosen.warnings
        assert apart(list(chosen.sequence), steps())["limbs"] < 0.1
        assert not np.allclose(free.sequence[3].body_pose, chosen.sequence[3].body_pose), "it does something"


def test_a_sitting_rest_pose_that_was_chosen_brings_the_motion_as_it_was(tmp_path: Path) -> None:
    write(tmp_path / "m.bvh", replace(DIALECTS["mixamo"], rest_pose=SITTING), steps())
    read = import_motion(tmp_path / "m.bvh", ImportOptions(rest="pose"))
    assert max(apart(list(read.sequence), steps()).values()) < MOST
    assert max(largest for _, largest in read.errors.values()) < MOST


def test_a_rest_pose_between_the_axes_has_axes_across_each_other(tmp_path: Path) -> None:
    between = Rotation.from_euler("ZX", [15.0, 18.0], degrees=True).as_matrix()
    write(tmp_path / "m.bvh", replace(DIALECTS["mixamo"], rest=between, world=between), steps())
    read = import_motion(tmp_path / "m.bvh", ImportOptions(rest="pose", up="+Y"))
    for frame in read.sequence:
        assert np.isfinite(frame.full_pose()).all()
    assert max(largest for _, largest in read.errors.values()) < 1


def test_hips_along_the_trunk_are_no_pose(tmp_path: Path) -> None:
    write(tmp_path / "m.bvh", DIALECTS["mixamo"], steps())
    text = (tmp_path / "m.bvh").read_text()
    text = re.sub(
        r"(RightUpLeg\s+\{\s+OFFSET)[^\n]*", r"\1 0 9 0", re.sub(r"(LeftUpLeg\s+\{\s+OFFSET)[^\n]*", r"\1 0 1 0", text)
    )
    (tmp_path / "m.bvh").write_text(text)
    with pytest.raises(InputError, match=r"m\.bvh: rest: expected a pose whose hips lie across the trunk \(or bones\)"):
        import_motion(tmp_path / "m.bvh", ImportOptions(rest="pose"))


def test_toes_that_bend_as_none_do_are_limited(tmp_path: Path) -> None:
    truth = []
    for frame in steps():
        pose = frame.body_pose.copy()
        pose[9] = [1.5, 0, 0]
        truth.append(frame.replace(body_pose=pose))
    write(tmp_path / "m.bvh", DIALECTS["mixamo"], truth)
    read = import_motion(tmp_path / "m.bvh")
    assert read.sequence[0].body_pose[9, 0] <= LIMITS[10, 0, 1] + 1e-9
    assert any(guess.what == "toes" for guess in read.guesses)


def test_locked_feet_stay_where_they_stand(tmp_path: Path) -> None:
    """A foot that slides by 6 cm while it stands does not, and neither bones nor the foot's rotation change."""
    stand = Signals.rest().replace(body_pose=named_pose("stand"))
    slide = [stand.replace(translation=np.array([0.06 * np.sin(k / 8), 0, 0])) for k in range(FRAMES)]
    write(tmp_path / "m.bvh", DIALECTS["mixamo"], slide)
    free, kept = (import_motion(tmp_path / "m.bvh", ImportOptions(lock_feet=on)).sequence for on in (False, True))

    def ankle(motion: SignalSequence) -> np.ndarray:
        places = rest_skeleton().posed(np.stack([f.full_pose() for f in motion]))[1]
        return places[:, INDEX["left_ankle"]] + np.stack([f.translation for f in motion])

    assert np.ptp(ankle(free)[:, 0]) > 0.055
    assert np.ptp(ankle(kept)[:, [0, 2]], axis=0).max() < 0.005
    turned = [
        rest_skeleton().posed(np.stack([f.full_pose() for f in m]))[0][:, INDEX["left_ankle"]] for m in (free, kept)
    ]
    assert np.allclose(turned[0], turned[1], atol=1e-6)


def test_options_are_json_and_refuse_what_cannot_be() -> None:
    options = ImportOptions("+Z", "-Y", "cm", 60.0, (("head", "Kopf"),), "bones", "each", True)
    assert ImportOptions.from_json(options.to_json()) == options
    assert ImportOptions().to_json() == {}
    for wrong, message in (
        ({"up": "up"}, "up: expected one of"), ({"up": "+Y", "forward": "-Y"}, "an axis across up"),
        ({"unit": "ell"}, "unit: expected m, dm"),
        ({"unit": "inf"}, "unit: expected"), ({"fps": 0}, "a rate above 0"), ({"joints": {"tail": "x"}}, "one of pelvis"),
        ({"joints": [1]}, "joints: expected an object"), ({"speed": 1}, "an unknown field"), ({"lock_feet": 1}, "true or false"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=re.escape(message)):
            ImportOptions.from_json(wrong)
