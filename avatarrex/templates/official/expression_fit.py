"""The 52 names on another face, by least squares: what its coefficients show of them, and which of them its coefficients are.

Both faces are laid on each other by turn, place and size. Points p are those of the default face, its ω their weights; there the other
face moves as its vertices nearest in place and normal. D is what the 52 move, F what the other's coefficients do, J a turn of its jaw:

    A_k = argmin  Σ_p w_p |F a (+ J θ of the names of the jaw) − D_k|² + ρ² |a|²        coefficients that show a name
    M   = argmin  Σ_p w_p |D M − F|² + σ² |M|²                                          names that a motion's coefficients are

A jaw that turns is apart: its pose moves it in motions, too, so that M follows the coefficients alone. Letters: v vertices, p points,
c coefficients. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.face import FaceTemplate
from avatarrex.templates.model import TemplateModel

ROUNDS, NEAR = 12, 0.05
"""Of laying the faces on each other; metres behind the tip of the nose that count for it, as a face's front does."""
NORMAL = 0.01
"""Metres that normals a radian apart are worth: lips that touch have opposite ones."""
NEIGHBOURS = 3
"""Vertices of the other face that a point follows."""
MATCHED = 0.01
"""Metres at which what a point is told by the other face counts 1/e: two mean faces are some millimetres apart, a tongue of one more."""
HIDDEN = 0.05
"""What the mouth's inside and what is no face (ω = 0) count: they should not go anywhere, and `tongueOut` moves a tongue alone."""
RIDGE = 0.01
"""Of coefficients: share of the directions' mean size. Below it a direction is noise of two meshes, and would cancel others."""
POOR = 0.5
"""Share of a name's motion below which the other face does not show it."""
JAW = [k for k, name in enumerate(EXPRESSION_NAMES) if name.startswith("jaw")]


@dataclass(frozen=True, eq=False)
class ExpressionFit:
    """Two tables, and what they are worth."""

    coefficients: np.ndarray
    """(c, 52): A, of the other face."""
    names: np.ndarray
    """(52, c): M."""
    explained: np.ndarray
    """(52,) share of the squared motion of each name that the other face shows, in [0, 1]; of the jaw's with its turn."""

    def poor(self) -> str:
        """Names with less than `POOR`, the poorest first, with their shares; empty where there are none."""
        order = [k for k in np.argsort(self.explained, kind="stable") if self.explained[k] < POOR]
        return ", ".join(f"{EXPRESSION_NAMES[k]} {self.explained[k]:.0%}" for k in order)


def fit_expressions(face: TemplateModel, default: FaceTemplate) -> ExpressionFit:
    """Of a `face` whose coefficients have no names, by the packaged person's. Raises `InputError` where none moves it."""
    rows, weight = _points(default)
    follow = _Following.of(face, default.model, rows)
    count, wanted = weight * follow.counts, default.model.expression_dirs.double().numpy()[rows]
    own = _stacked(follow(face.expression_dirs.double().numpy()), count)
    if not own.any():
        raise InputError("face", "expression directions", "some that move the face", "none")
    matched, turning = _stacked(wanted, count), np.hstack([own, _stacked(follow(jaw_turns(face)), count)])
    coefficients, turned = _nearest(own, matched), _nearest(turning, matched[:, JAW], own)
    left = matched - own @ coefficients
    coefficients[:, JAW], left[:, JAW] = turned[: own.shape[1]], matched[:, JAW] - turning @ turned
    whole = (_stacked(wanted, weight) ** 2).sum(0)
    shown = ((matched**2).sum(0) - (left**2).sum(0)) / np.maximum(whole, np.finfo(float).tiny)
    return ExpressionFit(coefficients, _nearest(matched, own), np.clip(shown, 0, 1))


def jaw_turns(face: TemplateModel) -> np.ndarray:
    """(v, 3, 3): what a radian about each axis of the jaw moves at rest; (v, 3, 0) of a face without a joint of that name."""
    if "jaw" not in face.joint_names:
        return np.zeros((len(face.v_template), 3, 0))
    joint, axes = face.joint_names.index("jaw"), np.eye(3)
    arm = (face.v_template - face.joint_template[joint]).double().numpy()
    turned = face.weights[:, joint, None, None].double().numpy() * np.cross(axes, arm[:, None])
    moved = turned.transpose(0, 2, 1)
    if face.posedirs is not None and face.pose_columns is None:
        turns = np.cross(axes[:, None], axes).transpose(0, 2, 1).reshape(3, 9)
        moved = moved + face.posedirs[..., 9 * (joint - 1) : 9 * joint].double().numpy() @ turns.T
    return np.asarray(moved)


