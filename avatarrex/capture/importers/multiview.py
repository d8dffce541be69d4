"""AvatarReX and THuman4.0 folders, which `open_capture` also reads as they are, as sources of an import."""

from __future__ import annotations

from avatarrex.capture.importers.source import Reading, Source, SourceView, smplx_parameters
from avatarrex.capture.readers.calibration import read_calibration
from avatarrex.capture.readers.framing import shows_a_face
from avatarrex.capture.readers.layout import CALIBRATIONS, RigFiles
from avatarrex.capture.readers.rigs import SMPLX_PELVIS


def read_multiview(reading: Reading) -> Source:
    """The capture at the reading's root. Raises `InputError`."""
    entries = reading.archive.entries(reading.root)
    kind = next(kind for name, kind in CALIBRATIONS.items() if name in entries)
    files = RigFiles(reading.archive, reading.root, kind)
    place = reading.archive.place(files.calibration)
    lenses = read_calibration(reading.archive.text(files.calibration), place)
    listed = files.listed_missing(tuple(lens.name for lens in lenses))
    if listed:
        reading.notes.append(f"{len(listed)} pictures listed as missing")
    parameters = smplx_parameters(reading, files.parameters)
    views, rig = [], "body"
    for view, lens in enumerate(lenses):
        lacking = {frame for number, frame in listed if number == view}
        pictures = (
            {t: name for t, name in one.items() if t not in lacking}
            for one in (files.pictures(lens.name), files.mattes(lens.name))
        )
        views.append(SourceView(lens, *(_below(reading.root, one) for one in pictures)))
    count = max((max(view.images, default=-1) for view in views), default=-1) + 1
    if parameters:
        count = len(parameters["transl"])
        rig = "face" if shows_a_face(files, parameters["transl"] + SMPLX_PELVIS, reading.unit) else "body"
    return Source(kind, rig, tuple(views), count, parameters)


def _below(root: str, names: dict[int, str]) -> dict[int, str]:
    """Names from the capture's root on."""
    return {frame: name.removeprefix(f"{root}/" if root else "") for frame, name in names.items()}
