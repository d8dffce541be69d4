"""Handles reach what is in reach within the limits, stay calm where nothing is, and leave alone what is pinned."""

from __future__ import annotations

import numpy as np
import pytest

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.handles import FORWARD, GAZE, HANDLES, Pull, looking, place, pulled
from avatarrex.signals.ik import Aim, Orient, Place, Problem, left_jacobian, solve
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.library import named_pose
from avatarrex.signals.limits import LIMITS, violations
from avatarrex.signals.rest_skeleton import rest_skeleton
from avatarrex.signals.skeleton import Skeleton

SKELETON = Skeleton(rest_skeleton().joints, rest_skeleton().parents)
STAND = Signals.rest().replace(body_pose=named_pose("stand"))
REACHING = ["left_hand", "right_hand", "left_foot", "right_elbow", "left_knee", "head"]


def at(signals, name):
    return place(SKELETON, SKELETON.posed(signals), name)


def drag(start, name, target, steps=6, pins=frozenset()):
    """`start` with a handle dragged straight to a target, as a mouse does; every pose on the way."""
    poses, begin = [start], at(start, name)
    for step in range(1, steps + 1):
        pull = Pull(name, begin + (target - begin) * step / steps)
        poses.append(pulled(SKELETON, poses[-1], pull, pins, start))
    return poses


def random_reachable(rng, name):
    """A place that the handle's own joints reach from `STAND` within their limits."""
    joints = [JOINT_NAMES.index(joint) for joint in HANDLES[name].follow]
    pose = STAND.full_pose()
    pose[joints] = rng.uniform(*np.moveaxis(LIMITS[joints], 2, 0))
    return at(Signals.from_full_pose(pose), name)


@pytest.mark.parametrize("name", REACHING)
def test_a_handle_reaches_what_is_in_reach(name):
    """Of 12 places at least 11 within a centimetre, all within three, each within the limits and with nothing else moved."""
    rng, misses = np.random.default_rng(7), []
    for _ in range(12):
        target = random_reachable(rng, name)
        end = drag(STAND, name, target)[-1]
        misses.append(np.linalg.norm(at(end, name) - target))
        assert not violations(end)
        others = [k for k, joint in enumerate(JOINT_NAMES) if joint not in (*HANDLES[name].follow, HANDLES[name].end)]
        assert np.array_equal(end.full_pose()[others], STAND.full_pose()[others])
    assert np.mean(np.array(misses) < 0.01) >= 11 / 12
    assert max(misses) < 0.03
    assert np.median(misses) < 0.002


@pytest.mark.parametrize("limited", [True, False])
def test_a_joint_beyond_its_limits_does_not_jump(limited):
    """An imported knee of 2.7 rad, a shoulder turned past half a turn: pulled to where it is, and a little further."""
    pose = STAND.full_pose()
    pose[JOINT_NAMES.index("left_knee"), 0] = 2.7
    pose[JOINT_NAMES.index("left_shoulder"), 1] = 4.0
    signals = Signals.from_full_pose(pose)
    for name in ("left_foot", "left_hand"):
        here = at(signals, name)
        still = pulled(SKELETON, signals, Pull(name, here), prior=signals, limited=limited)
        assert np.abs(still.full_pose() - signals.full_pose()).max() < 1e-6
        near = pulled(SKELETON, signals, Pull(name, here + 0.01), prior=signals, limited=limited)
        assert np.abs(near.full_pose() - signals.full_pose()).max() < 0.3


