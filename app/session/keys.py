"""Keys of one joint, coefficient or setting of the camera, and the curve through them.

A rotation goes through quaternions q of one hemisphere: on the shortest arc (linear), or normalised after a cubic (smooth). Smooth is
the monotone cubic of Fritsch and Carlson (scipy's PCHIP): it passes every key and never beyond its neighbours. Seconds of the layer;
radians, metres, coefficients; degrees of the camera. Letters: k keys, c 3 or 1 numbers of a key (4 of a quaternion).
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.signals.filters import continuous
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES

LINEAR, SMOOTH, STEP = CURVES = ("linear", "smooth", "step")
"""How a key leads to the next."""
CAMERA = {"camera.azimuth": 1, "camera.elevation": 1, "camera.distance": 1, "camera.fov": 1, "camera.target": 3}
"""Settings of the view that can have keys, and how many numbers each has."""
LENGTHS = {
    **dict.fromkeys(JOINT_NAMES, 3), **dict.fromkeys(EXPRESSION_NAMES, 1), "translation": 3, **CAMERA,
}  # fmt: skip
"""How many numbers a key of each track has."""
ROTATIONS = frozenset(JOINT_NAMES)
CLOSE = 1e-4
"""Seconds: keys that are no further apart are one."""
MOST_KEYS = 200_000
"""Of one track: an hour at 50 a second."""


@dataclass(frozen=True, order=True)
class Key:
    """A value at a time, and how it leads to the next key."""

    time: float
    value: tuple[float, ...]
    curve: str = SMOOTH

    def __post_init__(self) -> None:
        _check_finite("key", (self.time, *self.value))
        if self.curve not in CURVES:
            raise InputError("key", "curve", ", ".join(CURVES), self.curve)


def _check_finite(source: str, numbers: tuple[Any, ...]) -> None:
    if not all(isinstance(number, int | float) and math.isfinite(number) for number in numbers):
        raise InputError(source, "", "finite numbers", numbers)


@dataclass(frozen=True)
class Track:
    """The keys of one joint, coefficient or setting, in order of time; at least one."""

    name: str
    keys: tuple[Key, ...]

    def __post_init__(self) -> None:
        if self.name not in LENGTHS:
            raise InputError(
                "track", "name", "a joint, a coefficient, translation or a setting of the camera", self.name
            )
        if not 0 < len(self.keys) <= MOST_KEYS:
            raise InputError(f"track {self.name}", "keys", f"1 to {MOST_KEYS:,}", len(self.keys))
        if any(len(key.value) != LENGTHS[self.name] for key in self.keys):
            raise InputError(f"track {self.name}", "keys", f"values of {LENGTHS[self.name]} numbers", "others")
        if any(later.time - earlier.time <= CLOSE / 2 for earlier, later in zip(self.keys, self.keys[1:])):
            raise InputError(f"track {self.name}", "keys", "times in order", "two at one time, or a later one first")

    @cached_property
    def times(self) -> list[float]:
        """Of the keys."""
        return [key.time for key in self.keys]

    @cached_property
    def _points(self) -> Float64[np.ndarray, "k c"]:
        """Values, of a rotation quaternions of one hemisphere."""
        values = np.array([key.value for key in self.keys], dtype=np.float64)
        if self.name not in ROTATIONS:
            return values
        return continuous(values)

    @cached_property
    def _cubic(self) -> Any:
        from scipy.interpolate import PchipInterpolator  # takes 0.3 s: not before there is a curve

        return PchipInterpolator(self.times, self._points)

    def at(self, time: float) -> Float64[np.ndarray, " c"]:
        """The value at a time of the layer: before the first key the first one's, after the last the last one's."""
        k = bisect.bisect_right(self.times, time + 1e-9) - 1
        if k < 0 or k == len(self.keys) - 1 or self.keys[k].curve == STEP or abs(time - self.times[k]) < 1e-9:
            return np.array(self.keys[max(k, 0)].value, dtype=np.float64)
        if self.keys[k].curve == SMOOTH:
            return self._shown(self._cubic(time))
        start, end = self._points[k], self._points[k + 1]
        share = (time - self.times[k]) / (self.times[k + 1] - self.times[k])
        if self.name not in ROTATIONS:
            return np.asarray((1 - share) * start + share * end)
        first, last = Rotation.from_quat(start), Rotation.from_quat(end)
        return np.asarray((first * Rotation.from_rotvec(share * (first.inv() * last).as_rotvec())).as_rotvec())

    def _shown(self, point: Float64[np.ndarray, " q"]) -> Float64[np.ndarray, " c"]:
        """A point of the curve as the numbers of a key."""
        return np.asarray(Rotation.from_quat(point).as_rotvec() if self.name in ROTATIONS else point)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"name": self.name, "keys": [[key.time, list(key.value), key.curve] for key in self.keys]}

    @classmethod
    def from_json(cls, data: Any, source: str = "track") -> Track:
        """From `to_json`'s dictionary. Raises `InputError`."""
        if not isinstance(data, dict) or set(data) != {"name", "keys"}:
            raise InputError(source, "track", "a name and keys", type(data).__name__)
        for time, value, _ in data["keys"]:
            _check_finite(source, (time, *value))
        return cls(data["name"], tuple(Key(time, tuple(value), curve) for time, value, curve in data["keys"]))


