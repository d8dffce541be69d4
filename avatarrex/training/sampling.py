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
from jaxtyping import Bool, Float, Int
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
BEHIND = 3
"""Candidates behind the surface of which the deepest ends the samples."""
OPAQUE = 0.5
"""Rays that absorb more than this meet the surface; others pass it and are sampled half as densely."""


@dataclass(frozen=True)
class RaySamples:
    """Ascending t of each ray's samples."""

    t: Float[Tensor, "r s"]
    used: Bool[Tensor, "r s"]
    """The others repeat the last one used and weigh nothing."""


@dataclass(frozen=True)
class Walk:
    """The stored volume along rays."""

    entry: Float[Tensor, " r"]
    spacing: Float[Tensor, " r"]
    """Metres between candidates; 0 where a ray misses the volume."""
    t: Float[Tensor, "r c"]
    sdf: Float[Tensor, "r c"]
    """Stored distance there; ∞ where a ray misses the volume."""


def span(volume: SdfVolume, rays: Rays) -> tuple[Float[Tensor, " r"], Float[Tensor, " r"]]:
    """Entry into the body's box, not before the camera, and exit; entry ≥ exit where a ray misses it."""
    grid = volume.body
    size = grid.voxel * (torch.tensor(grid.sdf.shape).flip(0).to(rays.origin) - 1)
    entry, exit = slab(rays.origin - torch.as_tensor(grid.origin).to(rays.origin), rays.direction, size)
    return entry.maximum(rays.camera), exit


def uniform_samples(walk: Walk, samples: int, noise: torch.Generator) -> RaySamples:
    """`samples` strata with one sample in each."""
    length = CANDIDATES * walk.spacing
    place = (torch.arange(samples) + torch.rand(len(length), samples, generator=noise)) / samples
    return RaySamples(walk.entry[:, None] + length[:, None] * place, (length > 0)[:, None].expand(-1, samples))


def walk(volume: SdfVolume, rays: Rays) -> Walk:
    """`CANDIDATES` stored distances along each ray."""
    entry, exit = span(volume, rays)
    length = (exit - entry).clamp_min(0)
    t = entry[:, None] + length[:, None] * ((torch.arange(CANDIDATES) + 0.5) / CANDIDATES)
    rows = torch.nonzero(length > 0)[:, 0]
    points = rays.origin[rows, None] + t[rows, :, None] * rays.direction[rows, None]
    sdf = torch.full_like(t, torch.inf)
    sdf[rows] = sample(volume, points.reshape(-1, 3)).composed.sdf.reshape(len(rows), CANDIDATES)
    return Walk(entry, length / CANDIDATES, t, sdf)


def near_samples(walk: Walk, samples: int, gamma: float, noise: torch.Generator) -> RaySamples:
    """At most `samples` where the stored volume says that colour comes from; none on rays that pass far from it.

    The last sample of a ray that meets the surface lies well inside it: otherwise all of them may lie outside, and the
    losses, which then see nothing there, pull the surface towards the camera.
    """
    t, spacing, sdf = walk.t, walk.spacing[:, None], walk.sdf
    wide = max(gamma, BLUR)
    depth = laplace_density(sdf, wide) * spacing
    weight = torch.exp(depth - torch.cumsum(depth, -1)) * -torch.expm1(-depth)
    near = sdf.abs() < NEAR * wide + spacing
    opaque = weight.sum(-1) > OPAQUE
    inside = _inside(sdf, torch.cumsum(weight, -1))
    near &= ~opaque[:, None] | (torch.arange(CANDIDATES) <= inside[:, None])
    chance = torch.cumsum((weight + FLOOR) * near, -1)
    chance = chance / chance[:, -1:].clamp_min(1e-12)
    count = torch.where(opaque, samples, max(2, samples // 2)).masked_fill(~near.any(-1), 0)
    drawn = count - opaque.long()
    rank = torch.arange(samples)
    used = rank < count[:, None]
    strata = (rank + torch.rand(len(t), samples, generator=noise)) / drawn.clamp_min(1)[:, None]
    u = strata.clamp(1e-6, 1 - 1e-6)
    cell = torch.searchsorted(chance, u).clamp_max(CANDIDATES - 1)
    above = chance.gather(1, cell)
    below = torch.where(cell > 0, chance.gather(1, (cell - 1).clamp_min(0)), 0.0)
    within = ((u - below) / (above - below).clamp_min(1e-9)).clamp(0, 1)
    found = walk.entry[:, None] + spacing * (cell + within)
    behind = walk.entry + walk.spacing * (inside + 1)
    found = torch.where(opaque[:, None] & (rank == drawn[:, None]), behind[:, None], found)
    last = found.masked_fill(~used, -torch.inf).amax(-1, keepdim=True)
    return RaySamples(torch.where(used, found, torch.where(last.isfinite(), last, walk.entry[:, None])), used)


def _inside(sdf: Float[Tensor, "r c"], absorbed: Float[Tensor, "r c"]) -> Int[Tensor, " r"]:
    """The deepest of the `BEHIND` candidates from where a ray has absorbed half."""
    rank = torch.arange(CANDIDATES)
    first = (absorbed < OPAQUE).sum(-1, keepdim=True)
    return sdf.masked_fill((rank < first) | (rank >= first + BEHIND), torch.inf).argmin(-1)


def lowest(walk: Walk) -> tuple[Float[Tensor, " r"], Float[Tensor, " r"]]:
    """t at which each ray comes closest to the stored surface or lies deepest in it, by a parabola, and the distance there."""
    rank = walk.sdf.argmin(-1, keepdim=True)
    sides = [walk.sdf.gather(1, (rank + step).clamp(0, CANDIDATES - 1)) for step in (-1, 0, 1)]
    before, here, after = (side[:, 0] for side in sides)
    bend = before - 2 * here + after
    inner = (bend > 0) & torch.isfinite(bend)
    shift = torch.where(inner, (before - after) / torch.where(inner, 2 * bend, 1.0), 0.0).clamp(-0.5, 0.5)
    return walk.t.gather(1, rank)[:, 0] + walk.spacing * shift, here


def draw(walked: Walk, how: str, samples: int, gamma: float, noise: torch.Generator) -> RaySamples:
    """`near` or `uniform` samples. While γ is wide, `near` takes as many more as the fog is deeper, up to 16."""
    if how == "uniform":
        return uniform_samples(walked, samples, noise)
    return near_samples(walked, max(samples, min(16, round(samples * gamma / BLUR))), gamma, noise)


def noise_of(*seeds: int) -> torch.Generator:
    """The same noise for the same step, wherever the training was interrupted."""
    seed = int(np.random.SeedSequence(seeds).generate_state(1, np.uint64)[0] >> 1)
    return torch.Generator().manual_seed(seed)
