"""Temporal reuse of the body: what hardly moved since the previous frame keeps its state, as legs do while an arm is dragged.

Every node's embedding depends on the whole pose (fields/code.py), so that nothing stays exactly as it was; but far from the
dragged joint it changes the surface by hundredths of a millimetre. A node, a sample of the local frames or a vertex of the
skin that moves by less than a tolerance, or whose embedding moves the surface (or its colour: fields/body.py, `VISIBLE`) by less in the mean,
keeps the state it had. It is compared with what it keeps, not with the frame before: no state lags by more. All else is
exact: wherever nothing that changed is within reach the field is the previous one, and its values are reused.

Letters: n nodes, a samples, v vertices, p points, m places, b blocks. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from avatarrex.fields.body import MAX_CLOTHING_OFFSET, BodyFrame
from avatarrex.fields.code import BodyCode
from avatarrex.fields.influence import RADIUS
from avatarrex.ops.closest_vertex import closest_vertex
from avatarrex.ops.search_tree import SearchTree
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.sdf_volume import BodyGrid

LEVER = 0.05
"""Metres over which a turn counts as a shift: samples and vertices speak for points nearer than this."""
SKIN = 0.12
"""Metres within which samples and vertices affect points of the finest blocks."""
FAR = SKIN - MAX_CLOTHING_OFFSET
"""Metres: a guess up to this is still a lower bound where everything that changed is farther than `SKIN`."""
MOST_CHANGED = 0.6
"""Share of the nodes that changed from which nothing is kept."""


@dataclass(frozen=True, eq=False)
class ChangedRegion:
    """Where a body frame differs from the frame `since`."""

    since: BodyFrame
    nodes: SearchTree | None
    """Of the places of the nodes that changed, before and now."""
    skin: SearchTree | None
    """Of the samples and vertices that changed, before and now."""

    def touches(self, position: Float[np.ndarray, "p 3"], radius: float = 0.0) -> Bool[np.ndarray, " p"]:
        """Whether a point near the surface, or one up to `radius` metres around it, is within reach of something that changed."""
        touched = np.zeros(len(position), dtype=bool)
        for places, reach in ((self.nodes, RADIUS), (self.skin, SKIN)):
            if places is not None:
                rest = np.flatnonzero(~touched)
                touched[rest] = np.isfinite(closest_vertex(places, position[rest], reach + radius)[0])
        return touched


@dataclass(frozen=True, eq=False)
class ReusableBody:
    """A body frame and its skin, of which unmoved pieces keep the previous state."""

    frame: BodyFrame
    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    changed: ChangedRegion | None
    """None: too much changed, and nothing was kept."""


def reuse_unchanged(now: ReusableBody, before: ReusableBody, tolerance: float, effect: float) -> ReusableBody:
    """`now` with the state of `before` wherever that differs by less than `tolerance` metres.

    `effect`: metres that a unit of the embedding counts (`BodyField.embedding_effect`).
    """
    old, new = before.frame, now.frame
    moved = _moved_nodes(new, old, effect) > tolerance
    if moved.double().mean() > MOST_CHANGED:
        return now
    frame = replace(
        new,
        code=BodyCode(
            _mixed(moved, new.code.residual, old.code.residual), _mixed(moved, new.code.embedding, old.code.embedding)
        ),
        node_position=_mixed(moved, new.node_position, old.node_position),
        node_rest=_mixed(moved, new.node_rest, old.node_rest),
        node_from_rest=_mixed(moved, new.node_from_rest, old.node_from_rest),
    )
    skin = _moved_vertices(now, before) > tolerance
    places = [now.vertices[skin], before.vertices[skin]]
    turned = _moved_samples(frame, old) > tolerance
    frame = replace(
        frame,
        samples=replace(
            new.samples,
            position=_mixed(turned, new.samples.position, old.samples.position),
            outward=_mixed(turned, new.samples.outward, old.samples.outward),
            rest_from_posed=_mixed(turned, new.samples.rest_from_posed, old.samples.rest_from_posed),
        ),
    )
    places += [samples.position[turned].double().numpy() for samples in (new.samples, old.samples)]
    return ReusableBody(
        frame,
        np.where(skin[:, None], now.vertices, before.vertices),
        np.where(skin[:, None], now.normals, before.normals),
        ChangedRegion(
            old,
            _tree([each.node_position[moved].double().numpy() for each in (new, old)]),
            _tree(places),
        ),
    )


@dataclass(frozen=True, eq=False)
class PreviousGrid:
    """The body grid of the frame before, for voxels that are out of reach of what changed since."""

    grid: BodyGrid
    changed: ChangedRegion

    def onto(self, lattice: Lattice, block: np.ndarray, side: int, sdf: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Write what was there before into the voxels of `block`s (b, 3: z, y, x) of side³ near the surface.

        `sdf` and `known`, (z, y, x), are those of `lattice`. Returns which blocks (b,) were taken over.
        """
        assert self.grid.known is not None, "a grid of which nobody knows what was evaluated"
        centre = lattice.origin + lattice.voxel * (block[:, ::-1] * side + (side - 1) / 2)
        shift = np.rint((lattice.origin - self.grid.origin) / lattice.voxel).astype(int)[::-1]
        first, last = block * side, block * side + side - 1
        old, new = np.array(self.grid.sdf.shape), np.array(lattice.shape)
        stays: np.ndarray = ((first + shift >= 0) & (last + shift < old) & (last < new)).all(1)
        stays[stays] = ~self.changed.touches(centre[stays], np.sqrt(3) * lattice.voxel * (side - 1) / 2)
        inner = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)
        voxel = (first[stays][:, None] + inner).reshape(-1, 3)
        here, there = (np.ravel_multi_index(tuple(v.T), tuple(n)) for v, n in ((voxel, new), (voxel + shift, old)))
        was, value = self.grid.known.reshape(-1)[there], self.grid.sdf.numpy().reshape(-1)[there]
        known.reshape(-1)[here] = was
        sdf.reshape(-1)[here] = np.where(was, value, value.clip(-FAR, FAR))
        return stays


