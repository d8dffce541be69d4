"""`avatarrex-studio bench STAGE …`: measurements that take long, each a stage with a module of its own, `bench_STAGE.py`.

A stage declares its options here, so that the command line is read without loading torch, and has `run(arguments) -> int`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module


@dataclass(frozen=True)
class Stage:
    """One measurement."""

    help: str
    options: Callable[[argparse.ArgumentParser], None]


def _ablation(stage: argparse.ArgumentParser) -> None:
    add = stage.add_argument
    add("capture", help="a folder or .zip")
    add("--out", required=True, metavar="DIR", help="the study's folder; what is finished there is not done again")
    add("--arms", metavar="A,B,…", help="what to compare (every arm of the part)")
    add("--seeds", default="0,1,2", metavar="N,…", help="each arm is trained with each (0,1,2)")
    add(
        "--preset",
        default="quick",
        metavar="P",
        help="quick, long, smoke or paper: the recipe that the arms vary (quick)",
    )
    add("--minutes", metavar="M", help="length of every arm, instead of the recipe's steps")
    add("--scale", metavar="F", default="1", help="times the recipe's steps and schedules, for every arm")
    add("--parts", default="body", choices=("body", "face"), help="what is studied (body)")
    add("--held-out-frames", metavar="A:B:S", help="frames kept from training, instead of the capture's own")
    add("--held-out-views", metavar="NAMES", help="body cameras kept from training, instead of the capture's own")
    add("--json", metavar="FILE.json", help="every figure")
    add("--plot", metavar="DIR", help="PNG plots; needs matplotlib")


STAGES = {"ablation": Stage("what feature patches, pass II, sampling … are worth, trained for real", _ablation)}


def add_options(bench: argparse.ArgumentParser) -> None:
    """The options of every stage."""
    stages = bench.add_subparsers(dest="stage", metavar="STAGE", required=True)
    for name, stage in STAGES.items():
        stage.options(stages.add_parser(name, help=stage.help, allow_abbrev=False))


def run(arguments: argparse.Namespace) -> int:
    """The stage that was asked for."""
    return import_module(f"avatarrex_studio.bench_{arguments.stage}").run(arguments)