Tracks = tuple[Track, ...]
Place = tuple[str, float]
"""A track's name and the time of one of its keys."""


def with_keys(tracks: Tracks, name: str, keys: tuple[Key, ...], since: float | None = None) -> Tracks:
    """With `keys` in a track, new where there is none. A key at the time of another replaces it, and what lies after `since` up to
    the last of them goes: a recording leaves nothing of before.
    """
    last = max(key.time for key in keys)

    def stays(old: Key) -> bool:
        recorded = since is not None and since + CLOSE < old.time <= last
        return not recorded and all(abs(old.time - key.time) > CLOSE for key in keys)

    kept = [old for track in tracks if track.name == name for old in track.keys if stays(old)]
    new = Track(name, tuple(sorted((*kept, *keys))))
    if any(track.name == name for track in tracks):
        return tuple(new if track.name == name else track for track in tracks)
    return (*tracks, new)


def found(tracks: Tracks, places: tuple[Place, ...]) -> dict[str, tuple[Key, ...]]:
    """The keys at some places, by track."""
    wanted: dict[str, list[float]] = {}
    for name, time in places:
        wanted.setdefault(name, []).append(time)
    at = {
        track.name: tuple(
            key for key in track.keys if any(abs(key.time - time) <= CLOSE for time in wanted[track.name])
        )
        for track in tracks
        if track.name in wanted
    }
    return {name: keys for name, keys in at.items() if keys}


def without(tracks: Tracks, places: tuple[Place, ...]) -> Tracks:
    """Without the keys at some places; a track without keys is none."""
    gone = found(tracks, places)
    kept = [(track.name, tuple(key for key in track.keys if key not in gone.get(track.name, ()))) for track in tracks]
    return tuple(Track(name, keys) for name, keys in kept if keys)


def moved(tracks: Tracks, places: tuple[Place, ...], by: float) -> Tracks:
    """With some keys `by` seconds later; they replace those that they meet."""
    taken = found(tracks, places)
    tracks = without(tracks, places)
    for name, keys in taken.items():
        tracks = with_keys(tracks, name, tuple(replace(key, time=key.time + by) for key in keys))
    return tracks


def curved(tracks: Tracks, places: tuple[Place, ...], curve: str) -> Tracks:
    """With another curve after some keys. Raises `InputError` for an unknown one."""
    for name, keys in found(tracks, places).items():
        tracks = with_keys(tracks, name, tuple(replace(key, curve=curve) for key in keys))
    return tracks
