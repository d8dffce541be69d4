"""Case `poison`: NaN or Inf put into what one stage hands to the next. It must be refused there, by one `InputError`.

A picture is wrong even where it is finite: a number was lost on the way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import torch

from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.frame import DeferredFrame
from avatarrex.measure.stress.case import Entry, Inputs, Kind
from avatarrex.measure.stress.driving import subject
from avatarrex.measure.stress.findings import Findings
from avatarrex.pipeline import render_deferred
from avatarrex.pointmap.raycast import raycast
from avatarrex.settings import RenderSettings
from avatarrex.shading.shade import shade
from avatarrex.signals.driving import SHAPES, Signals
from avatarrex.templates.parts import PARTS
from avatarrex.volume.build import build_volume

SETTINGS = RenderSettings(voxel=0.04, part_voxel=0.0125, antialias=False)
CAMERA = Camera.orbit(0, 0, 2.8, 45, (0, 0, 0), 16, 16)
VALUES = (np.nan, np.inf, -np.inf)
MAPS = ("position", "normal", "depth", "coverage", "part_weight")


@cache
def clean() -> DeferredFrame:
    """The frame that is poisoned: a T-pose, 16 × 16 pixels."""
    return render_deferred(subject(), Signals.rest(), CAMERA, SETTINGS)


def draw(rng: np.random.Generator, number: int) -> Inputs:
    """The border of that number, the poison, and where it drops."""
    value = VALUES[number // len(BORDERS) % len(VALUES)]
    return {"border": np.array([number % len(BORDERS)]), "value": np.array([value]), "place": rng.random(1)}


def check(inputs: Inputs, found: Findings) -> None:
    """The one check of the case."""
    name = list(BORDERS)[int(inputs["border"][0])]
    value, place = float(inputs["value"][0]), float(np.clip(inputs["place"][0], 0, 1))
    try:
        BORDERS[name](partial(_spoiled, value, place))
    except InputError as error:
        found.flag("refused by one InputError", len(str(error).splitlines()) == 1, name)
    else:
        found.flag("refused by one InputError", False, f"{name}: {value} went through")


Spoil = Callable[[Any], Any]
"""An array or a tensor, but for one number the same."""


def _spoiled(value: float, place: float, values: Any) -> Any:
    copy = torch.tensor(values) if isinstance(values, np.ndarray) else values.clone()
    copy.view(-1)[min(int(place * copy.numel()), copy.numel() - 1)] = value
    return copy.numpy() if isinstance(values, np.ndarray) else copy


def _signals(name: str, spoil: Spoil) -> None:
    Signals.rest().replace(**{name: spoil(np.zeros(SHAPES[name]))})


def _camera(name: str, spoil: Spoil) -> None:
    replace(CAMERA, **{name: spoil(getattr(CAMERA, name))})


def _posed_mesh(name: str, spoil: Spoil) -> None:
    posed = clean().posed
    if name == "body":
        bad = replace(posed, body=replace(posed.body, vertices=spoil(posed.body.vertices)))
    else:
        bad = replace(posed, parts={**posed.parts, name: spoil(posed.parts[name])})
    build_volume(subject(), bad, SETTINGS, Counters(), None)


def _volume(name: str, spoil: Spoil) -> None:
    volume = clean().volume.sdf
    body = replace(volume.body, sdf=spoil(volume.body.sdf)) if name == "body" else volume.body
    parts = (replace(part, field=spoil(part.field)) if part.name == name else part for part in volume.parts)
    raycast(replace(volume, body=body, parts=tuple(parts)), clean().camera, antialias=False)


def _point_map(name: str, spoil: Spoil) -> None:
    frame = clean()
    bad = replace(frame.pointmap, **{name: spoil(getattr(frame.pointmap, name))})
    shade(subject(), replace(frame.surface, pointmap=bad), frame.shading.light, Counters(), None, RenderSettings())


BORDERS: dict[str, Callable[[Spoil], None]] = {
    f"{stage}: {name}": partial(run, name)
    for stage, run, names in (
        ("signals", _signals, SHAPES),
        ("camera", _camera, ("intrinsics", "camera_from_world")),
        ("posed mesh", _posed_mesh, ("body", *PARTS)),
        ("volume", _volume, ("body", *PARTS)),
        ("point map", _point_map, MAPS),
    )
    for name in names
}
"""What is poisoned, and what then runs."""
ENTRIES = {"border": Entry((1,), (0, len(BORDERS) - 1)), "value": Entry((1,)), "place": Entry((1,))}
KIND = Kind("poison", ENTRIES, draw, check, repeat=1000)
