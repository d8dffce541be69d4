"""Case `poison`: NaN or Inf put into what one stage hands to the next. It must be refused there, by one `InputError`.

A picture is wrong even where it is finite: somebody's number was lost on the way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.measure.stress.case import Entry, Inputs, Kind
from avatarrex.measure.stress.findings import Findings
from avatarrex.measure.stress.subject import subject
from avatarrex.pipeline import Frame, RenderSettings, render_frame
from avatarrex.pointmap.raycast import raycast
from avatarrex.shading.shade import shade
from avatarrex.signals.driving import SHAPES, Signals
from avatarrex.templates.parts import PARTS
from avatarrex.volume.build import build_volume

SETTINGS = RenderSettings(voxel=0.04, part_voxel=0.0125, antialias=False)
VALUES = (np.nan, np.inf, -np.inf)
MAPS = ("position", "normal", "depth", "coverage", "part_weight")


@cache
def clean() -> Frame:
    """The frame that is poisoned: a T-pose, 16 × 16 pixels."""
    return render_frame(subject(), Signals.rest(), Camera.orbit(0, 0, 2.8, 45, (0, 0, 0), 16, 16), SETTINGS)


def draw(rng: np.random.Generator, number: int) -> Inputs:
    """The border whose turn it is, the poison, and where it drops."""
    value = VALUES[number // len(BORDERS) % len(VALUES)]
    return {"border": np.array([number % len(BORDERS)]), "value": np.array([value]), "place": rng.random(1)}


def check(inputs: Inputs, found: Findings) -> None:
    """The one check of the case."""
    name = list(BORDERS)[int(inputs["border"][0])]
    value, place = float(inputs["value"][0]), float(np.clip(inputs["place"][0], 0, 1))
    try:
        BORDERS[name](value, place)
    except InputError as error:
        found.flag("refused by one InputError", len(str(error).splitlines()) == 1, name)
    else:
        found.flag("refused by one InputError", False, f"{name}: {value} went through")


def _spoiled(values: Tensor, value: float, place: float) -> Tensor:
    """A copy with one number replaced."""
    copy = values.clone()
    copy.view(-1)[min(int(place * copy.numel()), copy.numel() - 1)] = value
    return copy


def _array(values: np.ndarray, value: float, place: float) -> np.ndarray:
    return np.asarray(_spoiled(torch.as_tensor(np.array(values)), value, place).numpy())


def _signals(name: str) -> Callable[[float, float], object]:
    return lambda value, place: Signals.rest().replace(**{name: _array(np.zeros(SHAPES[name]), value, place)})


def _camera(name: str) -> Callable[[float, float], object]:
    camera = Camera.orbit(0, 0, 2.8, 45, (0, 0, 0), 16, 16)

    def run(value: float, place: float) -> None:
        bad: dict[str, Any] = {name: _array(getattr(camera, name), value, place)}
        replace(camera, **bad)

    return run


def _body_mesh(value: float, place: float) -> None:
    posed = clean().posed
    bad = replace(posed, body=replace(posed.body, vertices=_spoiled(posed.body.vertices, value, place)))
    build_volume(subject(), bad, SETTINGS, Counters(), None)


def _part_mesh(name: str) -> Callable[[float, float], object]:
    def run(value: float, place: float) -> None:
        posed = clean().posed
        bad = replace(posed, parts={**posed.parts, name: _spoiled(posed.parts[name], value, place)})
        build_volume(subject(), bad, SETTINGS, Counters(), None)

    return run


def _body_volume(value: float, place: float) -> None:
    volume = clean().volume.sdf
    bad = replace(volume, body=replace(volume.body, sdf=_spoiled(volume.body.sdf, value, place)))
    raycast(bad, clean().camera, antialias=False)


def _part_volume(name: str) -> Callable[[float, float], object]:
    def run(value: float, place: float) -> None:
        volume = clean().volume.sdf
        parts = (
            replace(part, field=_spoiled(part.field, value, place)) if part.name == name else part
            for part in volume.parts
        )
        raycast(replace(volume, parts=tuple(parts)), clean().camera, antialias=False)

    return run


def _point_map(name: str) -> Callable[[float, float], object]:
    def run(value: float, place: float) -> None:
        frame = clean()
        bad: dict[str, Any] = {name: _spoiled(getattr(frame.pointmap, name), value, place)}
        spoiled = replace(frame.pointmap, **bad)
        shade(subject(), replace(frame.surface, pointmap=spoiled), Counters(), None)

    return run


BORDERS: dict[str, Callable[[float, float], object]] = {
    **{f"signals: {name}": _signals(name) for name in SHAPES},
    **{f"camera: {name}": _camera(name) for name in ("intrinsics", "camera_from_world")},
    "posed mesh: body": _body_mesh,
    **{f"posed mesh: {name}": _part_mesh(name) for name in PARTS},
    "volume: body": _body_volume,
    **{f"volume: {name}": _part_volume(name) for name in PARTS},
    **{f"point map: {name}": _point_map(name) for name in MAPS},
}
"""What is poisoned, and what then runs."""
KIND = Kind(
    "poison",
    {"border": Entry((1,), (0, len(BORDERS) - 1)), "value": Entry((1,)), "place": Entry((1,))},
    draw,
    check,
    repeat=1000,
)
