"""An ablation study: arms (variants.py) trained alike on one capture, and measured on poses that none of them saw.

    DIR/study.json                  what is studied: capture, part, base recipe, the recipe of every arm
    DIR/ARM/seed_0/                 an ordinary run (run.py); effort.json: how long it took; evaluation.json: its figures
    DIR/full/seed_0/volume-test-time.json    the figures of an arm that only draws another's avatar
    DIR/baselines.json              the figures of the skinned meshes

What is there is not done again. For the face everything is cut by where the template's face is seen: the rest of the
person is not trained.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from avatarrex.avatar import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Capture
from avatarrex.errors import InputError
from avatarrex.measure.ablation.step_timing import measure_pace
from avatarrex.measure.ablation.variants import ARMS, Arm, recipe_of, scaled
from avatarrex.measure.volume_drawer import VolumeDrawer
from avatarrex.metrics.baselines import baselines
from avatarrex.metrics.drawing import AvatarDrawer, Drawer, Drawing
from avatarrex.metrics.evaluate import default_frames, evaluate, observations
from avatarrex.metrics.face_region import face_alone
from avatarrex.metrics.measures import Networks
from avatarrex.signals.driving import Signals
from avatarrex.training.core.trainer import Trainer
from avatarrex.training.recipe import Recipe
from avatarrex.training.runs import checkpoint
from avatarrex.training.runs.control import read_json, write_json
from avatarrex.training.runs.events import EventReader
from avatarrex.training.runs.folder import Run, read_about

FORMAT = 1
VIEWS = 8
"""Cameras that held-out poses are seen from, evenly chosen among those trained on."""
SLOW = (2, 1)
"""Frames and cameras of a drawing that takes minutes."""
STEADY = 0.25
"""The last part of pass I, in which samples are counted."""


@dataclass
class Study:
    """One part of one capture, in a folder."""

    folder: Path
    capture: Capture
    part: str
    base: Recipe
    minutes: float | None = None
    """Of each arm; the base recipe's steps unless given."""

    def __post_init__(self) -> None:
        """Raises `InputError` where the folder holds another study, or the capture nothing held out."""
        if self.part not in self.capture.rigs:
            raise InputError(self.capture.path, "--parts", "one of " + ", ".join(self.capture.rigs), self.part)
        self.rig = self.capture.rigs[self.part]
        if not self.rig.held_out_frames:
            raise InputError(self.capture.path, "held-out frames", "some (--held-out-frames A:B:S)", "none")
        about = {
            "format": FORMAT,
            "capture": str(self.capture.path),
            "part": self.part,
            "minutes": self.minutes,
            "held_out": {
                "frames": sorted(self.rig.held_out_frames),
                "views": sorted(self.rig.held_out_views),
            },
            "base": _plain(self.base),
        }
        found = read_json(self.folder / "study.json")
        if found is not None:
            try:  # a field of recipes that is newer than the study has its default
                found["base"] = _plain(Recipe.from_json(found["base"]))
            except (KeyError, TypeError, ValueError) as error:
                raise InputError(self.folder, "study.json: base", "a recipe of this version", error) from None
            _same(self.folder, "", about, {key: found.get(key) for key in about})
        self.about: dict[str, Any] = found or {**about, "recipes": {}}
        self.folder.mkdir(parents=True, exist_ok=True)
        self._note()

    def run_folder(self, arm: Arm, seed: int) -> Path:
        """Of the arm, or of the one whose avatar it draws."""
        return self.folder / (arm.redraws or arm.name) / f"seed_{seed}"

    def evaluation(self, arm: Arm, seed: int) -> dict[str, Any] | None:
        """What was measured, where that is done."""
        return read_json(self._file(arm, seed))

    def finish(self, arm: Arm, seed: int) -> dict[str, Any] | None:
        """Train and measure what is not done yet; None where the training was stopped. What it needs is done first."""
        for need in arm.needs:
            if self.finish(ARMS[need], seed) is None:
                return None
        found = self.evaluation(arm, seed)
        if found is None:
            if not arm.redraws and not self._train(arm, seed):
                return None
            found = self._redraw(arm, seed) if arm.redraws else self._measure(arm, seed)
            write_json(self._file(arm, seed), found, lasting=True)
        return found

    def baselines(self) -> dict[str, Any]:
        """Figures of the skinned meshes on the same pictures."""
        file = self.folder / "baselines.json"
        found = read_json(file)
        if found is None:
            found = self._evaluated(baselines(self.capture.person, observations(self.rig)), self._views(VIEWS))
            write_json(file, found)
        return found

    def recipe(self, arm: Arm, seed: int) -> Recipe:
        """Of all its seeds: times are measured once, with the first."""
        kept = self.about["recipes"].get(arm.name)
        if kept is not None:
            return Recipe.from_json(kept)
        recipe = recipe_of(arm, self.base, self.part)
        if arm.time_of:
            own, other = (self.effort(ARMS[name], seed)["cpu_seconds"] for name in (arm.pace_of, arm.time_of))
            paced = self.recipe(ARMS[arm.pace_of], seed)
            recipe = replace(scaled(paced, self.part, other / own), name=recipe.name)
        elif self.minutes is not None:
            factor = measure_pace(self.capture, recipe, self.part, seed).factor(60 * self.minutes)
            if factor <= 0:
                raise InputError("--minutes", "", "more than the warm start takes", self.minutes)
            recipe = scaled(recipe, self.part, factor)
        self.about["recipes"][arm.name] = _plain(recipe)
        self._note()
        return recipe

    def effort(self, arm: Arm, seed: int) -> dict[str, float]:
        """`seconds` and `cpu_seconds` of its training so far."""
        return read_json(self.run_folder(arm, seed) / "effort.json") or {"seconds": 0.0, "cpu_seconds": 0.0}

    def _train(self, arm: Arm, seed: int) -> bool:
        """To the end of the run, from where it is; False where it was stopped."""
        folder, recipe = self.run_folder(arm, seed), self.recipe(arm, seed)
        exists = (folder / "run.json").exists()
        if exists and read_about(folder)["state"] == "finished":
            return True
        config = {
            "part": self.part, "preset": recipe.name, "capture": str(self.capture.path), "seed": seed, "arm": arm.name,
            "steps": {self.part: recipe.steps()[self.part]}, "recipe": _plain(recipe), "held_out": self.about["held_out"],
        }  # fmt: skip
        run = Run.open(folder) if exists else Run.create(folder, config)
        with run, self._timed(arm, seed):
            finished = Trainer(self.capture, recipe, (self.part,), run, seed).train()
            run.close("finished" if finished else "stopped")
        return finished

    @contextmanager
    def _timed(self, arm: Arm, seed: int) -> Iterator[None]:
        before, begun = self.effort(arm, seed), (time.monotonic(), time.process_time())
        try:
            yield
        finally:
            taken = time.monotonic() - begun[0], time.process_time() - begun[1]
            effort = {key: before[key] + more for key, more in zip(("seconds", "cpu_seconds"), taken)}
            write_json(self.run_folder(arm, seed) / "effort.json", effort)

    def _measure(self, arm: Arm, seed: int) -> dict[str, Any]:
        """All figures of an arm that was trained."""
        folder, recipe = self.run_folder(arm, seed), self.recipe(arm, seed)
        drawer = AvatarDrawer(load_avatar(self._avatar(arm, seed)))
        one, two = getattr(recipe, self.part)
        field = load_avatar(self._avatar(arm, seed)).modules()[self.part]
        return {
            **self._evaluated([drawer], self._views(VIEWS)),
            "arm": arm.name,
            "seed": seed,
            "steps": [one.steps, two.steps],
            **self.effort(arm, seed),
            "parameters": sum(parameter.numel() for parameter in field.parameters()),
            "samples_per_ray": _steady(folder, f"{self.part}/rate/samples_per_ray", one.steps),
            "device": device(),
        }

    def _redraw(self, arm: Arm, seed: int) -> dict[str, Any]:
        """Another arm's avatar drawn by volume rendering, beside the deferred renderer on the same few pictures."""
        of = ARMS[arm.redraws]
        avatar, one = load_avatar(self._avatar(of, seed)), getattr(self.recipe(of, seed), self.part)[0]
        slow = VolumeDrawer(avatar, self.part, quadrature=one.quadrature)
        views, frames = self._views(SLOW[1]), self._frames()[: SLOW[0]]
        found = self._evaluated([AvatarDrawer(avatar), slow], views, frames)
        trained = self.evaluation(of, seed) or self._measure(of, seed)
        kept = {key: trained[key] for key in ("seed", "steps", "seconds", "cpu_seconds", "parameters")}
        return {**found, **kept, "arm": arm.name, "samples_per_ray": slow.samples, "device": device()}

    def _evaluated(self, drawers: list[Any], views: list[int], frames: list[int] | None = None) -> dict[str, Any]:
        """`subjects`: means on held-out poses by drawer, with the seconds that a picture took."""
        rig, subjects = self.rig, [Timed(drawer) for drawer in drawers]
        asked: list[Drawer] = list(subjects)
        if self.part == "face":
            rig, asked = face_alone(self.capture.person, rig, asked)
        networks = Networks.load()
        frames = self._frames() if frames is None else frames
        capture = replace(self.capture, ground_truth=None)
        found = evaluate(capture, rig, asked, networks, frames, views, progress=True)
        split = found.grouped("split")["held-out pose"]
        return {
            "subjects": {s.name: {**split[s.name], "seconds_per_picture": s.mean_seconds} for s in subjects},
            "frames": frames,
            "views": [self.rig.views[view].name for view in views],
            "size": list(found.size),
            "missing": networks.missing,
        }

    def _frames(self) -> list[int]:
        return [frame for frame in default_frames(self.rig) if frame in self.rig.held_out_frames]

    def _views(self, count: int) -> list[int]:
        """Evenly chosen among those trained on."""
        trained = [view for view in range(len(self.rig.views)) if view not in self.rig.held_out_views]
        return [trained[k] for k in np.unique(np.linspace(0, len(trained) - 1, count).round().astype(int))]

    def _avatar(self, arm: Arm, seed: int) -> Path:
        """Beside the last checkpoint of its finished run."""
        return checkpoint.found(self.run_folder(arm, seed) / "checkpoints")[-1].path / "avatar.avatar"

    def _file(self, arm: Arm, seed: int) -> Path:
        return self.run_folder(arm, seed) / (f"{arm.name}.json" if arm.redraws else "evaluation.json")

    def _note(self) -> None:
        write_json(self.folder / "study.json", self.about, lasting=True)


