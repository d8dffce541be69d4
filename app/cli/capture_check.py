"""`capture check`: what a capture holds and how well it fits together, as a table, contact sheets and JSON."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from avatarrex.capture.fit.check import CaptureReport, RigReport, check_capture, compared_frames
from avatarrex.capture.fit.overlay import contact_sheet
from avatarrex.capture.fit.surface_fit import fit_surface
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.errors import InputError
from avatarrex.files.gate import write_text
from avatarrex.files.images import write_png


def run(arguments: argparse.Namespace) -> int:
    """Check, print, and write what `--out` asks for. Raises `InputError`."""
    if not arguments.frames.isdigit() or not 1 <= int(arguments.frames) <= 1000:
        raise InputError("--frames", "", "1 to 1000 frames", arguments.frames)
    count = int(arguments.frames)
    out = None if arguments.out is None else Path(arguments.out)
    if out is not None and out.exists() and not out.is_dir():
        raise InputError(out, "", "a folder to write into", "a file")
    capture = open_capture(arguments.capture)
    if arguments.rig is not None and arguments.rig not in capture.rigs:
        raise InputError(capture.path, "--rig", "one of " + ", ".join(capture.rigs), arguments.rig)
    if arguments.surface:
        note = "person: surface fitted to the mattes of the frames and views that are not held out"
        capture = replace(capture, person=fit_surface(capture), notes=(*capture.notes, note))
    rigs = (arguments.rig,) if arguments.rig else tuple(capture.rigs)
    report = check_capture(capture, rigs, count)
    print("\n".join(table(report)))
    if out is not None:
        for path in _write(capture, report, rigs, count, out):
            print(path)
    return 0


def table(report: CaptureReport) -> list[str]:
    """The report in lines."""
    lines = [f"{report.path}: {len(report.rigs)} rigs, the template {report.person_height:.2f} m tall"]
    for rig in report.rigs:
        lines += ["", *_rig_lines(rig)]
    if report.notes:
        lines += ["", "notes", *(f"  {note}" for note in report.notes)]
    return lines


def _rig_lines(rig: RigReport) -> list[str]:
    compared = len({item.frame for item in rig.silhouettes})
    lines = [
        f"{rig.rig}: {rig.frames} frames at {rig.fps:g} a second, {len(rig.cameras)} cameras, {sum(rig.missing)} pictures missing",
        f"  held out: frames {_ranges(rig.held_out_frames)}; cameras {', '.join(rig.held_out_cameras) or 'none'}",
        f"  silhouettes of {compared} frames: share of the picture in the matte, and IoU with it",
    ]
    width = max(len("camera"), *map(len, rig.cameras))
    head = f"  {'camera':{width}}  {'size':>9}  distance  missing   matte  template"
    optional = [(what, title) for what, title in (("unfitted", "before fit"), ("mesh", "own mesh")) if _has(rig, what)]
    lines.append(head + "".join(f"  {title:>10}" for _, title in optional))
    for view, name in enumerate(rig.cameras):
        lines.append(
            f"  {name:{width}}  {rig.sizes[view]:>9}  {rig.distances[view]:6.2f} m  {rig.missing[view]:7d}"
            + _figures(rig, view, optional)
        )
    lines.append(f"  {'all':{width}}  {'':>9}  {'':>8}  {sum(rig.missing):7d}" + _figures(rig, None, optional))
    if rig.joint_error_mm is not None:
        mean, largest = rig.joint_error_mm
        lines.append(f"  joints: mean {mean:.3f} mm, at most {largest:.3f} mm from the capture's own, over all frames")
    return lines


def _has(rig: RigReport, what: str) -> bool:
    return rig.mean(what) is not None


def _figures(rig: RigReport, view: int | None, optional: list[tuple[str, str]]) -> str:
    coverage = rig.mean("coverage", view)
    if coverage is None:
        return "       –         –"
    columns = [f"  {100 * coverage:5.1f}%  {rig.mean('template', view):8.3f}"]
    return "".join([*columns, *(f"  {rig.mean(what, view):10.3f}" for what, _ in optional)])


def _ranges(numbers: tuple[int, ...]) -> str:
    """`1–4, 9`, or none."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(str(first) if first == last else f"{first}–{last}" for first, last in runs) or "none"


def _write(capture: Capture, report: CaptureReport, rigs: tuple[str, ...], count: int, out: Path) -> list[Path]:
    written = []
    for name in rigs:
        sheet = contact_sheet(capture, name, compared_frames(capture.rigs[name].frames, count))
        opaque = np.dstack([sheet, np.full(sheet.shape[:2], 255, np.uint8)])
        write_png(out / f"{name}.png", opaque)
        written.append(out / f"{name}.png")
    write_text(out / "check.json", json.dumps(report.to_json(), indent=2, ensure_ascii=False) + "\n")
    return [*written, out / "check.json"]
