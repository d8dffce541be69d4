"""Where rays first enter a field, by samples so dense that nothing visible is missed: float64, small images, any field.

No sample's value is trusted for the length of a step: between two samples a ray moves by `step`, or by as much as the
field itself guarantees to be empty (`clearance`). What enters and leaves within one step can be missed; two densities
that agree show that nothing did. A jump of the field from outside to inside counts as surface.

Letters: r rays, s samples of one block. Root frame, metres.
"""

from __future__ import annotations

import math
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.pointmap.rays import Rays, slab

RAY_SAMPLES = 24
"""Samples that a ray takes at a time: a crossing ends the ray within as many."""
CHUNK_POINTS = 100_000
"""Points of one evaluation, about 1 GB of (point, node) pairs in float64."""
EXACT = 1e-8
"""Metres to which a crossing is bisected."""


@runtime_checkable
class DenseField(Protocol):
    """What rays are cast against."""

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(3,) corners of a box that holds the surface."""
        ...

    def sdf(self, position: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
        """Signed distance, negative inside."""
        ...

    def clearance(self, position: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
        """A distance within which the field is certainly positive; 0 where it may be negative."""
        ...


def dense_crossing(field: DenseField, rays: Rays, step: float) -> Float[Tensor, " r"]:
    """t of the first crossing from s ≥ 0 to s < 0 along each float64 ray, exact to `EXACT`; +inf where there is none."""
    low, high = (torch.as_tensor(corner).to(rays.origin) for corner in field.bounds)
    entry, exit = slab(rays.origin - low, rays.direction, high - low)
    t = entry.maximum(rays.camera)
    before, after = torch.full_like(t, torch.inf), torch.full_like(t, torch.inf)
    active = torch.nonzero((entry < exit) & (exit > rays.camera))[:, 0]
    along = step * torch.arange(RAY_SAMPLES + 1, dtype=t.dtype)
    while len(active):
        at = t[active, None] + along
        flat = rays[active.repeat_interleave(RAY_SAMPLES + 1)].at(at.flatten())
        clear = field.clearance(flat)
        value = clear.clone()
        near = torch.nonzero(clear == 0)[:, 0]
        for rows in near.split(CHUNK_POINTS):
            value[rows] = field.sdf(flat[rows])
        value = value.view_as(at)
        falls = (value[:, :-1] >= 0) & (value[:, 1:] < 0)
        found = falls.any(1)
        place, rows = falls[found].int().argmax(1, keepdim=True), active[found]
        before[rows], after[rows] = at[found].gather(1, place)[:, 0], at[found].gather(1, place + 1)[:, 0]
        t[active] = at[:, -1] + clear.view_as(at)[:, -1]
        active = active[~found & (t[active] < exit[active])]
    return _bisect(field, rays, before, after, math.ceil(math.log2(step / EXACT)))


def _bisect(field: DenseField, rays: Rays, outside: Tensor, inside: Tensor, halvings: int) -> Tensor:
    rows = torch.nonzero(outside.isfinite())[:, 0]
    low, high, some = outside[rows], inside[rows], rays[rows]
    for _ in range(halvings):
        middle = (low + high) / 2
        out = field.sdf(some.at(middle)) >= 0
        low, high = torch.where(out, middle, low), torch.where(out, high, middle)
    first = torch.full_like(outside, torch.inf)
    first[rows] = (low + high) / 2
    return first
