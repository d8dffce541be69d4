"""How far a retargeted motion's directions are from the file's own forward kinematics: what says that it came in right.

Measured before contacts and clamps, per frame: limb bones (hip, knee, shoulder, elbow to the next joint), hands (wrist to the
middle finger's knuckle, or to the hand's tip) and the line of the hips as they point; soles, ankle to toes about what the same bone
is when the foot is flat (at rest, or where it stands lowest); the head's up and forward, its crown's direction where the rest pose
is none.
Letters: t frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avatarrex.signals.bone_frames import FLAT
from avatarrex.signals.direction import degrees_between, unit
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.rest_pose import hand_tip
from avatarrex.signals.rest_skeleton import rest_skeleton
from avatarrex.signals.source_motion import END, SourceMotion

INDEX = {name: j for j, name in enumerate(JOINT_NAMES)}
_BONES = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
_UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Fidelity:
    """A file's motion beside ours. `world` and `rest`: rotations from its world and its rest pose (None: a bundle) to ours."""

    source: SourceMotion
    found: dict[str, int]
    world: np.ndarray
    rest: np.ndarray | None
    turned: np.ndarray
    """(t, 55, 3, 3) ours."""
    places: np.ndarray
    """(t, 55, 3) ours."""

    def errors(self) -> dict[str, tuple[float, float]]:
        """Median and largest angle in degrees, by part; a part that the file lacks is left out."""
        sides = ("left", "right")
        parts = {
            "hips": [
                degrees_between(
                    self._theirs(self.found["right_hip"], self.found["left_hip"]), self._ours("right_hip", "left_hip")
                )
            ],
            "limbs": [self._bone(f"{s}_{a}", f"{s}_{b}") for s in sides for a, b in _BONES if f"{s}_{b}" in self.found],
            "hands": [angles for side in sides for angles in self._hand(side)],
            "feet": [self._sole(s) for s in sides if f"{s}_ankle" in self.found and f"{s}_foot" in self.found],
            "head": self._head() if "head" in self.found else [],
        }
        return {
            name: (float(np.median(angles)), float(np.max(angles))) for name, angles in parts.items() if len(angles)
        }

    def _theirs(self, start: int, end: int) -> np.ndarray:
        """(t, 3) in our axes."""
        return np.asarray((self.source.places[:, end] - self.source.places[:, start]) @ self.world.T)

    def _ours(self, start: str, end: str) -> np.ndarray:
        return np.asarray(self.places[:, INDEX[end]] - self.places[:, INDEX[start]])

    def _bone(self, start: str, end: str) -> np.ndarray:
        return degrees_between(self._theirs(self.found[start], self.found[end]), self._ours(start, end))

    def _hand(self, side: str) -> list[np.ndarray]:
        wrist, middle = f"{side}_wrist", f"{side}_middle1"
        if wrist not in self.found:
            return []
        if all(f"{side}_{finger}1" in self.found for finger in ("index", "middle", "pinky")):
            return [self._bone(wrist, middle)]
        end = hand_tip(self.source, self.found, side)
        if end is None:
            return []
        return [degrees_between(self._theirs(self.found[wrist], end), self._ours(wrist, middle))]

    def _sole(self, side: str) -> np.ndarray:
        ankle, foot = f"{side}_ankle", f"{side}_foot"
        bone, ours = unit(self._theirs(self.found[ankle], self.found[foot])), self.turned[:, INDEX[ankle]]
        rest = rest_skeleton().joints
        flat_ours = np.arcsin(unit(rest[INDEX[foot]] - rest[INDEX[ankle]])[1])
        slope = self._flat(ankle, foot, bone)
        # both bones turned up about the foot's own side until level when the foot is flat
        heading = unit(self._ours(ankle, foot))
        return degrees_between(_raised(bone, ours[..., 0], -slope), _raised(heading, ours[..., 0], -flat_ours))

    def _flat(self, ankle: str, foot: str, bone: np.ndarray) -> float:
        """Radians above level of the file's foot when flat."""
        if self.rest is not None:
            pose = self.source.rest @ self.rest.T
            elevation = float(np.arcsin(unit(pose[self.found[foot]] - pose[self.found[ankle]])[1]))
            if elevation > -np.pi / 3:
                return elevation
        heights = self.source.places[:, [self.found[ankle], self.found[foot]]] @ self.world[1]
        low = heights.min(1)
        return float(np.median(np.arcsin(np.clip(bone[low <= np.quantile(low, FLAT), 1], -1, 1))))

    def _head(self) -> list[np.ndarray]:
        k, ours = self.found["head"], self.turned[:, INDEX["head"]]
        theirs = self.world @ self.source.turned[:, k]
        if self.rest is not None:
            return [degrees_between(theirs @ (self.rest.T @ d), ours @ d) for d in (_UP, np.array([0.0, 0.0, 1.0]))]
        crown = [
            j for j, parent in enumerate(self.source.parents) if parent == k and self.source.names[j].endswith(END)
        ]
        return [degrees_between(theirs @ self.source.offsets[crown[0]], ours @ _UP)] if len(crown) == 1 else []


def _raised(direction: np.ndarray, side: np.ndarray, angle: float) -> np.ndarray:
    """(t, 3) unit directions turned up by `angle` about `side` (t, 3), a person's left."""
    across = unit(side - (side * direction).sum(-1, keepdims=True) * direction)
    above = np.cross(direction, across)
    return np.asarray(np.cos(angle) * direction + np.sin(angle) * above)
