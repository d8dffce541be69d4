"""Where the joints of a person are under a driving signal, in the world: forward kinematics in NumPy, float64.

    G_i = G_parent(i) R_i      p_i = p_parent(i) + G_parent(i) (J_i − J_parent(i))      p_0 = J_0 + t

The same joints as the template's (templates/model.py), without its mesh. Letters: j joints. Metres, world space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial.transform import Rotation

from avatarrex.signals.driving import Signals


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Joints of a body shape at rest (T-pose), metres, SMPL-X order."""

    joints: Float64[np.ndarray, "j 3"]
    parents: tuple[int, ...]
    """The root's is −1; parents stand before their children."""

    def posed(self, signals: Signals) -> PosedSkeleton:
        """The joints under `signals`."""
        return self.turned(signals.full_pose(), signals.translation)

    def turned(
        self,
        pose: Float64[np.ndarray, "j 3"],
        translation: Float64[np.ndarray, "3"],
        joints: Sequence[int] | None = None,
    ) -> PosedSkeleton:
        """The joints under rotation vectors `pose` (radians, the root's first) and a root that is moved by `translation`.

        `joints`: those that are wanted, with all that they hang from, parents first; the others stay at rest.
        """
        wanted = list(range(len(self.parents)) if joints is None else joints)
        position, rotation = self.joints + translation, np.tile(np.eye(3), (len(self.parents), 1, 1))
        rotation[wanted] = Rotation.from_rotvec(pose[wanted]).as_matrix()
        for joint in wanted:
            parent = self.parents[joint]
            if parent >= 0:
                position[joint] = position[parent] + rotation[parent] @ self._bones[joint]
                rotation[joint] = rotation[parent] @ rotation[joint]
        return PosedSkeleton(position, rotation)

    @cached_property
    def _bones(self) -> Float64[np.ndarray, "j 3"]:
        """From each joint's parent to it, at rest."""
        return np.asarray(self.joints - self.joints[np.maximum(self.parents, 0)])

    @cached_property
    def carries(self) -> Bool[np.ndarray, "j j"]:
        """[a, b]: whether joint b moves when a turns: b is a, or hangs from it."""
        carried = np.eye(len(self.parents), dtype=bool)
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                carried[:, joint] |= carried[:, parent]
        return carried


@dataclass(frozen=True, eq=False)
class PosedSkeleton:
    """Joints in the world."""

    position: Float64[np.ndarray, "j 3"]
    rotation: Float64[np.ndarray, "j 3 3"]
    """Of each joint's rest axes to the world."""

    def parent_rotation(self, joint: int, skeleton: Skeleton) -> Float64[np.ndarray, "3 3"]:
        """What a joint's own rotation is relative to; the world for the root."""
        parent = skeleton.parents[joint]
        return self.rotation[parent] if parent >= 0 else np.eye(3)
