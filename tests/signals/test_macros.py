"""Macros: a slider over several numbers shows what it set, and moves nothing else."""

import numpy as np
import pytest

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, FINGERS, HAND_JOINTS
from avatarrex.signals.library import mirror, named_expression, named_hand
from avatarrex.signals.limits import clamp
from avatarrex.signals.macros import (
    FACE_MACROS,
    HAND_MACROS,
    face_direction,
    face_value,
    hand_mean,
    hand_values,
    set_face,
    set_hand,
)

FACE = [name for group in FACE_MACROS.values() for name in group]
RNG = np.random.default_rng(7)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("macro", HAND_MACROS)
@pytest.mark.parametrize("finger", FINGERS)
def test_a_finger_shows_what_was_set_and_its_other_macro_stays(finger: str, macro: str, side: str) -> None:
    pose = RNG.normal(size=(15, 3)) * 0.3
    before = hand_values(pose, side)
    after = hand_values(set_hand(pose, side, (finger,), macro, 0.6), side)
    assert after[finger, macro] == pytest.approx(0.6)
    others = [key for key in before if key != (finger, macro)]
    assert all(after[key] == pytest.approx(before[key]) for key in others)


def test_what_a_macro_does_not_reach_stays() -> None:
    pose = RNG.normal(size=(15, 3))
    changed = set_hand(pose, "left", ("index",), "curl", 0.9)
    rows = [row for row, name in enumerate(HAND_JOINTS) if not name.startswith("index")]
    assert np.array_equal(pose[rows], changed[rows])
    there_and_back = set_hand(changed, "left", ("index",), "curl", hand_values(pose, "left")["index", "curl"])
    assert np.allclose(there_and_back, pose), "the way back loses nothing"


def test_all_fingers_move_together() -> None:
    pose = named_hand("point", "left")
    before, fingers = hand_values(pose, "left"), FINGERS[:4]
    after = hand_values(set_hand(pose, "left", fingers, "curl", 0.9), "left")
    assert hand_mean(after, fingers, "curl") == pytest.approx(0.9)
    steps = [after[finger, "curl"] - before[finger, "curl"] for finger in fingers]
    assert np.ptp(steps) < 1e-9, "each by the same"


def test_a_right_hand_is_a_left_one_in_the_mirror() -> None:
    for macro in HAND_MACROS:
        hands = {
            f"{side}_hand_pose": set_hand(np.zeros((15, 3)), side, FINGERS, macro, 0.7) for side in ("left", "right")
        }
        signals = Signals.rest().replace(**hands)
        assert mirror(signals) == signals


def test_curl_closes_a_fist_and_keeps_to_the_limits() -> None:
    values = hand_values(named_hand("fist", "left"), "left")
    assert all(values[finger, "curl"] > 0.75 for finger in FINGERS[:4])
    assert hand_values(named_hand("spread", "left"), "left")["pinky", "spread"] > 0.7
    closed = set_hand(np.zeros((15, 3)), "left", FINGERS, "curl", 1.0)
    signals = Signals.rest().replace(left_hand_pose=closed)
    assert np.degrees(np.abs(clamp(signals).left_hand_pose - closed)).max() < 6


@pytest.mark.parametrize("macro", FACE)
def test_a_face_macro_shows_what_was_set(macro: str) -> None:
    for value in (0.0, 0.35, 1.0):
        start = RNG.random(52) * (RNG.random(52) < 0.4)
        changed = set_face(start, macro, value)
        assert face_value(changed, macro) == pytest.approx(value, abs=1e-9)
        assert changed.min() >= 0
        assert changed.max() <= 1
        untouched = face_direction(macro) == 0
        assert np.array_equal(changed[untouched], start[untouched])


def test_a_face_at_rest_gets_the_macro_itself_and_says_so() -> None:
    assert np.allclose(set_face(np.zeros(52), "surprise", 0.5), 0.5 * face_direction("surprise"))
    assert face_value(named_expression("blink"), "blink") == pytest.approx(1)
    assert face_value(named_expression("blink"), "smile") == 0
    wink = np.zeros(52)
    wink[EXPRESSION_NAMES.index("eyeBlinkLeft")] = 1
    assert face_value(wink, "blink") == pytest.approx(0.5)


def test_unknown_macros_are_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"one of smile, .*blink.*, found grimace"):
        set_face(np.zeros(52), "grimace", 1)
    with pytest.raises(InputError, match=r"curl or spread of .*found twist of index"):
        set_hand(np.zeros((15, 3)), "left", ("index",), "twist", 1)
    with pytest.raises(InputError, match="left or right, found middle"):
        set_hand(np.zeros((15, 3)), "middle", ("index",), "curl", 1)
