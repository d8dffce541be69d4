"""The surface of a captured person, from the outlines of the mattes: a smooth field of offsets over the fitted template.

Where the posed template's outline (edges between a triangle that faces the camera and one that does not) meets the
background, the distance s along the outward normal n from the template's edge to the matte's is measured in the picture;
the field d at rest is

    argmin  Σ ρ(nᵀ M d(x) − s)²/σ_s²  +  Σ_neighbours |d_i − d_k|²/σ_d²  +  Σ |d_i|²/σ_0²

with M the skin's blended rotation and ρ a robust weight, so that a pony tail or a loose hem does not pull the skin along.
Joints stay. Letters: v vertices, n nodes of the field, e edges, k constraints. Metres.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse import hstack
from scipy.spatial import cKDTree
from tqdm import tqdm

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import FOREGROUND, compared_frames, posed_in_world, reduced, silhouette
from avatarrex.capture.readers.rigs import Capture
from avatarrex.ops.skinning import blend
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit, SurfaceOffsets

FIELD_NODES = 320
"""Six centimetres apart on an adult; finer than that, 20 outlines of 512 pixels say little."""
EDGE_SEARCH = 0.06
"""Metres to look for the matte's edge."""
OUTLIERS = (0.06, 0.04, 0.03, 0.02)
"""Metres, by round, at which an outline's weight has fallen to ¼ (Geman–McClure)."""
OUTLINE_SIGMA, NEIGHBOUR_SIGMA, OFFSET_SIGMA = 0.005, 0.02, 0.06
"""σ_s of an outline, σ_d between neighbours, σ_0 altogether, metres. Found on person_f001 (`docs/capture.md`): σ_d of 8 mm
leaves 5.6 mm between template and mesh, 15 mm 4.9, 20 mm 4.8."""
EDGE_SHARE = 0.3
"""Neighbouring outline edges repeat each other: this share of them counts."""
OUTLINE_PIXELS = 512
"""Pixels of the longer side of the template's silhouette."""
RIM_PIXELS = 1.6
"""Pixels of that silhouette within which an edge belongs to its rim; others are folds inside."""


Sight = tuple[Camera, Callable[[], np.ndarray]]
"""A camera, and what reads its matte (h, w), bytes."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Somebody in one pose, from some sides."""

    signals: Signals
    pictures: tuple[Sight, ...]


@dataclass(frozen=True)
class Outline:
    """Constraints of one picture."""

    vertices: np.ndarray
    """(k, 2) the edge's ends."""
    direction: np.ndarray
    """(k, 3) Mᵀ n: the direction at rest that moves the outline outwards."""
    distance: np.ndarray
    """(k,) metres from the template's edge to the matte's, outwards positive."""


def fit_surface(
    capture: Capture,
    frames: dict[str, Iterable[int]] | None = None,
    views: dict[str, Iterable[int]] | None = None,
    count: int = 4,
) -> Person:
    """`capture.person` with its skin moved onto the mattes of `count` frames per rig, never a held-out one.

    `frames` and `views` by rig narrow the choice. Raises `InputError` for a picture that cannot be decoded.
    """
    return fit_to_mattes(capture.person, _seen(capture, frames or {}, views or {}, count))


def fit_to_mattes(person: Person, seen: Sequence[Seen]) -> Person:
    """`person` with its skin moved onto the mattes of somebody of its size. What reading a matte raises is raised."""
    base, field = load_person(person.name), _Field(load_person(person.name))
    fit = person.fit or PersonFit(np.zeros(10), np.zeros((55, 3)))
    offsets = np.zeros((len(field.nodes), 3))
    with tqdm(total=len(OUTLIERS) * len(seen), desc="fit surface", unit="frame", leave=False) as bar:
        for outlier in OUTLIERS:
            found: list[Outline] = []
            for one in seen:
                found += _outlines(person, one)
                bar.update()
            offsets = field.solve(found, offsets, outlier)
            surface = SurfaceOffsets(tuple(field.nodes.tolist()), offsets)
            person = resize_person(base, PersonFit(fit.shape, fit.joint_offsets, surface))
    return person


def _seen(
    capture: Capture, frames: dict[str, Iterable[int]], views: dict[str, Iterable[int]], count: int
) -> list[Seen]:
    """What is compared."""
    chosen = []
    for name, rig in capture.rigs.items():
        allowed = sorted(set(frames.get(name, range(rig.frames))) - rig.held_out_frames)
        cameras = sorted(set(views.get(name, range(len(rig.views)))) - rig.held_out_views)
        for frame in (allowed[place] for place in compared_frames(len(allowed), count)):
            there = [view for view in cameras if rig.available(view, frame)]
            pictures = tuple((rig.views[view].camera, partial(rig.matte, view, frame)) for view in there)
            chosen.append(Seen(rig.signals[frame], pictures))
    return chosen


