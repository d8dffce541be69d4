"""`avatarrex-studio train CAPTURE --preset P --out RUN`: train an avatar from a capture."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from avatarrex_studio.cli import options
from avatarrex_studio.cli.evaluate import views_of

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.capture.fit.surface_fit import fit_surface
from avatarrex.capture.readers.rigs import Capture, Rig, open_capture
from avatarrex.errors import InputError
from avatarrex.fields.placement import device_named
from avatarrex.templates.person import Person
from avatarrex.training.core.trainer import PARTS, Trainer
from avatarrex.training.recipe import RECIPES, Recipe
from avatarrex.training.runs.folder import Run, read_about

STOPPED = 130
"""Exit status of a run that was asked to stop before its end."""


def run(arguments: argparse.Namespace) -> int:
    """Train, or go on with a training. Raises `InputError` before any work for a wrong option."""
    if arguments.preset not in RECIPES:
        raise InputError("--preset", "", ", ".join(RECIPES), arguments.preset)
    if not arguments.seed.isdigit():
        raise InputError("--seed", "", "an integer from 0", arguments.seed or "nothing")
    seed = int(arguments.seed)
    device = device_named(arguments.device)
    chosen = tuple(arguments.parts.split(",")) if arguments.parts else None
    for part in chosen or ():
        if part not in PARTS:
            raise InputError("--parts", "", "face, body or face,body", part or "nothing")
    start = load_avatar(arguments.start) if arguments.start else None
    capture = open_capture(arguments.capture)
    for note in capture.notes:
        print(note)
    capture = replace(capture, rigs={name: held_out(rig, arguments) for name, rig in capture.rigs.items()})
    if capture.person.fit is not None and start is None:
        print("person: fitting the template's skin to the mattes")
        capture = replace(capture, person=fit_surface(capture))
    if start is not None:
        capture = replace(capture, person=_same_body(start, capture))
    parts = tuple(part for part in PARTS if part in (chosen or capture.rigs))
    trained = _open_run(arguments, capture, parts, seed)
    with trained:
        trainer = Trainer(
            capture,
            kept_recipe(trained.path, trained.config, arguments.mixed),
            parts,
            trained,
            seed,
            start,
            str(device),
        )
        print(trainer.perceptual.note)
        finished = trainer.train()
        trained.close("finished" if finished else "stopped")
    print(f"{trained.path}: " + ("finished" if finished else "stopped; --resume goes on"))
    return 0 if finished else STOPPED


def held_out(rig: Rig, arguments: argparse.Namespace) -> Rig:
    """The rig with the options' frames (of every rig) and views held out; or all views but those to train on."""
    frames, views = rig.held_out_frames, rig.held_out_views
    if arguments.held_out_frames:
        frames = frozenset(options.frames(arguments.held_out_frames, rig.frames))
    if arguments.held_out_views and rig.name == "body":
        views = frozenset(views_of(rig, arguments.held_out_views, "--held-out-views"))
    only = getattr(arguments, f"{rig.name}_views", None)
    if only:
        views = frozenset(range(len(rig.views))) - frozenset(views_of(rig, only, f"--{rig.name}-views"))
    return rig.holding_out(frames, views)


def _same_body(start: Avatar, capture: Capture) -> Person:
    """The start's body, whose size and skin were fitted before; `InputError` where it is a modelled person's, but another."""
    if (capture.person.fit is None) != (start.person.fit is None):
        raise InputError("--start", "body", capture.person.name, start.person.name)
    return start.person


def kept_recipe(path: Path, config: Mapping[str, Any], mixed: bool) -> Recipe:
    """The one that the run began with, whatever the preset is by now. Raises `InputError`."""
    try:
        recipe = Recipe.from_json(config["recipe"])
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise InputError(path, "run.json: recipe", "a recipe of this version", repr(error)) from None
    if mixed and not recipe.mixed:
        raise InputError("--mixed", "", "as the run began, without", "--mixed")
    return recipe


def _open_run(arguments: argparse.Namespace, capture: Capture, parts: tuple[str, ...], seed: int) -> Run:
    recipe = replace(RECIPES[arguments.preset], mixed=arguments.mixed)
    config = {
        "part": ",".join(parts),
        "preset": recipe.name,
        "capture": str(arguments.capture),
        "seed": seed,
        "start": arguments.start,
        "steps": {part: steps for part, steps in recipe.steps().items() if part in parts},
        "recipe": recipe.to_json(),
        "held_out": {
            name: {"frames": sorted(rig.held_out_frames), "views": sorted(rig.held_out_views)}
            for name, rig in capture.rigs.items()
        },
    }
    if not arguments.resume:
        return Run.create(arguments.out, config)
    begun = read_about(Path(arguments.out))["config"]  # what is wrong is said before the run is touched
    for key in ("part", "preset", "seed", "start", "held_out"):
        if begun.get(key) != config[key]:
            raise InputError(arguments.out, f"run.json: {key}", f"{config[key]}, as asked for", begun.get(key))
    kept_recipe(Path(arguments.out), begun, arguments.mixed)
    return Run.open(arguments.out)
