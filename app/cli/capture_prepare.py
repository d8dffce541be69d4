"""`capture prepare`: videos, a calibration and keypoint files become a refined capture, and an avatar where that is wanted."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from avatarrex_studio.cli.capture_refine import FIGURES, refine
from avatarrex_studio.cli.main import main

from avatarrex.capture.fit.verdict import judge
from avatarrex.capture.importers.preparing import Options, Preparing
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.files.json_text import SMALL, read_json, write_json

MARKER = "steps/refined.json"
"""Which capture the refined one was made from."""


def prepare(source: Path, out: Path, options: Options, arguments: argparse.Namespace) -> int:
    """Every step that is not done, then refinement, verdict and training. Raises `InputError`."""
    work = Preparing(source, out, options)
    if arguments.redo:
        work.forget(arguments.redo)
    for line in work.run():
        print(line, flush=True)
    refined, finished = out / "refined", out / "capture"
    if not arguments.no_refine:
        _refined(finished, refined)
        finished = refined
    print("\n".join(judge(open_capture(finished))[2].lines()))
    print(finished)
    if arguments.train:
        run = out / "run"
        more = ["--resume"] if run.exists() else []
        return main(["train", str(finished), "--recipe", arguments.train, "--out", str(run), *more])
    return 0


def _refined(capture: Path, out: Path) -> None:
    """Refine `capture` into `out`, unless that is done; one of another capture's is removed first."""
    key = open_capture(capture).key
    marker = out.parent / MARKER
    before = read_json(marker, largest=SMALL).get("key") if marker.exists() else None
    if before != key and out.exists():
        shutil.rmtree(out)
    elif (out / FIGURES).exists():
        return
    write_json(marker, {"key": key})
    refine(str(capture), False, out)
