"""`capture refine`: a capture whose tracking is refined by its own pictures, with an overlay and figures, before and after."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from avatarrex.capture.fit.check import check_capture, joint_distances, shown_frames
from avatarrex.capture.fit.overlay import compared_sheet
from avatarrex.capture.fit.pose_fit import keypoint_error
from avatarrex.capture.fit.refined_capture import write_refined
from avatarrex.capture.fit.refining import FILE, Refining
from avatarrex.capture.fit.size_fit import fit_size
from avatarrex.capture.fit.surface_fit import fit_surface
from avatarrex.capture.readers.rigs import Capture, Rig, open_capture
from avatarrex.capture.readers.splits import Splits, with_validation
from avatarrex.errors import InputError
from avatarrex.files.gate import is_begun, remove_unfinished, write_text
from avatarrex.files.images import write_png

COMPARED = 4
"""Frames of each rig that figures and overlays are of."""
FIGURES, SHEET = "refine.json", "refine_{}.png"
LINES = {
    "iou": "silhouettes, IoU of the template",
    "iou_skin": "… its skin on the mattes",
    "keypoints_px": "keypoints, pixels",
    "joints_mm": "joints in the pictures, mm",
}


def refine(path: str, every: bool, out: Path, colours: bool = True, template: str = "default") -> int:
    """Refine into the folder `out`, or go on there; with `colours` by those, too, of the person `template`. Raises `InputError`."""
    capture = with_validation(open_capture(path, template=template))
    refuse = InputError(out, "", f"a new or empty folder, or one with {FILE} to go on with", "something else")
    ended = is_begun(out) and not (out / FILE).exists()
    if ended and not (out / FIGURES).exists():
        raise refuse
    for note in capture.notes:
        print(note)
    before = capture if capture.sized else fit_size(capture)
    work = Refining(before, out, every, colours)
    said = {"from": capture.key, "person": template, "frames": {rig: list(f) for rig, f in work.frames.items()}}
    said["key"] = hashlib.sha256(work.key.encode()).hexdigest()[:16]
    if ended:
        if open_capture(out, template=template).manifest.get("refined") != said:
            raise refuse
        print(f"{out}: done before")
        return 0
    body = work.body()
    pairs = [(rig, frame) for rig, frames in work.frames.items() for frame in frames]
    for rig, frame in tqdm(pairs, desc="refine poses", unit="frame"):
        work.pose(body, rig, frame)
    signals = {rig: work.signals(rig) for rig in capture.rigs}
    write_refined(before, body, signals, said, out)
    after = with_validation(open_capture(out, template=template))
    figures = {"before": measured(before, work.frames), "after": measured(after, work.frames)}
    print("\n".join(table(figures)))
    write_text(out / FIGURES, json.dumps(figures, indent=2) + "\n")
    for rig in capture.rigs:
        sheet = compared_sheet((before, after), rig, shown_frames(before.rigs[rig], COMPARED))
        write_png(out / SHEET.format(rig), np.dstack([sheet, np.full(sheet.shape[:2], 255, np.uint8)]))
        print(out / SHEET.format(rig))
    remove_unfinished(out)
    work.close()
    print(out)
    return 0


def measured(capture: Capture, frames: dict[str, tuple[int, ...]]) -> dict[str, dict[str, Any]]:
    """By rig and what `LINES` names; None where there is nothing to measure by."""
    skin = replace(capture, person=fit_surface(capture))
    reports = {"iou": check_capture(capture, frames=COMPARED), "iou_skin": check_capture(skin, frames=COMPARED)}
    found: dict[str, dict[str, Any]] = {rig: {} for rig in capture.rigs}
    for what, report in reports.items():
        for one in report.rigs:
            found[one.rig][what] = one.mean("template")
    for name, rig in capture.rigs.items():
        found[name]["keypoints_px"] = keypoint_error(capture.person, rig)
        found[name]["joints_mm"] = _joint_error(capture, rig, frames[name])
    return found


def _joint_error(capture: Capture, rig: Rig, frames: tuple[int, ...]) -> float | None:
    """Mean distance from the exact joints, mm, of those that two of the training's cameras or more have in their pictures."""
    away = joint_distances(capture, rig, frames)
    if away is None:
        return None
    exact, inside = capture.ground_truth[rig.name].joints, np.zeros(away.shape, int)
    assert exact is not None
    for view in Splits.of(rig).train.views:
        camera = rig.views[view].camera
        pixels, depth = camera.pixels(exact[list(frames)])
        inside += ((pixels > 0) & (pixels < (camera.width, camera.height))).all(-1) & (depth > 0)
    return float(1000 * away[inside > 1].mean()) if (inside > 1).any() else None


def table(figures: dict[str, dict[str, dict[str, Any]]]) -> list[str]:
    """Both states beside each other."""
    lines = [f"{'':5} {'':32} {'before':>8} {'after':>8}"]
    for rig, values in figures["before"].items():
        for what, label in LINES.items():
            pair = (values[what], figures["after"][rig][what])
            digits = 3 if what.startswith("iou") else 2
            cells = " ".join(f"{'n/a' if value is None else format(value, f'.{digits}f'):>8}" for value in pair)
            lines.append(f"{rig:5} {label:32} {cells}")
    return lines