@dataclass(frozen=True, eq=False)
class _Following:
    """How points of one face follow the vertices of another."""

    near: np.ndarray
    """(p, `NEIGHBOURS`) vertices of the other."""
    shares: np.ndarray
    turn: np.ndarray
    """(3, 3), with the size."""
    counts: np.ndarray
    """(p,) 1 where both lie together, falling to 0 with the distance."""

    @classmethod
    def of(cls, face: TemplateModel, default: TemplateModel, rows: np.ndarray) -> _Following:
        vertices, other = face.v_template.double().numpy(), default.v_template.double().numpy()
        turn, size, shift = _laid(vertices, other)
        eyes = [k for k, name in enumerate(face.joint_names) if name.endswith("eye")]
        skin = np.flatnonzero(face.weights[:, eyes].sum(1).numpy() < 0.5)
        there = np.hstack([size * vertices @ turn.T + shift, NORMAL * face.normals.double().numpy() @ turn.T])
        here = np.hstack([other, NORMAL * default.normals.double().numpy()])[rows]
        away, near = cKDTree(there[skin]).query(here, NEIGHBOURS)
        shares = 1 / np.maximum(away, 1e-6)
        return cls(
            skin[near], shares / shares.sum(1, keepdims=True), size * turn, np.exp(-((away[:, 0] / MATCHED) ** 2))
        )

    def __call__(self, directions: np.ndarray) -> np.ndarray:
        """(p, 3, n) of (v, 3, n)."""
        moved = np.einsum("pk,pkdn->pdn", self.shares, directions[self.near])
        return np.asarray(np.einsum("cd,pdn->pcn", self.turn, moved))


def _points(default: FaceTemplate) -> tuple[np.ndarray, np.ndarray]:
    """Vertices but for the eyeballs', and their weights: area times ω, or `HIDDEN`; they sum to one."""
    model = default.model
    a, b, c = model.v_template[model.faces].unbind(1)
    area = torch.linalg.cross(b - a, c - a).norm(dim=1)
    weight = torch.zeros(len(model.v_template)).index_add_(0, model.faces.ravel(), area.repeat_interleave(3))
    weight *= torch.where(default.mouth, 0, default.blend_weight).clamp(min=HIDDEN)
    for name in ("left_eye", "right_eye"):
        weight[model.groups.get(name, [])] = 0
    rows = torch.nonzero(weight > 0)[:, 0].numpy()
    chosen = weight.double().numpy()[rows]
    return rows, chosen / chosen.sum()


def _stacked(directions: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(3 p, n) of (p, 3, n), by the roots of weights (p,)."""
    scaled = np.sqrt(weight)[:, None, None] * directions
    return np.asarray(scaled.reshape(3 * len(directions), directions.shape[2]))


def _nearest(basis: np.ndarray, wanted: np.ndarray, sized: np.ndarray | None = None) -> np.ndarray:
    """x of the smallest |basis x − wanted|² + |RIDGE · size · x|², the size that of `sized`, or of the basis itself."""
    size = (np.square(basis if sized is None else sized)).sum(0).mean()
    square = basis.T @ basis + RIDGE**2 * size * np.eye(basis.shape[1])
    return np.asarray(np.linalg.solve(square, basis.T @ wanted))


def _laid(vertices: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Turn (3, 3), size and shift (3,) that lay a face on another: tips of the noses first, then the nearest points of the fronts."""
    tip, there = (points[points[:, 2].argmax()] for points in (vertices, other))
    front = vertices[vertices[:, 2] > tip[2] - NEAR]
    turn, size, shift = np.eye(3), 1.0, there - tip
    tree = cKDTree(other)
    for _ in range(ROUNDS):
        to = other[tree.query(size * front @ turn.T + shift)[1]]
        here, middle = front.mean(0), to.mean(0)
        turn = Rotation.align_vectors(to - middle, front - here)[0].as_matrix()
        size = float(np.linalg.norm(to - middle) / np.linalg.norm(front - here))
        shift = middle - size * turn @ here
    return turn, size, shift
