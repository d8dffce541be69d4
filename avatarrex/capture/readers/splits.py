"""Splits of a rig (train, validation, test), and captures that cannot show what is not in a split.

| split | frames | cameras | for |
|---|---|---|---|
| train | not held out, less validation | not held out | all that is learnt, fitted or clamped |
| validation | some of those not held out | not held out | a training's own figures and pictures, choosing, tuning |
| test | held out, or by a held-out camera | | `evaluate` alone |

What is held out is said by `capture.json` or options. Validation is what `capture.json` names (`validation_frames`), or
`--validation-frames`, or the `SHARE` of the frames in the middle of the rest. Of what a sealed capture does not show it has
neither pictures nor signals nor cameras: to touch one raises `Sealed`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avatarrex.camera import Camera
from avatarrex.capture.readers.images_store import Pictures
from avatarrex.capture.readers.keypoints import Keypoints
from avatarrex.capture.readers.rigs import Capture, Rig, View
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals

SHARE = 16
"""One frame in so many of those not held out is validation's."""
FEW = 8
"""Of fewer frames none is given up: a training then measures itself on its own pictures."""


class Sealed(LookupError):
    """What was touched is in another split."""


@dataclass(frozen=True)
class Split:
    """Some frames of a rig as some of its cameras see them."""

    frames: tuple[int, ...]
    views: tuple[int, ...]

    def pictures(self, rig: Rig) -> list[tuple[int, int]]:
        """(view, frame) of those that are there, frame by frame."""
        return [(view, frame) for frame in self.frames for view in self.views if rig.available(view, frame)]


@dataclass(frozen=True)
class Splits:
    """All of a rig."""

    train: Split
    validation: Split
    test: Split
    """Frames and cameras that are held out, each with all of the other."""

    @classmethod
    def of(cls, rig: Rig) -> Splits:
        """By what the rig holds out and keeps for validation."""
        views = tuple(view for view in range(len(rig.views)) if view not in rig.held_out_views)
        rest = [frame for frame in range(rig.frames) if frame not in rig.held_out_frames]
        named = rig.validation_frames
        kept = _middle(rest) if named is None else [frame for frame in rest if frame in named]
        train = tuple(frame for frame in rest if frame not in set(kept))
        test = Split(tuple(sorted(rig.held_out_frames)), tuple(sorted(rig.held_out_views)))
        return cls(Split(train, views), Split(tuple(kept), views), test)

    def to_json(self, rig: Rig) -> dict[str, dict[str, Any]]:
        """Frames as `A:B,…` like the options', cameras by name."""
        return {
            name: {"frames": slices(split.frames), "cameras": [rig.views[view].name for view in split.views]}
            for name, split in vars(self).items()
        }


def splits_of(capture: Capture) -> dict[str, dict[str, dict[str, Any]]]:
    """What run.json and avatar.json say: by rig and split."""
    return {name: Splits.of(rig).to_json(rig) for name, rig in capture.rigs.items()}


def with_validation(capture: Capture, frames: Mapping[str, Iterable[int]] | None = None) -> Capture:
    """The capture with its frames for validation named by rig, by `capture.json` unless given; the others by rule.

    Raises `InputError` for a frame or rig that it has not.
    """
    named: Any = capture.manifest.get("validation_frames", {}) if frames is None else frames
    if not isinstance(named, dict) or not set(named) <= set(capture.rigs):
        raise InputError(capture.path, "validation_frames", "lists of frames of " + ", ".join(capture.rigs), named)
    rigs = dict(capture.rigs)
    for name, listed in named.items():
        rig = rigs[name]
        chosen = [*listed] if isinstance(listed, Iterable) else [listed]
        for frame in chosen:
            if type(frame) is not int or not 0 <= frame < rig.frames:
                raise InputError(
                    capture.path, f"validation_frames.{name}", f"integers from 0 to {rig.frames - 1}", frame
                )
        rigs[name] = replace(rig, validation_frames=frozenset(chosen))
    return replace(capture, rigs=rigs)


