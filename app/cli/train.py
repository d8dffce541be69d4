"""`avatarrex-studio train CAPTURE --recipe R --out RUN`: train an avatar from a capture."""

from __future__ import annotations

import argparse
import logging
import shlex
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from avatarrex_studio.cli import options
from avatarrex_studio.cli.output import output_folder, print_figures

from avatarrex.capture.readers.choice import cameras, frames, held_out
from avatarrex.errors import InputError, plain
from avatarrex.training.recipe import RECIPES, Recipe, from_scratch

if TYPE_CHECKING:
    from avatarrex.avatar import Avatar
    from avatarrex.capture.readers.rigs import Capture, Rig
    from avatarrex.training.core.process_group import ProcessGroup
    from avatarrex.training.runs.folder import Run

log = logging.getLogger(__name__)
STOPPED = 130
"""Exit status of a run that was stopped before its end."""
LATER = ("splits", "capture_key", "person_hash")
"""What the `run.json` of older versions may lack."""
WITHOUT = 1
"""Exit status of a training whose surface could not be made, and of a process that lost the others."""
REFUSED = 2
"""Exit status of wrong input (main.py)."""
OPENED, ENDED = "run opened", "run ended"
"""What a training notes for the processes that torchrun starts again: that the run is its own; its exit status."""


def add_options(verb: argparse.ArgumentParser) -> None:
    """What is trained, how, and where it goes."""
    add = verb.add_argument
    add("capture", help="a folder or .zip")
    add("--out", required=True, metavar="RUN", help="a new folder for the run, or with --resume the one to go on with")
    recipes = ", ".join(RECIPES)
    options.add_renamed(verb, "--recipe", "--preset", default="quick", metavar="R", help=f"{recipes} (quick)")
    add("--parts", metavar="PARTS", help="face, body or face,body (what the capture has)")
    add("--resume", action="store_true", help="go on from the run's last checkpoint")
    add("--seed", default="0", metavar="N", help="of everything random (0)")
    options.add_held_out(verb, "body cameras", "kept from training, for `evaluate` alone")
    add(
        "--validation-frames",
        metavar="A:B:S",
        help="frames kept for the training's own figures, instead of some by rule",
    )
    add("--start", metavar="AVATAR", help="an avatar to go on from (with --recipe refine), in place of the template")
    options.add_person(verb, None, "default, or with --start as there")
    add("--from-scratch", action="store_true", help="from nothing: neither the packaged prior nor the template's shape")
    add("--no-surface", action="store_true", help="end without distilling the avatar's surface, which level live draws")
    add("--force", action="store_true", help="train though the capture is unusable by `capture check`")
    add("--mixed", action="store_true", help="colours in bfloat16 while training: for a processor with units for it")
    options.add_device(verb)
    for part in ("body", "face"):
        add(f"--{part}-views", metavar="NAMES", help=f"{part} cameras to train on alone")


def run(arguments: argparse.Namespace) -> int:
    """Train, or go on with a training. Raises `InputError` before any work for a wrong option."""
    recipe = RECIPES[options.one_of("--recipe", arguments.recipe, RECIPES)]
    if arguments.from_scratch:
        if arguments.start:
            raise InputError("--from-scratch", "", "no avatar to go on from with it", f"--start {arguments.start}")
        recipe = from_scratch(recipe)
    recipe = replace(recipe, mixed=arguments.mixed)
    options.whole("--seed", arguments.seed, 0)
    if arguments.parts:
        options.some_of("--parts", arguments.parts, recipe.steps())
    output_folder(arguments.out, "run.json")
    from avatarrex.training.core.process_group import PeerLost, leads, process_group

    try:
        with process_group(arguments.device) as (group, device):
            return _once(group, lambda: _train(arguments, recipe, group, device))
    except PeerLost as error:
        if not leads():
            return WITHOUT  # the one that leads says it, or why it ended itself
        raise InputError(arguments.out, "", "all processes of the training", str(error)) from None


def _once(group: ProcessGroup, train: Callable[[], int]) -> int:
    """Train; torchrun starts all again after whatever is not 0: what is no death ends again at once, and a stop is 0."""
    from avatarrex.training.core.process_group import under_torchrun
    from avatarrex.training.core.work import Diverged

    before = group.noted(ENDED)
    if before is not None:
        return int(before)
    try:
        code = train()
    except (InputError, Diverged) as error:
        group.note(ENDED, str(REFUSED if isinstance(error, InputError) else WITHOUT))
        raise
    if code == STOPPED and under_torchrun():
        return 0
    if code:
        group.note(ENDED, str(code))
    return code


