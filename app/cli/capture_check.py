"""`capture check`: what a capture contains and how well it fits together, as a table, contact sheets and JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
from avatarrex_studio.cli.options import one_of
from avatarrex_studio.jobs.task import UNUSABLE

from avatarrex.capture.fit.check import CaptureReport, RigReport, check_capture
from avatarrex.capture.fit.overlay import contact_sheet
from avatarrex.capture.fit.surface_fit import fit_surface
from avatarrex.capture.fit.verdict import Verdict, judge
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.capture.readers.splits import with_validation
from avatarrex.files.gate import write_text
from avatarrex.files.images import write_png

OPTIONAL = {"unfitted": "before fit", "mesh": "own mesh"}
"""Silhouettes that not every capture has, with the heads of their columns."""


def check(path: str, template: str, rig: str | None, count: int, surface: bool, out: Path | None) -> int:
    """Check `count` frames of one rig or all with a person's template, print table and verdict, write into `out`. Raises `InputError`.

    Returns `UNUSABLE` where the capture is that.
    """
    capture = with_validation(open_capture(path, template=template))
    rigs = (one_of("--rig", rig, capture.rigs),) if rig else tuple(capture.rigs)
    capture, report, verdict = judge(capture, rigs, count, exact=True)
    if surface and verdict.state != "unusable":
        note = "person: surface fitted to the mattes of the training's frames and cameras"
        capture = replace(capture, person=fit_surface(capture), notes=(*capture.notes, note))
        report = check_capture(capture, rigs, count)
    print("\n".join([*table(report), "", *verdict.lines()]))
    if out is not None:
        for written in _write(capture, report, verdict, out):
            print(written)
    return UNUSABLE if verdict.state == "unusable" else 0


def table(report: CaptureReport) -> list[str]:
    """The report in lines."""
    lines = [f"{report.path}: {len(report.rigs)} rigs, the template {report.person_height:.2f} m tall"]
    for rig in report.rigs:
        lines += ["", *_rig_lines(rig)]
    if report.notes:
        lines += ["", "notes", *(f"  {note}" for note in report.notes)]
    return lines


def _rig_lines(rig: RigReport) -> list[str]:
    compared, missing = len(rig.compared), sum(rig.missing)
    optional = [what for what in OPTIONAL if rig.mean(what) is not None]
    width = max(len("camera"), *map(len, rig.cameras))
    lines = [
        f"{rig.rig}: {rig.frames} frames at {rig.fps:g} a second; of the training's split {rig.trained} frames, "
        f"{len(rig.cameras)} cameras, {missing} pictures missing",
        f"  held out: frames {_ranges(rig.held_out_frames)}; cameras {', '.join(rig.held_out_cameras) or 'none'}",
        f"  silhouettes of {compared} frames: share of the picture in the matte, and IoU with it",
        f"  {'camera':{width}}  {'size':>9}  distance  missing   matte  template"
        + "".join(f"  {OPTIONAL[what]:>10}" for what in optional),
    ]
    for row, (view, name) in enumerate(zip(rig.views, rig.cameras)):
        place = f"  {name:{width}}  {rig.sizes[row]:>9}  {rig.distances[row]:6.2f} m  {rig.missing[row]:7d}"
        lines.append(place + _figures(rig, view, optional))
    lines.append(f"  {'all':{width}}  {'':>9}  {'':>8}  {missing:7d}" + _figures(rig, None, optional))
    if rig.joint_error_mm is not None:
        mean, largest = rig.joint_error_mm
        lines.append(f"  joints: mean {mean:.3f} mm, at most {largest:.3f} mm from the capture's own, over all frames")
    return lines


def _figures(rig: RigReport, view: int | None, optional: list[str]) -> str:
    coverage = rig.mean("coverage", view)
    if coverage is None:
        return "       –         –"
    columns = [f"  {100 * coverage:5.1f}%  {rig.mean('template', view):8.3f}"]
    return "".join([*columns, *(f"  {rig.mean(what, view):10.3f}" for what in optional)])


def _ranges(numbers: tuple[int, ...]) -> str:
    """`1–4, 9`, or none."""
    runs = [[number for _, number in run] for _, run in groupby(enumerate(numbers), lambda pair: pair[1] - pair[0])]
    return ", ".join(f"{run[0]}–{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs) or "none"


def _write(capture: Capture, report: CaptureReport, verdict: Verdict, out: Path) -> Iterator[Path]:
    """The contact sheets, which show held-out cameras, too, and the report."""
    for rig in report.rigs:
        name = rig.rig
        sheet = contact_sheet(capture, name, rig.compared)
        opaque = np.dstack([sheet, np.full(sheet.shape[:2], 255, np.uint8)])
        write_png(out / f"{name}.png", opaque)
        yield out / f"{name}.png"
    found = {**report.to_json(), "verdict": verdict.to_json()}
    write_text(out / "check.json", json.dumps(found, indent=2, ensure_ascii=False) + "\n")
    yield out / "check.json"
