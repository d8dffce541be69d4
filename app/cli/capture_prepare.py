"""`capture prepare`: videos, a calibration and keypoint files become a refined capture, and an avatar where that is wanted."""

from __future__ import annotations

import argparse
import shutil
from itertools import count
from pathlib import Path

from avatarrex_studio.cli.capture_refine import FIGURES, refine
from avatarrex_studio.cli.main import main

from avatarrex.capture.fit.refining import FILE
from avatarrex.capture.fit.verdict import judge
from avatarrex.capture.importers.preparing import Options, Preparing
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import check
from avatarrex.files.json_text import SMALL, read_json, write_json

REFINED, TRAINED = "steps/refined.json", "steps/trained.json"
"""Which fit, and so which files of the source, `OUT/refined` and `OUT/run` were made from."""


def prepare(source: Path, out: Path, options: Options, arguments: argparse.Namespace) -> int:
    """Every step that is not done, then refinement, verdict and training. Raises `InputError`."""
    work = Preparing(source, out, options)
    if arguments.redo:
        work.forget(arguments.redo)
    for line in work.run():
        print(line, flush=True)
    finished, key = out / "capture", work.made()
    if not arguments.no_refine:
        _refined(finished, out, key, options.person)
        finished = out / "refined"
    print("\n".join(judge(open_capture(finished, template=options.person))[2].lines()))
    print(finished)
    if arguments.train:
        run = out / "run"
        more = ["--resume"] if _begun(run, out / TRAINED, f"{key} {finished.name}") else []
        what = ["--recipe", arguments.train, "--person", options.person]
        return main(["train", str(finished), *what, "--out", str(run), *more])
    return 0


def _refined(capture: Path, out: Path, key: str, person: str) -> None:
    """Refine `capture` on `person` into `OUT/refined`, unless that is done; what was made from another fit is removed first."""
    marker, refined = out / REFINED, out / "refined"
    before = _marked(marker, refined)
    if before == key and (refined / FIGURES).exists() and not (refined / FILE).exists():
        return  # a refinement removes its file at the end
    if before not in (None, key):
        print(f"{refined}: refined from what the source was before: made anew", flush=True)
        shutil.rmtree(refined)
    write_json(marker, {"key": key})
    every = True  # validation and test are then driven by tracking of the same kind
    refine(str(capture), every, refined, template=person)


def _begun(run: Path, marker: Path, key: str) -> bool:
    """Whether a run has begun on these files; one of others is renamed, and the new one marked."""
    before = _marked(marker, run)
    if before not in (None, key):
        aside = next(name for k in count(1) if not (name := run.with_name(f"{run.name}_before_{k}")).exists())
        run.rename(aside)
        print(f"{aside}: trained on what the source was before", flush=True)
    write_json(marker, {"key": key})
    return before == key


def _marked(marker: Path, folder: Path) -> str | None:
    """The key of what `folder` was made from; None where there is no such folder. Raises `InputError` for one without a marker."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return None
    found = read_json(marker, largest=SMALL) if marker.exists() else None
    key = found.get("key") if isinstance(found, dict) else None
    check(
        isinstance(key, str), folder, "", f"a name that is free, or a folder that {marker} speaks of", "something else"
    )
    return str(key)
