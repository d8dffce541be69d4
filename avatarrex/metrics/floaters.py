"""Floaters: pieces of an avatar's shape apart from the person, seen from 26 sides and counted in the volume itself.

Two tests, since neither sees all. *Islands*: connected pieces (8 neighbours) of the silhouette, coverage of half a pixel or
more, besides the largest, in views along the 26 directions to a cube's faces, edges and corners. *Lumps*: connected pieces
(6 neighbours) of the negative samples of the composed field, besides the largest, on the body lattice cut `SAMPLES_PER_VOXEL` times along
each axis. The field is linear along the lattice's edges, so two neighbouring negative voxels are always connected; a lump
inside a cavity or before the body is found, too. Parts that the composition attaches are one piece with the body.

Letters: j joints. Root frame, metres; sizes of lumps in millimetres.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy import ndimage

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.pointmap.raycast import raycast
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.posed import pose_person
from avatarrex.volume.build import build_volume
from avatarrex.volume.sdf_volume import SdfVolume, sample

SILHOUETTE_PIXELS = 512
"""Pixels a side of the silhouettes: about 4 mm each on a standing person."""
SPECKS = 3
"""Islands of at most so many pixels are rounding at a silhouette's rim, not counted."""
SAMPLES_PER_VOXEL = 4
"""Samples to a body voxel along each axis: 5 mm, a third of the thinnest finger."""
BATCH = 400_000
"""Samples of the field at a time: about 200 MB."""
_FOV, _MARGIN = 20.0, 1.03
_WORDS = (("right", "", "left"), ("below", "", "above"), ("back", "", "front"))

Place = tuple[float, float, float]


@dataclass(frozen=True)
class Island:
    """A piece of a silhouette apart from the largest."""

    view: str
    """Where the camera stands, the person's sides: `front`, `left above`, …"""
    pixels: int
    place: Place
    """Root-frame metres: mean of the surface points seen there."""
    near: str
    """The nearest joint."""


@dataclass(frozen=True)
class Lump:
    """A piece of the volume apart from the largest."""

    size_mm: float
    """Longest side of its box."""
    volume_mm3: float
    place: Place
    """Root-frame metres: mean of its samples."""
    near: str


@dataclass(frozen=True)
class Floaters:
    """What one pose shows; both largest first."""

    pose: str
    views: int
    islands: tuple[Island, ...]
    lumps: tuple[Lump, ...]

    def line(self) -> str:
        """One line for a person to read."""
        seen, volume = f"{self.views} silhouettes in one piece each", "volume in one piece"
        for island in self.islands[:1]:
            sides = len({other.view for other in self.islands})
            seen = f"{_count(self.islands, 'island')} in {sides} of {self.views} silhouettes"
            seen += f" (largest {island.pixels} pixels, {island.view}, near {island.near})"
        for lump in self.lumps[:1]:
            volume = (
                f"{_count(self.lumps, 'lump')} apart from the body (largest {lump.size_mm:.0f} mm, near {lump.near})"
            )
        return f"{self.pose}: {seen}; {volume}"

    def to_json(self) -> dict[str, Any]:
        """Plain lists."""
        return asdict(self)


def find_floaters(avatar: Avatar, poses: dict[str, Signals], size: int = SILHOUETTE_PIXELS) -> Iterator[Floaters]:
    """What `avatar` shows in each named pose, as the renderer makes its volume; silhouettes of `size` pixels a side."""
    settings, counters = RenderSettings(hidden=avatar.hidden), Counters()
    posed, volume = None, None
    for name, signals in poses.items():
        posed = pose_person(avatar.person, signals, counters, posed)
        volume = build_volume(avatar, posed, settings, counters, volume)
        joints = posed.body.joints.double().numpy()
        yield Floaters(name, len(directions()), islands(volume.sdf, joints, size), lumps(volume.sdf, joints))


def directions() -> Float[np.ndarray, "d 3"]:
    """26 vectors from a cube's centre to its faces, edges and corners, not normalised; front first."""
    all_ = [np.array(d) for d in product((1, 0, -1), repeat=3) if any(d)]
    return np.array(sorted(all_, key=lambda d: (np.abs(d).sum(), *-d[::-1])), dtype=np.float64)


def islands(
    volume: SdfVolume, joints: Float[np.ndarray, "j 3"], size: int = SILHOUETTE_PIXELS, impl: str = "auto"
) -> tuple[Island, ...]:
    """Islands of more than `SPECKS` pixels in all views; `joints` in SMPL-X order name their places."""
    found = []
    for direction in directions():
        points = raycast(volume, _camera(volume, direction, size), impl=impl)
        labels, count = ndimage.label(points.coverage.numpy() >= 0.5, np.ones((3, 3)))
        pixels = np.bincount(labels.ravel(), minlength=count + 1)[1:]
        position = points.position.double().numpy()
        for label in np.flatnonzero(pixels > SPECKS) + 1:
            if label - 1 != pixels.argmax():
                place = _located(position[labels == label].mean(0), joints)
                found.append(Island(_words(direction), int(pixels[label - 1]), *place))
    return tuple(sorted(found, key=lambda island: -island.pixels))


