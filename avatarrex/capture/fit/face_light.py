"""The light on a face, by points of its skin that pictures show as it turns. Ours.

A cheek that turns away from a lamp darkens. A fit by colours would take that for a move. Letters: p points.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
import torch

from avatarrex.capture.fit.check import posed_in_world
from avatarrex.capture.fit.paint import Points, Seen
from avatarrex.fields.light import Irradiance
from avatarrex.fields.light_fit import LitPixels, fit_light
from avatarrex.signals.driving import Signals
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.model import EYES
from avatarrex.templates.person import Person


def without_light(
    person: Person, points: Points, signals: Sequence[Signals], seen: Sequence[list[Seen]], frame: str
) -> list[list[Seen]]:
    """`seen`, by frame and picture, with colours and slopes divided by the light E(n) that explains them best (fields/light_fit.py) and is
    fixed in `frame` (fields/light.py: `LIGHT_FRAMES`). Eyeballs, which shine, neither tell the light nor lose it.
    """
    skin = ~person.body.of_groups(EYES).numpy()[person.body.faces.numpy()[points.face]].all(1)
    lit = [
        [_lit(one, skin, normal) for one in pictures]
        for pictures, normal in zip(seen, _normals(person, points, signals, frame))
    ]
    light = Irradiance(fit_light(torch.zeros(8, 3), [*chain(*lit)], len(points.face)))
    return [
        [_unlit(one, skin, light(own.normal).double().numpy()) for one, own in zip(pictures, pixels)]
        for pictures, pixels in zip(seen, lit)
    ]


def _lit(one: Seen, skin: np.ndarray, normal: np.ndarray) -> LitPixels:
    """A picture's points, each a texel of its own; `skin` (p,) and `normal` (p, 3) of all points."""
    row, cosine, colour, _ = one
    weight = torch.from_numpy(skin[row] * cosine**2).float()
    shown, turned = (torch.from_numpy(values).float() for values in (colour, normal[row]))
    return LitPixels(torch.from_numpy(row)[:, None], weight[:, None], shown, turned)


def _unlit(one: Seen, skin: np.ndarray, light: np.ndarray) -> Seen:
    """A picture's points without the `light` (p, 3) on each."""
    row, cosine, colour, slope = one
    gain = np.where(skin[row, None], light, 1.0)
    return row, cosine, colour / gain, slope / gain[..., None]


def _normals(person: Person, points: Points, signals: Sequence[Signals], frame: str) -> Iterator[np.ndarray]:
    """(p, 3) of each pose, unit, in `frame`."""
    faces = person.body.faces
    for one in signals:
        posed, world = posed_in_world(person, one)
        normal = vertex_normals(posed.vertices.double(), faces).numpy()
        between = points.between(normal, faces.numpy())
        if frame == "world":
            between = between @ world[:3, :3].T
        yield between / np.linalg.norm(between, axis=1, keepdims=True).clip(1e-9)
