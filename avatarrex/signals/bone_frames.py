"""A file's rest pose that is a bundle of bones: how each of our joints rests in it, from bones and averages of the motion.

Where every bone rests along one axis (game engines, motion capture solvers), the rest pose tells a bone's direction in its
joint's frame and nothing else. What is missing is how the joint is turned about the bone: a hinge tells (a knee bends backwards,
an elbow forwards), a palm with fingers does, and else the average over the motion does: spine and hips look the same way, the head
looks where the chest looks. B as in rest_pose.py. Letters: t frames.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.signals.direction import TINY, degrees_between, frame_turn, unit
from avatarrex.signals.joints import FINGERS, JOINT_NAMES
from avatarrex.signals.rest_pose import hand_tip, tip
from avatarrex.signals.rest_skeleton import rest_skeleton
from avatarrex.signals.source_motion import END, SourceMotion

BENT = 0.08
"""Mean sine of a hinge's angle from which on its plane is known: 5 degrees."""
FLAT = 0.2
"""Share of the frames, those in which a foot is lowest, in which it lies flat."""
STEEPEST = np.radians(40.0)
"""Of a foot's bone against ours when flat; beyond it the foot was never flat."""
CROWN = 40.0
"""Degrees between an end site above the head and the average's up from which on it is no crown."""
ACROSS = np.array([1.0, 0.0, 0.0])