def lumps(volume: SdfVolume, joints: Float[np.ndarray, "j 3"]) -> tuple[Lump, ...]:
    """Pieces of the composed field's inside apart from the largest."""
    inside, origin = _inside(volume)
    step = volume.body.voxel / SAMPLES_PER_VOXEL
    labels, _ = ndimage.label(inside)
    samples = np.bincount(labels.ravel())
    samples[0] = 0
    found = []
    for label, box in enumerate(ndimage.find_objects(labels), start=1):
        if label != samples.argmax():
            piece = np.argwhere(labels[box] == label) + [part.start for part in box]
            place = _located(origin + step * piece[:, ::-1].mean(0), joints)
            longest = 1e3 * step * float(np.ptp(piece, axis=0).max() + 1)
            volume_mm3 = float(samples[label] * (1e3 * step) ** 3)
            found.append(Lump(round(longest, 1), round(volume_mm3, 1), *place))
    return tuple(sorted(found, key=lambda lump: (-lump.size_mm, -lump.volume_mm3)))


def _inside(volume: SdfVolume) -> tuple[Bool[np.ndarray, "z y x"], np.ndarray]:
    """Whether the composed field is negative on the fine lattice, cut to where it may be, and its first sample's place."""
    cells = _cells(volume)
    if not cells.any():
        return np.zeros((1, 1, 1), dtype=bool), volume.body.origin
    box = ndimage.find_objects(cells.astype(np.uint8))[0]
    first = np.array([part.start for part in box])
    cells = np.kron(cells[box], np.ones((SAMPLES_PER_VOXEL, SAMPLES_PER_VOXEL, SAMPLES_PER_VOXEL), dtype=bool))
    origin = volume.body.origin + volume.body.voxel * first[::-1]
    inside = np.zeros(cells.shape, dtype=bool)
    index = np.flatnonzero(cells)
    for part in np.array_split(index, -(-len(index) // BATCH)):
        place = np.stack(np.unravel_index(part, cells.shape), -1)[:, ::-1]
        position = torch.from_numpy(origin + volume.body.voxel / SAMPLES_PER_VOXEL * place)
        inside.ravel()[part] = (sample(volume, position).composed.sdf < 0).numpy()
    return inside, origin


def _cells(volume: SdfVolume) -> Bool[np.ndarray, "z y x"]:
    """Cells of the body lattice, by their first corner, that have a negative corner or may reach into a part's box."""
    cells: np.ndarray = ndimage.maximum_filter((volume.body.sdf < 0).numpy(), 2, origin=-1)
    unit = np.array(list(product((0, 1), repeat=3)))
    for part in volume.parts:
        root_from_box = np.linalg.inv(part.box_from_root)
        corners = (unit * part.size) @ root_from_box[:3, :3].T + root_from_box[:3, 3]
        place = (corners - volume.body.origin) / volume.body.voxel
        low = np.maximum(np.floor(place.min(0)).astype(int), 0)[::-1]
        high = np.maximum(np.ceil(place.max(0)).astype(int) + 1, 0)[::-1]
        cells[tuple(slice(a, b) for a, b in zip(low, high))] = True
    return cells


def _camera(volume: SdfVolume, direction: np.ndarray, size: int) -> Camera:
    """A camera out along `direction` into which the body grid just fits."""
    x, y, z = direction / np.linalg.norm(direction)
    azimuth, elevation = np.degrees([np.arctan2(x, z), np.arcsin(y)])
    extent = volume.body.voxel * (np.array(volume.body.sdf.shape[::-1]) - 1.0)
    corners = (np.array(list(product((-0.5, 0.5), repeat=3))) * extent) @ Camera.orbit(
        azimuth, elevation
    ).camera_from_world[:3, :3].T
    distance = (np.abs(corners[:, :2]).max(1) / np.tan(np.radians(_FOV / 2)) - corners[:, 2]).max()
    return Camera.orbit(azimuth, elevation, _MARGIN * distance, _FOV, volume.middle, size, size)


def _words(direction: np.ndarray) -> str:
    names = [_WORDS[axis][int(np.sign(direction[axis])) + 1] for axis in (2, 0, 1)]
    return " ".join(filter(None, names))


def _located(place: np.ndarray, joints: np.ndarray) -> tuple[Place, str]:
    """A place to report, and the joint nearest to it."""
    x, y, z = (round(float(value), 4) for value in place)
    return (x, y, z), JOINT_NAMES[int(np.linalg.norm(joints - place, axis=1).argmin())]


def _count(items: tuple[Any, ...], noun: str) -> str:
    return f"{len(items)} {noun}{'s' if len(items) != 1 else ''}"
