"""A person's own face on the template's: offsets of the skin at rest, and what the expression shapes differ by.

    v(ψ) = v_rest + Σ_e g_e ψ_e S_e + Σ_n w_n (o_n + Σ_k (b_k · ψ) d_nk)

with v_rest and S_e the template's rest and expression shapes, g_e how much of a shape is this person's, and some nodes n of the head's
skin, eyeballs, teeth and tongue. w falls with the way along the mesh: what moves the upper lip leaves the lower one; eyeballs,
rows of teeth and the tongue move as a whole each. b_k are a few directions of ψ, those that the pictures showed: of others nothing is
known, and g S stays. Ours.

Letters: v vertices, n nodes, k directions, e expression coefficients. Root frame at rest, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from avatarrex.errors import InputError
from avatarrex.templates.model import EYES, MOUTH, TemplateModel

SIGMA, NEAREST = (0.001, 0.01), 8
"""Metres: σ of a node's Gaussian at least and at most; how many nodes move a vertex."""
NARROW = 0.65
"""σ between, of the way to the next node."""
FADE = (0.02, 0.035)
"""Metres from the nearest node at which an offset begins to fade, and where it is 0."""
MOST_NODES, MOST_DIRECTIONS, LARGEST, MOST_GAIN = 1000, 64, 0.2, 4.0
"""Of a file: memory for each, metres (for a whole unit of ψ) that a face differs by at most, and g at most: twice the most of a fit."""
DIGITS = 6
"""Of metres and coefficients that are kept: a micrometre."""


@dataclass(frozen=True, eq=False)
class FaceOffsets:
    """What a face differs by from the template's."""

    vertices: tuple[int, ...]
    """The nodes: indices into the body template."""
    rest: np.ndarray
    """(n, 3) o, metres."""
    directions: np.ndarray
    """(k, e) b, unit and at right angles to each other."""
    moves: np.ndarray
    """(n, 3, k) d, metres for each unit along b."""
    eye_joints: bool = False
    """Whether the joint of an eye takes its ball's offset at rest along; False in the files of fits before 2026-11-27."""
    gains: np.ndarray = field(default_factory=lambda: np.ones(0))
    """(e,) g, 0 and more; none where all are 1, as in the files of fits before 2026-11-28."""

    def __post_init__(self) -> None:
        n = len(self.vertices)
        if not 0 < n <= MOST_NODES or len(set(self.vertices)) < n:
            raise InputError("person fit", "face.vertices", f"1 to {MOST_NODES} different indices", n)
        k, e = np.shape(self.directions) if np.ndim(self.directions) == 2 else (0, 0)
        wanted = {"rest": ((n, 3), LARGEST), "directions": ((k, e), 1.0), "moves": ((n, 3, k), LARGEST)}
        wanted["gains"] = ((np.size(self.gains),), MOST_GAIN)
        for name, (shape, most) in wanted.items():
            value = np.asarray(getattr(self, name), dtype=np.float64).round(DIGITS)
            if value.shape != shape or k > MOST_DIRECTIONS or not (np.abs(value) <= most).all():
                raise InputError(
                    "person fit", f"face.{name}", f"{shape} finite numbers, none beyond {most}", value.shape
                )
            object.__setattr__(self, name, value)
        if (self.gains < 0).any():
            raise InputError("person fit", "face.gains", "numbers of at least 0", float(self.gains.min()))

    def to_json(self) -> dict[str, Any]:
        """Plain lists; `from_json` gives the same back, bit for bit."""
        arrays = {name: getattr(self, name).tolist() for name in ("rest", "directions", "moves")}
        joints = {"eye_joints": True} if self.eye_joints else {}
        gains = {"gains": self.gains.tolist()} if len(self.gains) else {}
        return {"vertices": list(self.vertices), **arrays, **joints, **gains}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> FaceOffsets:
        """From `to_json`'s object. Raises `InputError`, TypeError, ValueError or KeyError."""
        vertices = data["vertices"]
        if not isinstance(vertices, list) or not all(type(vertex) is int for vertex in vertices):
            raise InputError("person fit", "face.vertices", "a list of integers", repr(vertices)[:60])
        joints = flag(data, "eye_joints", "face.eye_joints")
        rest, moves = (np.array(data[name], dtype=np.float64) for name in ("rest", "moves"))
        directions = np.array(data["directions"], dtype=np.float64)
        if not directions.size:
            directions = np.zeros((0, 0))
        gains = np.array(data.get("gains", []), dtype=np.float64)
        return cls(tuple(vertices), rest, directions, moves, joints, gains)

    def shapes(self, body: TemplateModel) -> tuple[np.ndarray, np.ndarray]:
        """Of every vertex of the original `body` what is added at rest (v, 3), and to its shapes g S of expressions (v, 3, e).

        Raises `InputError` for another template's.
        """
        e = body.expression_dirs.shape[2]
        if len(self.directions) and self.directions.shape[1] != e:
            raise InputError("person fit", "face.directions", f"{e} coefficients", self.directions.shape[1])
        weights = node_weights(body, self.vertices)
        moved = (weights @ self.moves.reshape(len(self.vertices), -1)).reshape(
            len(body.v_template), *self.moves.shape[1:]
        )
        return weights @ self.rest, moved @ self.directions.reshape(-1, e)

    def gain(self, count: int) -> np.ndarray:
        """(e,) g of a template with so many expressions. Raises `InputError` for another's."""
        if len(self.gains) not in (0, count):
            raise InputError("person fit", "face.gains", f"{count} numbers", len(self.gains))
        return self.gains if len(self.gains) else np.ones(count)


