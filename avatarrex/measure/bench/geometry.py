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

from dataclasses import dataclass, replace
from statistics import median

import numpy as np
import torch
from scipy.ndimage import label

from avatarrex.counters import Counters
from avatarrex.fields import body
from avatarrex.measure.bench.contest import Times, one_core, spent, timed
from avatarrex.measure.bench.report import SLOWER, Metric
from avatarrex.measure.bench.session import Bench
from avatarrex.settings import RenderSettings
from avatarrex.templates.parts import PART_JOINT
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.volume.build import AvatarVolume, build_volume
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.narrow_band import unsettled
from avatarrex.volume.small_components import without_small_components


@dataclass(frozen=True)
class Bubbles:
    """Pieces of one sign that only evaluating everything finds: in the body, seen from nowhere, and in the air."""

    voids: int
    floaters: int
    blind: float
    """Metres: the largest guess at one of them."""
    nearer: float
    """Share of the voxels in reach with a guess up to that of the farthest bubble."""

    @classmethod
    def of(cls, band: np.ndarray, full: np.ndarray, reached: np.ndarray) -> Bubbles:
        """Connected voxels (z, y, x) of one sign in `band` and the other in `full`, of those `reached`."""
        wrong = (band < 0) & (full >= 0), (band >= 0) & (full < 0)
        farthest = [float(np.abs(band[one]).max()) for one in wrong if one.any()]
        nearer = [float((np.abs(band) <= far)[reached].mean()) for far in farthest]
        voids, floaters = (int(label(one, np.ones((3, 3, 3)))[1]) for one in wrong)
        return cls(voids, floaters, max(farthest, default=0.0), max(nearer, default=0.0))


@dataclass(frozen=True)
class Found:
    """Of one frame."""

    band: Times
    full: Times
    lists: float
    """Processor milliseconds of the band in which pairs are listed."""
    band_pairs: int
    full_pairs: int
    needed_pairs: int
    """Of the corners of cells with crossings."""
    changed: int
    crossings: int
    shift: float
    """Metres, the largest."""
    bubbles: Bubbles


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    found = bench.once(compare)

    def total(name: str) -> int:
        return sum(getattr(frame, name) for frame in found)

    bubbles = [frame.bubbles for frame in found]
    changed = {
        "changed_crossings": total("changed"),
        "of": total("crossings"),
        "largest_shift_mm": 1e3 * max(frame.shift for frame in found),
        "voids": sum(one.voids for one in bubbles),
        "floaters": sum(one.floaters for one in bubbles),
        "farthest_bubble_mm": 1e3 * max(one.blind for one in bubbles),
        "evaluated_to_find_them": max(one.nearer for one in bubbles),
    }
    least = {"least_without_a_changed_crossing": total("needed_pairs") / total("full_pairs")}
    time = median(frame.band.cpu_ms / frame.full.cpu_ms for frame in found)
    share = sum(frame.lists for frame in found) / sum(frame.band.cpu_ms for frame in found)
    pairs, band = total("band_pairs") / total("full_pairs"), median(frame.band.cpu_ms for frame in found)
    full = median(frame.full.cpu_ms for frame in found)
    return [
        Metric("geometry.band_vs_full", time, SLOWER, error=changed, target=0.4),
        Metric("geometry.band_pairs", pairs, "of the pairs", error=changed | least, target=0.3),
        Metric("geometry.changed_crossings", total("changed"), "crossings", error=changed, target=0),
        Metric("geometry.pairlist_share", share, "of the pass", target=0.1),
        Metric("geometry.body.band.ms", band, "ms", error=changed),
        Metric("geometry.body.full.ms", full, "ms", error={"changed_crossings": 0}),
    ]


def compare(bench: Bench) -> list[Found]:
    """The whole sequence; the first frame warms up and is not counted."""
    settings, found = RenderSettings(hidden=frozenset(PART_JOINT), thin=0), []
    posed: PosedPerson | None = None
    volume: AvatarVolume | None = None
    with one_core():
        for signals in map(bench.signals, range(bench.count(33, 5) + 1)):
            posed = pose_person(bench.avatar.person, signals, Counters(), posed)
            volume, frame = _frame(bench, posed, volume, settings)
            found.append(frame)
    return found[1:]


def _frame(
    bench: Bench, posed: PosedPerson, before: AvatarVolume | None, settings: RenderSettings
) -> tuple[AvatarVolume, Found]:
    """The band's volume, and how its grid differs from one with every voxel evaluated."""
    counters, all_counters = Counters(), Counters()
    with spent(body, "find_pairs") as lists:
        volume, band = timed(build_volume, bench.avatar, posed, settings, counters, before)
    every = replace(settings, everywhere=True)
    complete, full = timed(build_volume, bench.avatar, posed, every, all_counters, None)
    assert complete.grid.known is not None
    ours, truth = volume.grid.sdf.numpy(), without_small_components(complete.grid).sdf.numpy()
    bubbles = Bubbles.of(ours, truth, complete.grid.known)
    ours, truth = solid(ours), solid(truth)
    pairs, all_pairs = (counted["local_mlp_evaluations"] for counted in (counters, all_counters))
    needed, crossings = _pairs_needed(bench, volume, truth), crossings_between(ours, truth, volume.grid.voxel)
    return volume, Found(band, full, sum(lists.cpu), pairs, all_pairs, needed, *crossings, bubbles)


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