class _Field:
    """Offsets of a few vertices, spread over all of them."""

    def __init__(self, person: Person) -> None:
        rest = person.body.v_template.double().numpy()
        self.nodes = _spread(rest, FIELD_NODES)
        self.weights = SurfaceOffsets(tuple(self.nodes.tolist()), np.zeros((FIELD_NODES, 3))).weights(rest)
        near = cKDTree(rest[self.nodes]).query(rest[self.nodes], 7)[1]
        graph = np.zeros((FIELD_NODES, FIELD_NODES))
        graph[near[:, :1], near[:, 1:]] = 1
        graph = np.maximum(graph, graph.T)
        self.stiffness = (np.diag(graph.sum(1)) - graph) / NEIGHBOUR_SIGMA**2 + np.eye(FIELD_NODES) / OFFSET_SIGMA**2

    def solve(self, outlines: list[Outline], old: np.ndarray, outlier: float) -> np.ndarray:
        """(n, 3) offsets for constraints measured with offsets `old`."""
        if not sum(len(item.distance) for item in outlines):
            return old
        ends = np.concatenate([item.vertices for item in outlines])
        direction = np.concatenate([item.direction for item in outlines])
        distance = np.concatenate([item.distance for item in outlines])
        weights = (self.weights[ends[:, 0]] + self.weights[ends[:, 1]]) * 0.5
        rows = hstack([weights.multiply(direction[:, axis, None]) for axis in range(3)]).tocsr()  # x of all nodes, y, z
        robust = (1 + (distance / outlier) ** 2) ** -2 * EDGE_SHARE / OUTLINE_SIGMA**2
        matrix = (rows.T @ rows.multiply(robust[:, None])).toarray()
        right = rows.T @ (robust * (rows @ old.T.ravel() + distance))
        matrix += np.kron(np.eye(3), self.stiffness)
        return np.linalg.solve(matrix, right).reshape(3, -1).T


def _spread(points: np.ndarray, count: int) -> np.ndarray:
    """Indices of `count` points far from each other, each the farthest from those before; the lowest first."""
    chosen = [int(points[:, 1].argmin())]
    away = np.full(len(points), np.inf)
    for _ in range(count - 1):
        away = np.minimum(away, ((points - points[chosen[-1]]) ** 2).sum(1))
        chosen.append(int(away.argmax()))
    return np.array(chosen)


def _outlines(person: Person, seen: Seen) -> list[Outline]:
    posed, world = posed_in_world(person, seen.signals)
    vertices = posed.vertices.double().numpy() @ world[:3, :3].T + world[:3, 3]
    turn = world[:3, :3] @ blend(posed.skinning, person.body.weights)[:, :3, :3].double().numpy()
    faces = person.body.faces.numpy()
    edges, sides = _edges(faces)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    face_normal = np.cross(b - a, c - a)
    normal = np.zeros_like(vertices)
    np.add.at(normal, faces.T, face_normal)
    found = []
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
        own = _to_edge(mask, pixel * factor, along, scale * factor)
        distance = _to_edge(matte(), pixel, along, scale) - own
        inside = ((pixel > 2) & (pixel < np.array([camera.width, camera.height]) - 2)).all(1)
        keep = inside & np.isfinite(distance) & (np.abs(own) * scale * factor < RIM_PIXELS)
        direction = np.einsum("kcd,kc->kd", turn[ends[keep]].mean(1), outward[keep])
        found.append(Outline(ends[keep], direction, distance[keep]))
    return found


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inner edges (e, 2) and the two faces (e, 2) of each."""
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(faces)), 3)
    order = np.lexsort(ends.T)
    ends, owner = ends[order], owner[order]
    twin = np.flatnonzero((ends[1:] == ends[:-1]).all(1))
    return ends[twin], np.stack([owner[twin], owner[twin + 1]], 1)


def _to_edge(matte: np.ndarray, pixel: np.ndarray, along: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Metres along the outward direction to the nearest place where the matte ends; NaN within `EDGE_SEARCH` of none."""
    steps = np.linspace(-EDGE_SEARCH, EDGE_SEARCH, 121)
    places = pixel[:, None] + along[:, None] * (steps[None, :, None] * scale[:, None, None])
    bilinear = map_coordinates(matte.astype(np.float32), np.moveaxis(places[..., ::-1], -1, 0) - 0.5, order=1)
    value = bilinear - FOREGROUND  # zero beyond the picture's edge
    leaves = (value[:, :-1] > 0) & (value[:, 1:] <= 0)
    nearest = np.where(leaves, np.abs(steps[:-1] + steps[1:]), np.inf)
    best = nearest.argmin(1)
    row = np.arange(len(best))
    high, low = value[row, best], value[row, best + 1]
    exact = steps[best] + (steps[1] - steps[0]) * high / np.maximum(high - low, 1e-6)
    return np.where(leaves.any(1), exact, np.nan)
