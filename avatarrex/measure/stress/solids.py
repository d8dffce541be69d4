"""Case `rays`: thin and touching solids in a small volume under hostile cameras; every ray caster against the float64 walk.

At silhouettes a ray may fall either way: only pixels with neighbours that agree about being hit are judged.
"""

from __future__ import annotations

import numpy as np
import torch

from avatarrex.measure.stress import driving, views
from avatarrex.measure.stress.case import Entry, Inputs, Kind
from avatarrex.measure.stress.findings import Findings
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.raycast import available, raycast
from avatarrex.reference.solids import Solid, body_grid, capsule, part_box, rotation, union
from avatarrex.volume.sdf_volume import SdfVolume

RAYS_A_SIDE = 24
GRID = ((0.0, 0.0, 0.0), 0.02, (31, 31, 31))
BOX_SIDE, BOX_VOXEL = 0.16, 0.005
MOST_OFF = 1e-5
"""Metres: what a ray caster may be off (design: performance, target 4)."""


def draw(rng: np.random.Generator, number: int) -> Inputs:
    """Capsules from a millimetre to 12 cm thick, a box about the first in every other case."""
    count = int(rng.integers(1, 6))
    ends = rng.uniform(0.1, 0.5, (count, 2, 3))
    ends[:, 1] = np.where(rng.random((count, 1)) < 0.3, ends[:, 0] + 1e-4, ends[:, 1])  # balls
    ends[:, 1] = np.where(rng.random((count, 3)) < 0.2, ends[:, 0] + 1e-4, ends[:, 1])  # along the axes
    radius = 10.0 ** rng.uniform(-2.5, -0.92, count)
    solids = np.concatenate([ends.reshape(count, 6), radius[:, None]], 1)
    share = rng.random((200, 1))
    rows = rng.integers(count, size=200)
    skin = ends[rows, 0] * share + ends[rows, 1] * (1 - share) + radius[rows, None] * driving.directions(rng, 200)
    camera = views.draw_view(rng, int(rng.integers(8)), skin, RAYS_A_SIDE)
    box = np.array([float(number % 2), *rng.uniform(-90, 90, 2)])
    return {"solids": solids, "box": box, **views.inputs_of(camera)}


def check(inputs: Inputs, found: Findings) -> None:
    """All checks of the case."""
    volume, camera = _volume(inputs), views.camera_of(inputs, RAYS_A_SIDE)
    truth = raycast(volume, camera, "reference", antialias=False)
    for impl in (name for name in available() if name != "reference"):
        one = raycast(volume, camera, impl, antialias=False)
        found.finite(f"{impl}: point map finite", one.position, one.normal, one.depth)
        found.unit(f"{impl}: normal of unit length", one.normal[one.hit], 1e-5)
        inner = _inner(truth)
        found.at_most(f"{impl}: missed or false off silhouettes", ((one.hit != truth.hit) & inner).double().sum(), 0)
        both = one.hit & truth.hit & inner
        apart = (one.position.double() - truth.position.double())[both].norm(dim=-1)
        # Of a few dozen pixels one or two see a second surface edge-on: their share is bounded, not their error.
        found.at_most(f"{impl}: share of positions off", (apart > MOST_OFF).double().mean() if len(apart) else 0.0, 0.1)


def _volume(inputs: Inputs) -> SdfVolume:
    solids: list[Solid] = [capsule(row[:3].tolist(), row[3:6].tolist(), float(row[6])) for row in inputs["solids"]]
    on, first, second = inputs["box"]
    body = body_grid(union(*solids), *GRID)
    if not on:
        return SdfVolume(body)
    place = np.eye(4)
    place[:3, :3] = rotation(1, first) @ rotation(2, second)
    place[:3, 3] = inputs["solids"][0, :3] - place[:3, :3] @ np.full(3, BOX_SIDE / 2)
    shape = (round(BOX_SIDE / BOX_VOXEL) + 1,) * 3
    box = part_box("face", union(*solids), lambda p: torch.ones_like(p[:, 0]), place, BOX_VOXEL, shape)
    return SdfVolume(body, (box,))


def _inner(truth: PointMap) -> torch.Tensor:
    """Pixels with neighbours that are all hit as they are."""
    hit = truth.hit[None, None].float()
    pool = torch.nn.functional.max_pool2d
    return (pool(hit, 3, 1, 1) + pool(-hit, 3, 1, 1) == 0)[0, 0]


ENTRIES = {"solids": Entry((-1, 7)), "box": Entry((3,)), **views.ENTRIES}
KIND = Kind("rays", ENTRIES, draw, check, repeat=20, fewer=("solids",))
