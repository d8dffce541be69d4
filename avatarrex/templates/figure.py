"""A person as somebody points at it: joints and skin in the world, and which part a point of the surface belongs to.

A point of the surface belongs to the joint that carries the nearest vertex of the template most, and in the face to the region
whose expressions move that vertex most. Letters: v vertices, j joints, e expressions. Metres, world space.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from scipy.spatial import cKDTree

from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, FACE_REGIONS, JOINT_NAMES
from avatarrex.signals.skeleton import PosedSkeleton, Skeleton
from avatarrex.templates.model import TemplateModel, pose_by_signals, shape_joints
from avatarrex.templates.transform import world_from_root

EXPRESSIVE = 0.35
"""Share of a region's largest displacement from which a vertex of the head belongs to it."""
FINE = {"mouth": 1.25, "eye": 1.5, "brow": 1.8, "nose": 1.4, "jaw": 0.8}
"""Weights of regions within others: lips move with the jaw and with puffed cheeks."""
REACH = 0.02
"""Metres: a still vertex, such as the nose's ridge, belongs to what moves so near to it."""
INNER = ("tongue", "upper_teeth", "lower_teeth")
"""Groups of vertices that nobody points at."""


@dataclass(frozen=True, eq=False)
class Figure:
    """A template's body under a driving signal."""

    body: TemplateModel
    signals: Signals

    @cached_property
    def skeleton(self) -> Skeleton:
        """Joints at rest, of the signal's shape."""
        shape, expression = (
            torch.from_numpy(v.astype(np.float32)) for v in (self.signals.shape, self.signals.expression)
        )
        joints = shape_joints(self.body, shape, expression)
        return Skeleton(joints.double().numpy(), self.body.parents)

    @cached_property
    def posed(self) -> PosedSkeleton:
        """The joints."""
        return self.skeleton.posed(self.signals)

    @cached_property
    def vertices(self) -> Float32[np.ndarray, "v 3"]:
        """The template's skin."""
        posed = pose_by_signals(self.body, self.signals)
        pelvis = posed.joints[0].double().numpy()
        root = world_from_root(self.signals.global_orient, self.signals.translation, pelvis)
        return np.asarray(posed.vertices.double().numpy() @ root[:3, :3].T + root[:3, 3], np.float32)

    def part_at(self, point: Float[np.ndarray, "3"]) -> str:
        """The joint or the region of the face (`FACE_REGIONS`) that a point of the surface belongs to."""
        distance = ((self.vertices - np.asarray(point, np.float32)) ** 2).sum(1)
        owners = _owners(self.body)
        distance[owners == ""] = np.inf
        return str(owners[distance.argmin()])

    def region(self, name: str) -> Int64[np.ndarray, " n"]:
        """The vertices that belong to a joint or a region."""
        return np.flatnonzero(_owners(self.body) == name)


@dataclass(frozen=True, eq=False)
class Wire:
    """The edges of a template's skin."""

    faces: Int64[np.ndarray, "f 3"]
    edges: Int64[np.ndarray, "n 2"]
    """Vertices, each pair once."""
    beside: Int64[np.ndarray, "n 2"]
    """The faces at both sides of each edge."""

    @classmethod
    def of(cls, body: TemplateModel) -> Wire:
        """Of a template, found once."""
        if body not in _WIRES:
            faces = body.skin_faces().numpy()
            pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1)
            order = np.lexsort(pairs.T)
            pairs, face = pairs[order], np.tile(np.arange(len(faces)), 3)[order]
            first = np.concatenate([[True], (pairs[1:] != pairs[:-1]).any(1)])
            start = np.flatnonzero(first)
            last = np.concatenate([start[1:], [len(pairs)]]) - 1
            _WIRES[body] = cls(faces, pairs[start], np.stack([face[start], face[last]], 1))
        return _WIRES[body]


_WIRES: WeakKeyDictionary[TemplateModel, Wire] = WeakKeyDictionary()
_OWNERS: WeakKeyDictionary[TemplateModel, np.ndarray] = WeakKeyDictionary()


def _owners(body: TemplateModel) -> np.ndarray:
    """(v,) what each vertex belongs to, found once; empty where nobody points."""
    if body not in _OWNERS:
        owners = np.array(JOINT_NAMES)[body.weights.argmax(1).numpy()].astype(object)
        strength, head = _strengths(body), np.isin(owners, ("head", "jaw"))
        strongest = np.array(FACE_REGIONS)[strength.argmax(1)]
        face = head & (strength.max(1) > EXPRESSIVE)
        owners[face] = strongest[face]
        still, rest = head & ~face, body.v_template.numpy()
        if face.any():
            distance, nearest = cKDTree(rest[face]).query(rest[still], distance_upper_bound=REACH)
            near = np.isfinite(distance)
            owners[np.flatnonzero(still)[near]] = owners[face][nearest[near]]
        for group in INNER:
            if group in body.groups:
                owners[body.groups[group].numpy()] = ""
        _OWNERS[body] = owners
    return _OWNERS[body]


def _strengths(body: TemplateModel) -> Float32[np.ndarray, "v r"]:
    """How far the expressions of each region move each vertex: of each the share of the farthest that it moves."""
    names = body.expression_names or EXPRESSION_NAMES
    moved = body.expression_dirs.norm(dim=1).numpy()
    share = moved / np.maximum(moved.max(0), 1e-9)
    strengths = np.zeros((len(moved), len(FACE_REGIONS)), np.float32)
    for column, region in enumerate(FACE_REGIONS):
        rows = [k for k, name in enumerate(names[: moved.shape[1]]) if name.startswith(region)]
        if rows:
            strengths[:, column] = share[:, rows].max(1) * FINE.get(region, 1.0)
    return strengths
