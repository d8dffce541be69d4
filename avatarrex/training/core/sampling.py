"""Where on a ray the field is evaluated (docs/training.md, 'What a step does').

`uniform` takes what the paper takes: samples spread evenly between the ray's entry into the volume and its exit. `near`
walks the same span over the stored volume of an earlier moment of the training, which costs no network, and draws the
few samples that are evaluated from the weights found there: none in empty space, none beyond the first surface.

Letters: r rays, c candidates, s samples. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.pointmap.rays import Rays, slab
from avatarrex.training.core.volume_rendering import laplace_density
from avatarrex.volume.sdf_volume import SdfVolume, distance

CANDIDATES = 64
BLUR = 0.004
"""Metres: the stored surface may be off by this much; the least γ that the candidates are weighed with."""
WEIGHT_FLOOR = 0.02
"""Weight of a candidate near the surface that seems hidden or thin: what has moved since is found again."""
NEAR_GAMMAS = 3.0
"""Candidates within so many γ of the stored surface count as near it."""
BEYOND = 3
"""Candidates beyond the surface of which the deepest ends the samples."""
OPAQUE = 0.5
"""Rays that absorb more than this meet the surface; others pass it and are sampled half as densely."""


@dataclass(frozen=True)
class RaySamples:
    """Ascending t of each ray's samples."""

    t: Float[Tensor, "r s"]
    used: Bool[Tensor, "r s"]
    """The others repeat the last one used and weigh nothing."""


@dataclass(frozen=True, eq=False)
class Walk:
    """The stored volume along rays, evaluated on first use."""

    volume: SdfVolume
    rays: Rays

    @cached_property
    def span(self) -> tuple[Float[Tensor, " r"], Float[Tensor, " r"]]:
        """Entry into the body's box, not before the camera, and length up to the exit; 0 where a ray misses it."""
        grid, rays = self.volume.body, self.rays
        size = grid.voxel * (torch.tensor(grid.sdf.shape).flip(0).to(rays.origin) - 1)
        entry, exit = slab(rays.origin - torch.as_tensor(grid.origin).to(rays.origin), rays.direction, size)
        entry = entry.maximum(rays.camera)
        return entry, (exit - entry).clamp_min(0)

    @property
    def spacing(self) -> Float[Tensor, " r"]:
        """Metres between candidates."""
        return self.span[1] / CANDIDATES

    @cached_property
    def t(self) -> Float[Tensor, "r c"]:
        """Of the candidates."""
        entry, length = self.span
        return entry[:, None] + length[:, None] * ((torch.arange(CANDIDATES) + 0.5) / CANDIDATES)

    @cached_property
    def sdf(self) -> Float[Tensor, "r c"]:
        """Stored distance there; ∞ where a ray misses the volume."""
        rows = torch.nonzero(self.spacing > 0)[:, 0]
        points = self.rays.origin[rows, None] + self.t[rows, :, None] * self.rays.direction[rows, None]
        sdf = torch.full_like(self.t, torch.inf)
        sdf[rows] = distance(self.volume, points.reshape(-1, 3)).reshape(len(rows), CANDIDATES)
        return sdf

    @cached_property
    def lowest(self) -> tuple[Float[Tensor, " r"], Float[Tensor, " r"]]:
        """t at which each ray comes closest to the stored surface or lies deepest in it, and its candidate's distance.

        Between candidates t is a parabola's.
        """
        rank = self.sdf.argmin(-1, keepdim=True)
        sides = [self.sdf.gather(1, (rank + step).clamp(0, CANDIDATES - 1)) for step in (-1, 0, 1)]
        before, here, after = (side[:, 0] for side in sides)
        bend = before - 2 * here + after
        inner = (bend > 0) & torch.isfinite(bend)
        shift = torch.where(inner, (before - after) / torch.where(inner, 2 * bend, 1.0), 0.0).clamp(-0.5, 0.5)
        return self.t.gather(1, rank)[:, 0] + self.spacing * shift, here


