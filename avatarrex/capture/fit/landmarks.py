"""Points of a body that detectors find in pictures: SMPL-X's joints, and places on the skin that move rigidly with one.

Nose, ears, heels, toes and finger tips are vertices of a person, chosen by where they lie at rest. Letters: l landmarks.
Metres, T-pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from avatarrex.signals.joints import FINGERS, JOINT_NAMES
from avatarrex.signals.rest_skeleton import RestSkeleton, rest_skeleton
from avatarrex.templates.person import Person

EYE_BAND = (-0.05, 0.03)
"""Metres below and above the eyes within which ears and the tip of the nose lie."""
EAR_FRONT = 0.06
"""Metres before the pelvis behind which ears lie."""


@dataclass(frozen=True, eq=False)
class Landmarks:
    """The joints in their order, then the places on the skin."""

    names: tuple[str, ...]
    joints: np.ndarray
    """(l,) which joint carries each."""
    offsets: np.ndarray
    """(l, 3) from that joint at rest."""
    vertices: np.ndarray
    """(l,) the person's vertex of each; −1 of joints."""

    def rows(self, names: tuple[str, ...]) -> np.ndarray:
        """Rows of landmarks by name."""
        return np.array([self.names.index(name) for name in names])


@lru_cache(maxsize=1)
def landmarks() -> Landmarks:
    """Of the default person; all persons have the same names in the same order."""
    return _chosen(rest_skeleton())


def landmarks_of(person: Person) -> Landmarks:
    """Of a person with 55 joints in SMPL-X's order, of any mesh."""
    body = person.body
    joints, vertices = (values.double().numpy() for values in (body.joint_template, body.v_template))
    return _chosen(RestSkeleton(joints, body.parents, vertices, body.weights.numpy().argmax(1)))


def _chosen(rest: RestSkeleton) -> Landmarks:
    forward, level = rest.vertices[:, 2], _level(rest)
    middle = np.where(np.abs(rest.vertices[:, 0]) < 0.01, forward, -1.0)
    found = {"nose": _extreme(rest, ("head", "jaw"), "head", middle * level)}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        outward = sign * rest.vertices[:, 0]
        found[f"{side}_ear"] = _extreme(rest, ("head",), "head", outward * level * (forward < EAR_FRONT))
        foot = (f"{side}_ankle", f"{side}_foot")
        found[f"{side}_heel"] = _extreme(rest, foot, foot[0], -forward)
        found[f"{side}_big_toe"] = _extreme(rest, foot, foot[1], forward)
        found[f"{side}_small_toe"] = _extreme(rest, foot, foot[1], outward + 0.5 * forward)
        for finger in FINGERS:
            ends = [rest.joints[JOINT_NAMES.index(f"{side}_{finger}{k}")] for k in (2, 3)]
            last = f"{side}_{finger}3"
            found[f"{side}_{finger}_tip"] = _extreme(rest, (last,), last, rest.vertices @ (ends[1] - ends[0]))
    vertices = np.array([-1] * 55 + [vertex for vertex, _ in found.values()])
    carriers = np.array([*range(55), *(joint for _, joint in found.values())])
    places = np.concatenate([rest.joints, rest.vertices[vertices[55:]]])
    return Landmarks((*JOINT_NAMES, *found), carriers, places - rest.joints[carriers], vertices)


def _extreme(rest: RestSkeleton, owners: tuple[str, ...], carrier: str, measure: np.ndarray) -> tuple[int, int]:
    """The vertex of joints `owners` with the largest measure (v,), and the joint that carries it."""
    there = np.flatnonzero(np.isin(rest.owner, [JOINT_NAMES.index(name) for name in owners]))
    return int(there[np.argmax(measure[there])]), JOINT_NAMES.index(carrier)


def _level(rest: RestSkeleton) -> np.ndarray:
    """(v,) 1 where vertices are as high as the eyes, else 0."""
    above = rest.vertices[:, 1] - rest.joints[JOINT_NAMES.index("left_eye"), 1]
    return np.asarray((above > EYE_BAND[0]) & (above < EYE_BAND[1]), np.float64)