@pytest.mark.parametrize("name", ["left_hand", "left_knee"])
def test_out_of_reach_a_limb_points_there_without_jumps(name):
    """Round a circle far out of reach: as near as any pose of many, small steps, and the same pose after a round."""
    follow = [JOINT_NAMES.index(joint) for joint in HANDLES[name].follow]
    far = at(STAND, name) + np.array([0.0, 0.0, 1.5])
    circle = [far + 0.3 * np.array([np.sin(t), np.cos(t), 0]) for t in np.linspace(0, 4 * np.pi, 81)]
    signals, rounds = drag(STAND, name, circle[0])[-1], []
    for target in circle:
        after = pulled(SKELETON, signals, Pull(name, target), prior=STAND)
        assert np.abs(after.full_pose() - signals.full_pose())[follow].max() < 0.1, (
            "5 cm of the mouse turn no joint by 6°"
        )
        signals = after
        rounds.append(signals.full_pose())
    assert np.abs(rounds[40] - rounds[0]).max() < 0.1
    rng = np.random.default_rng(3)
    nearest = min(np.linalg.norm(random_reachable(rng, name) - circle[-1]) for _ in range(200))
    assert np.linalg.norm(at(signals, name) - circle[-1]) < nearest + 0.01


def test_a_straight_leg_folds_towards_its_own_hip():
    straight = Signals.rest()
    target = at(straight, "left_foot") + np.array([0.0, 0.006, 0.0])
    assert np.linalg.norm(at(pulled(SKELETON, straight, Pull("left_foot", target)), "left_foot") - target) < 0.002


def test_what_is_pulled_moves_though_it_is_pinned():
    target = at(STAND, "left_hand") + np.array([0.0, 0.2, 0.1])
    end = drag(STAND, "left_hand", target, pins=frozenset({"left_hand"}))[-1]
    assert np.linalg.norm(at(end, "left_hand") - target) < 0.01


def test_a_target_that_stays_gives_a_pose_that_stays():
    for target in (np.array([0.3, 0.3, 0.3]), np.array([0.9, 1.8, 0.9])):
        signals = drag(STAND, "left_hand", target)[-1]
        again = pulled(SKELETON, signals, Pull("left_hand", target), prior=STAND)
        assert np.abs(again.full_pose() - signals.full_pose()).max() < 0.02
        assert np.array_equal(
            again.full_pose(), pulled(SKELETON, signals, Pull("left_hand", target), prior=STAND).full_pose()
        )


def test_pinned_hands_and_feet_stay_while_the_pelvis_moves():
    pins = frozenset({"left_foot", "right_foot", "left_hand"})
    begin = at(STAND, "pelvis")
    down = drag(STAND, "pelvis", begin + np.array([0.08, -0.3, 0.04]), 15, pins)[-1]
    assert np.linalg.norm(at(down, "pelvis") - begin - [0.08, -0.3, 0.04]) < 0.01
    up = drag(STAND, "pelvis", begin + np.array([0.0, 0.3, 0.0]), 15, pins)[-1]
    for signals in (down, up):
        assert not violations(signals)
        for joint in ("left_foot", "right_foot", "left_wrist"):
            place, before = (SKELETON.posed(each).position[JOINT_NAMES.index(joint)] for each in (signals, STAND))
            assert np.linalg.norm(place - before) < 0.002
    assert np.linalg.norm(at(up, "left_foot") - at(STAND, "left_foot")) < 0.002, "no heel lifts"
    assert np.linalg.norm(at(up, "pelvis") - begin) < 0.05, "no higher than the legs"
    free = drag(STAND, "pelvis", begin + np.array([0.0, 0.3, 0.0]), 3)[-1]
    assert np.array_equal(free.full_pose(), STAND.full_pose())
    assert at(free, "left_foot") - at(STAND, "left_foot") == pytest.approx([0, 0.3, 0], abs=1e-3)


def test_in_a_deep_squat_the_heels_lift_and_the_toes_stay_level():
    """The pelvis follows half a metre down, where a flat foot would need more than the ankle can bend."""
    pins = frozenset({"left_foot", "right_foot"})
    begin = at(STAND, "pelvis")
    down = drag(STAND, "pelvis", begin + np.array([0.0, -0.5, 0.0]), 12, pins)[-1]
    assert np.linalg.norm(at(down, "pelvis") - begin - [0.0, -0.5, 0.0]) < 0.03
    before, after = SKELETON.posed(STAND), SKELETON.posed(down)
    for side in ("left", "right"):
        ankle, ball = (JOINT_NAMES.index(f"{side}_{name}") for name in ("ankle", "foot"))
        assert np.linalg.norm(after.position[ball] - before.position[ball]) < 0.004
        assert after.position[ankle, 1] > before.position[ankle, 1] - 0.002
        tip = after.rotation[ball] @ before.rotation[ball].T @ np.array([0.0, 0.0, 0.1])
        assert tip[1] > -0.01, "toes of 10 cm end less than a centimetre lower"


