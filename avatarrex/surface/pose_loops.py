"""The compiled loops of `pose_surface` (ops/native.py): joints, corrections, which vertices moved, skinning, normals.

What each computes is said in pose.py. Every vertex is computed alone and in the same order of operations, whichever others are:
so what is kept from a previous pose equals what would be computed. Sums are float64, what is stored float32.

Letters: v vertices, k joints of a vertex, j joints, g groups, q joints of a group, r rank, e expressions, n chosen rows or fitted poses.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Shaped

from avatarrex.ops.native import native

Array = Shaped[np.ndarray, "..."]


class Mesh(NamedTuple):
    """A surface's arrays as the loops read them, C-contiguous."""

    joint: Array
    """(v, k) uint8."""
    weight: Array
    """(v, k) float32."""
    group: Array
    """(v,) uint8."""
    basis: Array
    """(v, r, 6) float32."""
    morph_row: Array
    """(v,) int32: the row of a vertex in `morph`, −1 for none."""
    morph: Array
    """(m, e, 6) float32: displacement and change of colour."""
    ring_start: Array
    """(v + 1,) int32."""
    ring: Array
    """(·, 2) int32: of each face at a vertex the two other corners, in the face's order."""


class State(NamedTuple):
    """What the vertices depend on."""

    rest: Array
    """(v, 3) float32 with the shape's part."""
    skinning: Array
    """(j, 3, 4) float64."""
    amount: Array
    """(g, r) float64: clipped coefficients of the corrections."""
    expression: Array
    """(e,) float64."""


@native
def joint_matrices(order: Array, parents: Array, turn: Array, joints: Array, transform: Array, skinning: Array) -> None:
    """transform and skinning (j, 3, 4) of rotations (j, 3, 3) about joints (j, 3); `order`: parents before children."""
    for j in order:
        above = parents[j]
        for a in range(3):
            if above < 0:
                transform[j, a, :3] = turn[j, a]
                transform[j, a, 3] = joints[j, a]
                continue
            moved = transform[above, a, 3]
            for b in range(3):
                moved += transform[above, a, b] * (joints[j, b] - joints[above, b])
                total = 0.0
                for c in range(3):
                    total += transform[above, a, c] * turn[j, c, b]
                transform[j, a, b] = total
            transform[j, a, 3] = moved
        for a in range(3):
            moved = transform[j, a, 3]
            for b in range(3):
                skinning[j, a, b] = transform[j, a, b]
                moved -= transform[j, a, b] * joints[j, b]
            skinning[j, a, 3] = moved


@native
def corrections(
    turn: Array,
    fitted: Array,
    joints: Array,
    closeness: Array,
    weights: Array,
    low: Array,
    high: Array,
    amount: Array,
) -> None:
    """amount (g, r) = clip(Σ_n weights_n k(turn, fitted_n), low, high): pose_kernel.py of `turn` (j, 9) and `fitted` (n, j, 9)."""
    n, count = fitted.shape[:2]
    alike, apart = np.empty((n, count)), np.empty((n, count))
    for i in range(n):
        for j in range(count):
            dot, square = 0.0, 0.0
            for entry in range(9):
                dot += turn[j, entry] * fitted[i, j, entry]
                square += (turn[j, entry] - fitted[i, j, entry]) ** 2
            alike[i, j], apart[i, j] = dot, square
    for g in range(len(joints)):
        amount[g] = 0
        for i in range(n):
            dot, square = 0.0, 0.0
            for q in range(joints.shape[1]):
                j, c = joints[g, q], closeness[g, q]
                if j >= 0:
                    dot += c * alike[i, j]
                    square += c * apart[i, j]
            kernel = dot + np.exp(-square / 2)
            for r in range(amount.shape[1]):
                amount[g, r] += weights[g, i, r] * kernel
        for r in range(amount.shape[1]):
            amount[g, r] = min(max(amount[g, r], low[g, r]), high[g, r])


@native
def mark_moved(begin: int, end: int, mesh: Mesh, joint: Array, group: Array, morphs: bool, moved: Array) -> None:
    """moved (v,): whether a joint that carries the vertex, its group or its expressions changed."""
    for v in range(begin, end):
        found = group[mesh.group[v]] or (morphs and mesh.morph_row[v] >= 0)
        for k in range(mesh.joint.shape[1]):
            found = found or (mesh.weight[v, k] != 0 and joint[mesh.joint[v, k]])
        moved[v] = found


@native
def mark_neighbours(begin: int, end: int, mesh: Mesh, moved: Array, turned: Array) -> None:
    """turned (v,): whether the vertex or another corner of its faces is in moved (v,)."""
    for v in range(begin, end):
        found = moved[v]
        for i in range(mesh.ring_start[v], mesh.ring_start[v + 1]):
            found = found or moved[mesh.ring[i, 0]] or moved[mesh.ring[i, 1]]
        turned[v] = found


@native
def place(begin: int, end: int, chosen: Array, mesh: Mesh, state: State, position: Array, tint: Array) -> None:
    """position and tint (v, 3) of the vertices `chosen` (n,)."""
    joints, active = mesh.joint.shape[1], np.flatnonzero(state.expression)
    at, blend = np.empty(6), np.empty(12)
    flat = state.skinning.reshape(-1, 12)
    for n in range(begin, end):
        v = chosen[n]
        amount, row = state.amount[mesh.group[v]], mesh.morph_row[v]
        at[:] = 0
        for r in range(len(amount)):
            for c in range(6):
                at[c] += mesh.basis[v, r, c] * amount[r]
        if row >= 0:
            for e in active:
                for c in range(6):
                    at[c] += mesh.morph[row, e, c] * state.expression[e]
        blend[:] = 0
        for k in range(joints):
            weight, matrix = mesh.weight[v, k], flat[mesh.joint[v, k]]
            if weight != 0:
                for c in range(12):
                    blend[c] += weight * matrix[c]
        x, y, z = at[0] + state.rest[v, 0], at[1] + state.rest[v, 1], at[2] + state.rest[v, 2]
        for c in range(3):
            position[v, c] = blend[4 * c] * x + blend[4 * c + 1] * y + blend[4 * c + 2] * z + blend[4 * c + 3]
            tint[v, c] = at[3 + c]


@native
def turn_normals(begin: int, end: int, chosen: Array, mesh: Mesh, position: Array, normal: Array) -> None:
    """normal (v, 3) of the vertices `chosen` (n,): the unit sum of their faces' vector areas; +Z where that is zero."""
    for n in range(begin, end):
        v = chosen[n]
        x, y, z = np.float64(position[v, 0]), np.float64(position[v, 1]), np.float64(position[v, 2])
        nx, ny, nz = 0.0, 0.0, 0.0
        for i in range(mesh.ring_start[v], mesh.ring_start[v + 1]):
            b, c = mesh.ring[i, 0], mesh.ring[i, 1]
            bx, by, bz = position[b, 0] - x, position[b, 1] - y, position[b, 2] - z
            cx, cy, cz = position[c, 0] - x, position[c, 1] - y, position[c, 2] - z
            nx += by * cz - bz * cy
            ny += bz * cx - bx * cz
            nz += bx * cy - by * cx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length > 0:
            normal[v, 0], normal[v, 1], normal[v, 2] = nx / length, ny / length, nz / length
        else:
            normal[v, 0], normal[v, 1], normal[v, 2] = 0, 0, 1
