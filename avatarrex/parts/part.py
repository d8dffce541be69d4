"""A part of an avatar that has a field of its own beside the body's: what every part can do (paper sec. 3.2 to 3.4).

A part lives in the frame of its joint and depends on its own coefficients and the shape alone. One file here makes a kind of
part: hand.py, face.py. Volume and shading reach a part's field by this interface only;
the raycast has a slot for each of `PARTS`, up to four.

| step     | needs from a part                                                       |
|----------|-------------------------------------------------------------------------|
| prepare  | its state under one driving signal: search tree, tri-planes             |
| sample   | its whole box, where it knows where its surface is                      |
| start    | else: where its box has to be evaluated first, and what stands there until then |
| evaluate | values for the box, saturated outside the composition's band            |
| distance | signed distance and ω at any points, for the exact composed field       |
| colour   | sRGB at surface points                                                  |

Letters: v vertices, p points. Part frame, metres, negative inside.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, Literal, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.fields.light import Irradiance
from avatarrex.ops.mesh_lattice import Grid

CLAMP = 0.051
"""Metres: beyond the deepest value that the composition needs (paper eq. 13), however half precision rounds it."""
Impl = Literal["auto", "reference"]


class PartState:
    """What a part prepared for one driving signal."""

    def apart(self) -> PartState:
        """A copy for one step of a training: colour planes that are decoded in it do not become the original's."""
        return copy.copy(self)


State = TypeVar("State", bound=PartState)


@dataclass(frozen=True)
class Start:
    """What a part's box contains before the field is evaluated."""

    values: Float[np.ndarray, "p 2"]
    """(signed distance, ω)."""
    first: Int[np.ndarray, " k"]
    """Points that are evaluated at once."""
    unused: Bool[np.ndarray, " p"] | None = None
    """Points at which the field is never evaluated: ω is 0 there. None: there are none."""


@dataclass(frozen=True)
class SurfacePoints:
    """Points of a part that are coloured, and from where they are seen."""

    position: Float[Tensor, "p 3"]
    """Part frame."""
    gaze: Float[Tensor, "p 3"]
    """Unit, from the eye to the point, part frame."""
    direction: Float[Tensor, "p 3"]
    """What colour networks get as the viewing direction: `gaze`, or one given in its place (`SurfaceColour.told`)."""
    root_direction: Float[Tensor, "p 3"]
    """`direction` in the root frame."""
    root_from_part: Float[Tensor, "3 3"]
    """Rotation."""
    light: Irradiance
    """What falls on them, root frame."""


@dataclass(frozen=True)
class Part(ABC, Generic[State]):
    """A hand, the face, or another part."""

    name: str
    """One of `PARTS`."""
    blend_weight: Float[Tensor, " v"]
    """Painted ω of the part's mesh."""
    margin: float
    """Metres around the vertices with ω > 0 beyond which the part is not blended."""
    halvings: int
    """How often the first voxels of its box are halved."""
    work: str
    """The counter of its evaluations."""

    @abstractmethod
    def prepare(
        self,
        vertices: Tensor,
        coefficients: Tensor,
        counters: Counters,
        impl: Impl = "auto",
        before: State | None = None,
    ) -> State:
        """Whatever the field needs of one driving signal, computed once from the posed mesh (v, 3) and the part's coefficients.

        `before`: what the same part prepared for another signal, of which something may serve again.
        """

    def sample(self, state: State, grids: Sequence[Grid], counters: Counters) -> Float[np.ndarray, "z y x 2"] | None:
        """(signed distance, ω) at the last of `grids`, each of half the voxel of the one before; None: evaluate it point by point."""
        return None

    @abstractmethod
    def start(self, state: State, grid: Grid, everywhere: bool) -> Start:
        """First values of the box, voxel by voxel; `everywhere`: evaluate all points that are used, not only those near the surface."""

    @abstractmethod
    def evaluate(self, state: State, position: Float[Tensor, "p 3"]) -> Float[Tensor, "p _c"]:
        """Signed distance within ±`CLAMP` and, where c = 2, ω."""

    @abstractmethod
    def distance(self, state: State, position: Tensor, impl: Impl = "auto") -> tuple[Tensor, Tensor]:
        """At points (p, 3): signed distance (p,), saturated outside the composition's band, and ω (p,). `reference` skips nothing."""

    def decode_colour(self, state: State, counters: Counters) -> object:
        """Make what all colours of `state` need, before they are chosen for side by side."""
        return None

    @abstractmethod
    def colour(self, state: State, points: SurfacePoints, counters: Counters, impl: Impl = "auto") -> Tensor:
        """sRGB (p, 3); differentiable in the part's networks."""

    @cached_property
    def _blended(self) -> Int[Tensor, " k"]:
        """Vertices at which the part has a share."""
        return torch.nonzero(self.blend_weight > 0)[:, 0]

    def bounds(self, vertices: Float[Tensor, "v 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest corner, (3,) metres, of the box in which the part may be blended: the part's one box."""
        mesh = vertices.index_select(0, self._blended).double().numpy()
        return mesh.min(0) - self.margin, mesh.max(0) + self.margin
