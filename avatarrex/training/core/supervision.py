"""Supervision of geometry by the template: a guess at its signed distance about body and face, for the warm start and the prior.

Letters: p points, v vertices. Root frame for the body, head frame for the face; metres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.fields.face import FaceField
from avatarrex.fields.orthographic import AXES, VIEW_PIXELS, before, render_places, render_views, seen
from avatarrex.fields.template_distance import TemplateDistance
from avatarrex.ops.closest_point import closest_point
from avatarrex.ops.crossings import winding
from avatarrex.ops.pseudonormal import pseudonormals
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.search_tree import SearchTree
from avatarrex.signals.driving import Signals
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.volume.build import template_distance

POINTS_PER_FRAME = 12_000
"""Per frame, the same for all steps."""
OUTGROWTH_POINTS, OUTGROWTH_SPREAD = 4000, 0.02
"""More of them about an outgrowth, with a standard deviation in metres."""
BATCH = 2500
BODY_SPREAD = ((0.004, 0.35), (0.015, 0.35), (0.05, 0.3))
"""Standard deviation of the points off the surface, metres, and the share of each."""
FACE_SPREAD = ((0.002, 0.3), (0.004, 0.3), (0.015, 0.25), (0.05, 0.15))
"""Of a face: lips are thin."""
LOOKS = ((0.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, 0.5, 0.0), (-0.5, -0.5, 0.0), (0.0, 0.7, 0.0))
"""Rotvecs by which a head is turned to see which of its vertices show, by each of the three views: 18 directions."""
CLOSED = 1e6
"""Where a view without a say has its surface: before everything, in halves of the box."""
HIDDEN, BESIDE = 0.0015, 0.003
"""Metres beyond what a view shows that count as hidden; and about a triangle in which it gives the side."""
Draw = Callable[[np.random.Generator], tuple[Tensor, Tensor]]
"""Predicted and true values of one step's points."""
Distances = tuple[Tensor, Tensor]
"""Points (p, 3) and their signed distances (p,)."""


def supervision(
    avatar: Avatar, poses: Sequence[Signals], part: str, rng: np.random.Generator
) -> tuple[list[nn.Parameter], Draw]:
    """Parameters of the geometry of `body` or `face`, and what draws a step from those poses."""
    posed = [pose_person(avatar.person, pose, Counters(), None) for pose in tqdm(poses, desc=f"{part}: poses")]
    if part == "body":
        return avatar.body.geometry_parameters(), _body(avatar, posed, rng)
    return list(avatar.face.geometry.parameters()), _face(avatar, posed, rng)


