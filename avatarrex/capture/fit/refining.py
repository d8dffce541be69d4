"""What a refinement has found so far, in a file that it goes on from: `refining.npz` in the folder of the refined capture.

The person's fit and colours first, then the pose of each frame as it is done. Letters: t frames, p points.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from avatarrex.capture.fit.paint import POINTS, Paint, Points
from avatarrex.capture.fit.refine import Body, refine_body, refine_pose
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Split, Splits, sealed, sealed_rig, splits_of
from avatarrex.errors import InputError, check
from avatarrex.files.arrays import read_arrays
from avatarrex.files.assets import require
from avatarrex.files.images import write_arrays
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import load_person, other_files, resize_person
from avatarrex.templates.person_fit import PersonFit

FILE = "refining.npz"
LARGEST_BYTES = 2**30
"""Of the arrays: poses of half a million frames."""


class Refining:
    """A refinement that can be stopped after any frame."""

    def __init__(self, capture: Capture, out: Path, every: bool = False, colours: bool = True) -> None:
        """Goes on with what is in `out`; with `every`, frames of other splits have their poses refined, too; with `colours`, by
        those, too.

        Raises `InputError` where that is another capture's, or damaged.
        """
        self.capture, self.path = capture, out / FILE
        self.training = sealed(capture, "train")
        self.frames = {name: _frames(rig, every) for name, rig in capture.rigs.items()}
        self._rigs = self.training.rigs
        if every:  # as the training's cameras see them
            whole = {
                name: Split(frames, Splits.of(capture.rigs[name]).train.views) for name, frames in self.frames.items()
            }
            self._rigs = {name: sealed_rig(capture.rigs[name], split) for name, split in whole.items()}
        self.key = work_key(capture, colours)
        self.colours = colours
        counts = {name: rig.frames for name, rig in capture.rigs.items()}
        self._fit = ""
        self._paint = np.zeros((POINTS, 4), np.float32)
        self._done = {name: np.zeros(count, bool) for name, count in counts.items()}
        self._pose = {name: np.zeros((count, 55, 3)) for name, count in counts.items()}
        self._place = {name: np.zeros((count, 3)) for name, count in counts.items()}
        if self.path.exists():
            self._read()

    def body(self) -> Body:
        """Shape, skin and colours, refined where they are not yet."""
        if not self._fit:
            body = refine_body(self.training, self.colours)
            assert body.person.fit is not None
            self._fit = json.dumps(body.person.fit.to_json())
            if body.paint is not None:
                self._paint = np.column_stack([body.paint.colour, body.paint.known]).astype(np.float32)
            self._write()
        fit = PersonFit.from_json(json.loads(self._fit), self.path)
        person = resize_person(load_person(self.capture.person.name), fit)
        paint = Paint(Points.of(person), self._paint[:, :3], self._paint[:, 3] > 0)
        return Body(person, paint if self.colours else None)

    def pose(self, body: Body, rig: str, frame: int) -> None:
        """Refine a frame, unless it is done."""
        if not self._done[rig][frame]:
            found = refine_pose(body, self._rigs[rig], frame)
            self._pose[rig][frame], self._place[rig][frame] = found.full_pose(), found.translation
            self._done[rig][frame] = True
            self._write()

    def signals(self, rig: str) -> tuple[Signals, ...]:
        """All frames of a rig: those that are done as refined, the others as they were tracked."""
        found = []
        for frame, first in enumerate(self.capture.rigs[rig].signals):
            if self._done[rig][frame]:
                kept = {"expression": first.expression, "shape": first.shape}
                first = Signals.from_full_pose(self._pose[rig][frame], translation=self._place[rig][frame], **kept)
            found.append(first)
        return tuple(found)

    def close(self) -> None:
        """Remove the file."""
        self.path.unlink(missing_ok=True)

    def _arrays(self) -> dict[str, dict[str, np.ndarray]]:
        return {"done": self._done, "pose": self._pose, "place": self._place}

    def _write(self) -> None:
        arrays = {f"{rig}_{what}": value for what, by_rig in self._arrays().items() for rig, value in by_rig.items()}
        write_arrays(self.path, {"key": np.array(self.key), "fit": np.array(self._fit), "paint": self._paint, **arrays})

    def _read(self) -> None:
        names = tuple(f"{rig}_{what}" for what, by_rig in self._arrays().items() for rig in by_rig)
        found = read_arrays(self.path, ("key", "fit", "paint", *names), LARGEST_BYTES, str(self.path))
        key = str(found.get("key", ""))
        check(key == self.key, self.path, "key", f"this capture's, splits' and options', {self.key}", key or "none")
        for what, by_rig in self._arrays().items():
            for rig, value in by_rig.items():
                value[:] = require(found, self.path, f"{rig}_{what}", value.shape)
        self._paint = require(found, self.path, "paint", self._paint.shape)
        self._fit = str(found.get("fit", ""))
        try:
            PersonFit.from_json(json.loads(self._fit), self.path)
        except json.JSONDecodeError:
            raise InputError(self.path, "fit", "a person's fit", self._fit[:60]) from None


def work_key(capture: Capture, colours: bool) -> str:
    """What a refinement is of: the capture's files and splits, the option, and the person's files."""
    said = ("" if colours else " without colours") + other_files(capture.person.name)
    return f"{capture.key} {json.dumps(splits_of(capture), sort_keys=True)}{said}"


def _frames(rig: Rig, every: bool) -> tuple[int, ...]:
    """Whose poses are sought: of those with any picture."""
    split = Splits.of(rig).train
    frames = range(rig.frames) if every else split.frames
    return tuple(frame for frame in frames if any(rig.available(view, frame) for view in split.views))
