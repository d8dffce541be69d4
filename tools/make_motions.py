"""Writes the motions that come with the program, `avatarrex/data/motions/NAME.npz`: formulas and key poses of our own.

    python tools/make_motions.py

Each is a loop: the frame after the last is the first. Stored as captures are (`body_pose` … `arkit52`, half precision), so that the
path and the face come back as written. Radians, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from avatarrex.signals.contacts import locked
from avatarrex.signals.driving import Signals
from avatarrex.signals.ground import grounded
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES, JOINT_ROWS
from avatarrex.signals.library import named_expression, named_hand, named_pose

FOLDER = Path(__file__).parents[1] / "avatarrex" / "data" / "motions"
FPS = 30
BLINK = 0.16
"""Seconds of a blink's half width."""
J = {name: j for j, name in enumerate(JOINT_NAMES)}


def standing(count: int) -> np.ndarray:
    """(count, 55, 3) standing with relaxed hands."""
    pose = np.zeros((55, 3))
    pose[JOINT_ROWS["body_pose"]] = named_pose("stand")
    for side in ("left", "right"):
        pose[JOINT_ROWS[f"{side}_hand_pose"]] = named_hand("relaxed", side)
    return np.tile(pose, (count, 1, 1))


def turns(seconds: float, cycles: int, lag: float = 0.0) -> np.ndarray:
    """(t,) phases of `cycles` whole turns, `lag` of one later."""
    return 2 * np.pi * (cycles * np.arange(round(seconds * FPS)) / round(seconds * FPS) - lag)


def blinking(seconds: float, *moments: float) -> np.ndarray:
    """(t, 52) eyelids that close at some moments."""
    times = np.arange(round(seconds * FPS)) / FPS
    closed = sum(np.clip(1 - np.abs(times - moment) / BLINK, 0, 1) ** 0.7 for moment in moments)
    face = np.zeros((len(times), 52))
    for side in ("Left", "Right"):
        face[:, EXPRESSION_NAMES.index(f"eyeBlink{side}")] = closed
    return face


def eased(times: np.ndarray, start: float, end: float) -> np.ndarray:
    """0 before `start`, 1 after `end`, smooth between."""
    x = np.clip((times - start) / (end - start), 0, 1)
    return x * x * (3 - 2 * x)


def idle() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eight seconds: two breaths, the weight goes from one leg to the other and back."""
    seconds = 8.0
    sway, breath = turns(seconds, 1), turns(seconds, 2)
    pose = standing(len(sway))
    move = np.zeros((len(sway), 3))
    move[:, 0] = 0.018 * np.sin(sway)
    pose[:, J["pelvis"], 2] += 0.012 * np.sin(sway)
    pose[:, J["spine2"], 2] -= 0.018 * np.sin(sway)
    for name, share in (("spine2", 0.012), ("spine3", 0.016), ("neck", -0.014)):
        pose[:, J[name], 0] += share * np.sin(breath)
    for side, sign in (("left", 1), ("right", -1)):
        pose[:, J[f"{side}_collar"], 2] += sign * 0.012 * np.sin(breath)
        pose[:, J[f"{side}_shoulder"], 1] -= sign * 0.02 * np.sin(sway + 0.6)
        pose[:, J[f"{side}_elbow"], 1] -= sign * 0.03 * (1 + np.sin(breath - 0.8))
    pose[:, J["head"], 1] += 0.10 * np.sin(sway - 0.9)
    pose[:, J["head"], 0] += 0.02 * np.sin(sway * 2 + 0.4)
    return pose, move, blinking(seconds, 1.7, 5.1, 5.5)


def wave() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Four seconds: the right hand rises, waves four times with a smile, and sinks."""
    seconds = 4.0
    times = np.arange(round(seconds * FPS)) / FPS
    up = eased(times, 0.2, 0.9) - eased(times, 3.0, 3.8)
    pose, raised = standing(len(times)), standing(1)[0]
    raised[JOINT_ROWS["body_pose"]] = named_pose("wave")
    raised[JOINT_ROWS["right_hand_pose"]] = named_hand("spread", "right") * 0.6
    arm = [J[f"right_{part}"] for part in ("collar", "shoulder", "elbow", "wrist")]
    arm += range(*JOINT_ROWS["right_hand_pose"].indices(55))
    pose[:, arm] += up[:, None, None] * (raised - standing(1)[0])[arm]
    swing = np.sin(2 * np.pi * 2.0 * (times - 0.9)) * (eased(times, 0.8, 1.1) - eased(times, 2.8, 3.1))
    pose[:, J["right_elbow"], 2] += 0.22 * swing
    pose[:, J["right_wrist"], 2] += 0.20 * swing
    pose[:, J["spine3"], 2] += 0.03 * up
    pose[:, J["head"], 2] -= 0.06 * up
    pose[:, J["head"], 1] -= 0.05 * up
    face = blinking(seconds, 0.5) + 0.75 * up[:, None] * named_expression("smile")
    return pose, np.zeros((len(times), 3)), np.clip(face, 0, 1)