def uniform_samples(walk: Walk, samples: int, noise: torch.Generator) -> RaySamples:
    """`samples` strata with one sample in each."""
    entry, length = walk.span
    place = (torch.arange(samples) + torch.rand(len(length), samples, generator=noise)) / samples
    return RaySamples(entry[:, None] + length[:, None] * place, (length > 0)[:, None].expand(-1, samples))


def near_samples(walk: Walk, samples: int, gamma: float, noise: torch.Generator) -> RaySamples:
    """At most `samples` where the stored volume says that colour comes from; none on rays that pass far from it.

    The last sample of a ray that enters the surface lies inside it: otherwise all of them may lie outside, and the
    losses, which then see nothing there, pull the surface towards the camera.
    """
    (entry, _), spacing, sdf = walk.span, walk.spacing[:, None], walk.sdf
    wide = max(gamma, BLUR)
    depth = laplace_density(sdf, wide) * spacing
    weight = torch.exp(depth - torch.cumsum(depth, -1)) * -torch.expm1(-depth)
    near = sdf.abs() < NEAR_GAMMAS * wide + spacing
    deep, enters = _inside(sdf, torch.cumsum(weight, -1))
    near &= ~enters[:, None] | (torch.arange(CANDIDATES) <= deep[:, None])
    chance = torch.cumsum((weight + WEIGHT_FLOOR) * near, -1)
    chance = chance / chance[:, -1:].clamp_min(1e-12)
    count = torch.where(weight.sum(-1) > OPAQUE, samples, max(2, samples // 2)).masked_fill(~near.any(-1), 0)
    drawn = count - enters.long()
    rank = torch.arange(samples)
    used = rank < count[:, None]
    strata = (rank + torch.rand(len(sdf), samples, generator=noise)) / drawn.clamp_min(1)[:, None]
    u = strata.clamp(1e-6, 1 - 1e-6)
    cell = torch.searchsorted(chance, u).clamp_max(CANDIDATES - 1)
    above = chance.gather(1, cell)
    below = torch.where(cell > 0, chance.gather(1, (cell - 1).clamp_min(0)), 0.0)
    within = ((u - below) / (above - below).clamp_min(1e-9)).clamp(0, 1)
    found = entry[:, None] + spacing * (cell + within)
    end = walk.t.gather(1, deep[:, None])
    found = torch.where(enters[:, None], torch.where(rank == drawn[:, None], end, found.minimum(end)), found)
    last = found.masked_fill(~used, -torch.inf).amax(-1, keepdim=True)
    return RaySamples(torch.where(used, found, torch.where(last.isfinite(), last, entry[:, None])), used)


def _inside(sdf: Float[Tensor, "r c"], absorbed: Float[Tensor, "r c"]) -> tuple[Int[Tensor, " r"], Bool[Tensor, " r"]]:
    """The deepest of the `BEYOND` candidates from the first that lies inside where a ray has absorbed half; whether one does."""
    there = (absorbed > OPAQUE) & (sdf < 0)
    rank, first = torch.arange(CANDIDATES), there.int().argmax(-1, keepdim=True)
    deepest = sdf.masked_fill((rank < first) | (rank >= first + BEYOND), torch.inf).argmin(-1)
    return deepest, there.any(-1)


def draw(walked: Walk, how: str, samples: int, gamma: float, noise: torch.Generator) -> RaySamples:
    """`near` or `uniform` samples. While γ is wide, `near` takes as many more as the fog is deeper, up to 16."""
    if how == "uniform":
        return uniform_samples(walked, samples, noise)
    return near_samples(walked, max(samples, min(16, round(samples * gamma / BLUR))), gamma, noise)


def noise_of(*seeds: int) -> torch.Generator:
    """The same noise for the same step, wherever the training was interrupted."""
    seed = int(np.random.SeedSequence(seeds).generate_state(1, np.uint64)[0] >> 1)
    return torch.Generator().manual_seed(seed)