def _train(arguments: argparse.Namespace, recipe: Recipe, group: ProcessGroup, device: str) -> int:
    """Train as one of the group's processes; of several the first alone writes."""
    from avatarrex.avatar_file import load_avatar
    from avatarrex.capture.readers.rigs import open_capture
    from avatarrex.fields.placement import device_named
    from avatarrex.training.core.trainer import Trainer

    _check_free(arguments, group)
    device = str(device_named(device))
    start = load_avatar(arguments.start) if arguments.start else None
    arguments.person = template(arguments.person, start)
    capture = open_capture(arguments.capture, template=arguments.person)
    for note in capture.notes:
        print(note)
    chosen = options.some_of("--parts", arguments.parts, recipe.steps()) if arguments.parts else None
    parts = tuple(part for part in recipe.steps() if part in (chosen or capture.rigs))
    capture = split_as_wanted(capture, arguments)
    require_pictures(capture, parts)
    capture = _fitted(capture, start, arguments)
    trained = _joined_run(arguments, _config(arguments, capture, recipe, parts), group)
    with trained:
        recipe = kept_recipe(trained.path, trained.config, arguments.mixed, arguments.from_scratch)
        trainer = Trainer(capture, recipe, trained, start, device, group)
        print(trainer.perceptual.note)
        finished = trainer.train()
        if not finished:
            trained.close("stopped")
        elif arguments.no_surface or not group.leads:
            trained.close("finished")
        else:
            return _with_surface(trained, device)
    print(f"{trained.path}: " + ("finished" if finished else "stopped; --resume goes on"))
    return 0 if finished else STOPPED


def _check_free(arguments: argparse.Namespace, group: ProcessGroup) -> None:
    """Refuse a folder in which another training is; one that torchrun starts again goes on with its own."""
    from avatarrex.training.runs.folder import check_free

    arguments.resume = arguments.resume or group.noted(OPENED) is not None
    if group.leads:
        check_free(Path(arguments.out), arguments.resume)
    group.wait()


def _joined_run(arguments: argparse.Namespace, config: dict[str, Any], group: ProcessGroup) -> Run:
    """The run, opened by the process that leads; the others follow once it is there."""
    from avatarrex.training.runs.follower import Follower

    if group.leads:
        run = _open_run(arguments, config)
        group.note(OPENED, "yes")
        group.wait()
        return run
    group.wait()
    return Follower(arguments.out)


def _with_surface(trained: Run, device: str) -> int:
    """Give the trained avatar its surface and end the run; what fails or stops here is gone on with by `--resume`."""
    from avatarrex.training.distilled import Stopped, add_surface

    try:
        surface = add_surface(trained, device)
    except (KeyboardInterrupt, Stopped):
        trained.close("stopped")
        print(f"{trained.path}: trained; stopped before its surface was made; --resume goes on")
        return STOPPED
    except Exception as error:  # the avatar is trained and saved: whatever this is, the training has not failed
        log.exception("%s: no surface", trained.path)
        reason = plain((str(error) or type(error).__name__).splitlines()[0])
        trained.close("finished", f"no surface: {reason}")
        print(f"{trained.path}: finished without a surface ({reason}); --resume tries again")
        return WITHOUT
    trained.close("finished")
    print_figures(surface.meta)
    print(f"{trained.path}: finished")
    return 0


def split_as_wanted(capture: Capture, arguments: argparse.Namespace) -> Capture:
    """The capture as the options split it, with what its training keeps for validation.

    A run that began when there was none goes on without.
    """
    from avatarrex.capture.readers.splits import with_validation
    from avatarrex.training.runs.folder import read_about

    capture = replace(capture, rigs={name: trained_on(rig, arguments) for name, rig in capture.rigs.items()})
    if arguments.resume and "splits" not in read_about(Path(arguments.out))["config"]:
        return with_validation(capture, dict.fromkeys(capture.rigs, ()))
    if not arguments.validation_frames:
        return with_validation(capture)
    option = "--validation-frames"
    named = {name: frames(arguments.validation_frames, rig.frames, option) for name, rig in capture.rigs.items()}
    return with_validation(capture, named)


def template(named: str | None, start: Avatar | None) -> str:
    """The person to train on: the one that was named, or the start's. Raises `InputError` where these are two."""
    own = "default" if start is None else start.person.name
    if start is not None and named not in (None, own):
        raise InputError("--person", "", f"{own}, which the avatar to go on from has", named)
    return named or own


def require_pictures(capture: Capture, parts: Iterable[str]) -> None:
    """Raise `InputError` where the rig of a part that is to be trained has no picture for it, before anything is fitted."""
    from avatarrex.capture.readers.splits import Splits

    for name in parts:
        rig = capture.rigs.get(name)
        if rig is None or Splits.of(rig).train.pictures(rig):
            continue
        found = f"{len(rig.held_out_frames)} of {rig.frames} frames and {len(rig.held_out_views)} of {len(rig.views)} cameras held out"
        raise InputError(capture.path, f"{name} rig", "at least one picture to train on", found)


def trained_on(rig: Rig, arguments: argparse.Namespace) -> Rig:
    """The rig with the options' frames (of every rig) and views held out; or all views but those to train on."""
    rig = held_out(rig, arguments.held_out_frames, arguments.held_out_views if rig.name == "body" else None)
    alone = getattr(arguments, f"{rig.name}_views")
    if not alone:
        return rig
    others = set(range(len(rig.views))) - set(cameras(rig, alone, f"--{rig.name}-views"))
    return rig.holding_out(rig.held_out_frames, others)


