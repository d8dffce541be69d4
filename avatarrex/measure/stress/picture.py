"""Case `picture`: a driving signal and a camera through `render_frame`, 64 × 64 pixels.

One in ten at the level that is used every day, the others with coarser voxels: what breaks is seldom a matter of their size.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from avatarrex.counters import Counters
from avatarrex.fields.body import MAX_CLOTHING_OFFSET
from avatarrex.fields.template_distance import MAX_DEVIATION
from avatarrex.frame import DeferredFrame
from avatarrex.levels import LEVELS
from avatarrex.measure.stress import driving, views
from avatarrex.measure.stress.case import Entry, Inputs, Kind
from avatarrex.measure.stress.findings import Findings
from avatarrex.measure.stress.subject import subject
from avatarrex.pipeline import render_deferred
from avatarrex.settings import RenderSettings
from avatarrex.templates.posed import pose_person
from avatarrex.volume.sdf_volume import sample

SIDE = 64
COARSE = RenderSettings(voxel=0.03, part_voxel=0.01)
FINE_EVERY = 10
ASIDE, CROSSING = 1e-4, 3e-4
"""Metres before and beyond a hit at which the field is evaluated, and what it may be there on the wrong side: a steep field."""
FAR_VOXELS = 3.0
"""Beyond, nearly all is a fill, guessed from the nearest template vertex; nearer, the field's own value."""
MOST_FAR = 40_000
"""Of the voxels farther than that, evenly taken: a search among the template's vertices takes long far from them."""


def draw(rng: np.random.Generator, number: int) -> Inputs:
    """Signals and a camera on the person that they pose."""
    signals = driving.draw_signals(rng, number)
    posed = pose_person(subject().person, signals, Counters(), None)
    place = posed.world_from_root(signals)
    surface = posed.body.vertices.double().numpy() @ place[:3, :3].T + place[:3, 3]
    camera = views.draw_view(rng, number, surface, SIDE)
    fine = np.array([int(number % FINE_EVERY == 0)])
    return {**driving.inputs_of(signals), **views.inputs_of(camera), "fine": fine}


def check(inputs: Inputs, found: Findings) -> None:
    """All checks of the case."""
    settings = LEVELS["balanced"] if inputs["fine"][0] else COARSE
    frame = render_deferred(subject(), driving.signals_of(inputs), views.camera_of(inputs, SIDE), settings)
    volume, points = frame.volume.sdf, frame.pointmap
    contacts = [part.contact.field for part in volume.parts if part.contact is not None]
    found.finite("frame's templates finite", frame.posed.body.vertices, *frame.posed.parts.values())
    found.finite("volume finite", volume.body.sdf, *(part.field for part in volume.parts), *contacts)
    found.finite("point map finite", points.position, points.normal, points.depth, points.coverage, points.part_weight)
    found.finite("image finite", frame.image)
    covered = points.coverage > 0
    found.within("coverage in 0 to 1", points.coverage, 0, 1)
    straight = frame.image[..., :3] / points.coverage[..., None].clamp_min(1e-9)
    found.within("colour in 0 to coverage", straight, 0, 1, 1e-6)
    found.unit("normal of unit length", points.normal[covered], 1e-5)
    found.within("part weights in 0 to 1", points.part_weight.sum(-1), 0, 1, 1e-5)
    behind = torch.where(points.hit, -points.depth, -torch.inf)
    found.at_most("hit behind the camera (m)", behind.amax().clamp_min(0), 1e-6)
    _check_surface(frame, found)


def _check_surface(frame: DeferredFrame, found: Findings) -> None:
    """Hits are crossings of the stored field, from outside to inside; its fill keeps to the template's distance."""
    volume, points = frame.volume.sdf, frame.pointmap
    hit = points.position[points.hit].double()
    view = frame.camera.seen_from(frame.world_from_root)
    gaze = torch.nn.functional.normalize(hit - torch.as_tensor(view.centre), dim=-1)
    outside, inside = (sample(volume, hit + side * ASIDE * gaze).composed.sdf for side in (-1, 1))
    found.at_most("hit no crossing, p99 (m)", _p99(torch.maximum(-outside, inside)), CROSSING)
    grid = volume.body
    far = np.argwhere((grid.sdf.abs() > FAR_VOXELS * grid.voxel).numpy())
    far = far[:: len(far) // MOST_FAR + 1]
    value, point = grid.sdf.numpy()[tuple(far.T)], grid.origin + grid.voxel * far[:, ::-1]
    body, vertices = frame.volume.body, frame.volume.body.skin.vertices
    away, here = cKDTree(vertices).query(point)[0], body.skin.query(point)
    # Flat fingers of the template that are sunk into a belly: its depth is counted from its own skin (fields/body_without_hands.py).
    for own, _ in body.touched:
        sunk = (value < 0) & (here.weight > 0) & own[here.nearest]
        away[sunk] = cKDTree(vertices[~own]).query(point[sunk])[0]
    # A guess differs from the distance to the nearest vertex by the clothing offset, an evaluated voxel by MAX_DEVIATION more.
    beyond = np.abs(value) - away
    found.at_most("far voxels beyond the template (m)", beyond, MAX_CLOTHING_OFFSET + MAX_DEVIATION)


def _p99(values: torch.Tensor) -> float:
    return float(values.quantile(0.99)) if len(values) else 0.0


ENTRIES = {**driving.ENTRIES, **views.ENTRIES, "fine": Entry((1,), (0, 1))}
KIND = Kind("picture", ENTRIES, draw, check, repeat=20, simpler=tuple(driving.ENTRIES))