def sealed(capture: Capture, split: str) -> Capture:
    """The capture as far as `train` or `validation` sees it; it has no exact meshes. Frames and cameras keep their numbers."""
    rigs = {name: sealed_rig(rig, getattr(Splits.of(rig), split)) for name, rig in capture.rigs.items()}
    return replace(capture, rigs=rigs, ground_truth={})


def sealed_rig(rig: Rig, split: Split) -> Rig:
    """The rig without what is not in the split: held out is everything else, and of the rest none is for validation."""
    frames, views = frozenset(split.frames), frozenset(split.views)
    signals = tuple(
        own if frame in frames else _SealedSignals(f"{rig.name} rig, signals of frame {frame}")
        for frame, own in enumerate(rig.signals)
    )
    cameras = tuple(
        own if view in views else View(own.name, _SealedCamera(f"{rig.name} rig, camera {own.name}"))
        for view, own in enumerate(rig.views)
    )
    others = {(v, f) for v in range(len(rig.views)) for f in range(rig.frames) if v not in views or f not in frames}
    return replace(
        rig,
        signals=replace(rig.signals, frames=signals),
        views=cameras,
        missing=rig.missing | others,
        held_out_frames=frozenset(range(rig.frames)) - frames,
        held_out_views=frozenset(range(len(rig.views))) - views,
        validation_frames=frozenset(),
        pictures=SealedPictures(rig.pictures, rig.name, frozenset(others)),
        keypoints=None if rig.keypoints is None else SealedKeypoints(rig.keypoints, rig.name, frozenset(others)),
    )


class SealedPictures(Pictures):
    """Pictures of a rig, but some."""

    def __init__(self, pictures: Pictures, rig: str, others: frozenset[tuple[int, int]]) -> None:
        self._open_pictures, self._rig, self._others = pictures, rig, others

    def get(self, kind: str, view: int, frame: int) -> np.ndarray:
        """See `Pictures`. Raises `Sealed`."""
        if (view, frame) in self._others:
            raise Sealed(f"{self._rig} rig, {kind} of view {view}, frame {frame}: not in this split")
        return self._open_pictures.get(kind, view, frame)

    def check_size(self, view: int, frame: int) -> None:
        """See `Pictures`. Raises `Sealed`."""
        if (view, frame) in self._others:
            raise Sealed(f"{self._rig} rig, view {view}, frame {frame}: not in this split")
        self._open_pictures.check_size(view, frame)


class SealedKeypoints(Keypoints):
    """Keypoints of a rig, but of some pictures."""

    def __init__(self, keypoints: Keypoints, rig: str, others: frozenset[tuple[int, int]]) -> None:
        for name, value in (("joints", keypoints.joints), ("_open", keypoints), ("_rig", rig), ("_others", others)):
            object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> Any:
        if name in ("points", "confidence"):
            raise Sealed(f"{self._rig} rig, keypoints of all pictures: not in this split")
        raise AttributeError(name)

    def at(self, view: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """See `Keypoints`. Raises `Sealed`."""
        if (view, frame) in self._others:
            raise Sealed(f"{self._rig} rig, keypoints of view {view}, frame {frame}: not in this split")
        points, confidence = self._open.at(view, frame)
        return points, confidence


class _Nothing:
    """An object without any of its fields: to read one raises `Sealed`."""

    def __init__(self, what: str) -> None:
        object.__setattr__(self, "_what", what)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        raise Sealed(f"{self._what}: not in this split ({name})")

    def __repr__(self) -> str:
        return f"<{self._what}: not in this split>"


class _SealedSignals(_Nothing, Signals):
    """Signals of another split's frame."""


class _SealedCamera(_Nothing, Camera):
    """A camera of another split."""


def slices(frames: Iterable[int]) -> str:
    """Ascending frames as `A:B` stretches, comma separated, B not included."""
    found: list[list[int]] = []
    for frame in frames:
        if found and found[-1][1] == frame:
            found[-1][1] += 1
        else:
            found.append([frame, frame + 1])
    return ",".join(f"{begin}:{end}" for begin, end in found)


def _middle(frames: list[int]) -> list[int]:
    """A stretch in the middle: its neighbours give little away."""
    count = 0 if len(frames) < FEW else max(round(len(frames) / SHARE), 1)
    begin = (len(frames) - count) // 2
    return frames[begin : begin + count]
