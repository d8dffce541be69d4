"""Which rest position p̄ does a posed point p have? (paper sec. 3.1, p_i = T⁻¹p − (n̄_i + Δn_i): T has no subscript.)

T⁻¹ = Σ_a g_a T_a⁻¹ / Σ g_a over the nearest skinned samples of the template (anchors), g Gaussian in the posed distance and gated
by the rest distance to the anchor that the point's limb has there, so that another limb's anchors do not mix in. An avatar stores which
T_a it was trained with (`local_frame`):

    turned   rotations blended: the default. A blended matrix shrinks a limb that is bent by θ by cos θ/2, and its inverse takes a
             point 1 cm off a sharp elbow to 3 cm
    anchors  the linear part of the blended skinning matrix: of older avatars

A sample's T maps its rest position onto its vertex of the posed template, whatever moved it there (skinning, shape, pose blend
shapes). Other readings of the paper are compared in avatarrex/measure/studies/local_frames.py.

Letters: a samples (anchors), n nodes, p points, k neighbours. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.fields import loops
from avatarrex.ops import native
from avatarrex.ops.closest_vertex import closest_vertices
from avatarrex.ops.search_tree import SearchTree
from avatarrex.ops.skinning import skin

LOCAL_FRAMES = ("anchors", "turned")
UNSAID = "anchors"
"""Of avatars and checkpoints that do not name one: from before there was a choice."""
NEIGHBOURS = 5
"""Anchors searched per point. The farthest one's weight is subtracted from all: a neighbour enters with weight 0, and p̄
does not jump (avatarrex/measure/studies/local_frames.py: step)."""
NEVER_ZERO = 1e-6
"""Keeps the sum positive where all neighbours are equally far."""
ANCHOR_SIGMA = 0.015
"""σ of the anchors' Gaussian at 2048 anchors, metres; it grows with their spacing, 0.021 at 1024."""
ASIDE = 0.3
"""Share of the distance along the skin where limbs touch: the point belongs to the one that it is deepest inside, as in a
union of solids, or else to the one with the surface that it is on, though a sample of the other may be nearer (they are 3 cm apart)."""
OPEN, SHUT = 4.0, 6.0
"""Rest distance to that anchor, in σ, where an anchor's gate starts to close and where it is shut."""


