"""A capture whose cameras have one exposure: the same files, linked where that is possible, and a `gain` for each camera in its calibration.

Gains of the training's cameras are found among themselves. That of a held-out camera is found beside them by its pictures of the training's
frames, and changes none of theirs: it is a part of its calibration, as where it stands.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatarrex.capture.fit.camera_gains import gains_of, seen_colours
from avatarrex.capture.fit.refined_capture import rewrite_json, write_anew
from avatarrex.capture.readers.calibration import checked_gain, read_calibration
from avatarrex.capture.readers.layout import RigFiles
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Split, Splits, sealed_rig
from avatarrex.errors import InputError
from avatarrex.files.json_text import parse_json
from avatarrex.templates.person import Person

DECIMALS = 4
"""Of a gain in the file."""


def gains_of_all(rig: Rig, person: Person) -> Float[np.ndarray, "k 3"]:
    """What the pictures of each camera have to be multiplied by, held-out ones, too; NaN of those that cannot be compared."""
    learnt, every = list(Splits.of(rig).train.views), tuple(range(len(rig.views)))
    colours = seen_colours(sealed_rig(rig, Split(Splits.of(rig).train.frames, every)), person)
    before, gains = np.array([view.gain for view in rig.views]), np.full((len(every), 3), np.nan)
    gains[learnt] = gains_of(colours[learnt], before[learnt])
    for view in sorted(set(every) - set(learnt)):
        chosen = [*learnt, view]
        beside = gains_of(colours[chosen], before[chosen])
        known = np.isfinite(beside[:-1] * gains[learnt]).all(-1)
        if known.any() and np.isfinite(beside[-1]).all():
            same = np.log(gains[learnt][known] / beside[:-1][known]).mean(0)
            gains[view] = beside[-1] * np.exp(same)
    return gains


def write_matched(capture: Capture, out: Path) -> dict[str, Float[np.ndarray, "k 3"]]:
    """Into the folder `out`; the gains that were found, by rig.

    Raises `InputError` where no cameras can be compared, where gains are beyond what a calibration may have, and for a damaged file.
    """
    gains = {name: gains_of_all(rig, capture.person) for name, rig in capture.rigs.items()}
    if not any(np.isfinite(found).any() for found in gains.values()):
        raise InputError(capture.path, "pictures", "two cameras or more whose colours can be compared", "none")

    def write(rig: str, files: RigFiles, target: Path) -> None:
        place = files.archive.place(files.calibration)
        rewrite_json(target, _calibration(files, place, capture.rigs[rig], gains[rig]), place)

    write_anew(capture, out, lambda files: files.calibration, write, {"matched": capture.key})
    return gains


def _calibration(
    files: RigFiles, place: str, rig: Rig, gains: Float[np.ndarray, "k 3"]
) -> dict[str, dict[str, object]]:
    """That of the file, with what is found multiplied onto its gains; cameras that could not be compared stay as they are."""
    text = files.archive.text(files.calibration)
    before = {lens.name: lens.gain for lens in read_calibration(text, place)}
    entries: dict[str, dict[str, object]] = dict(parse_json(text, place))
    for view, gain in zip(rig.views, gains):
        if np.isfinite(gain).all():
            both = np.round(np.multiply(before[view.name], gain), DECIMALS)
            entries[view.name] |= {"gain": list(checked_gain(both, place, f"{view.name}.gain"))}
    return entries
