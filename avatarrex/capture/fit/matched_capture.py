"""A capture whose cameras have one exposure: the same files, linked where that is possible, and a `gain` for each camera in its calibration.

The gain of a held-out camera is found by its pictures of the training's frames: it is a part of the calibration, as where the camera stands.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatarrex.capture.fit.camera_gains import camera_gains
from avatarrex.capture.fit.refined_capture import all_files
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.calibration import read_calibration
from avatarrex.capture.readers.layout import find_rigs
from avatarrex.capture.readers.linked import link
from avatarrex.capture.readers.manifest import FORMAT
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Split, Splits, sealed_rig
from avatarrex.files.json_text import parse_json, write_json

DECIMALS = 4
"""Of a gain in the file."""


def every_camera(rig: Rig) -> Rig:
    """The training's frames alone, as all cameras see them."""
    return sealed_rig(rig, Split(Splits.of(rig).train.frames, tuple(range(len(rig.views)))))


def write_matched(capture: Capture, out: Path) -> dict[str, Float[np.ndarray, "k 3"]]:
    """Into the folder `out`; the gains that were found, by rig. Raises `InputError` for a file that is damaged."""
    archive = Archive(capture.path)
    root, found = find_rigs(archive)
    files = {name: found.get(name) or next(iter(found.values())) for name in capture.rigs}
    calibrations = {files[name].calibration: name for name in capture.rigs}
    gains = {name: camera_gains(every_camera(rig), capture.person) for name, rig in capture.rigs.items()}
    for name in all_files(archive, root):
        target = out / name.removeprefix(f"{root}/" if root else "")
        if name in calibrations:
            rig = calibrations[name]
            write_json(target, _calibration(archive, name, capture.rigs[rig], gains[rig]))
        elif target != out / "capture.json":
            link(archive, name, target)
    write_json(out / "capture.json", {"format": FORMAT, **capture.manifest, "matched": capture.key})
    return gains


def _calibration(archive: Archive, name: str, rig: Rig, gains: Float[np.ndarray, "k 3"]) -> dict[str, object]:
    """That of the file, with what is found multiplied onto its gains; cameras without pictures stay as they are."""
    text, place = archive.text(name), archive.place(name)
    before = {lens.name: lens.gain for lens in read_calibration(text, place)}
    entries: dict[str, dict[str, object]] = dict(parse_json(text, place))
    for view, gain in zip(rig.views, gains):
        entries[view.name] |= {"gain": np.round(np.multiply(before[view.name], gain), DECIMALS).tolist()}
    return entries