def _tree(places: list[np.ndarray]) -> SearchTree | None:
    joined = np.concatenate(places)
    return SearchTree.of_vertices(joined) if len(joined) else None


def _mixed(moved: Tensor, new: Tensor, old: Tensor) -> Tensor:
    return torch.where(moved.view(-1, *[1] * (new.dim() - 1)), new, old)


def _moved_nodes(new: BodyFrame, old: BodyFrame, effect: float) -> Float[Tensor, " n"]:
    """Metres by which the change of each node may move the surface."""
    shift = (new.node_position - old.node_position).norm(dim=-1) + (new.node_rest - old.node_rest).norm(dim=-1)
    moved: Tensor = shift + effect * (new.code.embedding - old.code.embedding).abs().amax(-1)
    return moved


def _moved_samples(new: BodyFrame, old: BodyFrame) -> Float[Tensor, " a"]:
    """Metres by which the change of each sample moves the rest positions of points around it."""
    turn = new.samples.rest_from_posed - old.samples.rest_from_posed
    here = (turn[:, :, :3] @ old.samples.position[:, :, None])[:, :, 0] + turn[:, :, 3]
    apart = (new.samples.position - old.samples.position).norm(dim=-1)
    moved: Tensor = apart.maximum(here.norm(dim=-1) + LEVER * turn[:, :, :3].flatten(1).norm(dim=-1))
    return moved


def _moved_vertices(now: ReusableBody, before: ReusableBody) -> Float[np.ndarray, " v"]:
    """Metres by which each vertex, or the plane at it, moved."""
    apart = np.linalg.norm(now.vertices - before.vertices, axis=-1)
    return np.asarray(apart + LEVER * np.linalg.norm(now.normals - before.normals, axis=-1))
