"""Where another limb reaches into a part's box: the body field of the part's own nodes and of all the others.

A hand on a hip is a union (docs/architecture.md, 'How the parts compose'): the composed value of the hand must never
replace the hip's flesh. Both fields are evaluated on the body's lattice, inside the box only, and only when a vertex of
another limb is there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.fields.body import BodyField, BodyFrame
from avatarrex.fields.composition import WHOLE, emptied
from avatarrex.fields.influence import Pairs
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.part_box import PartField
from avatarrex.volume.probe import VertexProbe
from avatarrex.volume.volume import PARTS, BodyGrid, Contact

OWN_REACH = 0.22
"""Metres at rest around the part's extent: what is nearer is the part's own (forearm; neck, shoulders, chest). More than a
node's influence and the box's margin: a field that lacks some of its nodes is wrong where they are heard."""
TRUST, RIM = 0.5, 0.015
"""Share of the usual freedom for a field of some nodes only, and how far (metres) it reaches past the rim of their skin."""
NEAR = 0.03
"""Metres around the box in which another limb's vertex counts as contact: its surface may stand off by cloth."""


@dataclass(frozen=True)
class Ownership:
    """Whose nodes and vertices belong to a part: those that are near it at rest."""

    own_node: Tensor
    """(n,) bool."""
    other_vertex: np.ndarray
    """(v,) bool."""

    @staticmethod
    def of(rest_node: Tensor, rest_vertices: Tensor, part_vertices: Tensor) -> Ownership:
        """From rest positions (n, 3), (v, 3) and the part's own rest vertices (k, 3), root frame."""
        low, high = part_vertices.amin(0), part_vertices.amax(0)

        def apart(position: Tensor) -> Tensor:
            return (position - position.clamp(low, high)).norm(dim=-1)

        return Ownership(apart(rest_node) < OWN_REACH, (apart(rest_vertices) >= OWN_REACH).numpy())


def nodes_of(ownership: Mapping[str, Ownership], side: int) -> Tensor | None:
    """(n,) the nodes of a side (`Composed.side`); None for the whole body's."""
    if side == WHOLE:
        return None
    own = ownership[PARTS[side // 2]].own_node
    return ~own if side % 2 else own


@dataclass(frozen=True)
class Limbs:
    """The body field of one pose, told apart: the nodes near a part along the surface, and all others."""

    field: BodyField
    frame: BodyFrame
    sides: tuple[tuple[Tensor, VertexProbe], ...]
    """(n,) nodes and their skin: own, then others."""

    @staticmethod
    def of(field: BodyField, frame: BodyFrame, probe: VertexProbe, ownership: Ownership) -> Limbs:
        """`probe` of the whole skin."""
        other = ownership.other_vertex
        return Limbs(
            field,
            frame,
            tuple(
                (nodes, VertexProbe.of(probe.vertices[v], probe.normals[v], probe.weight[v], probe.worn[v], RIM))
                for nodes, v in ((ownership.own_node, ~other), (~ownership.own_node, other))
            ),
        )

    @torch.no_grad()
    def own_and_others(self, position: Float[Tensor, "p 3"], pairs: Pairs) -> Float[Tensor, "p 2"]:
        """Both values at points whose `pairs` with all nodes are given, metres."""
        values = []
        for nodes, probe in self.sides:
            sdf = self.field.sdf(self.frame, position, pairs, among=nodes)
            here = probe.query(position.double().numpy())
            values.append(emptied(here.held(sdf, TRUST), torch.as_tensor(here.weight).to(sdf)))
        return torch.stack(values, -1)


def reached_by_others(
    probe: VertexProbe, ownership: Ownership, part_from_root: np.ndarray, low: np.ndarray, high: np.ndarray
) -> bool:
    """Whether another limb's vertex is in the part-frame box from `low` to `high` (3,), or `NEAR` to it."""
    left = np.flatnonzero(ownership.other_vertex)
    for axis in range(3):
        along = probe.vertices[left] @ part_from_root[axis, :3] + part_from_root[axis, 3]
        left = left[(along > low[axis] - NEAR) & (along < high[axis] + NEAR)]
    return len(left) > 0


def find_contact(
    field: BodyField,
    frame: BodyFrame,
    probe: VertexProbe,
    grid: BodyGrid,
    part: PartField,
    root_from_part: np.ndarray,
    ownership: Ownership,
    counters: Counters,
) -> Contact | None:
    """Evaluate `own` and `others` in the box of `part` when another limb is in it, else None."""
    corners = part.corners()
    if not reached_by_others(probe, ownership, np.linalg.inv(root_from_part), corners.min(0), corners.max(0)):
        return None
    lattice = Lattice(grid.origin, grid.voxel, (grid.sdf.shape[0], grid.sdf.shape[1], grid.sdf.shape[2]))
    placed = corners @ root_from_part[:3, :3].T + root_from_part[:3, 3]
    first = np.floor((placed.min(0) - grid.origin) / grid.voxel).astype(int)[::-1]
    last = np.ceil((placed.max(0) - grid.origin) / grid.voxel).astype(int)[::-1]
    first, last = np.maximum(first, 0), np.minimum(last, np.array(lattice.shape) - 1)
    block = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last)), indexing="ij")
    index = np.ravel_multi_index([axis.ravel() for axis in block], lattice.shape)
    points = torch.as_tensor(lattice.position(index), dtype=torch.float32)
    pairs = field.pairs(frame, points)
    values = Limbs.of(field, frame, probe, ownership).own_and_others(points, pairs)
    counters.add("voxels_evaluated", 2 * len(index))
    counters.add("local_mlp_evaluations", len(pairs.point))
    shape = tuple(int(n) for n in last - first + 1)
    return Contact(first=first, field=values.reshape(*shape, 2))
