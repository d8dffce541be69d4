"""A hand as a part: exact distance to its mesh, painted ω, colour network under the avatar's light (paper sec. 3.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.fields.composition import BAND
from avatarrex.fields.hand import HandField, HandQuery, HandSurface
from avatarrex.ops.halving import between
from avatarrex.ops.mesh_lattice import Grid, PaintedMesh, paint_near, winding_lattice
from avatarrex.parts.part import CLAMP, Impl, Part, PartState, Start, SurfacePoints

BOUND = (-CLAMP, 0.026)
"""Metres at which distances of the box saturate: both ends outside the composition's band."""
MARGIN = 0.028
"""Metres: from +0.025 on the hand is not blended (paper eq. 13)."""


@dataclass(frozen=True)
class HandState(PartState):
    """A posed hand."""

    field: HandField
    vertices: Float[Tensor, "v 3"]
    hand_pose: Float[Tensor, "15 3"]

    @cached_property
    def surface(self) -> HandSurface:
        """Prepared for many queries."""
        return self.field.surface(self.vertices)

    @cached_property
    def surface_reference(self) -> HandSurface:
        """Without a tree; the winding number decides every sign."""
        return HandSurface.of(self.vertices, self.field.faces, "reference")

    def query(
        self, position: Float[Tensor, "p 3"], bound: tuple[float, float] | None, impl: Impl = "auto"
    ) -> HandQuery:
        """The nearest point of the mesh; the distance saturates beyond `bound`."""
        surface = self.surface_reference if impl == "reference" else self.surface
        return self.field.sdf(self.vertices, position, bound, impl, surface)


@dataclass(frozen=True)
class Hand(Part[HandState]):
    """`left_hand` or `right_hand`."""

    field: HandField

    @classmethod
    def of(cls, name: str, field: HandField) -> Hand:
        """The hand of an avatar."""
        return cls(
            name=name,
            blend_weight=field.blend_weight,
            margin=MARGIN,
            halvings=2,
            work="hand_distances",
            field=field,
        )

    def prepare(
        self,
        vertices: Tensor,
        coefficients: Tensor,
        counters: Counters,
        impl: Impl = "auto",
        before: HandState | None = None,
    ) -> HandState:
        """See `Part`."""
        return HandState(self.field, vertices, coefficients)

    def sample(self, state: HandState, grids: Sequence[Grid], counters: Counters) -> Float[np.ndarray, "z y x 2"]:
        """`evaluate` around the surface; farther off what lies between the voxels of the grid before. The winding number says
        what is inside."""
        mesh, last = self._painted(state.vertices), grids[-1]
        inside = winding_lattice(mesh.corner, last) > 0
        values = np.zeros((*grids[0].shape, 2), np.float32)
        values[..., 0] = BOUND[1]
        for k, grid in enumerate(grids):
            # All that blends, and the far corners of cells in which it does; then what a crossing can touch.
            within = 2 * grid.voxel if k else BAND[1] + math.sqrt(3) * grid.voxel
            values = between(values) if k else values
            step = 2 ** (len(grids) - 1 - k)
            here = np.ascontiguousarray(inside[::step, ::step, ::step])
            counters.add(self.work, paint_near(mesh, grid, here, within, values))
            if not k:
                values[..., 0].clip(*BOUND, out=values[..., 0])
        return values

    def _painted(self, vertices: Float[Tensor, "v 3"]) -> PaintedMesh:
        faces = self.field.faces.numpy()
        return PaintedMesh(vertices.double().numpy()[faces], self.blend_weight.double().numpy()[faces])

    def start(self, state: HandState, grid: Grid, everywhere: bool) -> Start:
        """Every voxel."""
        count = math.prod(grid.shape)
        return Start(np.zeros((count, 2), dtype=np.float32), np.arange(count))

    def evaluate(self, state: HandState, position: Float[Tensor, "p 3"]) -> Float[Tensor, "p 2"]:
        """The exact distance and the painted ω of the nearest surface point (paper eq. 8, 9)."""
        query = state.query(position, BOUND)
        return torch.stack([query.sdf.clamp(-CLAMP, CLAMP), self.field.omega(query)], -1)

    def distance(self, state: HandState, position: Tensor, impl: Impl = "auto") -> tuple[Tensor, Tensor]:
        """See `Part`."""
        query = state.query(position, BAND, impl)
        return query.sdf, self.field.omega(query)

    def colour(self, state: HandState, points: SurfacePoints, counters: Counters, impl: Impl = "auto") -> Tensor:
        """C_H (paper eq. 10) times the light on the normal that faces the eye."""
        counters.add("hand_pixels", len(points.position))
        query = state.query(points.position, None, impl).facing(points.gaze)
        root_normal = query.normal @ points.root_from_part.T
        colour: Tensor = self.field.colour(state.vertices, state.hand_pose, query) * points.light(root_normal)
        return colour