class BoneFrames:
    """B of joint after joint of one file, the trunk first."""

    def __init__(self, source: SourceMotion, found: dict[str, int], up: np.ndarray) -> None:
        """`up` (3,): the file's up, of the world that it moves in."""
        self._source, self._found, self._up = source, found, up
        self._ours = dict(zip(JOINT_NAMES, rest_skeleton().joints))
        self.turns: dict[str, np.ndarray] = {}

    def trunk(self) -> None:
        """Pelvis, spine, neck and head."""
        left = unit(self._place("left_hip") - self._place("right_hip"))
        top = [self._place(name) for name in ("left_shoulder", "right_shoulder")]
        hips = (self._place("left_hip") + self._place("right_hip")) / 2
        trunk = unit((top[0] + top[1]) / 2 - hips)
        ours = self._ours
        our_trunk = (ours["left_shoulder"] + ours["right_shoulder"] - ours["left_hip"] - ours["right_hip"]) / 2
        for name, across in (("pelvis", left), ("spine1", left), ("spine2", left), ("spine3", unit(top[0] - top[1]))):
            if name in self._found:
                self._set(name, (ACROSS, our_trunk), (self._mean(name, across), self._mean(name, trunk)))
        for name in ("neck", "head"):
            if name in self._found:
                self._follow(name, next(n for n in ("spine3", "spine2", "spine1", "pelvis") if n in self.turns))
        self._crown()

    def collar(self, side: str) -> None:
        """A collar bone, the trunk's up above it."""
        name, child = f"{side}_collar", f"{side}_shoulder"
        if name in self._found:
            up = self._mean(name, self._world("pelvis", np.array([0.0, 1.0, 0.0])))
            self._set(name, (self._bone(name, child), np.array([0.0, 1.0, 0.0])), (self._theirs(name, child), up))

    def arm(self, side: str) -> None:
        """Collar, shoulder, elbow, wrist and fingers."""
        self.collar(side)
        shoulder, elbow, wrist = (f"{side}_{part}" for part in ("shoulder", "elbow", "wrist"))
        self._hinge((shoulder, elbow, wrist), np.array([0.0, 0.0, 1.0]))
        if wrist not in self._found:
            return
        middle, index, pinky = (f"{side}_{finger}1" for finger in ("middle", "index", "pinky"))
        if all(name in self._found for name in (middle, index, pinky)):
            across = self._mean(wrist, self._place(index) - self._place(pinky))
            along, second = (
                self._mean(wrist, self._place(middle) - self._place(wrist)),
                self._ours[index] - self._ours[pinky],
            )
        else:
            end = hand_tip(self._source, self._found, side)
            if end is None:
                self._follow(wrist, elbow)
                return
            second = np.array([0.0, 1.0, 0.0])
            across = self._mean(wrist, self._world(elbow, second))
            along = self._mean(wrist, self._source.places[:, end] - self._place(wrist))
        self._set(wrist, (self._bone(wrist, middle), second), (along, across))
        for finger in FINGERS:
            self._finger(side, finger)

    def leg(self, side: str) -> None:
        """Hip, knee, ankle and toes."""
        hip, knee, ankle = (f"{side}_{part}" for part in ("hip", "knee", "ankle"))
        self._hinge((hip, knee, ankle), np.array([0.0, 0.0, -1.0]))
        self.foot(side)

    def foot(self, side: str) -> None:
        """Ankle and toes: along the bone, level where the foot stands."""
        knee, ankle, foot = (f"{side}_{part}" for part in ("knee", "ankle", "foot"))
        if ankle not in self._found:
            return
        if foot not in self._found:
            self._follow(ankle, knee)
            return
        across = self._mean(ankle, self._world(knee, ACROSS))
        self._set(ankle, (self._bone(ankle, foot), ACROSS), (self._theirs(ankle, foot), across))
        turn = self._slope(ankle, foot)
        if abs(turn) < STEEPEST:
            self.turns[ankle] = self.turns[ankle] @ Rotation.from_rotvec([turn, 0, 0]).as_matrix()
        self._follow(foot, ankle)

    def all(self) -> np.ndarray:
        """(55, 3, 3): B of every joint; one that the file lacks rests as its parent."""
        self.trunk()
        for side in ("left", "right"):
            self.arm(side)
            self.leg(side)
        for name, parent in zip(JOINT_NAMES[1:], rest_skeleton().parents[1:]):
            if name not in self.turns and name in self._found:
                self._follow(name, JOINT_NAMES[parent])
            self.turns.setdefault(name, self.turns[JOINT_NAMES[parent]])
        return np.stack([self.turns[name] for name in JOINT_NAMES])

    def _hinge(self, joints: tuple[str, str, str], bends: np.ndarray) -> None:
        """Two bones of a limb: in the plane that they bend in, or as the trunk is turned. `bends`: where ours bend to."""
        upper, lower, end = joints
        places = [self._place(name) for name in joints if name in self._found]
        normal = np.zeros_like(places[0])
        if len(places) == 3:
            normal = np.cross(unit(places[1] - places[0]), unit(places[2] - places[1]))
        known = float(np.linalg.norm(normal, axis=1).mean()) > BENT
        for name, child in ((upper, lower), (lower, end)):
            ours = np.cross(unit(self._bone(name, child)), bends)
            mean = self._mean(name, normal)
            if not known or np.linalg.norm(mean) < BENT / 2:
                mean = self._mean(name, self._world("pelvis", ours if name.endswith(("hip", "knee")) else bends))
                ours = ours if name.endswith(("hip", "knee")) else bends
            self._set(name, (self._bone(name, child), ours), (self._theirs(name, child), mean))

    def _finger(self, side: str, finger: str) -> None:
        """Each bone along the file's, its back where the hand's back is."""
        back, along = np.array([0.0, 1.0, 0.0]), np.zeros(3)
        for k in (1, 2, 3):
            name, child = f"{side}_{finger}{k}", f"{side}_{finger}{k + 1}"
            if name not in self._found:
                continue
            across, bone = self._mean(name, self._world(f"{side}_wrist", back)), self._theirs(name, child)
            if not bone.any():
                bone = along  # in a bundle every bone lies along the same axis of its joint
            along = bone
            self._set(name, (self._finger_bone(side, finger, k), back), (bone, across))

    def _finger_bone(self, side: str, finger: str, k: int) -> np.ndarray:
        """Our bone from a finger's joint; the last one's as the one before it."""
        first = min(k, 2)
        return self._bone(f"{side}_{finger}{first}", f"{side}_{finger}{first + 1}")

    def _crown(self) -> None:
        """Where an end site stands above the head, up is where it stands."""
        k = self._found.get("head")
        crown = [
            j for j, parent in enumerate(self._source.parents) if parent == k and self._source.names[j].endswith(END)
        ]
        if k is None or len(crown) != 1:
            return
        up, head = self._source.offsets[crown[0]], self.turns["head"]
        if degrees_between(head @ [0, 1, 0], up) < CROWN:
            self._set("head", (np.array([0.0, 1.0, 0.0]), ACROSS), (up, head @ ACROSS))

    def _slope(self, ankle: str, foot: str) -> float:
        """Radians that our foot has to be turned about its side so that both lie flat when the file's does."""
        places = self._place(ankle), self._place(foot)
        low = np.minimum(places[0] @ self._up, places[1] @ self._up)
        flat = low <= np.quantile(low, FLAT)
        theirs = float(np.median(np.arcsin(np.clip(unit(places[1] - places[0])[flat] @ self._up, -1, 1))))
        return theirs - float(np.arcsin(unit(self._bone(ankle, foot))[1]))

    def _place(self, name: str) -> np.ndarray:
        """(t, 3) of one of our joints in the file."""
        return np.asarray(self._source.places[:, self._found[name]])

    def _mean(self, name: str, directions: np.ndarray) -> np.ndarray:
        """(3,) the average of directions (t, 3) in a joint's frame."""
        return np.asarray(np.einsum("tba,tb->ta", self._source.turned[:, self._found[name]], directions).mean(0))

    def _world(self, name: str, ours: np.ndarray) -> np.ndarray:
        """(t, 3) where our rest direction `ours` of a joint goes."""
        k = self._found[name]
        return np.asarray(self._source.turned[:, k] @ (self.turns[name] @ ours))

    def _bone(self, name: str, child: str) -> np.ndarray:
        return np.asarray(self._ours[child] - self._ours[name])

    def _theirs(self, name: str, child: str) -> np.ndarray:
        """(3,) a bone of the file in its joint's frame; without the child to what lies farthest from the joint."""
        k = self._found[name]
        end = self._found[child] if child in self._found else tip(self._source, k)
        return self._mean(name, self._source.places[:, end] - self._source.places[:, k])

    def _set(self, name: str, ours: tuple[np.ndarray, np.ndarray], theirs: tuple[np.ndarray, np.ndarray]) -> None:
        self.turns[name] = frame_turn(ours, theirs)

    def _follow(self, name: str, leader: str) -> None:
        """A joint that on average is turned as another one is."""
        mean = np.stack([self._mean(name, self._world(leader, direction)) for direction in np.eye(3)], 1)
        left, _, right = np.linalg.svd(mean + TINY * np.eye(3))
        self.turns[name] = left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right