class Timed:
    """A drawer with the time it takes."""

    def __init__(self, drawer: Drawer) -> None:
        self.drawer, self.name = drawer, drawer.name
        self.seconds: list[float] = []

    @property
    def mean_seconds(self) -> float:
        """Of a picture; a pose that is new is part of it."""
        return float(np.mean(self.seconds))

    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """See `Drawer`."""
        begun = time.perf_counter()
        drawing = self.drawer.draw(signals, camera)
        self.seconds.append(time.perf_counter() - begun)
        return drawing


def device() -> str:
    """What it ran on."""
    return f"{platform.machine()} CPU, {torch.get_num_threads()} threads"


def _steady(folder: Path, tag: str, steps: int) -> float | None:
    """Mean of a tag over the last part of pass I."""
    events = EventReader(folder)
    while events.poll():
        pass
    series = events.series(tag)
    values = series.values[series.steps < steps]
    return float(values[-max(round(STEADY * len(values)), 1) :].mean()) if len(values) else None


def _same(folder: Path, place: str, wanted: Any, found: Any) -> None:
    """Raises `InputError` for the first entry in which two JSON values differ."""
    if isinstance(wanted, dict) and isinstance(found, dict) and wanted.keys() == found.keys():
        for key in wanted:
            _same(folder, f"{place}.{key}", wanted[key], found[key])
    elif isinstance(wanted, list) and isinstance(found, list) and len(wanted) == len(found):
        for number, pair in enumerate(zip(wanted, found)):
            _same(folder, f"{place}[{number}]", *pair)
    elif wanted != found:
        raise InputError(folder, f"study.json: {place[1:]}", f"{wanted}, as asked for (else another --out)", found)


def _plain(recipe: Recipe) -> dict[str, Any]:
    """As JSON gives it back: lists, not tuples."""
    data = recipe.to_json()
    return {key: list(value) if isinstance(value, tuple) else value for key, value in data.items()}