@dataclass(frozen=True)
class Samples:
    """Anchors at one pose, of the skin and of what hangs on a joint, each with the transform of its place."""

    rest: Float[Tensor, "a 3"]
    position: Float[Tensor, "a 3"]
    """On the posed surface: where the cloth is, where there is any."""
    outward: Float[Tensor, "a 3"]
    """Unit normals there."""
    rest_from_posed: Float[Tensor, "a 3 4"]
    owner: Int[Tensor, " a"]
    """The node nearest at rest: `among` nodes, only the samples they own are searched."""
    spread: float
    slide: Float[Tensor, "a 3"] | None = None
    """What is painted there comes from so far beside at rest (slide.py), metres; None: from there."""
    gate_rest: Float[Tensor, "a 3"] | None = None
    """Rest positions by which the gate distinguishes limbs; None: `rest`. An outgrowth's are far from the skin's: what hangs over
    a back mixes with the back's anchors no more than another limb's would."""

    @property
    def _gated(self) -> Float[Tensor, "a 3"]:
        return self.rest if self.gate_rest is None else self.gate_rest

    @cached_property
    def tree(self) -> SearchTree:
        """Search tree over the posed positions."""
        return SearchTree.of_vertices(self.position.detach().numpy())

    @cached_property
    def grid(self) -> loops.AnchorGrid:
        """The posed positions in cells."""
        return loops.AnchorGrid.of(self.position.detach().numpy())

    def nearest(self, position: Float[Tensor, "p 3"], impl: str = "auto") -> Int[Tensor, "p k"]:
        """Indices of the nearest samples, nearest first; not differentiable. `impl`: `auto` (cells, for float32), `torch` (a tree)."""
        count = min(NEIGHBOURS, len(self.rest))
        if not count:
            return torch.zeros(len(position), 0, dtype=torch.int64)
        point = position.detach().contiguous()
        if impl == "auto" and count > 1 and native.serves(point, self.position.detach()):
            out = np.empty((len(position), count), np.int64)
            native.spread(loops.nearest, len(point), point.numpy(), self.grid, out)
        else:
            out = closest_vertices(self.tree, point.numpy(), count)[1]
        return torch.from_numpy(out)

    def among(self, nodes: Tensor) -> Samples:
        """Only the samples that the nodes of the mask (n,) own."""
        keep = nodes[self.owner]
        rows = ("rest", "position", "outward", "rest_from_posed", "owner")
        slide, gate_rest = (None if each is None else each[keep] for each in (self.slide, self.gate_rest))
        return replace(self, **{name: getattr(self, name)[keep] for name in rows}, slide=slide, gate_rest=gate_rest)

    def neighbours_of(self, position: Float[Tensor, "p 3"], impl: str = "auto") -> Neighbours:
        """The samples that carry every point, and their weights; differentiable in the point. `impl`: `auto`, `torch`."""
        index = self.nearest(position, impl)
        if index.shape[1] <= 1:
            return Neighbours(index, position.new_ones(index.shape))
        if impl == "auto" and native.serves(position, self.position, self.rest, self.outward):
            return Neighbours(index, self._weights(position, index))
        shape = index.shape
        offset = position.T[:, :, None] - take(self.position, index.flatten()).unflatten(1, shape)
        squared = offset.square().sum(0)
        rest = take(self._gated, index.flatten()).unflatten(1, shape)
        height = (offset * take(self.outward, index.flatten()).unflatten(1, shape)).sum(0).detach()
        limb = (height * height.abs() + ASIDE * squared.detach()).argmin(1)
        leader = rest.gather(2, limb[None, :, None].expand(3, -1, 1))
        apart = (rest - leader).square().sum(0) / self.spread**2
        t = ((SHUT**2 - apart) / (SHUT**2 - OPEN**2)).clamp(0, 1)
        weight = torch.exp((squared[:, :1].detach() - squared) / (2 * self.spread**2))
        weight = (weight - weight[:, -1:] + NEVER_ZERO) * t * t * (3 - 2 * t)
        return Neighbours(index, weight / weight.sum(-1, keepdim=True))

    def _weights(self, position: Tensor, index: Tensor) -> Tensor:
        """Those of `neighbours_of` by compiled loops."""
        tables = (table.contiguous().numpy() for table in (self.position, self._gated, self.outward))
        constants = map(np.float32, (self.spread, ASIDE, OPEN, SHUT, NEVER_ZERO))
        arguments = (
            position.contiguous().numpy(),
            index.numpy(),
            loops.Anchors(*tables),
            loops.AnchorWeights(*constants),
        )
        weight = np.empty(index.shape, np.float32)
        native.spread(loops.weigh_neighbours, len(position), *arguments, weight)
        return torch.from_numpy(weight)

    def rest_position(
        self, position: Float[Tensor, "p 3"], neighbours: Neighbours | None = None
    ) -> Float[Tensor, "p 3"]:
        """p̄ of every point; differentiable in the point and in the pose where the neighbours do not change."""
        if not len(self.rest):  # no node is left that needs it
            return position
        neighbours = self.neighbours_of(position) if neighbours is None else neighbours
        return skin(neighbours.mean(self.rest_from_posed.reshape(-1, 12)).reshape(-1, 3, 4), position)

    def painted_position(self, position: Float[Tensor, "p 3"], neighbours: Neighbours) -> Float[Tensor, "p 3"]:
        """Where at rest lies what is painted on every point: p̄ with the slide."""
        if self.slide is None or not len(self.rest):
            return self.rest_position(position, neighbours)
        back = torch.cat([self.rest_from_posed[..., :3], self.rest_from_posed[..., 3:] + self.slide[..., None]], -1)
        return skin(neighbours.mean(back.reshape(-1, 12)).reshape(-1, 3, 4), position)

    def facing(self, neighbours: Neighbours) -> Float[Tensor, "p 3"]:
        """Which way the surface next to each point is turned: unit, smooth, turning with the limb."""
        return torch.nn.functional.normalize(neighbours.mean(self.outward), dim=-1)


@dataclass(frozen=True)
class Neighbours:
    """The samples that carry points."""

    index: Int[Tensor, "p k"]
    weight: Float[Tensor, "p k"]
    """Sum 1 over k."""

    def rows(self, some: Int[Tensor, " q"]) -> Neighbours:
        """Of some of the points."""
        return Neighbours(self.index[some], self.weight[some])

    def mean(self, values: Float[Tensor, "a c"]) -> Float[Tensor, "p c"]:
        """Weighted means of the samples' `values`."""
        if (
            self.weight.requires_grad or values.requires_grad
        ):  # the eikonal term differentiates twice; embedding_bag, once
            return (self.weight[:, :, None] * values[self.index]).sum(1)
        return torch.nn.functional.embedding_bag(self.index, values, per_sample_weights=self.weight, mode="sum")


def take(values: Float[Tensor, "p c"], index: Int[Tensor, " k"]) -> Float[Tensor, "c k"]:
    """Rows `index` of `values`, channels first: adjacent values of one channel make every later step faster."""
    return values.T.contiguous().index_select(1, index)
