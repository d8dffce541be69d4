"""ActorsHQ: `calibration.csv`, `rgbs/CamXXX/…`, `masks/CamXXX/…`; SMPL-X parameters where somebody has added them (`smpl_params.npz`).

name, w, h, rx ry rz (axis-angle, camera→world), tx ty tz (the camera's place, metres), fx fy px py relative to w and h; OpenCV axes.
"""

from __future__ import annotations

import csv
import math
import re

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.capture.importers.source import Reading, Source, SourceView, posed_lens, smplx_parameters
from avatarrex.capture.readers.archive import safe
from avatarrex.capture.readers.calibration import LARGEST_NUMBER, MOST_CAMERAS, Lens
from avatarrex.errors import InputError, check

CALIBRATION = "calibration.csv"
COLUMNS = ("name", "w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py")
DISTORTION = ("k1", "k2", "p1", "p2", "k3")
_PICTURE = re.compile(r"(?:.*\D)?(\d{1,9})\.(?:jpg|jpeg|png)", re.IGNORECASE)


def read_actorshq(reading: Reading) -> Source:
    """The capture at the reading's root. Raises `InputError` for a calibration that cannot be understood."""
    lenses = _lenses(reading)
    views = tuple(
        SourceView(lens, numbered(reading, "rgbs", lens.name), numbered(reading, "masks", lens.name)) for lens in lenses
    )
    parameters = smplx_parameters(reading, reading.name("smpl_params.npz"))
    shown = max((max(view.images, default=-1) for view in views), default=-1) + 1
    count = len(parameters["transl"]) if parameters else shown
    check(shown, reading.place("rgbs"), "", f"pictures of {lenses[0].name}, …", "none")
    return Source("ActorsHQ", "body", views, count, parameters)


def numbered(reading: Reading, *folder: str) -> dict[int, str]:
    """Pictures of a folder by the last number in their names."""
    name = reading.name(*folder)
    matches = (_PICTURE.fullmatch(entry) for entry in sorted(reading.archive.entries(name)))
    return {int(match[1]): "/".join((*folder, match[0])) for match in matches if match}


def _lenses(reading: Reading) -> tuple[Lens, ...]:
    place = reading.place(CALIBRATION)
    try:
        rows = list(csv.DictReader(reading.archive.text(reading.name(CALIBRATION)).splitlines()))
    except csv.Error as error:
        raise InputError(place, "", "a table with commas", error) from None
    check(0 < len(rows) <= MOST_CAMERAS, place, "", f"1 to {MOST_CAMERAS} cameras", len(rows))
    missing = [column for column in COLUMNS if column not in rows[0]]
    check(not missing, place, "", f"columns {', '.join(COLUMNS)}", f"no {', '.join(missing)}")
    lenses = tuple(_lens(row, place, line) for line, row in enumerate(rows, 2))
    names = [lens.name for lens in lenses]
    twice = next((name for name in names if names.count(name) > 1), None)
    check(twice is None, place, "name", "each camera once", f"{twice} twice")
    return lenses


def _lens(row: dict[str, str], place: str, line: int) -> Lens:
    name = (row["name"] or "").strip()
    check(safe(name) and "/" not in name and name.isprintable(), place, f"line {line}", "a camera's name", repr(name))
    value = {column: _number(row.get(column) or "", place, f"line {line}, {column}") for column in COLUMNS[1:]}
    lens = [_number(row.get(column) or "0", place, f"line {line}, {column}") for column in DISTORTION]
    width, height = value["w"], value["h"]
    check(
        all(1 <= side <= 16384 and side == int(side) for side in (width, height)),
        place,
        f"line {line}",
        "w and h from 1 to 16384",
        (width, height),
    )
    check(
        value["fx"] > 0 and value["fy"] > 0, place, f"line {line}", "focal lengths above 0", (value["fx"], value["fy"])
    )
    intrinsics = np.array(
        [[value["fx"] * width, 0, value["px"] * width], [0, value["fy"] * height, value["py"] * height], [0, 0, 1]]
    )
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = Rotation.from_rotvec([value[axis] for axis in ("rx", "ry", "rz")]).as_matrix()
    world_from_camera[:3, 3] = [value[axis] for axis in ("tx", "ty", "tz")]
    return posed_lens(name, intrinsics, np.linalg.inv(world_from_camera), (int(width), int(height)), np.array(lens))


def _number(text: str, place: str, field: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(place, field, "a number", repr(text)[:40]) from None
    check(
        math.isfinite(value) and abs(value) <= LARGEST_NUMBER,
        place,
        field,
        f"a finite number up to {LARGEST_NUMBER:g}",
        text,
    )
    return value
