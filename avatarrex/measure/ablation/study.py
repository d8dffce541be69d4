"""An ablation study: variants (variants.py) trained alike on one capture, and measured on poses that none of them saw.

    DIR/study.json                  what is studied: capture, part, base recipe, the recipe of every variant
    DIR/VARIANT/seed_0/             an ordinary run (run.py); effort.json: how long it took; evaluation.json: its figures
    DIR/full/seed_0/volume-test-time.json    the figures of a variant that only draws another's avatar
    DIR/baselines.json              the figures of the skinned meshes

What is there is not done again. For the face everything is cut by where the template's face is seen: the rest of the
person is not trained.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Capture
from avatarrex.errors import InputError, check
from avatarrex.measure.ablation.step_timing import step_timing
from avatarrex.measure.ablation.variants import VARIANTS, Variant, recipe_of, scaled
from avatarrex.measure.bench.contest import Times, timed
from avatarrex.measure.rivals import timed_training
from avatarrex.measure.rivals.kinds import make_rival
from avatarrex.measure.volume_drawer import VolumeDrawer
from avatarrex.metrics.baselines import rivals, with_fitted_skin
from avatarrex.metrics.drawing import AvatarDrawer, Drawer, Drawing
from avatarrex.metrics.evaluate import Choice, default_frames, evaluate, observations, spread
from avatarrex.metrics.face_region import face_alone
from avatarrex.metrics.measures import Networks
from avatarrex.signals.driving import Signals
from avatarrex.training.core.trainer import Trainer
from avatarrex.training.recipe import Recipe
from avatarrex.training.runs import checkpoint
from avatarrex.training.runs.begun import begun_person
from avatarrex.training.runs.control import read_json, write_json
from avatarrex.training.runs.events import EventReader
from avatarrex.training.runs.folder import Run, read_about

FORMAT = 1
CAMERAS_MEASURED = 8
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
    """Of each variant: processor minutes, on a GPU wall minutes; the base recipe's steps unless given."""
    device: str = "cpu"
    """Where networks are trained; pictures are drawn on the CPU."""

    def __post_init__(self) -> None:
        """Raises `InputError` where the folder holds another study, or the capture nothing held out."""
        rigs, path = self.capture.rigs, self.capture.path
        check(self.part in rigs, path, "--parts", "one of " + ", ".join(rigs), self.part)
        self.rig = rigs[self.part]
        check(self.rig.held_out_frames, path, "held-out frames", "some (--held-out-frames A:B:S)", "none")
        about = {
            "format": FORMAT,
            "capture": str(path),
            "part": self.part,
            "minutes": self.minutes,
            "device": self.device,
            "held_out": {"frames": sorted(self.rig.held_out_frames), "views": sorted(self.rig.held_out_views)},
            "base": _plain(self.base),
        }
        found = read_json(self.folder / "study.json")
        if found is not None:
            try:  # a field of recipes that is newer than the study has its default
                found["base"] = _plain(Recipe.from_json(found["base"]))
            except (KeyError, TypeError, ValueError) as error:
                raise InputError(self.folder, "study.json: base", "a recipe of this version", error) from None
            found.setdefault("device", "cpu")  # before there was a choice
            _same(self.folder, "", about, {key: found.get(key) for key in about})
        self.about: dict[str, Any] = found or {**about, "recipes": {}}
        self.folder.mkdir(parents=True, exist_ok=True)
        self._note()

    @cached_property
    def fitted(self) -> Capture:
        """The capture, its person with the skin fitted even where an avatar's training needs no fit: what meshes and rivals begin at."""
        return replace(self.capture, person=with_fitted_skin(self.capture, self.capture.person))

    def run_folder(self, variant: Variant, seed: int) -> Path:
        """Of the variant, or of the one that it redraws."""
        return self.folder / (variant.redraws or variant.name) / f"seed_{seed}"

    def evaluation(self, variant: Variant, seed: int) -> dict[str, Any] | None:
        """What was measured, where that is done."""
        return read_json(self._file(variant, seed))

    def finish(self, variant: Variant, seed: int) -> dict[str, Any] | None:
        """Train and measure what is not done yet; None where the training was stopped. What it needs is done first."""
        for need in variant.needs:
            if self.finish(VARIANTS[need], seed) is None:
                return None
        found = self.evaluation(variant, seed)
        if found is None:
            if not variant.redraws and not self._train(variant, seed):
                return None
            found = self._redraw(variant, seed) if variant.redraws else self._measure(variant, seed)
            write_json(self._file(variant, seed), found, lasting=True)
        return found

    def baselines(self) -> dict[str, Any]:
        """Figures of the skinned meshes on the same pictures."""
        file = self.folder / "baselines.json"
        found = read_json(file)
        if found is None:
            meshes = rivals(self.capture, self.fitted.person, list(observations(self.rig)))
            found = self._evaluated(meshes, self._views(CAMERAS_MEASURED))
            write_json(file, found)
        return found

    def recipe(self, variant: Variant, seed: int) -> Recipe:
        """Of all its seeds: times are measured once, with the first."""
        kept = self.about["recipes"].get(variant.name)
        if kept is not None:
            return Recipe.from_json(kept)
        recipe = recipe_of(variant, self.base, self.part)
        if variant.time_of:
            pilot, other = VARIANTS[variant.timing_of], VARIANTS[variant.time_of]
            factor = self.effort(other, seed)["cpu_seconds"] / self.effort(pilot, seed)["cpu_seconds"]
            recipe = replace(scaled(self.recipe(pilot, seed), self.part, factor), name=recipe.name)
        elif self.minutes is not None:
            factor = step_timing(self.capture, recipe, self.part, seed, self.device).factor(60 * self.minutes)
            check(factor > 0, "--minutes", "", "more than the warm start takes", self.minutes)
            recipe = scaled(recipe, self.part, factor)
        self.about["recipes"][variant.name] = _plain(recipe)
        self._note()
        return recipe

    def effort(self, variant: Variant, seed: int) -> dict[str, float]:
        """`seconds` and `cpu_seconds` of its training so far."""
        return read_json(self.run_folder(variant, seed) / "effort.json") or {"seconds": 0.0, "cpu_seconds": 0.0}

    def _train(self, variant: Variant, seed: int) -> bool:
        """To the end of the run, from where it is; False where it was stopped."""
        folder = self.run_folder(variant, seed)
        exists = (folder / "run.json").exists()
        if exists and read_about(folder)["state"] == "finished":
            return True
        run = Run.open(folder) if exists else Run.create(folder, self._config(variant, seed))
        with run, self._effort_noted(variant, seed):
            finished = self._learn(variant, seed, run)
            run.close("finished" if finished else "stopped")
        return finished

    def _config(self, variant: Variant, seed: int) -> dict[str, Any]:
        """What a run says of itself."""
        config = {
            "part": self.part, "preset": variant.name, "capture": str(self.capture.path), "seed": seed, "variant": variant.name,
            "held_out": self.about["held_out"], "capture_key": self.capture.key, "pelvis": self.capture.pelvis.tolist(),
        }  # fmt: skip
        if variant.rival:
            return config
        recipe = self.recipe(variant, seed)
        steps = {self.part: recipe.steps()[self.part]}
        return {**config, "preset": recipe.name, "steps": steps, "recipe": _plain(recipe)}

    def _learn(self, variant: Variant, seed: int, run: Run) -> bool:
        """False where it was stopped."""
        if not variant.rival:
            begun = begun_person(run.path)
            capture = self.capture if begun is None else replace(self.capture, person=begun)
            return Trainer(capture, self.recipe(variant, seed), run, device=self.device).train()
        seconds = self.effort(VARIANTS[variant.time_of], seed)["cpu_seconds"]
        return timed_training.train(make_rival(variant.name, self.fitted, self.part, seed), run, seconds, seed)

    @contextmanager
    def _effort_noted(self, variant: Variant, seed: int) -> Iterator[None]:
        before, begun = self.effort(variant, seed), (time.monotonic(), time.process_time())
        try:
            yield
        finally:
            taken = time.monotonic() - begun[0], time.process_time() - begun[1]
            effort = {key: before[key] + more for key, more in zip(("seconds", "cpu_seconds"), taken)}
            write_json(self.run_folder(variant, seed) / "effort.json", effort)

    def _measure(self, variant: Variant, seed: int) -> dict[str, Any]:
        """All figures of a variant that was trained."""
        drawer, networks, trained = self._trained(variant, seed)
        folder, tag = self.run_folder(variant, seed), f"{self.part}/rate/samples_per_ray"
        return {
            **self._evaluated([drawer], self._views(CAMERAS_MEASURED)),
            "variant": variant.name,
            "seed": seed,
            **self.effort(variant, seed),
            **trained,
            "parameters": sum(parameter.numel() for parameter in networks.parameters()),
            "samples_per_ray": None if variant.rival else _steady(folder, tag, trained["steps"][0]),
            "device": machine(self.device),
        }

    def _trained(self, variant: Variant, seed: int) -> tuple[Drawer, nn.Module, dict[str, Any]]:
        """Who draws what a finished run has learnt, its networks, and what else is known of it: steps of its passes, an avatar's size on
        disk, the processor time of a rival's steps."""
        if variant.rival:
            rival = make_rival(variant.name, self.fitted, self.part, seed)
            seconds, step = timed_training.read(rival, self.run_folder(variant, seed))
            return rival, rival, {"steps": [step], "cpu_seconds": seconds}
        avatar = load_avatar(self._avatar(variant, seed))
        one, two = getattr(self.recipe(variant, seed), self.part)
        trained = {"steps": [one.steps, two.steps], "file_bytes": self._file_bytes(variant, seed)}
        return AvatarDrawer(avatar), avatar.modules()[self.part], trained

    def _redraw(self, variant: Variant, seed: int) -> dict[str, Any]:
        """Another variant's avatar drawn by volume rendering, beside the deferred renderer on the same few pictures."""
        of = VARIANTS[variant.redraws]
        avatar, one = load_avatar(self._avatar(of, seed)), getattr(self.recipe(of, seed), self.part)[0]
        slow = VolumeDrawer(avatar, self.part, quadrature=one.quadrature)
        views, frames = self._views(SLOW[1]), self._frames()[: SLOW[0]]
        found = self._evaluated([AvatarDrawer(avatar), slow], views, frames)
        trained = self.evaluation(of, seed) or self._measure(of, seed)
        kept = {key: trained[key] for key in ("seed", "steps", "seconds", "cpu_seconds", "parameters")}
        return {
            **found,
            **kept,
            "file_bytes": self._file_bytes(of, seed),
            "variant": variant.name,
            "samples_per_ray": slow.samples,
            "device": machine(self.device),
        }

    def _evaluated(self, drawers: list[Any], views: list[int], frames: list[int] | None = None) -> dict[str, Any]:
        """`subjects`: means on held-out poses by drawer, with the seconds that a picture took."""
        rig, subjects = self.rig, [Timed(drawer) for drawer in drawers]
        compared: list[Drawer] = list(subjects)
        if self.part == "face":
            rig, compared = face_alone(self.capture.person, rig, compared)
        networks = Networks.load()
        frames = self._frames() if frames is None else frames
        capture = replace(self.capture, ground_truth={})
        found = evaluate(capture, rig, compared, networks, Choice(frames, views), progress=True)
        split = found.grouped("split")["held-out pose"]
        return {
            "subjects": {s.name: {**split[s.name], **s.per_picture} for s in subjects},
            "frames": frames,
            "views": [self.rig.views[view].name for view in views],
            "size": list(found.size),
            "missing": networks.missing,
        }

    def _frames(self) -> list[int]:
        return [frame for frame in default_frames(self.rig) if frame in self.rig.held_out_frames]

    def _views(self, count: int) -> list[int]:
        """Evenly chosen among those trained on."""
        return spread([view for view in range(len(self.rig.views)) if view not in self.rig.held_out_views], count)

    def _avatar(self, variant: Variant, seed: int) -> Path:
        """Beside the last checkpoint of its finished run."""
        return checkpoint.found(self.run_folder(variant, seed) / "checkpoints")[-1].path / "avatar.avatar"

    def _file_bytes(self, variant: Variant, seed: int) -> int:
        """Of the whole avatar as it is saved, whichever part was trained."""
        return self._avatar(variant, seed).stat().st_size

    def _file(self, variant: Variant, seed: int) -> Path:
        return self.run_folder(variant, seed) / (f"{variant.name}.json" if variant.redraws else "evaluation.json")

    def _note(self) -> None:
        write_json(self.folder / "study.json", self.about, lasting=True)


class Timed:
    """A drawer with the time it takes."""

    def __init__(self, drawer: Drawer) -> None:
        self.drawer, self.name, self.times = drawer, drawer.name, Times()

    @property
    def per_picture(self) -> dict[str, float]:
        """Mean seconds, the wall's and all processors'; a pose that is new is part of them."""
        taken = {"seconds_per_picture": self.times.wall, "cpu_seconds_per_picture": self.times.cpu}
        return {key: 1e-3 * float(np.mean(times)) for key, times in taken.items()}

    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """See `Drawer`."""
        drawing, took = timed(self.drawer.draw, signals, camera)
        self.times.add(took)
        return drawing


def machine(device: str) -> str:
    """What it ran on, with networks trained on `device`."""
    trained = "" if device == "cpu" else f", networks trained on {device}"
    return f"{platform.machine()} CPU, {torch.get_num_threads()} threads, torch {torch.__version__}{trained}"


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
        raise InputError(folder, f"study.json: {place[1:]}", f"{wanted}, as requested (else another --out)", found)


def _plain(recipe: Recipe) -> dict[str, Any]:
    """As JSON gives it back: lists, not tuples."""
    plain: dict[str, Any] = json.loads(json.dumps(recipe.to_json()))
    return plain
