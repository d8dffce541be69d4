"""`avatarrex-studio bench ablation CAPTURE --out DIR`: variants of the training compared on held-out poses (docs/ablations.md)."""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from avatarrex_studio.cli.options import add_held_out, add_renamed, one_of
from avatarrex_studio.cli.rigs import open_held_out
from avatarrex_studio.cli.train import STOPPED

from avatarrex.capture.fit.surface_fit import fit_surface
from avatarrex.capture.readers.rigs import Capture
from avatarrex.errors import InputError
from avatarrex.files.gate import write_text
from avatarrex.measure.ablation.report import plot, rows, table, to_json
from avatarrex.measure.ablation.study import Study
from avatarrex.measure.ablation.variants import chosen_arms, scaled
from avatarrex.training.recipe import RECIPES


def add_options(ablation: argparse.ArgumentParser) -> None:
    """The options of `bench ablation`."""
    add = ablation.add_argument
    add("capture", help="a folder or .zip")
    add("--out", required=True, metavar="DIR", help="the study's folder; what is finished there is not done again")
    add_renamed(ablation, "--variants", "--arms", metavar="A,B,…", help="what to compare (every variant of the part)")
    add("--seeds", default="0,1,2", metavar="N,…", help="each variant is trained with each (0,1,2)")
    what = f"{', '.join(RECIPES)}: the schedule that the variants change (quick)"
    add_renamed(ablation, "--recipe", "--preset", default="quick", metavar="R", help=what)
    add("--minutes", metavar="M", help="length of every variant, instead of the recipe's steps")
    add("--scale", metavar="F", default="1", help="times the recipe's steps and schedules, for every variant")
    add("--parts", default="body", choices=("body", "face"), help="what is studied (body)")
    add_held_out(ablation, "body cameras", "kept from training")
    add("--json", metavar="FILE.json", help="every figure")
    add("--plot", metavar="DIR", help="PNG plots; needs matplotlib")


def run(arguments: argparse.Namespace) -> int:
    """Do what is missing, print what is there. Raises `InputError` before any work for a wrong option."""
    recipe = RECIPES[one_of("--recipe", arguments.recipe, RECIPES)]
    seeds = _seeds(arguments.seeds)
    arms = chosen_arms(tuple(arguments.variants.split(",")) if arguments.variants else None, arguments.parts)
    minutes = None if arguments.minutes is None else _positive("--minutes", arguments.minutes)
    factor = _positive("--scale", arguments.scale)
    if arguments.plot and find_spec("matplotlib") is None:
        raise InputError("--plot", "", "matplotlib: pip install 'avatarrex-studio[bench]'", "none")
    if arguments.json and Path(arguments.json).is_dir():
        raise InputError(arguments.json, "", "a file to write", "a folder")
    capture = _opened(arguments)
    recipe = scaled(recipe, arguments.parts, factor)
    study = Study(Path(arguments.out), capture, arguments.parts, recipe, minutes)
    finished = True
    for seed in seeds:
        for arm in arms:
            print(f"{arm.name}, seed {seed}: {arm.what}", file=sys.stderr)
            finished = finished and study.finish(arm, seed) is not None
            if not finished:
                break
    found = rows(study, arms, seeds)
    print(table(study, found))
    if arguments.json:
        text = json.dumps(to_json(study, found, seeds), indent=1, ensure_ascii=False, allow_nan=False)
        write_text(arguments.json, text + "\n")
        print(arguments.json)
    if arguments.plot:
        path = Path(arguments.plot) / f"ablation_{arguments.parts}.png"
        plot(found, path, f"{arguments.parts}: held-out poses, inside the matte")
        print(path)
    if not finished:
        print(f"{arguments.out}: stopped; the same command goes on")
    return 0 if finished else STOPPED


def _opened(arguments: argparse.Namespace) -> Capture:
    capture = open_held_out(arguments)
    for note in capture.notes:
        print(note, file=sys.stderr)
    return capture if capture.person.fit is None else replace(capture, person=fit_surface(capture))


def _seeds(text: str) -> list[int]:
    words = [word.strip() for word in text.split(",")]
    if not all(word.isdecimal() for word in words):
        raise InputError("--seeds", "", "integers from 0, comma separated", text or "nothing")
    return list(dict.fromkeys(int(word) for word in words))


def _positive(option: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise InputError(option, "", "a positive number", text or "nothing")
    return value
