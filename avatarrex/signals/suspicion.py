"""What looks wrong in a motion that was read, each with the option that puts it right. Letters: t frames."""

from __future__ import annotations

import numpy as np

from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.limits import LIMITS
from avatarrex.signals.rest_skeleton import rest_skeleton

LIES = 50.0
"""Degrees from upright beyond which the mean body lies: a bow and a crouch stay below."""
BEYOND = np.radians(60.0)
"""Past a joint's limit: farther than measuring or another skeleton explains."""
FASTEST = 15.0
"""Metres a second; sprinters reach 12."""
MOST_NAMED = 4
"""Joints that one warning names."""


def suspicions(pose: np.ndarray, translation: np.ndarray, fps: float) -> list[str]:
    """Warnings about (t, 55, 3) rotation vectors and (t, 3) translations, before toes are limited."""
    return [*_lies(pose), *_beyond(pose), *_haste(translation, fps)]


def lean(pose: np.ndarray) -> float:
    """Degrees between upright and the mean direction of hips to shoulders."""
    places = rest_skeleton().posed(pose)[1]
    ends = [
        places[:, [JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right")]].mean(1)
        for name in ("shoulder", "hip")
    ]
    trunk = ends[0] - ends[1]
    mean = (trunk / np.linalg.norm(trunk, axis=1, keepdims=True)).mean(0)
    return float(np.degrees(np.arctan2(np.hypot(mean[0], mean[2]), mean[1])))


def _lies(pose: np.ndarray) -> list[str]:
    angle = lean(pose)
    if angle < LIES:
        return []
    return [f"the mean body lies, {angle:.0f}° from upright: if it should stand, choose another up (--up +Y, +Z …)"]


def _beyond(pose: np.ndarray) -> list[str]:
    """Joints that pass a limit by `BEYOND`."""
    over = np.maximum(LIMITS[:, :, 0] - pose, pose - LIMITS[:, :, 1]).max(2)
    over[:, 0] = 0
    worst = over.max(0)
    named = [int(j) for j in np.argsort(-worst) if worst[j] > BEYOND]
    if not named:
        return []
    words = [
        f"{JOINT_NAMES[j]} by {np.degrees(worst[j]):.0f}° in frame {int(over[:, j].argmax())}"
        for j in named[:MOST_NAMED]
    ]
    more = f" and {len(named) - MOST_NAMED} more" if len(named) > MOST_NAMED else ""
    remedy = "another joint may be meant (--map FILE.json), or the rest pose is read wrongly (--rest bones or pose)"
    return [f"past its limit: {', '.join(words)}{more}: {remedy}"]


def _haste(translation: np.ndarray, fps: float) -> list[str]:
    """Where the root goes faster than anybody runs, the path is in another unit."""
    speed = np.linalg.norm(np.diff(translation, axis=0), axis=1) * fps
    usual = float(np.quantile(speed, 0.9)) if len(speed) else 0.0
    if usual <= FASTEST:
        return []
    name, short = ("millimetres", "mm") if usual > 30 * FASTEST else ("centimetres", "cm")
    return [
        f"the root goes at {usual:.0f} metres a second: the path looks like {name} (--unit {short}, or another --fps)"
    ]
