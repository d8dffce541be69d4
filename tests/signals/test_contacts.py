"""Library poses touch what they should, on the default person's skin (bare; the packaged subject is clothed a centimetre above)."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.library import POSES, hands_of_pose, named_pose
from avatarrex.templates.model import pose_by_signals, skinned_normals
from avatarrex.templates.person import load_person

BODY = load_person().body
OWNER = BODY.weights.argmax(1).numpy()
REST = BODY.v_template.numpy()
SKIN = np.isin(np.arange(len(REST)), BODY.groups["body"].numpy())
FINGERS = ("index", "middle", "ring", "pinky", "thumb")
TOUCHING = ("hands_on_hips", "crossed_arms", "think", "clasped_hands", "salute", "hand_on_heart", "facepalm")


def of(*names: str) -> np.ndarray:
    """The skin that moves most with joints whose names begin with one of `names`."""
    rows = [row for row, name in enumerate(JOINT_NAMES) if name.startswith(names)]
    return np.flatnonzero(np.isin(OWNER, rows) & SKIN)


def hand(side: str) -> np.ndarray:
    """Palm and fingers."""
    return of(f"{side}_wrist", *(f"{side}_{finger}" for finger in FINGERS))


def palm(side: str) -> np.ndarray:
    """The inner side of the palm: what faces down at rest."""
    rows = of(f"{side}_wrist")
    return rows[(BODY.normals.numpy()[rows, 1] < -0.5) & (np.abs(REST[rows, 0]) > 0.74)]


def near(rest: tuple[float, float, float], radius: float) -> np.ndarray:
    """The skin around a place of the rest pose."""
    return np.flatnonzero((np.linalg.norm(REST - rest, axis=1) < radius) & SKIN)


@cache
def posed(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and normals."""
    signals = Signals.rest().replace(body_pose=named_pose(name), **hands_of_pose(name))
    model = pose_by_signals(BODY, signals)
    return model.vertices.numpy(), skinned_normals(BODY, model).numpy()


def gap(name: str, one: np.ndarray, other: np.ndarray) -> float:
    """Metres between the nearest points."""
    points = posed(name)[0]
    return float(cKDTree(points[one]).query(points[other])[0].min())


def depth(name: str, side: str) -> float:
    """How deep a hand is in the rest of the body and in the other arm, metres."""
    points, normals = posed(name)
    mine = hand(side)
    others = np.setdiff1d(np.flatnonzero(SKIN), of(f"{side}_wrist", f"{side}_elbow", *(f"{side}_{f}" for f in FINGERS)))
    distance, nearest = cKDTree(points[others]).query(points[mine])
    within = -((points[mine] - points[others[nearest]]) * normals[others[nearest]]).sum(1)
    return float(np.where(distance < 0.04, within, 0).max())


@pytest.mark.parametrize("side", ["left", "right"])
def test_hands_on_hips_lie_on_the_hips(side: str) -> None:
    hip = near((0.17 if side == "left" else -0.17, 0.075, 0.01), 0.07)
    assert gap("hands_on_hips", palm(side), hip) < 0.02


def test_a_thinker_has_index_and_thumb_on_the_chin() -> None:
    chin = near((0.0, 0.62, 0.14), 0.035)
    for finger in ("right_index3", "right_thumb3"):
        assert gap("think", of(finger), chin) < 0.015, finger
    assert gap("think", hand("left"), of("right_elbow")) < 0.02, "the other hand carries the elbow"


def test_clasped_fingers_alternate() -> None:
    """The first bones of the fingers cross in the order right, left, right, … from the index."""
    points, _ = posed("clasped_hands")
    order = ("index", "middle", "ring", "pinky")
    centres = {side: [points[of(f"{side}_{finger}1")].mean(0) for finger in order] for side in ("right", "left")}
    across = np.diff([centres["right"][0], centres["right"][3]], axis=0)[0]
    along = [float(centre @ across) for pair in zip(centres["right"], centres["left"]) for centre in pair]
    assert along == sorted(along)
    assert gap("clasped_hands", hand("left"), hand("right")) < 0.003


def test_crossed_arms_lie_on_each_other() -> None:
    assert gap("crossed_arms", palm("right"), of("left_elbow", "left_shoulder")) < 0.02
    assert gap("crossed_arms", hand("left"), of("right_elbow", "right_shoulder")) < 0.02
    for side, other in (("left", "right"), ("right", "left")):
        points, _ = posed("crossed_arms")
        elbow, wrist = points[of(f"{side}_elbow")].mean(0), points[of(f"{side}_wrist")].mean(0)
        slope = np.degrees(np.arctan2(wrist[1] - elbow[1], np.abs(wrist[0] - elbow[0])))
        assert abs(slope) < 25, "forearms are level, no X"
        assert np.sign(wrist[0]) == (1 if other == "left" else -1), "each hand is on the other's side"


def test_a_knee_and_its_toes_are_on_the_floor() -> None:
    points, _ = posed("kneel")
    floor = points[of("left_ankle", "left_foot"), 1].min()
    assert abs(points[of("right_knee", "right_hip"), 1].min() - floor) < 0.01
    assert abs(points[of("right_foot", "right_ankle"), 1].min() - floor) < 0.02


def test_the_other_contacts() -> None:
    assert gap("salute", of("right_index3", "right_middle3"), of("head")) < 0.015
    assert gap("hand_on_heart", palm("right"), near((0.05, 0.36, 0.14), 0.05)) < 0.02
    assert gap("facepalm", of("right_index3", "right_middle3"), near((0, 0.77, 0.13), 0.05)) < 0.015


@pytest.mark.parametrize("name", [*TOUCHING, "sit", "kneel", "stand", "hands_up"])
def test_no_hand_is_deep_in_the_body(name: str) -> None:
    assert name in POSES
    for side in ("left", "right"):
        assert depth(name, side) < 0.01, side
