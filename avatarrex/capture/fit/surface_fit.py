"""The surface of a captured person, from the outlines of the mattes: a smooth field of offsets over the fitted template.

With the distances s along the outward normals n from the template's outline to the matte's (`outlines.py`) the field d at
rest is

    argmin  Σ ρ(nᵀ M d(x) − s)²/σ_s²  +  Σ_neighbours |d_i − d_k|²/σ_d²  +  Σ |d_i|²/σ_0²

with M the skin's blended rotation and ρ a robust weight, so that a pony tail or a loose hem does not pull the skin along.
Joints stay, and eyes with them. Letters: v vertices, n nodes of the field, k constraints. Metres.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import hstack
from scipy.spatial import cKDTree
from tqdm import tqdm

from avatarrex.capture.fit.check import posed_in_world
from avatarrex.capture.fit.outlines import EDGE_SHARE, Seen, measured, seen_frames
from avatarrex.capture.readers.rigs import Capture
from avatarrex.ops.skinning import blend
from avatarrex.templates.model import EYES, MOUTH, TemplateModel
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit, SurfaceOffsets, places

NODE_SPACING, HAND_NODE_SPACING = 0.04, 0.012
"""Metres between the field's nodes, in `places`: on hands fine enough for the thickness of a finger. `docs/capture.md` has errors."""
FRAMES = 12
"""Of each rig: with four, few outlines pass a place."""
EDGE_SEARCH = 0.06
"""Metres to look for the matte's edge."""
OUTLIERS = (0.06, 0.04, 0.03, 0.02)
"""Metres, by round, at which an outline's weight has fallen to ¼ (Geman–McClure)."""
OUTLINE_SIGMA, OFFSET_SIGMA = 0.005, 0.06
"""σ_s of an outline, σ_0 altogether, metres."""
NEIGHBOUR_SIGMA = (0.012, 0.008, 0.005, 0.003)
"""σ_d between neighbours, metres: the first with which no triangle of the skin turns over (`docs/capture.md`)."""
AtRest = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Of an outline: the edges' ends (k, 2), Mᵀ n (k, 3), the direction at rest that moves it outwards, and s (k,)."""


def fit_surface(
    capture: Capture,
    frames: dict[str, Iterable[int]] | None = None,
    views: dict[str, Iterable[int]] | None = None,
    count: int = FRAMES,
) -> Person:
    """`capture.person` with its skin moved onto the mattes of `count` frames per rig, of the training's split alone.

    `frames` and `views` by rig narrow the choice. Raises `InputError` for a picture that cannot be decoded.
    """
    return fit_to_mattes(capture.person, seen_frames(capture, count, frames, views))


def fit_to_mattes(person: Person, seen: Sequence[Seen]) -> Person:
    """`person` with its skin moved onto the mattes of somebody of its size. What reading a matte raises is raised."""
    fit = person.fit or PersonFit(np.zeros(10), np.zeros((55, 3)))
    sized = resize_person(load_person(person.name), PersonFit(fit.shape, fit.joint_offsets))
    for sigma in NEIGHBOUR_SIGMA:
        fitted = _fitted(person, fit, seen, sigma)
        if not turned_over(fitted.body, sized.body).any():
            break
    return fitted


def _fitted(person: Person, fit: PersonFit, seen: Sequence[Seen], sigma: float) -> Person:
    """`fit_to_mattes` with σ_d = `sigma`."""
    base, field = load_person(person.name), _Field(load_person(person.name), sigma)
    offsets = np.zeros((len(field.nodes), 3))
    with tqdm(total=len(OUTLIERS) * len(seen), desc="fit surface", unit="frame", leave=False) as bar:
        for outlier in OUTLIERS:
            found = []
            for one in seen:
                found.append(_at_rest(person, one))
                bar.update()
            offsets = field.solve(found, offsets, outlier)
            surface = replace(field.still, offsets=offsets)
            person = resize_person(base, PersonFit(fit.shape, fit.joint_offsets, surface))
    return person


class _Field:
    """Offsets of a few vertices, spread over all of them."""

    def __init__(self, person: Person, sigma: float = NEIGHBOUR_SIGMA[0]) -> None:
        place = places(person.body)
        self.nodes = _spread(place, np.where(person.hand_weight > 0, HAND_NODE_SPACING, NODE_SPACING))
        count = len(self.nodes)
        self.still = SurfaceOffsets(tuple(self.nodes.tolist()), np.zeros((count, 3)), eyes_stay=True, limbs_apart=True)
        self.weights = self.still.weights(person.body)
        near = cKDTree(place[self.nodes]).query(place[self.nodes], 7)[1]
        graph = np.zeros((count, count))
        graph[near[:, :1], near[:, 1:]] = 1
        graph = np.maximum(graph, graph.T)
        self.stiffness = (np.diag(graph.sum(1)) - graph) / sigma**2 + np.eye(count) / OFFSET_SIGMA**2

    def solve(self, found: list[AtRest], old: np.ndarray, outlier: float) -> np.ndarray:
        """(n, 3) offsets for constraints measured with offsets `old`."""
        if not sum(len(distance) for _, _, distance in found):
            return old
        ends, direction, distance = (np.concatenate(part) for part in zip(*found))
        weights = (self.weights[ends[:, 0]] + self.weights[ends[:, 1]]) * 0.5
        rows = hstack([weights.multiply(direction[:, axis, None]) for axis in range(3)]).tocsr()  # x of all nodes, y, z
        robust = (1 + (distance / outlier) ** 2) ** -2 * EDGE_SHARE / OUTLINE_SIGMA**2
        matrix = (rows.T @ rows.multiply(robust[:, None])).toarray()
        right = rows.T @ (robust * (rows @ old.T.ravel() + distance))
        matrix += np.kron(np.eye(3), self.stiffness)
        return np.linalg.solve(matrix, right).reshape(3, -1).T


def _spread(points: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """Indices of nodes, the lowest point first; each is the one farthest from those before in units of its own `spacing` (v,), until
    all points are nearer than that to a node."""
    chosen, away = [int(points[:, 1].argmin())], np.full(len(points), np.inf)
    while True:
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1) / spacing)
        if away.max() < 1:
            return np.array(chosen)
        chosen.append(int(away.argmax()))


def turned_over(body: TemplateModel, before: TemplateModel) -> np.ndarray:
    """(f,) triangles of the skin that face the other way than they did `before`: a point whose nearest vertex is theirs has the wrong
    sign of distance, however far away it is. Eyes, teeth and tongue do not count."""
    normal, then = (
        np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        for corner in (model.v_template.double().numpy()[body.faces.numpy()] for model in (body, before))
    )
    skin = ~body.of_groups((*EYES, *MOUTH)).numpy()[body.faces.numpy()].any(1)
    return np.asarray(((normal * then).sum(1) < 0) & skin)


def _at_rest(person: Person, seen: Seen) -> AtRest:
    posed, world = posed_in_world(person, seen.signals)
    turn = world[:3, :3] @ blend(posed.skinning, person.body.weights)[:, :3, :3].double().numpy()
    found = measured(person, seen, EDGE_SEARCH)
    return found.vertices, np.einsum("kcd,kc->kd", turn[found.vertices].mean(1), found.outward), found.distance