def walk() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two strides in place: heel, stance and swing of each leg half a turn apart, arms against the legs."""
    seconds = 2.2
    stride = turns(seconds, 2)
    pose = standing(len(stride))
    for side, sign in (("left", 1), ("right", -1)):
        phase = stride + (0 if side == "left" else np.pi)
        swings = np.clip(np.sin(phase + 0.5), 0, None)
        pose[:, J[f"{side}_hip"], 0] = -0.06 - 0.36 * np.cos(phase)
        pose[:, J[f"{side}_knee"], 0] = 0.10 + 0.80 * np.clip(-np.sin(phase - 0.35), 0, None) ** 1.5 + 0.08 * swings
        pose[:, J[f"{side}_ankle"], 0] = -(pose[:, J[f"{side}_hip"], 0] + pose[:, J[f"{side}_knee"], 0]) * 0.75
        pose[:, J[f"{side}_foot"], 0] = -0.25 * np.clip(np.cos(phase - np.pi + 0.3), 0, None) ** 3
        pose[:, J[f"{side}_shoulder"], 1] += sign * 0.34 * np.cos(phase) - sign * 0.05
        pose[:, J[f"{side}_elbow"], 1] -= sign * (0.25 - 0.15 * np.cos(phase))
    pose[:, J["pelvis"], 1] = -0.07 * np.cos(stride)
    pose[:, J["pelvis"], 2] = 0.03 * np.sin(stride)
    pose[:, J["spine2"], 1] = 0.08 * np.cos(stride)
    pose[:, J["spine3"], 1] = 0.06 * np.cos(stride)
    pose[:, J["neck"], 1] = -0.07 * np.cos(stride)
    return pose, np.zeros((len(stride), 3)), blinking(seconds, 1.2)


def write(name: str, made: tuple[np.ndarray, np.ndarray, np.ndarray], floor: str, lock: bool) -> None:
    """One motion on the floor; the first frame above the origin."""
    pose, move, face = made
    move = grounded(pose, move, floor, FPS)
    if lock:
        # three rounds of the loop, so that its ends meet
        pose, count = locked(np.tile(pose, (3, 1, 1)), np.tile(move, (3, 1)), FPS), len(pose)
        pose = pose[count : 2 * count]
    Signals.from_full_pose(pose[0], translation=move[0], expression=face[0])  # what cannot be is refused here
    parts = {
        part: pose[:, JOINT_ROWS[part]].reshape(len(pose), -1)
        for part in ("global_orient", "body_pose", "left_hand_pose", "right_hand_pose")
    }
    arrays = {**parts, "transl": move, "arkit52": face}
    FOLDER.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        FOLDER / f"{name}.npz", fps=np.array(FPS), **{key: value.astype(np.float16) for key, value in arrays.items()}
    )


MAKERS: dict[str, tuple[Callable[[], tuple[np.ndarray, np.ndarray, np.ndarray]], str, bool]] = {
    "idle": (idle, "contacts", True),
    "wave": (wave, "contacts", False),
    "walk": (walk, "each", False),
}

if __name__ == "__main__":
    for name, (maker, floor, lock) in MAKERS.items():
        write(name, maker(), floor, lock)
        print(FOLDER / f"{name}.npz", (FOLDER / f"{name}.npz").stat().st_size)
