"""The raycast on tensors, for machines without compute shaders: the walk of shaders/pointmap, step by step.

Letters: r rays. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.pointmap.occlusion_edges import NEIGHBOURS, SHEET_GAP, OcclusionEdges
from avatarrex.pointmap.point_map import CoveredPixels, PointMap
from avatarrex.pointmap.raycast_reference import first_crossing, surface
from avatarrex.pointmap.rays import SUBPIXELS, RayPlane, Rays, pixel_centres, slab
from avatarrex.volume.sdf_volume import SdfVolume, sample

FINEST = 0.25
"""Smallest step, in voxels of the box or grid that the ray is in."""
MAX_STEPS = 400
"""128 voxels × √3 × 2: steps average half a voxel along a grazing ray."""
SECANTS = 3
CONVERGED = 2e-6
"""Metres: residual above which the exact walk takes over."""


@dataclass(frozen=True)
class March:
    """What sphere tracing found."""

    t: Float[Tensor, " r"]
    """+inf where there is no crossing."""
    suspect: Bool[Tensor, " r"]
    """A near miss or an open bracket: to be walked exactly."""
    near: Bool[Tensor, " r"]
    """Passed the surface within a pixel."""
    steps: Float[Tensor, " r"]


def raycast_torch(volume: SdfVolume, camera: Camera, antialias: bool, march: str = "exact") -> PointMap:
    """See `avatarrex.pointmap.raycast.raycast`."""
    if march == "fixed":
        return _plain(volume, camera)
    plane = RayPlane.of(camera, volume.middle)
    pixels = pixel_centres(camera)
    rays = plane.rays(pixels)
    first = _march(volume, rays, plane.footprint)
    t, steps = first.t, first.steps
    again = torch.nonzero(first.suspect)[:, 0]
    t[again] = first_crossing(volume, plane.rays(pixels[again].double())).float()
    hit = t.isfinite()
    coverage, count, total, edges = hit.float(), len(pixels), int(steps.sum()), OcclusionEdges.none()
    if antialias:
        sheet = _other_sheet(t, plane, rays, camera)
        edge = torch.nonzero(_beside_silhouette(hit, camera) | (first.near & ~hit) | (sheet >= 0))[:, 0]
        offset = torch.as_tensor(SUBPIXELS).float()
        sub_pixels = (pixels[edge, None] - 0.5 + offset).view(-1, 2)
        sub = _march(volume, plane.rays(sub_pixels), plane.footprint)
        sub_t = sub.t.view(-1, 16)
        covered = sub_t.isfinite()
        coverage[edge] = covered.float().mean(1).maximum(hit[edge] / 16)
        edges = _occlusion_edges(t, sub_t, edge, sheet[edge])
        # Where the centre misses, the covered sub-position nearest to it speaks for the pixel.
        away = (offset - 0.5).square().sum(1).expand(len(edge), 16).masked_fill(~covered, torch.inf)
        nearest = away.argmin(1)
        borrow = covered.any(1) & ~hit[edge]
        pixels[edge[borrow]] += offset[nearest[borrow]] - 0.5
        t[edge[borrow]] = sub_t[borrow, nearest[borrow]]
        count, total = count + 16 * len(edge), total + int(sub.steps.sum())
    pixel = torch.nonzero(t.isfinite())[:, 0]
    position = plane.rays(pixels[pixel]).at(t[pixel])
    normal, weight = surface(volume, position)
    counters = {"rays": count, "ray_steps": total}
    found = CoveredPixels(pixel, position, normal, weight, hit[pixel], coverage[pixel], steps[pixel], edges)
    return found.scatter(camera, "torch on the CPU", counters)


def _plain(volume: SdfVolume, camera: Camera) -> PointMap:
    """Steps of a quarter of a body voxel to the first crossing, and one linear interpolation."""
    rays = RayPlane.of(camera, volume.middle).rays(pixel_centres(camera))
    t, end = _range(volume, rays)
    before, steps = torch.full_like(t, -1.0), torch.zeros_like(t)
    found, step = torch.zeros(len(t), dtype=torch.bool), FINEST * volume.body.voxel
    going = torch.nonzero(t <= end)[:, 0]
    while len(going):
        s = sample(volume, rays[going].at(t[going])).composed.sdf
        steps[going] += 1
        crossed = (s < 0) & (before[going] >= 0)
        rows = going[crossed]
        t[rows] -= step * s[crossed] / (s[crossed] - before[rows])
        found[rows] = True
        before[going] = s
        going = going[~crossed]
        t[going] += step
        going = going[t[going] <= end[going]]
    pixel = torch.nonzero(found)[:, 0]
    position = rays[pixel].at(t[pixel])
    normal, weight = surface(volume, position)
    counters = {"rays": len(t), "ray_steps": int(steps.sum())}
    return CoveredPixels(pixel, position, normal, weight, steps=steps[pixel]).scatter(
        camera, "torch on the CPU", counters
    )


def _march(volume: SdfVolume, rays: Rays, footprint: float) -> March:
    """Sphere tracing with a smallest step to the first outside-to-inside crossing; then the bracket is closed."""
    start, end = _range(volume, rays)
    t, before = start.clone(), start.clone()
    value, value_before = torch.full_like(t, -1.0), torch.full_like(t, -1.0)
    smallest, steps = torch.zeros_like(t), torch.zeros_like(t)
    found, suspect, near = (torch.zeros(len(t), dtype=torch.bool) for _ in range(3))
    active = torch.nonzero(start <= end)[:, 0]
    for _ in range(MAX_STEPS):
        if not len(active):
            break
        here = sample(volume, rays[active].at(t[active]))
        s, last = here.composed.sdf, value_before[active]
        steps[active] += 1
        value[active] = s
        found[active] = crossed = (s < 0) & (last >= 0)
        suspect[active] |= (last >= 0) & (last < smallest[active]) & (s >= last)
        pixel = footprint * (1 - t[active] / rays.camera[active])
        near[active] |= (s >= 0) & (s < 1.2 * pixel)
        going = ~crossed & (t[active] < end[active])
        active, s, step = active[going], s[going], here.step[going]
        smallest[active] = FINEST * here.voxel[going]
        before[active], value_before[active] = t[active], s
        t[active] = (t[active] + step.maximum(smallest[active])).minimum(end[active])
    rows = torch.nonzero(found)[:, 0]
    a, b, fa, fb = before[rows], t[rows], value_before[rows], value[rows]
    fm = torch.zeros_like(a)
    for _ in range(SECANTS):
        middle = (a + (b - a) * fa / (fa - fb)).maximum(a).minimum(b)
        fm = sample(volume, rays[rows].at(middle)).composed.sdf
        inside = fm < 0
        a, fa = torch.where(inside, a, middle), torch.where(inside, fa, fm)
        b, fb = torch.where(inside, middle, b), torch.where(inside, fm, fb)
    steps[rows] += SECANTS
    suspect[rows] |= fm.abs() > CONVERGED
    result = torch.full_like(t, torch.inf)
    result[rows] = (a + (b - a) * fa / (fa - fb).clamp(min=1e-12)).maximum(a).minimum(b)
    return March(result, suspect, near, steps)


def _range(volume: SdfVolume, rays: Rays) -> tuple[Float[Tensor, " r"], Float[Tensor, " r"]]:
    """Where any box is, from the camera on; start > end where there is none."""
    body = torch.eye(4, dtype=torch.float64)
    body[:3, 3] = -torch.as_tensor(volume.body.origin)
    size = volume.body.voxel * (torch.tensor(volume.body.sdf.shape).flip(0) - 1.0)
    boxes = [(body, size), *((torch.as_tensor(p.box_from_root), torch.as_tensor(p.size)) for p in volume.parts)]
    start, end = torch.full_like(rays.camera, torch.inf), torch.full_like(rays.camera, -torch.inf)
    for matrix, size in boxes:
        rotation, translation = matrix[:3, :3].to(rays.origin), matrix[:3, 3].to(rays.origin)
        entry, exit = slab(rays.origin @ rotation.T + translation, rays.direction @ rotation.T, size.to(rays.origin))
        met = (entry <= exit) & (exit >= rays.camera)
        start, end = torch.where(met, start.minimum(entry), start), torch.where(met, end.maximum(exit), end)
    return start.maximum(rays.camera), end


def _other_sheet(t: Float[Tensor, " r"], plane: RayPlane, rays: Rays, camera: Camera) -> Int[Tensor, " r"]:
    """The neighbouring pixel whose hit is farthest before or behind a pixel's own, on another sheet; −1 where there is none."""
    gap = SHEET_GAP * float(np.linalg.norm(plane.across)) * (1 - t / rays.camera)
    found, image = torch.full_like(t, -1, dtype=torch.int64), t.view(camera.height, camera.width)
    number = torch.arange(len(t)).view_as(image)
    for right, down in NEIGHBOURS:
        rows, columns = (
            torch.arange(size).add(step).clamp(0, size - 1)
            for size, step in ((camera.height, down), (camera.width, right))
        )
        apart = (image[rows][:, columns] - image).abs().flatten()
        farther = apart.isfinite() & (apart > gap)
        found = torch.where(farther, number[rows][:, columns].flatten(), found)
        gap = torch.where(farther, apart, gap)
    return found


def _occlusion_edges(
    t: Float[Tensor, " r"], sub_t: Float[Tensor, "e 16"], edge: Int[Tensor, " e"], beside: Int[Tensor, " e"]
) -> OcclusionEdges:
    """Of the pixels `edge`, those with sub-positions nearer to the hit of `beside` than to their own."""
    covered = sub_t.isfinite()
    others = ((sub_t - t[beside, None]).abs() < (sub_t - t[edge, None]).abs()) & covered & (beside >= 0)[:, None]
    share = others.float().sum(1) / covered.sum(1).clamp(min=1)
    rows = torch.nonzero(share)[:, 0]
    return OcclusionEdges(edge[rows], beside[rows], share[rows])


def _beside_silhouette(hit: Bool[Tensor, " r"], camera: Camera) -> Bool[Tensor, " r"]:
    """Pixels with a neighbour that differs in being hit."""
    value = hit.view(1, 1, camera.height, camera.width).float()
    pool = torch.nn.functional.max_pool2d
    return (pool(value, 3, 1, 1) + pool(-value, 3, 1, 1) > 0).view(-1)
