"""Where the outline of a posed template differs from the edge of a matte: what the fits of size and skin are driven by.

Outline edges lie between a triangle that faces the camera and one that does not, on the rim of the silhouette (others are
folds inside). Along the outward normal n of such an edge, seen in the picture, s is the way from the template's own edge
to the matte's. Letters: e edges, k constraints, h w pixels. World metres.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Shaped

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import FOREGROUND, compared_frames, posed_in_world, reduced, silhouette
from avatarrex.capture.readers.rigs import Capture
from avatarrex.capture.readers.splits import Splits
from avatarrex.ops.native import borrowing, native
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person

OUTLINE_PIXELS = 512
"""Pixels of the longer side of the template's silhouette."""
RIM_PIXELS = 1.6
"""Pixels of that silhouette within which an edge belongs to its rim; others are folds inside."""
EDGE_SHARE = 0.3
"""Neighbouring outline edges repeat each other: this share of them counts."""
RIM_SEARCH = 0.06
"""Metres within which the silhouette's own rim is looked for: 1.6 pixels are less on every picture that shows a person."""
SEARCH_STEP = 0.001
"""Metres between the places that are looked at along a normal; the edge between two of them is interpolated."""

Array = Shaped[np.ndarray, "..."]
Sight = tuple[Camera, Callable[[], np.ndarray]]
"""A camera, and what reads its matte (h, w), bytes."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Somebody in one pose, from some sides."""

    signals: Signals
    pictures: tuple[Sight, ...]


@dataclass(frozen=True)
class Outline:
    """Constraints of a pose from all its pictures."""

    vertices: np.ndarray
    """(k, 2) the edge's ends."""
    outward: np.ndarray
    """(k, 3) n, unit, world."""
    distance: np.ndarray
    """(k,) s, metres from the template's edge to the matte's, outwards positive."""


def seen_frames(
    capture: Capture,
    count: int,
    frames: dict[str, Iterable[int]] | None = None,
    views: dict[str, Iterable[int]] | None = None,
) -> list[Seen]:
    """`count` frames of each rig from all cameras, of the training's split alone; `frames` and `views` by rig narrow the choice."""
    chosen = []
    for name, rig in capture.rigs.items():
        train = Splits.of(rig).train
        allowed = sorted(set((frames or {}).get(name, train.frames)) & set(train.frames))
        cameras = sorted(set((views or {}).get(name, train.views)) & set(train.views))
        for frame in (allowed[place] for place in compared_frames(len(allowed), count)):
            there = [view for view in cameras if rig.available(view, frame)]
            pictures = tuple((rig.views[view].camera, partial(rig.matte, view, frame)) for view in there)
            chosen.append(Seen(rig.signals[frame], pictures))
    return chosen


def measured(person: Person, seen: Seen, search: float) -> Outline:
    """The constraints of every picture, of edges within `search` metres. What reading a matte raises is raised."""
    posed, world = posed_in_world(person, seen.signals)
    vertices = posed.vertices.double().numpy() @ world[:3, :3].T + world[:3, 3]
    faces = person.body.faces.numpy()
    edges, sides = _edges(faces)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    face_normal = np.cross(b - a, c - a)
    normal = np.zeros_like(vertices)
    np.add.at(normal, faces.T, face_normal)
    found = [(np.zeros((0, 2), int), np.zeros((0, 3)), np.zeros(0))]
    for camera, matte in seen.pictures:
        towards = np.einsum("fc,fc->f", face_normal, a - camera.centre)
        rim = np.flatnonzero((towards[sides[:, 0]] < 0) != (towards[sides[:, 1]] < 0))
        ends = edges[rim]
        point = vertices[ends].mean(1)
        ray = point - camera.centre
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        outward = normal[ends].sum(1)
        outward -= (outward * ray).sum(1, keepdims=True) * ray
        outward /= np.linalg.norm(outward, axis=1, keepdims=True) + 1e-12
        pixel, tip = camera.pixels(point)[0], camera.pixels(point + 1e-3 * outward)[0]
        scale = np.linalg.norm(tip - pixel, axis=1) / 1e-3
        along = (tip - pixel) / (1e-3 * scale[:, None] + 1e-12)
        small = reduced(camera, OUTLINE_PIXELS)
        factor = small.width / camera.width
        mask = 255 * silhouette(vertices, faces, small).astype(np.float32)
        inside = ((pixel > 2) & (pixel < np.array([camera.width, camera.height]) - 2)).all(1)
        own = to_edge(mask, pixel * factor, along, scale * factor, RIM_SEARCH)
        keep = np.flatnonzero(inside & (np.abs(own) * scale * factor < RIM_PIXELS))
        distance = to_edge(matte(), pixel[keep], along[keep], scale[keep], search) - own[keep]
        keep, distance = keep[np.isfinite(distance)], distance[np.isfinite(distance)]
        found.append((ends[keep], outward[keep], distance))
    return Outline(*map(np.concatenate, zip(*found)))


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inner edges (e, 2) and the two faces (e, 2) of each."""
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(faces)), 3)
    order = np.lexsort(ends.T)
    ends, owner = ends[order], owner[order]
    twin = np.flatnonzero((ends[1:] == ends[:-1]).all(1))
    return ends[twin], np.stack([owner[twin], owner[twin + 1]], 1)


def to_edge(matte: np.ndarray, pixel: np.ndarray, along: np.ndarray, scale: np.ndarray, search: float) -> np.ndarray:
    """Metres along the outward direction to the nearest place where the matte ends; NaN where none is within `search`."""
    found = np.full(len(pixel), np.nan)
    step = along * scale[:, None] * SEARCH_STEP
    _find_edges(matte.astype(np.float32), FOREGROUND, pixel - 0.5, step, round(search / SEARCH_STEP), found)
    return found * SEARCH_STEP


@native
def _find_edges(matte: Array, least: int, pixel: Array, step: Array, count: int, found: Array) -> Any:
    """Into `found` (e,) how many steps (e, 2) it is from `pixel` (e, 2), within `count` to either side, nearest first, inside before."""
    for e in range(len(pixel)):
        for k in range(count):
            for near in (-k - 1, k):
                high = _level(matte, least, pixel[e, 0] + near * step[e, 0], pixel[e, 1] + near * step[e, 1])
                if high <= 0:
                    continue
                low = _level(matte, least, pixel[e, 0] + (near + 1) * step[e, 0], pixel[e, 1] + (near + 1) * step[e, 1])
                if low <= 0:
                    found[e] = near + high / max(high - low, 1e-6)
                    break
            if found[e] == found[e]:
                break


@borrowing
def _level(matte: Array, least: int, column: float, row: float) -> Any:
    """The matte between its pixels' centres, less `least`; it is zero beyond them."""
    height, width = matte.shape
    if not (0 <= column <= width - 1 and 0 <= row <= height - 1):
        return -1.0 * least
    x, y = min(int(column), width - 2), min(int(row), height - 2)
    right, down = column - x, row - y
    above = (1 - right) * matte[y, x] + right * matte[y, x + 1]
    below = (1 - right) * matte[y + 1, x] + right * matte[y + 1, x + 1]
    return (1 - down) * above + down * below - least