def test_a_pinned_hand_stays_while_the_head_is_pulled():
    pins = frozenset({"left_hand", "left_foot"})
    end = drag(STAND, "head", at(STAND, "head") + np.array([0.1, -0.1, 0.2]), 10, pins)[-1]
    assert np.linalg.norm(at(end, "left_hand") - at(STAND, "left_hand")) < 0.002
    loose = drag(STAND, "head", at(STAND, "head") + np.array([0.1, -0.1, 0.2]), 10)[-1]
    assert np.linalg.norm(at(loose, "left_hand") - at(STAND, "left_hand")) > 0.01
    assert np.array_equal(end.body_pose[[0, 3]], STAND.body_pose[[0, 3]]), "legs are not in it"


@pytest.mark.parametrize("target", [(0.5, 0.7, 1.0), (0.0, 0.2, 1.0), (-2.0, 0.7, 0.5), (1.0, 1.2, 3.0)])
def test_the_eyes_look_at_a_place(target):
    signals = looking(SKELETON, STAND, np.array(target))
    posed = SKELETON.posed(signals)
    for eye in (JOINT_NAMES.index(name) for name in GAZE):
        way = np.array(target) - posed.position[eye]
        assert posed.rotation[eye] @ FORWARD @ way > np.cos(np.radians(1)) * np.linalg.norm(way)
    assert not violations(signals)
    assert np.abs(signals.body_pose[14]).max() > 0.02, "the head turns, too"


def test_the_jacobian_is_that_of_finite_differences():
    rng = np.random.default_rng(0)
    free = tuple(
        JOINT_NAMES.index(name) for name in ("spine2", "left_collar", "left_shoulder", "left_elbow", "left_wrist")
    )
    wrist, pose = free[-1], rng.normal(0, 0.5, (55, 3))
    goals = (
        Place(wrist, np.array([0.3, 0.2, 0.4]), np.array([0.1, 0.0, 0.02])),
        Orient(wrist, SKELETON.turned(pose, np.zeros(3)).rotation[wrist]),
        Aim(wrist, np.array([1e6, 0.0, 0.0]), FORWARD),
    )
    from avatarrex.signals.ik import _Search

    search = _Search(Problem(SKELETON, free, goals, moves=True, limited=False), pose, np.zeros(3), (pose, np.zeros(3)))
    x, step = search.begin, 1e-6
    jacobian = search._jacobian(x, search._posed(x))
    for k in range(len(x)):
        ahead, behind = (
            search._off(y, search._posed(y)) for y in (x + step * np.eye(len(x))[k], x - step * np.eye(len(x))[k])
        )
        assert (behind - ahead) / (2 * step) == pytest.approx(jacobian[:, k], abs=1e-5)


def test_the_left_jacobian_of_no_turn_is_the_identity():
    assert left_jacobian(np.zeros((1, 3)))[0] == pytest.approx(np.eye(3))


def test_without_limits_a_joint_passes_them():
    target = np.array([-0.5, 0.3, -0.2])
    free = pulled(SKELETON, STAND, Pull("left_hand", target), limited=False)
    assert violations(free)
    assert np.linalg.norm(at(free, "left_hand") - target) < np.linalg.norm(
        at(pulled(SKELETON, STAND, Pull("left_hand", target)), "left_hand") - target
    )


def test_nothing_free_is_nothing_moved():
    solution = solve(Problem(SKELETON, (), [Place(20, np.zeros(3))]), STAND.full_pose(), np.zeros(3))
    assert np.array_equal(solution.pose, STAND.full_pose())


def test_an_unknown_handle_is_refused():
    with pytest.raises(InputError):
        pulled(SKELETON, STAND, Pull("tail", np.zeros(3)))
