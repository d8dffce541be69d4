"""What an avatar's own training kept from a capture, and where it saw the person stand: without it, figures are of other splits.

`avatar.json` says it since captures have keys; of an avatar of before, the run's `run.json` says it, three folders up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from avatarrex.avatar import Avatar
from avatarrex.capture.fit.size_fit import fit_size
from avatarrex.capture.readers.choice import frames
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.errors import InputError, check
from avatarrex.files.gate import what_is
from avatarrex.files.json_text import SMALL, read_json
from avatarrex.templates.person import Person


@dataclass(frozen=True)
class OwnTraining:
    """Of an avatar that was trained on the capture at hand."""

    source: str
    """The file that says so."""
    splits: Mapping[str, Any]
    """By rig and split: `frames`, `A:B,…`, and `cameras`, names. Of a run that began when there were none `frames` and `views`, indices."""
    pelvis: np.ndarray | None
    """J_0, (3,) metres, as the training placed it; None where the file does not say."""
    before: bool = False
    """Whether it is such a run, without validation."""

    def applied(self, capture: Capture, person: Person) -> Capture:
        """With the training's splits, and its place of the person where the capture's files leave that open.

        Raises `InputError` for frames or views that the capture does not have.
        """
        rigs = dict(capture.rigs)
        for name in set(rigs) & set(self.splits):
            rigs[name] = self._split(rigs[name], self.splits[name])
        return self.placed(replace(capture, rigs=rigs), person)

    def placed(self, capture: Capture, person: Person) -> Capture:
        """The capture with `person` where the training had it, unless its files say that themselves."""
        if capture.sized or self.pelvis is None:
            return capture
        return replace(capture.moved(self.pelvis - capture.pelvis), person=person, sized=True)

    def _split(self, rig: Rig, said: Any) -> Rig:
        """The rig as the training split it."""
        if self.before:
            frames, views = (self._list(said, f"held_out.{rig.name}", what, int) for what in ("frames", "views"))
            return replace(rig.holding_out(frames, views), validation_frames=frozenset())
        test, validation = (said.get(split) if isinstance(said, Mapping) else None for split in ("test", "validation"))
        where = f"splits.{rig.name}"
        names = self._list(test, f"{where}.test", "cameras", str)
        known = [view.name for view in rig.views]
        for name in names:
            check(name in known, self.source, f"{where}.test.cameras", "some of " + ", ".join(known), name)
        rig = rig.holding_out(self._frames(rig, test, f"{where}.test"), map(known.index, names))
        return replace(rig, validation_frames=frozenset(self._frames(rig, validation, f"{where}.validation")))

    def _frames(self, rig: Rig, said: Any, where: str) -> tuple[int, ...]:
        text = said.get("frames") if isinstance(said, Mapping) else None
        if not isinstance(text, str):
            raise InputError(self.source, f"{where}.frames", "A:B,…", repr(text)[:60])
        return frames(text, rig.frames, f"{self.source}: {where}.frames") if text else ()

    def _list(self, said: Any, where: str, what: str, kind: type) -> list[Any]:
        found = said.get(what) if isinstance(said, Mapping) else None
        if not isinstance(found, list) or not all(type(one) is kind for one in found):
            words = {int: "integers", str: "names"}[kind]
            raise InputError(self.source, f"{where}.{what}", f"a list of {words}", repr(found)[:60])
        return found


def as_trained(avatar: Avatar, source: str | Path, capture: Capture) -> tuple[Capture, bool]:
    """With the splits and place of the avatar's own training where that was on this capture, and whether it was.

    A capture whose files do not say how large the person is has its size fitted otherwise. Raises `InputError`.
    """
    trained = own_training(avatar, source, capture)
    if trained is not None:
        note = f"splits: as in the avatar's training ({trained.source})"
        capture = trained.applied(replace(capture, notes=(*capture.notes, note)), avatar.person)
    return (capture if capture.sized else fit_size(capture)), trained is not None


def own_training(avatar: Avatar, source: str | Path, capture: Capture) -> OwnTraining | None:
    """What the training of the avatar read from `source` kept of this very capture; None where that was another's, or nobody says.

    Raises `InputError` for a damaged `run.json` or numbers of another form.
    """
    training = avatar.meta.get("training")
    if isinstance(training, dict) and "capture_key" in training:
        return _read(training, f"{source}: avatar.json: training") if training["capture_key"] == capture.key else None
    run = Path(source).resolve().parent.parent.parent / "run.json"
    if what_is(run) != "a file":
        return None
    about = read_json(run, largest=SMALL)
    config = about.get("config") if isinstance(about, dict) else None
    if not isinstance(config, dict) or not isinstance(config.get("capture"), str):
        return None
    if "variant" in config:  # a study of before its avatars had the capture's key: its `held_out` is not by rig
        return None
    same = Path(config["capture"]).resolve() == Path(capture.path).resolve()
    return _read(config, f"{run}: config") if same else None


def _read(said: dict[str, Any], source: str) -> OwnTraining:
    before = "splits" not in said
    key, parts = ("held_out", "frames and views") if before else ("splits", "train, validation and test")
    splits, pelvis = said.get(key), said.get("pelvis")
    if not isinstance(splits, dict):
        raise InputError(source, key, f"an object with {parts} by rig", repr(splits)[:60])
    if pelvis is None:
        return OwnTraining(source, splits, None, before)
    numbers = isinstance(pelvis, list) and len(pelvis) == 3 and all(type(n) in (int, float) for n in pelvis)
    if not numbers or not np.isfinite(pelvis).all():
        raise InputError(source, "pelvis", "three finite numbers, metres", repr(pelvis)[:60])
    return OwnTraining(source, splits, np.array(pelvis, dtype=np.float64), before)
