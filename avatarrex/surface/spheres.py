"""Spheres that stand for a surface where its shape does not matter: how much of the sky it hides from a point.

The vertices that a joint carries most are cut along their longest direction into pieces of about `LENGTH`; a piece of area S at
rest is a sphere of radius √(S / 4π) about the mean of its vertices, which has the piece's mean silhouette (Cauchy). A point that
sees it at distance d, at the angle θ from its normal, loses cos θ (R / d)² of the sky.

Letters: v vertices, n spheres. Metres, root frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from avatarrex.signals.joints import BODY_JOINTS, JOINT_NAMES
from avatarrex.surface.surface import Surface

LENGTH = 0.17
"""Metres."""
MOST = 28
"""Spheres of one surface; pieces beyond it are longer."""
_made: WeakKeyDictionary[Surface, Spheres] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Spheres:
    """Pieces of a surface."""

    shares: csr_array
    """(n, v): of each vertex in each piece's middle."""
    radius: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, surface: Surface) -> Spheres:
        """Of a surface; made once."""
        if surface not in _made:
            _made[surface] = _cut(surface)
        return _made[surface]

    def centres(self, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "n 3"]:
        """Of the posed vertices."""
        return np.asarray(self.shares @ vertices)


def _cut(surface: Surface) -> Spheres:
    rest, area = surface.vertices.astype(np.float64), _areas(surface)
    carrier = np.array([_body_joint(joint) for joint in range(len(JOINT_NAMES))])[surface.joint[:, 0]]
    rows = [np.flatnonzero(carrier == joint) for joint in np.unique(carrier)]
    length = LENGTH
    while sum(_pieces(rest[own], length) for own in rows) > MOST:
        length *= 1.1
    pieces = [piece for own in rows for piece in _along(rest, own, _pieces(rest[own], length)) if area[piece].sum() > 0]
    sums = np.array([area[piece].sum() for piece in pieces])
    vertex, number = np.concatenate(pieces), np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
    shares = csr_array((area[vertex] / sums[number], (number, vertex)), (len(pieces), len(rest)))
    return Spheres(shares, np.sqrt(sums / (4 * np.pi)))


def _areas(surface: Surface) -> Float[np.ndarray, " v"]:
    """A third of the faces about each vertex at rest."""
    a, b, c = (surface.vertices[surface.faces[:, k]].astype(np.float64) for k in range(3))
    third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    area = np.zeros(len(surface.vertices))
    np.add.at(area, surface.faces, third[:, None])
    return area


def _body_joint(joint: int) -> int:
    """The joint itself; of fingers the wrist, of jaw and eyes the head."""
    name = JOINT_NAMES[joint]
    if name in BODY_JOINTS or name == "pelvis":
        return joint
    side = name.partition("_")[0]
    return JOINT_NAMES.index("head" if name == "jaw" or "eye" in name else f"{side}_wrist")


def _pieces(rest: np.ndarray, length: float) -> int:
    return max(1, round(float(np.ptp(rest, axis=0).max()) / length))


def _along(rest: np.ndarray, own: np.ndarray, count: int) -> list[np.ndarray]:
    """The vertices `own` in pieces along their longest direction."""
    axis = int(np.ptp(rest[own], axis=0).argmax())
    place = rest[own, axis]
    edges = np.linspace(place.min(), place.max(), count + 1)[1:-1]
    number = np.searchsorted(edges, place)
    return [own[number == piece] for piece in range(count) if (number == piece).any()]
