"""The default person's body group at rest, as what cloth is laid over. T-pose, root frame, metres, float64.

Letters: v vertices, f faces, p points, j joints.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from drape import mesh_distance

from avatarrex.templates.person import load_person

X, Y, Z = 0, 1, 2


class Body:
    """Skin, joints and a dense cloud of surface points with their skin weights."""

    def __init__(self) -> None:
        self.person = load_person()
        self.model = self.person.body.double()
        count = len(self.model.groups["body"])
        if not np.array_equal(self.model.groups["body"].numpy(), np.arange(count)):
            raise SystemExit("the body group must come first in person.npz")
        self.vertices, faces = self.model.v_template.numpy()[:count], self.model.faces.numpy()
        self.faces = faces[(faces < count).all(1)]
        self.weights = self.model.weights.numpy()[:count]
        self.joints = dict(zip(self.model.joint_names, self.model.joint_template.numpy()))
        self.distance = mesh_distance(self.vertices, self.faces)
        bary = np.array([(i, j, 5 - i - j) for i in range(6) for j in range(6 - i)]) / 5
        self.cloud = np.einsum("sk,fkc->fsc", bary, self.vertices[self.faces]).reshape(-1, 3)
        self.cloud_weights = np.einsum("sk,fkj->fsj", bary, self.weights[self.faces]).reshape(len(self.cloud), -1)

    def group(self, name: str) -> np.ndarray:
        """(v, 3) the vertices of a group of the person: eyes, teeth, tongue."""
        return self.model.v_template.numpy()[self.model.groups[name].numpy()]

    def share(self, *names: str) -> np.ndarray:
        """(p,) summed skin weight of the named joints at the cloud's points."""
        return self.cloud_weights[:, [self.model.joint_names.index(name) for name in names]].sum(1)

    @cached_property
    def arms(self) -> np.ndarray:
        """(p,) summed skin weight of both arms at the cloud's points."""
        parts = ("shoulder", "elbow", "wrist", "index", "thumb")
        return self.share(*(name for name in self.joints if any(part in name for part in parts)))

    @cached_property
    def crotch(self) -> float:
        """y of the lowest skin near the middle between the legs."""
        near = (np.abs(self.cloud[:, X]) < 0.01) & (self.cloud[:, Y] < 0.1) & (self.cloud[:, Y] > -0.3)
        return float(self.cloud[near, Y].min())

    @cached_property
    def armpit(self) -> float:
        """y of the lowest skin under the shoulder joint's inner side."""
        x = self.joints["left_shoulder"][X]
        beside = np.abs(self.cloud[:, X] - x - 0.045) < 0.015
        near = beside & (self.share("left_shoulder", "left_collar", "spine3") > 0.8)
        return float(np.quantile(self.cloud[near, Y], 0.02)) - 0.02


def smoothstep(t: np.ndarray) -> np.ndarray:
    """3t² − 2t³ within [0, 1]."""
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)
