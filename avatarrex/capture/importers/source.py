"""A capture of another layout as it is understood before it is written in ours: what each reader of `layouts.py` makes.

Cameras in our convention (world→camera, OpenCV axes, pixel centres at +0.5), pictures by frame, parameters in SMPL-X's joints. Letters: t
frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from avatarrex.camera import Camera
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.parameters import KEYS, LARGEST_BYTES, read_parameters
from avatarrex.errors import CannotWrite, InputError
from avatarrex.templates.person import Person

Value = TypeVar("Value")


@dataclass(frozen=True, eq=False)
class SourceView:
    """One camera with its files, names in the archive, by frame."""

    lens: Lens
    images: dict[int, str]
    mattes: dict[int, str]


@dataclass(frozen=True, eq=False)
class Source:
    """A rig of a capture of another layout."""

    layout: str
    rig: str
    """`body` or `face`."""
    views: tuple[SourceView, ...]
    frames: int
    parameters: dict[str, np.ndarray]
    """As `readers/parameters.py` names them, rows by frame; empty where the layout has none."""
    without_parameters: frozenset[int] = frozenset()
    """Frames whose parameters are missing; their rows repeat a neighbour's."""
    backdrop: str | None = None
    """A picture of the empty scene, where mattes are what differs from it."""
    problems: tuple[str, ...] = ()
    """One sentence each: what of the files cannot be used."""
    notes: tuple[str, ...] = ()
    """One sentence each: what was decided."""


@dataclass(eq=False)
class Reading:
    """An archive while a layout is read from it."""

    archive: Archive
    root: str
    person: Person
    unit: float | None = None
    """Metres of a unit of the cameras' places, where that was said."""
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def name(self, *parts: str) -> str:
        """A file of the capture."""
        return "/".join(part for part in (self.root, *parts) if part)

    def place(self, *parts: str) -> str:
        """What an error calls it."""
        return self.archive.place(self.name(*parts))

    def attempt(self, what: str, read: Callable[[], Value]) -> Value | None:
        """What `read` gives; None where it refuses, which is then one of the problems and ends nothing.

        Raises `CannotWrite`: a full disk is no problem of the source's.
        """
        try:
            return read()
        except CannotWrite:
            raise
        except InputError as error:
            field = f"{what}: {error.field}" if error.field else what
            self.problems.append(f"{field}: expected {error.expected}, found {error.found}")
            return None


def smplx_parameters(reading: Reading, name: str) -> dict[str, np.ndarray]:
    """Arrays of a `smpl_params.npz` with `global_orient` and `transl` (t, 3); none, and a problem, where it cannot be understood."""

    def read() -> dict[str, np.ndarray]:
        arrays = reading.archive.arrays(name, KEYS, LARGEST_BYTES)
        values = read_parameters(arrays, reading.archive.place(name))
        return {**arrays, "global_orient": values.pose[:, 0], "transl": values.translation}

    there = reading.archive.exists(name)
    return (reading.attempt(name, read) if there else None) or {}


def posed_lens(
    name: str, intrinsics: np.ndarray, camera_from_world: np.ndarray, size: tuple[int, int], distortion: np.ndarray
) -> Lens:
    """A camera of (3, 3) K, (4, 4) pose, width and height in pixels, and (5,) distortion. Raises `InputError`."""
    return Lens(name, Camera(intrinsics, camera_from_world, *size), distortion)


def repeated(rows: dict[int, dict[str, np.ndarray]], count: int) -> tuple[dict[str, np.ndarray], frozenset[int]]:
    """Parameters of `count` frames by name (t, …) from those that are there, and the frames that are not.

    A frame without parameters repeats its neighbour's: its pictures are not used.
    """
    there = np.array(sorted(rows))
    if not len(there):
        return {}, frozenset()
    nearest = [int(there[np.abs(there - frame).argmin()]) for frame in range(count)]
    names = rows[nearest[0]]
    stacked = {name: np.stack([rows[frame][name] for frame in nearest]) for name in names}
    return stacked, frozenset(range(count)) - frozenset(there.tolist())
