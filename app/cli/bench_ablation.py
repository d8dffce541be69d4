"""`avatarrex-studio bench ablation CAPTURE --out DIR`: arms of the training compared on held-out poses (docs/ablations.md)."""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from avatarrex_studio.cli.train import STOPPED, held_out

from avatarrex.capture.fit.surface_fit import fit_surface
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.errors import InputError
from avatarrex.files.gate import write_text
from avatarrex.measure.ablation.report import plot, rows, table, to_json
from avatarrex.measure.ablation.study import Study
from avatarrex.measure.ablation.variants import chosen_variants, scaled
from avatarrex.training.recipe import RECIPES


def run(arguments: argparse.Namespace) -> int:
    """Do what is missing, print what is there. Raises `InputError` before any work for a wrong option."""
    if arguments.preset not in RECIPES:
        raise InputError("--preset", "", ", ".join(RECIPES), arguments.preset)
    seeds = _seeds(arguments.seeds)
    variants = chosen_variants(tuple(arguments.arms.split(",")) if arguments.arms else None, arguments.parts)
    minutes = None if arguments.minutes is None else _positive("--minutes", arguments.minutes)
    factor = _positive("--scale", arguments.scale)
    if arguments.plot and find_spec("matplotlib") is None:
        raise InputError("--plot", "", "matplotlib: pip install 'avatarrex-studio[bench]'", "none")
    if arguments.json and Path(arguments.json).is_dir():
        raise InputError(arguments.json, "", "a file to write", "a folder")
    capture = _opened(arguments)
    recipe = scaled(RECIPES[arguments.preset], arguments.parts, factor)
    study = Study(Path(arguments.out), capture, arguments.parts, recipe, minutes)
    finished = True
    for seed in seeds:
        for arm in variants:
            print(f"{arm.name}, seed {seed}: {arm.what}", file=sys.stderr)
            finished = finished and study.finish(arm, seed) is not None
            if not finished:
                break
    found = rows(study, variants, seeds)
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
    capture = open_capture(arguments.capture)
    for note in capture.notes:
        print(note, file=sys.stderr)
    capture = replace(capture, rigs={name: held_out(rig, arguments) for name, rig in capture.rigs.items()})
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
