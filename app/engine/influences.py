"""What carries each place of an avatar, as colours: the body node nearest to it at rest, or how much a joint turns it along.

Letters: v vertices of the template or of a surface, p points, n nodes. Metres.
"""

from __future__ import annotations

import colorsys
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from avatarrex.avatar import Avatar
from avatarrex.fields.body import BodyField
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.surface.surface import Surface
from avatarrex.templates.figure import Figure

NONE, WHOLE = np.array([0.36, 0.41, 0.50]), np.array([0.98, 0.72, 0.20])
"""sRGB-encoded: where a joint carries nothing, and where it alone carries."""
GOLDEN = 0.61803
"""Of a turn, between the hues of two nodes that were placed one after the other: those lie far apart."""
_trees: WeakKeyDictionary[BodyField, cKDTree] = WeakKeyDictionary()


def of_surface(avatar: Avatar, surface: Surface, selected: str | None) -> Float[np.ndarray, "v 3"]:
    """Of a surface's vertices. A selected joint: its weight there; else the colour of the node that is nearest at rest."""
    if selected in JOINT_NAMES:
        return heat((surface.weight * (surface.joint == JOINT_NAMES.index(selected))).sum(1))
    return _node_colours(avatar, surface.vertices)


def of_points(
    avatar: Avatar, signals: Signals, points: Float[np.ndarray, "p 3"], selected: str | None
) -> Float[np.ndarray, "p 3"]:
    """Of points of the avatar posed by `signals`, world: those of the template's nearest vertices."""
    body = avatar.person.body
    vertex = cKDTree(Figure(body, signals).vertices).query(points)[1]
    if selected in JOINT_NAMES:
        return heat(np.asarray(body.weights)[vertex, JOINT_NAMES.index(selected)])
    return np.asarray(_node_colours(avatar, body.v_template.numpy())[vertex])


def heat(weight: Float[np.ndarray, " v"]) -> Float[np.ndarray, "v 3"]:
    """From `NONE` to `WHOLE`."""
    return np.asarray(NONE + (WHOLE - NONE) * np.clip(weight, 0, 1)[:, None])


def _node_colours(avatar: Avatar, rest: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
    if avatar.body not in _trees:
        _trees[avatar.body] = cKDTree(avatar.body.node_rest.double().cpu().numpy())
    node = _trees[avatar.body].query(rest)[1]
    return np.asarray(_palette(len(avatar.body.node_rest))[node])


@lru_cache(maxsize=8)
def _palette(count: int) -> Float[np.ndarray, "n 3"]:
    """A colour for each node."""
    return np.array([colorsys.hls_to_rgb(k * GOLDEN % 1, 0.52 + 0.12 * (k % 3 - 1), 0.55) for k in range(count)])
