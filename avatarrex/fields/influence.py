"""How much weight each node has at a point (paper eq. 5), and which nodes reach which points.

    w_i = max(exp(−‖p − n_i‖²/2σ²) − ε, 0),   σ = 0.05 m, ε = 0.001

written ε·expm1((r² − ‖p − n_i‖²)/2σ²) with r = σ√(2 ln 1/ε), which keeps its digits near the rim, and multiplied by a
gate on the rest-pose distance ‖p̄ − n̄_i‖: a hand near a thigh is in the support of its own nodes only
(docs/fields.md, 'Gate').

Letters: n nodes, p points, k (point, node) pairs sorted by node. Root frame, metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.fields import loops
from avatarrex.ops import native

SIGMA = 0.05
EPSILON = 0.001
RADIUS = SIGMA * math.sqrt(2 * math.log(1 / EPSILON))
"""Where the influence ends, 0.1858 m."""
GATE = (1.2 * RADIUS, 1.6 * RADIUS)
"""Rest distances where the gate starts to close and where it is shut; a bent joint stretches distances by less."""
MAX_DISTANCES = 4_000_000
"""Computed at once while pairs are listed (16 MB)."""


@dataclass(frozen=True)
class Pairs:
    """(point, node) pairs sorted by node."""

    point: Int[Tensor, " k"]
    node: Int[Tensor, " k"]
    offsets: Int[Tensor, " m"]
    """(n + 1,): the pairs of node i are offsets[i] : offsets[i + 1]."""

    def keep(self, mask: Tensor) -> Pairs:
        """The pairs where `mask` (k,) is true, still sorted."""
        return self.take(torch.nonzero(mask)[:, 0])

    def take(self, index: Int[Tensor, " i"]) -> Pairs:
        """The listed pairs, `index` ascending."""
        return Pairs.of(self.point.index_select(0, index), self.node.index_select(0, index), len(self.offsets) - 1)

    @classmethod
    def of(cls, point: Int[Tensor, " k"], node: Int[Tensor, " k"], nodes: int) -> Pairs:
        """From lists that are already sorted by node."""
        offsets = torch.zeros(nodes + 1, dtype=torch.int64, device=node.device)
        offsets[1:] = torch.cumsum(torch.bincount(node, minlength=nodes), 0)
        return cls(point, node, offsets)


def find_pairs(
    position: Float[Tensor, "p 3"],
    node_position: Float[Tensor, "n 3"],
    among: Tensor | None = None,
    impl: str = "auto",
) -> Pairs:
    """Every pair closer than `RADIUS`; `among` (n,) bool restricts the nodes. `impl`: `auto`, `torch`."""
    nodes = torch.arange(len(node_position), device=position.device)
    if among is not None:
        nodes = nodes[among]
    position, node_position = position.detach(), node_position.detach()
    if impl == "auto" and native.serves(position, node_position):
        return _listed(position, node_position, nodes)
    step = max(1, MAX_DISTANCES // max(len(position), 1))
    points, owners = [nodes.new_zeros(0)], [nodes.new_zeros(0)]
    for block in nodes.split(step):
        centre = node_position[block].mean(0)  # small numbers: |p|² + |n|² − 2 p·n loses no digits that matter here
        a, b = node_position[block] - centre, position - centre
        squared = torch.addmm((b * b).sum(-1).expand(len(a), -1), a, b.T, alpha=-2) + (a * a).sum(-1, keepdim=True)
        row, point = torch.nonzero(squared < RADIUS**2, as_tuple=True)
        points.append(point)
        owners.append(block[row])
    return Pairs.of(torch.cat(points), torch.cat(owners), len(node_position))


def _listed(position: Tensor, node_position: Tensor, nodes: Tensor) -> Pairs:
    """`find_pairs` by compiled loops: how many each node has, then which."""
    point, node = position.T.contiguous().numpy(), node_position[nodes].numpy()
    count, radius = np.zeros(len(node), np.int64), np.float32(RADIUS)
    loops.list_pairs(0, len(position), point, node, radius, count, np.empty(0, np.int64))
    of_all = np.zeros(len(node_position), np.int64)
    of_all[nodes.numpy()] = count
    found, place = np.empty(count.sum(), np.int64), np.cumsum(count) - count
    if len(found):
        loops.list_pairs(0, len(position), point, node, radius, place, found)
    owner = torch.repeat_interleave(torch.from_numpy(of_all))
    return Pairs.of(torch.from_numpy(found), owner, len(node_position))


def influence(squared_distance: Float[Tensor, " k"]) -> Float[Tensor, " k"]:
    """w of squared posed distances, m²."""
    return EPSILON * torch.expm1((RADIUS**2 - squared_distance) / (2 * SIGMA**2)).clamp_min(0)


def influence_reference(squared_distance: Float[Tensor, " k"]) -> Float[Tensor, " k"]:
    """Equation 5 as it stands."""
    return torch.clamp(torch.exp(-squared_distance / (2 * SIGMA**2)) - EPSILON, min=0)


def gate(squared_rest_distance: Float[Tensor, " k"]) -> Float[Tensor, " k"]:
    """1 inside `GATE[0]`, 0 outside `GATE[1]`, smooth between, of squared rest distances, m²."""
    low, high = GATE[0] ** 2, GATE[1] ** 2
    t = ((high - squared_rest_distance) / (high - low)).clamp(0, 1)
    return t * t * (3 - 2 * t)


def weighted_mean(
    value: Float[Tensor, "k c"], weight: Float[Tensor, " k"], pairs: Pairs, points: int, impl: str = "auto"
) -> tuple[Float[Tensor, "p c"], Float[Tensor, " p"]]:
    """Σ w v / Σ w per point and Σ w; zero where no weight arrives. `impl`: `auto`, `torch`."""
    if impl == "auto" and native.serves(value, weight):
        out, total = value.new_zeros(points, value.shape[1]), weight.new_zeros(points)
        tables = pairs.point, weight, value.contiguous(), total, out
        native.spread(
            loops.mean, points, *(table.numpy() for table in tables), pieces=1
        )  # each looks through all pairs
        return out, total
    total = weight.new_zeros(points).index_add(0, pairs.point, weight)
    summed = value.new_zeros(points, value.shape[1]).index_add(0, pairs.point, value * weight[:, None])
    reached = total > 0
    return summed / torch.where(reached, total, torch.ones_like(total))[:, None], total
