"""Stage `geometry`: Step I of the body as a frame makes it, against evaluating every voxel that any node reaches.

Both over the same moving sequence, frame by frame, the fast one with the frame before at hand. A crossing is a pair of
neighbouring voxels with opposite signs: one that only one of the two grids has is changed. Voids that the body encloses are
filled and small components (volume/small_components.py) emptied in both: what is left is what a ray from outside can meet. Where both have
it, its place between the two voxels is compared. Two bounds on any band: it evaluates the corners of the cells with such
crossings; and to find the voids, too, all voxels with a guess no larger than that of one that it would otherwise take
the wrong sign of.
One core, processor time. Letters: z y x voxels, k (voxel, node) pairs.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np
import torch
from scipy.ndimage import label

from avatarrex.counters import Counters
from avatarrex.fields import body
from avatarrex.measure.bench.clock import Times, one_core, spent, timed
from avatarrex.measure.bench.metric import SLOWER, Metric
from avatarrex.measure.bench.session import Bench
from avatarrex.settings import RenderSettings
from avatarrex.templates.parts import PART_JOINT
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.volume.build import AvatarVolume, build_volume
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.narrow_band import unsettled
from avatarrex.volume.small_components import without_small_components


@dataclass
class Found:
    """Of a sequence, one entry a frame."""

    band: list[Times] = field(default_factory=list)
    full: list[Times] = field(default_factory=list)
    lists: list[float] = field(default_factory=list)
    """Processor milliseconds of the band in which pairs are listed."""
    band_pairs: list[int] = field(default_factory=list)
    full_pairs: list[int] = field(default_factory=list)
    changed: int = 0
    crossings: int = 0
    needed_pairs: int = 0
    """Of the corners of cells with crossings."""
    bubbles: dict[str, int] = field(default_factory=lambda: {"voids": 0, "floaters": 0})
    """Pieces of one sign that only evaluating everything finds: in the body, seen from nowhere, and in the air."""
    blind: float = 0.0
    """Metres: the largest guess at one of them."""
    nearer: list[float] = field(default_factory=list)
    """Share of a frame's voxels in reach with a guess up to that of its own farthest bubble."""
    shift: float = 0.0
    """Metres, the largest."""


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    found = bench.once(compare)
    changed = {
        "changed_crossings": found.changed,
        "of": found.crossings,
        "largest_shift_mm": 1e3 * found.shift,
        **found.bubbles,
        "farthest_bubble_mm": 1e3 * found.blind,
        "evaluated_to_find_them": max(found.nearer, default=0.0),
    }
    least = {"least_without_a_changed_crossing": found.needed_pairs / sum(found.full_pairs)}
    time = median(b.cpu[0] / f.cpu[0] for b, f in zip(found.band, found.full))
    pairs = sum(found.band_pairs) / sum(found.full_pairs)
    share = sum(found.lists) / sum(times.cpu[0] for times in found.band)
    return [
        Metric("geometry.band_vs_full", time, SLOWER, error=changed, target=0.4),
        Metric("geometry.band_pairs", pairs, "of the pairs", error=changed | least, target=0.3),
        Metric("geometry.changed_crossings", found.changed, "crossings", error=changed, target=0),
        Metric("geometry.pairlist_share", share, "of the pass", target=0.1),
        Metric("geometry.body.band.ms", median(t.cpu[0] for t in found.band), "ms", error=changed),
        Metric("geometry.body.full.ms", median(t.cpu[0] for t in found.full), "ms", error={"changed_crossings": 0}),
    ]


def compare(bench: Bench) -> Found:
    """The whole sequence."""
    found, settings = Found(), RenderSettings(hidden=frozenset(PART_JOINT))
    posed: PosedPerson | None = None
    volume: AvatarVolume | None = None
    with one_core():
        for number, signals in enumerate(map(bench.signals, range(bench.count(33, 5) + 1))):
            posed = pose_person(bench.avatar.person, signals, Counters(), posed)
            volume = _frame(bench, posed, volume, settings, found if number else None)
    return found


