"""Pose blend shapes of the default person: what linear blend skinning loses where a limb bends, given back.

Turning joint j alone by R splits the mesh in two bones: a vertex follows j and its descendants with weight w, the rest
with 1 − w. Linear blending pulls it towards the hinge; the target here turns it about its *centre of rotation* c(w),
the area-weighted middle of the surface that moves as it does (Le and Hodgins 2016, for two bones):

    v' = slerp(w, R)(v − c) + (1 − w) c + w (R (c − J) + J)

Over sampled R, an offset d = D·vec(R − I) of the rest vertex is fitted, in posed space, so that linear skinning comes
nearest to v'. D is `posedirs`. Only shoulders, elbows, hips and knees have one: other joints bend too little to need
it, and wrists, fingers, neck and head must not (hand and face templates are posed in their own frames).

Letters: v vertices, s sampled rotations, q pose directions. Metres; rotation vectors in degrees in the table below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

RANGES = {
    "shoulder": ((-70, 70), (-110, 40), (-85, 80)),
    "elbow": ((-60, 60), (-145, 5), (-10, 10)),
    "hip": ((-125, 30), (-40, 40), (-30, 55)),
    "knee": ((0, 145), (-15, 15), (-5, 5)),
}
"""Left joint: the box its rotation vector is drawn from, x y z. The right one's is the mirror image."""
SAMPLES, LARGEST = 150, np.radians(150)
"""How many, and the largest turn: at 180° the short way round is ambiguous."""
KERNEL = 0.1
"""How near in w the surface must be to share a centre: a tenth of the blend, some 1 cm of skin."""
RIDGE = 2e-3
"""Damping relative to the mean squared feature: a vertex must gain a millimetre to be moved by several."""
SMALLEST = 3e-4
"""Metres per unit feature below which a direction is dropped: invisible, and half of the file."""


@dataclass(frozen=True)
class Binding:
    """One joint between two bones."""

    joint: np.ndarray
    """(3,) rest position."""
    share: np.ndarray
    """(v,) w: summed skin weight of the joint and its descendants."""
    template: np.ndarray
    """(v, 3) rest positions."""
    moved: np.ndarray
    """(m,) the vertices between the bones: all others are rigid."""


def pose_offsets(
    template: np.ndarray,
    faces: np.ndarray,
    weights: np.ndarray,
    joints: np.ndarray,
    names: list[str],
    parents: list[int],
) -> tuple[np.ndarray, np.ndarray, dict[str, tuple[float, float]]]:
    """`posedirs` (v, 3, q), `pose_columns` (q,) into vec(R_1.. − I), mean posed error before and after in metres."""
    offsets, columns, errors = [], [], {}
    for name in (f"{side}_{kind}" for kind in RANGES for side in ("left", "right")):
        j = names.index(name)
        share = weights[:, descendants(j, parents)].sum(1)
        binding = Binding(joints[j], share, template, np.flatnonzero((share > 1e-3) & (share < 1 - 1e-3)))
        directions, errors[name] = fit(binding, centres(binding, faces), draw(name))
        offsets.append(directions)
        columns.append(9 * (j - 1) + np.arange(9))
    return np.concatenate(offsets, 2), np.concatenate(columns), errors


def descendants(joint: int, parents: list[int]) -> list[int]:
    """The joint and all that hang on it."""
    found = [joint]
    for child in range(joint + 1, len(parents)):
        if parents[child] in found:
            found.append(child)
    return found


def draw(name: str) -> np.ndarray:
    """(s, 3, 3) rotations of a joint within its range, the same at every run; right is left mirrored."""
    side, kind = name.split("_")
    low, high = np.radians(RANGES[kind]).T
    vectors = np.random.default_rng(0).uniform(low, high, (SAMPLES, 3))
    vectors *= np.minimum(1, LARGEST / np.linalg.norm(vectors, axis=1, keepdims=True))
    return Rotation.from_rotvec(vectors * ([1, 1, 1] if side == "left" else [1, -1, -1])).as_matrix()


def centres(binding: Binding, faces: np.ndarray) -> np.ndarray:
    """Centre of rotation of each moved vertex, (m, 3)."""
    corners = binding.template[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    share, middle = binding.share[faces].mean(1), corners.mean(1)
    mass = area * share * (1 - share)
    levels = np.linspace(0, 1, 65)
    kernel = mass * np.exp(-(((levels[:, None] - share) / KERNEL) ** 2))
    table = kernel @ middle / kernel.sum(1, keepdims=True)
    return np.stack([np.interp(binding.share[binding.moved], levels, column) for column in table.T], 1)


def target(binding: Binding, centre: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """(m, 3) where the moved vertices should be when the joint turns by `rotation`."""
    w = binding.share[binding.moved][:, None]
    turn = Rotation.from_rotvec(w * Rotation.from_matrix(rotation).as_rotvec())
    hinged = (centre - binding.joint) @ rotation.T + binding.joint
    return turn.apply(binding.template[binding.moved] - centre) + (1 - w) * centre + w * hinged


def fit(binding: Binding, centre: np.ndarray, rotations: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Directions (v, 3, 9) that bring linear skinning nearest to the target, and its mean error before and after."""
    moved, w = binding.moved, binding.share[binding.moved]
    feature = (rotations - np.eye(3)).reshape(len(rotations), 9)
    linear = (1 - w)[:, None, None, None] * np.eye(3) + w[:, None, None, None] * rotations
    shift = w[:, None, None] * (binding.joint - rotations @ binding.joint)
    missing = np.stack([target(binding, centre, rotation) for rotation in rotations], 1)
    missing -= np.einsum("msab,mb->msa", linear, binding.template[moved]) + shift
    system = np.einsum("msab,sk->msabk", linear, feature).reshape(len(moved), -1, 27)
    normal = system.transpose(0, 2, 1) @ system
    normal += RIDGE * len(rotations) * np.kron(np.eye(3), np.diag((feature**2).mean(0)))
    solved = np.linalg.solve(normal, system.transpose(0, 2, 1) @ missing.reshape(len(moved), -1, 1))
    left = missing - (system @ solved).reshape(missing.shape)
    directions = np.zeros((len(binding.template), 3, 9))
    directions[moved] = solved.reshape(-1, 3, 9)
    directions[np.abs(directions) < SMALLEST] = 0
    before, after = (float(np.linalg.norm(error, axis=2).mean()) for error in (missing, left))
    return directions, (before, after)
