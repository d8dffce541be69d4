"""Where on a ray the field is asked (docs/training.md, 'Samples').

`uniform` takes what the paper takes: samples spread evenly between the ray's entry into the volume and its exit. `near`
walks the same span over the stored volume of an earlier moment of the training, which costs no network, and draws the
few samples that are evaluated from the weights found there: none in empty space, none behind the first surface.

Letters: r rays, c candidates, s samples. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from avatarrex.pointmap.rays import Rays, slab
from avatarrex.training.volume_rendering import laplace_density
from avatarrex.volume.volume import SdfVolume, sample

CANDIDATES = 64
BLUR = 0.004
"""Metres: the stored surface may be off by this much; the least γ that the candidates are weighed with."""
FLOOR = 0.02
"""Weight of a candidate near the surface that seems hidden or thin: what has moved since is found again."""
NEAR = 3.0
"""Candidates within so many γ of the stored surface count as near it."""
OPAQUE = 0.5
"""Rays that absorb more than this meet the surface; others pass it and are sampled half as densely."""


@dataclass(frozen=True)
class RaySamples:
    """Ascending t of each ray's samples."""

    t: Float[Tensor, "r s"]
    used: Bool[Tensor, "r s"]
    """The others repeat the last one used and weigh nothing."""


def span(volume: SdfVolume, rays: Rays) -> tuple[Float[Tensor, " r"], Float[Tensor, " r"]]:
    """Entry into the body's box, not before the camera, and exit; entry ≥ exit where a ray misses it."""
    grid = volume.body
    size = grid.voxel * (torch.tensor(grid.sdf.shape).flip(0).to(rays.origin) - 1)
    entry, exit = slab(rays.origin - torch.as_tensor(grid.origin).to(rays.origin), rays.direction, size)
    return entry.maximum(rays.camera), exit


def uniform_samples(volume: SdfVolume, rays: Rays, samples: int, noise: torch.Generator) -> RaySamples:
    """`samples` strata with one sample in each."""
    entry, exit = span(volume, rays)
    length = (exit - entry).clamp_min(0)
    place = (torch.arange(samples) + torch.rand(len(entry), samples, generator=noise)) / samples
    return RaySamples(entry[:, None] + length[:, None] * place, (length > 0)[:, None].expand(-1, samples))


def near_samples(volume: SdfVolume, rays: Rays, samples: int, gamma: float, noise: torch.Generator) -> RaySamples:
    """At most `samples` where the stored volume says that colour comes from; none on rays that pass far from it."""
    entry, exit = span(volume, rays)
    length = (exit - entry).clamp_min(0)
    fraction = (torch.arange(CANDIDATES) + 0.5) / CANDIDATES
    middle = entry[:, None] + length[:, None] * fraction
    rows = torch.nonzero(length > 0)[:, 0]
    points = rays.origin[rows, None] + middle[rows, :, None] * rays.direction[rows, None]
    sdf = torch.full_like(middle, torch.inf)
    sdf[rows] = sample(volume, points.reshape(-1, 3)).composed.sdf.reshape(len(rows), CANDIDATES)
    wide = max(gamma, BLUR)
    spacing = length[:, None] / CANDIDATES
    depth = laplace_density(sdf, wide) * spacing
    weight = torch.exp(depth - torch.cumsum(depth, -1)) * -torch.expm1(-depth)
    near = sdf.abs() < NEAR * wide + spacing
    opaque = weight.sum(-1) > OPAQUE
    density = weight + FLOOR * near
    chance = torch.cumsum(density, -1)
    chance = chance / chance[:, -1:].clamp_min(1e-12)
    count = torch.where(opaque, samples, max(2, samples // 2)).masked_fill(~near.any(-1), 0)
    rank = torch.arange(samples)
    used = rank < count[:, None]
    strata = (rank + torch.rand(len(entry), samples, generator=noise)) / count.clamp_min(1)[:, None]
    u = strata.clamp(1e-6, 1 - 1e-6)
    cell = torch.searchsorted(chance, u).clamp_max(CANDIDATES - 1)
    above = chance.gather(1, cell)
    below = torch.where(cell > 0, chance.gather(1, (cell - 1).clamp_min(0)), 0.0)
    within = ((u - below) / (above - below).clamp_min(1e-9)).clamp(0, 1)
    t = entry[:, None] + spacing * (cell + within)
    last = t.masked_fill(~used, -torch.inf).amax(-1, keepdim=True)
    return RaySamples(torch.where(used, t, torch.where(last.isfinite(), last, entry[:, None])), used)


def draw(volume: SdfVolume, rays: Rays, how: str, samples: int, gamma: float, noise: torch.Generator) -> RaySamples:
    """`near` or `uniform` samples. While γ is wide, `near` takes as many more as the fog is deeper, up to 16."""
    if how == "uniform":
        return uniform_samples(volume, rays, samples, noise)
    return near_samples(volume, rays, max(samples, min(16, round(samples * gamma / BLUR))), gamma, noise)


def noise_of(*seeds: int) -> torch.Generator:
    """The same noise for the same step, wherever the training was interrupted."""
    seed = int(np.random.SeedSequence(seeds).generate_state(1, np.uint64)[0] >> 1)
    return torch.Generator().manual_seed(seed)