def _body(avatar: Avatar, frames: list[PosedPerson], rng: np.random.Generator) -> Draw:
    field, faces = avatar.body, avatar.person.body.faces
    bank = []
    for f in frames:
        skin, off = distances_around(f.body.vertices, faces, POINTS_PER_FRAME, rng), _standing_off(avatar, f, rng)
        bank.append((f, (torch.cat([skin[0], off[0]]), torch.cat([skin[1], off[1]]))))

    def draw(rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        posed, (position, sdf) = bank[rng.integers(len(bank))]
        rows = torch.from_numpy(rng.integers(len(sdf), size=BATCH))
        body_frame = field.frame(posed.body, field.code(posed.body_rotation))
        return field.sdf(body_frame, position[rows]), sdf[rows]

    return draw


def _standing_off(avatar: Avatar, posed: PosedPerson, rng: np.random.Generator) -> Distances:
    """Points about what stands off the template, and the guess there; none where nothing does."""
    skin = template_distance(avatar, posed)
    if skin.outgrowth is None:
        return torch.zeros(0, 3), torch.zeros(0)
    around = skin.outgrowth.points[rng.integers(len(skin.outgrowth.points), size=OUTGROWTH_POINTS)]
    position = around + rng.normal(size=around.shape) * OUTGROWTH_SPREAD
    return torch.from_numpy(position).float(), torch.from_numpy(skin.query(position).guess).float()


def _face(avatar: Avatar, frames: list[PosedPerson], rng: np.random.Generator) -> Draw:
    field, template = avatar.face, avatar.person.face
    near, inner = template.blend_weight > 0, hidden_at_rest(field, template.v_template.float())
    bank = []
    for posed in tqdm(frames, desc="face: distances"):
        mesh = posed.parts["face"]
        driven = field.driven(mesh, posed.coefficients["face"])
        bank.append((driven, *distances_before(field, mesh, near, inner, rng)))

    def draw(rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        views, position, sdf = bank[rng.integers(len(bank))]
        rows = torch.from_numpy(rng.integers(POINTS_PER_FRAME, size=2 * BATCH))
        return field.sdf(field.geometry_planes(views), position[rows]), sdf[rows]

    return draw


def distances_around(vertices: Tensor, faces: Tensor, count: int, rng: np.random.Generator) -> Distances:
    """Points around the vertices (v, 3), with the height over its nearest vertex (fields/template_distance.py).

    None that lies above the skin of one limb and within another, or above the inner face and within an eyeball or the tongue:
    there the union is inside, and the height is not.
    """
    chosen = vertices[torch.from_numpy(rng.integers(len(vertices), size=count))].double().numpy()
    position = chosen + _aside(BODY_SPREAD, count, rng)
    mesh, nothing = vertices.double().numpy(), np.zeros(len(vertices))
    skin = TemplateDistance.of(mesh, vertex_normals(vertices, faces).double().numpy(), nothing, nothing)
    guess = skin.query(position).guess
    known = (guess <= 0) | (winding(SearchTree.of_triangles(mesh, faces.numpy()), position) <= 0)
    return torch.from_numpy(position[known]).float(), torch.from_numpy(guess[known]).float()


def hidden_at_rest(field: FaceField, rest: Tensor) -> Tensor:
    """(v,) vertices of a face mesh that no look shows while it rests (v, 3), mouth closed and eyes open."""
    return ~_shown(field, rest, *_looks(field, rest, None))


def shown_skin(field: FaceField, mesh: Tensor, inner: Tensor) -> Tensor:
    """(v,) vertices of a posed face mesh (v, 3) that a look shows, eyeballs included, without those that are `inner` at rest: lips and
    lids slide over them."""
    return _shown(field, mesh, *_looks(field, mesh, None)) & ~inner


def distances_before(
    field: FaceField, mesh: Tensor, near: Tensor, inner: Tensor, rng: np.random.Generator
) -> Distances:
    """Points around the vertices `near` (v,) of a posed face mesh that can be seen, with the distance to what can be seen.

    What lids and lips hide (the back of the eyeballs, the mouth's cavity) is no surface: it would make bubbles. Inside is
    what is hidden from every look; beside the surface, where views are too coarse, the inner side of the nearest triangle.
    What is hidden at rest (`inner`) is seen from straight before alone: cheeks and lips over a cavity are thinner than
    what the networks resolve. Where sight ends there is no triangle: no distance is larger than that to the nearest point
    of the other side.
    """
    turned, places = _looks(field, mesh, inner)
    shown = _shown(field, mesh, turned, places)
    chosen = mesh[near & shown][torch.from_numpy(rng.integers(int((near & shown).sum()), size=POINTS_PER_FRAME))]
    position = chosen + torch.from_numpy(_aside(FACE_SPREAD, POINTS_PER_FRAME, rng)).to(mesh)
    whole = shown[field.faces].all(1)
    normals = pseudonormals(mesh.double(), field.faces).of(whole)
    sdf = closest_point(mesh, field.faces[whole], position, normals=normals).sdf
    gaps = [before(points, image, field.box) for points, image in zip(_turned(field, position), places)]
    outside = (torch.cat(gaps) < 0).any(0)
    sdf = torch.where(sdf.abs() < BESIDE, sdf, sdf.abs() * torch.where(outside, 1, -1))
    return position, _consistent(position, sdf)


def _turned(field: FaceField, points: Tensor) -> list[Tensor]:
    """Points (p, 3) of the head frame as each of the `LOOKS` turns them."""
    turns = matrix_from_rotvec(torch.tensor(LOOKS).to(points))
    return [(points - field.box_centre) @ turn.T + field.box_centre for turn in turns]


def _looks(field: FaceField, mesh: Tensor, inner: Tensor | None) -> tuple[list[Tensor], list[Tensor]]:
    """The mesh (v, 3) as each look turns it, and the places that its views show: of `inner` vertices (v,) none, but straight
    from before."""
    turned, places = _turned(field, mesh), []
    towards = torch.tensor(AXES)[:, 2, :, None, None].expand(-1, -1, VIEW_PIXELS, VIEW_PIXELS)
    for number, vertices in enumerate(turned):
        place = render_places(vertices, field.faces, field.box)
        if inner is not None:
            marked = inner[:, None].expand(-1, 3).float()
            closed = render_views(vertices, field.faces, marked, field.box)[:, :1] > 0
            if number == 0:
                closed[0] = False
            place[:, :3] = torch.where(closed, CLOSED * towards, place[:, :3])
        places.append(place)
    return turned, places


def _shown(field: FaceField, mesh: Tensor, turned: list[Tensor], places: list[Tensor]) -> Tensor:
    """(v,) vertices of the mesh (v, 3) that a look shows."""
    found = [seen(vertices, field.faces, image, field.box, HIDDEN) for vertices, image in zip(turned, places)]
    return torch.stack(found).any(0)


def _aside(spread: tuple[tuple[float, float], ...], count: int, rng: np.random.Generator) -> np.ndarray:
    """Normal offsets (count, 3) of the standard deviations in `spread`, each by its share."""
    sigma = rng.choice([width for width, _ in spread], count, p=[share for _, share in spread])
    offset: np.ndarray = rng.normal(size=(count, 3)) * sigma[:, None]
    return offset


def _consistent(position: Tensor, sdf: Tensor) -> Tensor:
    """Distances no larger than that to the nearest point of the other side, as signed distances are."""
    inside, limited = sdf < 0, sdf.clone()
    if inside.all() or not inside.any():
        return sdf
    for here in (inside, ~inside):
        reach = torch.from_numpy(cKDTree(position[~here].numpy()).query(position[here].numpy())[0]).to(sdf)
        limited[here] = sdf[here].sign() * sdf[here].abs().minimum(reach)
    return limited