def _frame(
    bench: Bench, posed: PosedPerson, before: AvatarVolume | None, settings: RenderSettings, found: Found | None
) -> AvatarVolume:
    """Both grids of one frame; the first frame warms up and is not counted."""
    counters, all_counters = Counters(), Counters()
    with spent(body, "find_pairs") as lists:
        volume, band = timed(build_volume, bench.avatar, posed, settings, counters, before)
    every = replace(settings, everywhere=True)
    complete, full = timed(build_volume, bench.avatar, posed, every, all_counters, None)
    if found is not None:
        found.band.append(band)
        found.full.append(full)
        found.lists.append(sum(lists.cpu))
        found.band_pairs.append(counters["local_mlp_evaluations"])
        found.full_pairs.append(all_counters["local_mlp_evaluations"])
        assert complete.grid.known is not None
        ours, truth = volume.grid.sdf.numpy(), without_small_components(complete.grid).sdf.numpy()
        _count_bubbles(ours, truth, complete.grid.known, found)
        ours, truth = solid(ours), solid(truth)
        found.needed_pairs += _pairs_needed(bench, volume, truth)
        changed, crossings, shift = crossings_between(ours, truth, volume.grid.voxel)
        found.changed, found.crossings = found.changed + changed, found.crossings + crossings
        found.shift = max(found.shift, shift)
    return volume


def solid(sdf: np.ndarray) -> np.ndarray:
    """Distances (z, y, x) with the voids that the body encloses filled: no ray from outside meets them."""
    air, _ = label(sdf >= 0, np.ones((3, 3, 3)))
    return np.where((air > 0) & (air != air[0, 0, 0]), -sdf, sdf)


def _pairs_needed(bench: Bench, volume: AvatarVolume, full: np.ndarray) -> int:
    """Pairs at the corners of cells in which the sign of `full` (z, y, x) changes."""
    inside = full < 0
    lattice = Lattice(volume.grid.origin, volume.grid.voxel, inside.shape)
    corners = lattice.position(unsettled(inside, np.zeros_like(inside)))
    return len(bench.avatar.body.pairs(volume.body_frame, torch.as_tensor(corners, dtype=torch.float32)).point)


def _count_bubbles(band: np.ndarray, full: np.ndarray, reached: np.ndarray, found: Found) -> None:
    """Connected voxels (z, y, x) of one sign in `band` and the other in `full`."""
    for name, wrong in (("voids", (band < 0) & (full >= 0)), ("floaters", (band >= 0) & (full < 0))):
        found.bubbles[name] += int(label(wrong, np.ones((3, 3, 3)))[1])
        if wrong.any():
            farthest = float(np.abs(band[wrong]).max())
            found.blind = max(found.blind, farthest)
            found.nearer.append(float((np.abs(band) <= farthest)[reached].mean()))


def crossings_between(band: np.ndarray, full: np.ndarray, voxel: float) -> tuple[int, int, float]:
    """Crossings that only one of two grids (z, y, x) has, those of the second, and the largest shift of a common one."""
    changed = total = 0
    shift = 0.0
    for axis in range(3):
        ours, theirs = (np.moveaxis(a, axis, 0) for a in (band, full))
        (a, b), (c, d) = ((values[:-1], values[1:]) for values in (ours, theirs))
        mine, other = (a < 0) != (b < 0), (c < 0) != (d < 0)
        turned = mine & other & ((a < 0) != (c < 0))
        changed += int((mine != other).sum() + turned.sum())
        total += int(other.sum())
        both = mine & other & ~turned
        place = [p[both].astype(np.float64) / (p[both].astype(np.float64) - q[both]) for p, q in ((a, b), (c, d))]
        if both.any():
            shift = max(shift, float(voxel * np.abs(place[0] - place[1]).max()))
    return changed, total, shift
