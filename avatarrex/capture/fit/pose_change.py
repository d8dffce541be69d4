"""How points of a posed template follow its joints: the derivatives that pose fits step along.

A turn ω_j of joint j, in the axes of its parent, moves a skinned point x = Σ_k w_k A_k v by

    dx = ω × (Σ_{k below j} w_k A_k v − w_{below j} p_j)        w_{below j} = Σ_{k below j} w_k

k below j: j and all that hangs on it, p_j where j is. Pose blend shapes are left out of the derivative: millimetres of a
step, and the next one measures with them. Letters: j joints, k constraints, v vertices, m unknowns. World metres, radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from avatarrex.capture.fit.check import posed_in_world
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_ROWS
from avatarrex.templates.model import shape_template
from avatarrex.templates.person import Person

TURNED = tuple(
    joint
    for name in ("global_orient", "body_pose", "left_hand_pose", "right_hand_pose")
    for joint in range(JOINT_ROWS[name].start, JOINT_ROWS[name].stop)
)
"""The joints that are sought: neither outlines nor joints say where jaw and eyes point."""
UNKNOWNS = 3 + 3 * len(TURNED)
"""Translation, then the turn of each of `TURNED`."""


@dataclass(frozen=True, eq=False)
class Levers:
    """A posed person, for derivatives."""

    person: Person
    joints: np.ndarray
    """(55, 3) where they are."""
    axes: np.ndarray
    """(j, 3, 3) by `TURNED`: columns are the axes that turns are about."""
    below: np.ndarray
    """(j, 55) bool."""
    skinning: np.ndarray
    """(55, 3, 4) rest to world."""
    rest: np.ndarray
    """(v, 3)."""

    @classmethod
    def of(cls, person: Person, signals: Signals) -> Levers:
        """Of one pose."""
        posed, world = posed_in_world(person, signals)
        parents, turn = person.body.parents, world[:3, :3] @ posed.joint_transforms[:, :3, :3].double().numpy()
        axes = np.stack([turn[parents[joint]] if joint else np.eye(3) for joint in TURNED])
        below = np.eye(55, dtype=bool)
        for joint in range(54, 0, -1):
            below[parents[joint]] |= below[joint]
        skinning = (world @ posed.skinning.double().numpy())[:, :3]
        joints = posed.joints.double().numpy() @ world[:3, :3].T + world[:3, 3]
        shape = torch.from_numpy(signals.shape.astype(np.float32))
        rest = shape_template(person.body, shape, torch.zeros(0))[0].double().numpy()
        return cls(person, joints, axes, below[list(TURNED)], skinning, rest)

    def of_edges(self, ends: np.ndarray, outward: np.ndarray) -> np.ndarray:
        """(k, m): how far the middles of edges `ends` (k, 2) move along `outward` (k, 3)."""
        used, row = np.unique(ends, return_inverse=True)
        weights = self.person.body.weights[used].double().numpy()
        turned = self.rest[used] @ self.skinning[:, :, :3].reshape(-1, 3).T
        moved = turned.reshape(len(used), 55, 3) + self.skinning[:, :, 3]
        below = self.below.astype(np.float64)
        arms = below @ (weights[..., None] * moved) - (weights @ below.T)[..., None] * self.joints[list(TURNED)]
        arm = arms[row.reshape(ends.shape)].mean(1)
        return self._along(arm, outward)

    def of_joints(self, joints: tuple[int, ...]) -> np.ndarray:
        """(k, 3, m): how joints move."""
        arm = self.joints[list(joints), None] - self.joints[list(TURNED)]
        arm *= self.below[:, list(joints)].T[..., None]
        axis = [self._along(arm, np.broadcast_to(np.eye(3)[c], (len(joints), 3))) for c in range(3)]
        return np.stack(axis, 1)

    def _along(self, arm: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """(k, m) of arms (k, j, 3) and directions (k, 3)."""
        turns = np.einsum("kjc,jca->kja", np.cross(arm, direction[:, None]), self.axes)
        return np.concatenate([direction, turns.reshape(len(turns), 3 * len(TURNED))], 1)


def stepped(signals: Signals, step: np.ndarray) -> Signals:
    """The pose after a step (m,)."""
    pose = signals.full_pose()
    turns = Rotation.from_rotvec(step[3:].reshape(-1, 3)) * Rotation.from_rotvec(pose[list(TURNED)])
    pose[list(TURNED)] = turns.as_rotvec()
    kept = {name: getattr(signals, name) for name in ("expression", "shape")}
    return Signals.from_full_pose(pose, translation=signals.translation + step[:3], **kept)


def way_from(first: Signals, signals: Signals) -> np.ndarray:
    """(m,) the step that leads from one pose to another."""
    before, after = (Rotation.from_rotvec(one.full_pose()[list(TURNED)]) for one in (first, signals))
    turns = (after * before.inv()).as_rotvec()
    return np.concatenate([signals.translation - first.translation, turns.ravel()])
