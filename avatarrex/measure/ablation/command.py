"""Variants of the training compared on held-out poses of a capture: what feature patches, pass II … are worth (docs/ablations.md)."""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace
from pathlib import Path

from avatarrex.capture.fit.capture_fit import fit_capture
from avatarrex.capture.readers.choice import held_out
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.errors import check
from avatarrex.fields.placement import device_named
from avatarrex.files.json_text import write_json
from avatarrex.measure.ablation.report import plot, rows, table, to_json
from avatarrex.measure.ablation.study import Study
from avatarrex.measure.ablation.variants import chosen_variants, scaled
from avatarrex.measure.plotting import require_matplotlib
from avatarrex.training.recipe import RECIPES

STOPPED = 130
"""Exit status of a study that was stopped before its end."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """What to compare, on what, for how long."""
    add = parser.add_argument
    add("capture", help="a folder or .zip")
    add("--out", required=True, metavar="DIR", help="the study's folder; what is finished there is not done again")
    add("--variants", metavar="A,B,…", help="what to compare (every variant of the part)")
    add("--seeds", default="0,1,2", metavar="N,…", help="each variant is trained with each (0,1,2)")
    what = f"{', '.join(RECIPES)}: the schedule that the variants change (quick)"
    add("--recipe", default="quick", metavar="R", help=what)
    for name, old in (("variants", "--arms"), ("recipe", "--preset")):  # still accepted
        add(old, dest=name, default=argparse.SUPPRESS, help=argparse.SUPPRESS)
    add("--minutes", metavar="M", help="processor minutes (GPU: wall) of every variant, not the recipe's steps")
    add("--scale", metavar="F", default="1", help="times the recipe's steps and schedules, for every variant")
    add("--parts", default="body", choices=("body", "face"), help="what is studied (body)")
    add("--held-out-frames", metavar="A:B:S", help="frames kept from training, instead of the capture's own")
    add("--held-out-views", metavar="NAMES", help="body cameras kept from training, instead of the capture's own")
    add("--device", default="cpu", metavar="D", help="where networks are trained: cpu, cuda, mps, xpu … (cpu)")
    add("--json", metavar="FILE.json", help="every figure")
    add("--plot", metavar="DIR", help="PNG plots; needs matplotlib")


def run(options: argparse.Namespace) -> int:
    """Do what is missing, print what is there. Raises `InputError` before any work for a wrong option."""
    check(options.recipe in RECIPES, "--recipe", "", "one of " + ", ".join(RECIPES), options.recipe)
    seeds = _seeds(options.seeds)
    variants = chosen_variants(tuple(options.variants.split(",")) if options.variants else None, options.parts)
    minutes = None if options.minutes is None else _positive("--minutes", options.minutes)
    factor = _positive("--scale", options.scale)
    if options.plot:
        require_matplotlib()
    check(not (options.json and Path(options.json).is_dir()), options.json, "", "a file to write", "a folder")
    timed = ", ".join(variant.name for variant in variants if variant.time_of)
    wanted = "cpu: they take as much processor time as another variant"
    check(options.device == "cpu" or not timed, "--device", timed, wanted, options.device)
    device = str(device_named(options.device))
    recipe = scaled(RECIPES[options.recipe], options.parts, factor)
    study = Study(Path(options.out), _opened(options), options.parts, recipe, minutes, device)
    finished = True
    for variant, seed in ((variant, seed) for seed in seeds for variant in variants):
        print(f"{variant.name}, seed {seed}: {variant.what}", file=sys.stderr)
        finished = study.finish(variant, seed) is not None
        if not finished:
            break
    found = rows(study, variants, seeds)
    print(table(study, found))
    if options.json:
        write_json(options.json, to_json(study, found, seeds))
        print(options.json)
    if options.plot:
        path = Path(options.plot) / f"ablation_{options.parts}.png"
        print(plot(found, path, f"{options.parts}: held-out poses, inside the matte"))
    if not finished:
        print(f"{options.out}: stopped; the same command goes on")
    return 0 if finished else STOPPED


def _opened(options: argparse.Namespace) -> Capture:
    capture = open_capture(options.capture)
    for note in capture.notes:
        print(note, file=sys.stderr)
    frames, views = options.held_out_frames, options.held_out_views
    rigs = {name: held_out(rig, frames, views if name == "body" else None) for name, rig in capture.rigs.items()}
    return fit_capture(replace(capture, rigs=rigs))


def _seeds(text: str) -> list[int]:
    words = [word.strip() for word in text.split(",")]
    check(all(word.isdecimal() for word in words), "--seeds", "", "integers from 0, comma separated", text or "nothing")
    return list(dict.fromkeys(int(word) for word in words))


def _positive(option: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    check(0 < value < math.inf, option, "", "a positive number", text or "nothing")
    return value
