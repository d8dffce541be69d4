"""A file's rest pose that is a person's: T, A or arms down. Its axes, and how each of our joints rests in it.

B of a joint takes our rest directions to the file's, so that ours is (file's global rotation) · B. With X the rotation from the
file's axes to ours, B is Xᵀ · A. A is the identity for pelvis, spine, collars, neck, head, jaw and eyes: these rest alike in every
file. For a limb A takes our bone's direction to the file's, starting from the parent's A, so that T- and A-poses meet and twist is
carried along the limb; a palm with fingers gives its whole frame; a foot, flat at rest, gives its heading. A foot that dangles at
rest and a collar that rises along the spine are no pose: bone_frames.py reads them.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.signals.direction import TINY, degrees_between, frame_turn, smallest_turn, unit
from avatarrex.signals.joint_names import ancestors
from avatarrex.signals.joints import FINGERS, JOINT_NAMES
from avatarrex.signals.rest_skeleton import rest_skeleton
from avatarrex.signals.source_motion import END, SourceMotion

LIMBS = (("", "hip", "knee"), ("hip", "knee", "ankle"), ("", "shoulder", "elbow"), ("shoulder", "elbow", "wrist"))
"""Joint before, joint and joint after it."""
OPPOSITE = 130.0
"""Degrees: trunk and thighs of a standing rest pose point farther apart (ours 175, sitting 90, a bundle of bones 0)."""
SNAPS = 20.0
"""Degrees from an axis of the file within which a rest pose stands along it."""
DANGLES = 35.0
"""Degrees between shin and foot from which on a foot is flat (ours 72; 45 in the steepest rig seen, MakeHuman's 60)."""
ACROSS = 0.02
"""Least share of the hips' line that is across the trunk, to give axes at all."""
RISES = 65.0
"""Degrees between a collar bone and the line of the shoulders from which on the bone is no collar's at rest (ours 14)."""

BENT_WRIST = 45.0
"""Degrees between forearm and hand at rest beyond which an end site is no fingertip."""


def rest_axes(source: SourceMotion, found: dict[str, int], chosen: bool = False) -> np.ndarray | None:
    """Rotation (3, 3) from the file's axes to ours (+X left, +Y up, +Z forward) at rest; None where no person rests so.

    Along the file's own axes where the person nearly is: hips and trunks of rigs lean by some degrees that mean nothing. Where a
    person's pose was `chosen`, it may sit, and None is where hips and trunk lie along one line.
    """
    rest = source.rest
    left = rest[found["left_hip"]] - rest[found["right_hip"]]
    hips = (rest[found["left_hip"]] + rest[found["right_hip"]]) / 2
    trunk = rest[found.get("neck", found["left_shoulder"])] - hips
    thighs = (rest[found["left_knee"]] + rest[found["right_knee"]]) / 2 - hips
    stands = degrees_between(trunk, thighs) >= OPPOSITE
    y = _snapped(trunk - thighs if stands else trunk)
    across = left - (left @ y) * y
    level = np.linalg.norm(across) / max(float(np.linalg.norm(left)), TINY)
    if not y.any() or level < ACROSS:
        return None
    if not chosen and (level < 0.7 or not stands):
        return None
    x = _snapped(across)
    if abs(x @ y) > TINY:
        x = unit(across)
    return np.stack([x, y, np.cross(x, y)])


def _snapped(direction: np.ndarray) -> np.ndarray:
    """(3,) the file's axis that a direction nearly has, or the direction."""
    k = int(np.abs(direction).argmax())
    near = np.eye(3)[k] * np.sign(direction[k])
    return near if degrees_between(direction, near) < SNAPS else unit(direction)


def dangling(source: SourceMotion, found: dict[str, int], axes: np.ndarray) -> list[str]:
    """Our feet and collars whose bones at rest point where no person's do."""
    rest, odd = source.rest @ axes.T, []
    for side in ("left", "right"):
        knee, ankle, foot, collar, shoulder = (f"{side}_{n}" for n in ("knee", "ankle", "foot", "collar", "shoulder"))
        if ankle in found and foot in found:
            shin, sole = rest[found[ankle]] - rest[found[knee]], rest[found[foot]] - rest[found[ankle]]
            odd += [ankle] if sole.any() and degrees_between(shin, sole) < DANGLES else []
        if collar in found:
            bone, across = rest[found[shoulder]] - rest[found[collar]], [1.0 if side == "left" else -1.0, 0, 0]
            odd += [collar] if bone.any() and degrees_between(bone, np.array(across)) > RISES else []
    return odd


def rest_turns(source: SourceMotion, found: dict[str, int], axes: np.ndarray) -> np.ndarray:
    """(55, 3, 3): B of each joint."""
    rest = source.rest @ axes.T
    ours = dict(zip(JOINT_NAMES, rest_skeleton().joints))
    theirs = {name: rest[k] for name, k in found.items()}
    align = dict.fromkeys(JOINT_NAMES, np.eye(3))

    def towards(start: np.ndarray, joint: str, child: str) -> np.ndarray:
        """`start`, turned the least so that our bone joint-child has the file's rest direction."""
        if joint not in theirs or child not in theirs:
            return start
        return np.asarray(smallest_turn(start @ (ours[child] - ours[joint]), theirs[child] - theirs[joint]) @ start)

    def palm(forearm: np.ndarray, side: str) -> np.ndarray:
        """A of a wrist: the palm's frame; without fingers the hand's direction; without either the forearm's."""
        wrist, index, middle, pinky = (f"{side}_{part}" for part in ("wrist", "index1", "middle1", "pinky1"))
        if wrist not in theirs:
            return forearm
        if all(name in theirs for name in (index, middle, pinky)):
            hands = ((joints[middle] - joints[wrist], joints[index] - joints[pinky]) for joints in (ours, theirs))
            return frame_turn(*hands)
        end = hand_tip(source, found, side)
        if end is None:
            return forearm
        return np.asarray(smallest_turn(forearm @ (ours[middle] - ours[wrist]), rest[end] - theirs[wrist]) @ forearm)

    for side in ("left", "right"):
        for before, part, after in LIMBS:
            start = align[f"{side}_{before}"] if before else np.eye(3)
            align[f"{side}_{part}"] = towards(start, f"{side}_{part}", f"{side}_{after}")
        align[f"{side}_wrist"] = palm(align[f"{side}_elbow"], side)
        for finger in FINGERS:
            first, second, third = (f"{side}_{finger}{k}" for k in (1, 2, 3))
            align[first] = towards(align[f"{side}_wrist"], first, second)
            align[second] = align[third] = towards(align[first], second, third)
        ankle, foot = f"{side}_ankle", f"{side}_foot"
        if ankle in theirs and foot in theirs:
            align[ankle] = align[foot] = _heading(ours[foot] - ours[ankle], theirs[foot] - theirs[ankle])
    return np.stack([axes.T @ turn for turn in align.values()])


def tip(source: SourceMotion, k: int) -> int:
    """What of a joint's descendants lies farthest from it at rest; itself without any."""
    rest = source.rest
    far = [j for j in range(len(rest)) if k in ancestors(j, source.parents)]
    return max(far, key=lambda j: float(np.linalg.norm(rest[j] - rest[k])), default=k)


def hand_tip(source: SourceMotion, found: dict[str, int], side: str) -> int | None:
    """What a hand without fingers points to; None where an end site alone says so, far from the forearm: many stand anywhere."""
    wrist, elbow, rest = found[f"{side}_wrist"], found[f"{side}_elbow"], source.rest
    end = tip(source, wrist)
    hand = rest[end] - rest[wrist]
    bent = degrees_between(rest[wrist] - rest[elbow], hand) > BENT_WRIST
    alone = source.names[end].endswith(END) and source.parents[end] == wrist
    return None if not hand.any() or (alone and bent) else end


def _heading(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """The turn about the vertical from one foot's heading to another's."""
    angle = np.arctan2(theirs[0], theirs[2]) - np.arctan2(ours[0], ours[2])
    return np.asarray(Rotation.from_rotvec([0.0, float(angle) if theirs[[0, 2]].any() else 0.0, 0.0]).as_matrix())
