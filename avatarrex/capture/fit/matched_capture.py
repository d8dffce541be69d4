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
from avatarrex.capture.readers.calibration import LARGEST_GAIN, read_calibration
from avatarrex.capture.readers.layout import find_rigs
from avatarrex.capture.readers.linked import link
from avatarrex.capture.readers.manifest import FORMAT
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Split, Splits, sealed_rig
from avatarrex.errors import InputError, check
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
    if not any(np.isfinite(found).any() for found in gains.values()):
        raise InputError(capture.path, "pictures", "two cameras or more whose colours can be compared", "none")
    for name in all_files(archive, root):
        target = out / name.removeprefix(f"{root}/" if root else "")
        if name in calibrations:
            rig = calibrations[name]
            _write(target, _calibration(archive, name, capture.rigs[rig], gains[rig]), archive.place(name))
        elif target != out / "capture.json":
            link(archive, name, target)
    said = {"format": FORMAT, **capture.manifest, "matched": capture.key}
    _write(out / "capture.json", said, archive.place(f"{root}/capture.json".lstrip("/")))
    return gains


def _write(path: Path, data: object, source: str) -> None:
    """JSON of what was read from `source`."""
    try:
        write_json(path, data)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(source, "", "finite numbers, and texts that are UTF-8", error) from None


def _calibration(archive: Archive, name: str, rig: Rig, gains: Float[np.ndarray, "k 3"]) -> dict[str, object]:
    """That of the file, with what is found multiplied onto its gains; cameras that could not be compared stay as they are."""
    text, place = archive.text(name), archive.place(name)
    before = {lens.name: lens.gain for lens in read_calibration(text, place)}
    entries: dict[str, dict[str, object]] = dict(parse_json(text, place))
    for view, gain in zip(rig.views, gains):
        if np.isfinite(gain).all():
            both = np.round(np.multiply(before[view.name], gain), DECIMALS)
            within = ((both >= 1 / LARGEST_GAIN) & (both <= LARGEST_GAIN)).all()
            check(
                within,
                place,
                f"{view.name}.gain",
                f"factors from {1 / LARGEST_GAIN:g} to {LARGEST_GAIN:g}",
                both.tolist(),
            )
            entries[view.name] |= {"gain": both.tolist()}
    return entries