def _fitted(capture: Capture, start: Avatar | None, arguments: argparse.Namespace) -> Capture:
    """With the person's size, skin and face, or the start's body. Raises `InputError` for what cannot be trained on, unless forced."""
    from avatarrex.capture.fit.capture_fit import fit_geometry
    from avatarrex.capture.fit.verdict import judge
    from avatarrex.capture.readers.splits import sealed

    if start is not None:
        capture = _with_body(capture, start, arguments.start)
    if not capture.sized:
        print("person: fitting the template's size to the mattes")
    capture, _, verdict = judge(capture)
    if verdict.reasons:
        print("\n".join(verdict.lines()))
    if verdict.state == "unusable" and not (arguments.force or arguments.resume):
        expected = "a capture that can be trained on (`capture check` shows it; --force trains anyway)"
        worst = next(reason for reason in verdict.reasons if reason.state == "unusable")
        raise InputError(arguments.capture, worst.where, expected, worst.what)
    if start is not None or capture.person.packaged:
        return capture
    from avatarrex.training.runs.begun import begun_person

    begun = begun_person(Path(arguments.out)) if arguments.resume else None
    if begun is not None and begun.name == capture.person.name:
        return replace(capture, person=begun)
    own = "face" in capture.rigs and bool((capture.person.face.body_vertex_ids >= 0).all())
    face = ", then its face to the face rig's pictures" if own else ""
    print(f"person: fitting the template's skin to the mattes{face}")
    return replace(capture, person=fit_geometry(sealed(capture, "train")))


def _with_body(capture: Capture, start: Avatar, source: str) -> Capture:
    """With the start's body, fitted before in size and skin; `InputError` where it is a modelled person's, but another."""
    if not capture.sized:
        from avatarrex.metrics.own_training import own_training

        trained = own_training(start, source, capture)
        if trained is None:
            expected = "one trained on this capture, whose files do not say how large the person is"
            raise InputError("--start", "", expected, source)
        return trained.placed(capture, start.person)
    if capture.person.packaged != start.person.packaged:
        whose = {True: "the studio's own", False: "one fitted to a capture"}
        raise InputError("--start", "body", whose[capture.person.packaged], whose[start.person.packaged])
    return replace(capture, person=start.person)


def kept_recipe(path: Path, config: Mapping[str, Any], mixed: bool, scratch: bool = False) -> Recipe:
    """The one that the run began with, whatever `RECIPES` has under its name by now. Raises `InputError`."""
    try:
        recipe = Recipe.from_json(config["recipe"])
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise InputError(path, "run.json: recipe", "a recipe of this version", repr(error)) from None
    if mixed and not recipe.mixed:
        raise InputError("--mixed", "", "as the run began, without", "--mixed")
    if scratch and not recipe.scratch:
        raise InputError("--from-scratch", "", "as the run began, without", "--from-scratch")
    return recipe


def _config(arguments: argparse.Namespace, capture: Capture, recipe: Recipe, parts: tuple[str, ...]) -> dict[str, Any]:
    """What `run.json` records of a training."""
    from avatarrex.capture.readers.splits import splits_of
    from avatarrex.templates.person import load_person

    return {
        "part": ",".join(parts),
        "preset": recipe.name,
        "capture": arguments.capture,
        "seed": int(arguments.seed),
        "command": _command(arguments),
        "start": arguments.start,
        "person": arguments.person,
        "person_hash": load_person(arguments.person).hash,
        "steps": {part: steps for part, steps in recipe.steps().items() if part in parts},
        "recipe": recipe.to_json(),
        "capture_key": capture.key,
        "pelvis": capture.pelvis.tolist(),
        "held_out": {
            name: {"frames": sorted(rig.held_out_frames), "views": sorted(rig.held_out_views)}
            for name, rig in capture.rigs.items()
        },
        "splits": splits_of(capture),
    }


def _command(arguments: argparse.Namespace) -> str:
    """The command line as it is kept in files that are given away: of paths the last name alone."""
    paths = {arguments.capture, arguments.out, arguments.start}
    words = ["avatarrex-studio"]
    for word in arguments.words:
        option, equals, value = word.rpartition("=")  # also in --out=FOLDER
        words.append(option + equals + Path(value).name if value in paths else word)
    return shlex.join(words)


def _open_run(arguments: argparse.Namespace, config: dict[str, Any]) -> Run:
    """A new run, or with `--resume` the one that is there; what differs is refused before that is touched."""
    from avatarrex.training.runs.folder import Run, read_about

    if not arguments.resume:
        return Run.create(arguments.out, config)
    begun = read_about(Path(arguments.out))["config"]
    for key in ("part", "preset", "seed", "start", "person", "person_hash", "capture_key", "held_out", "splits"):
        if begun.get(key, {"person": "default"}.get(key, config[key] if key in LATER else None)) != config[key]:
            raise InputError(arguments.out, f"run.json: {key}", f"{config[key]}, as requested", begun.get(key))
    kept_recipe(Path(arguments.out), begun, arguments.mixed, arguments.from_scratch)
    return Run.open(arguments.out)