def flag(data: dict[str, Any], name: str, field: str) -> bool:
    """`data[name]`, false where there is none. Raises `InputError`, of `field`."""
    value = data.get(name, False)
    if not isinstance(value, bool):
        raise InputError("person fit", field, "true or false", repr(value)[:60])
    return value


def node_weights(body: TemplateModel, nodes: tuple[int, ...]) -> csr_array:
    """(v, n) w: Gaussians of the nearest nodes, with sum 1 close to them and all over an eyeball, teeth or tongue, 0 far away. Raises
    `InputError` for no vertices."""
    if not nodes or min(nodes) < 0 or max(nodes) >= len(body.v_template):
        raise InputError("person fit", "face.vertices", f"indices below {len(body.v_template)}", nodes[:8])
    edges, rigid = mesh_edges(body), body.of_groups((*EYES, *MOUTH)).numpy()
    away = dijkstra(edges, indices=list(nodes), limit=FADE[1]).T
    for column in np.flatnonzero(rigid[list(nodes)]):
        away[:, column] = dijkstra(edges, indices=nodes[column])
    between = away[list(nodes)]
    np.fill_diagonal(between, np.inf)
    sigma = np.clip(NARROW * between.min(1), *SIGMA)
    reached = np.flatnonzero(np.isfinite(away).any(1))
    nearest = np.argsort(away[reached], 1, kind="stable")[:, :NEAREST]
    away = np.take_along_axis(away[reached], nearest, 1)
    value = np.exp(-0.5 * (away / sigma[nearest]) ** 2)
    fade = np.clip((FADE[1] - away[:, :1]) / (FADE[1] - FADE[0]), 0, 1)
    value *= np.where(rigid[reached, None], 1, fade) / value.sum(1, keepdims=True)
    rows = np.repeat(reached, value.shape[1])
    return csr_array((value.ravel(), (rows, nearest.ravel())), shape=(len(body.v_template), len(nodes)))


def mesh_edges(body: TemplateModel) -> csr_array:
    """(v, v) lengths of the edges at rest, metres."""
    rest, faces = body.v_template.double().numpy(), body.faces.numpy()
    ends = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    length = np.linalg.norm(rest[ends[:, 0]] - rest[ends[:, 1]], axis=1).clip(1e-9)
    graph = csr_array((length, (ends[:, 0], ends[:, 1])), shape=(len(rest), len(rest)))
    return graph + graph.T
