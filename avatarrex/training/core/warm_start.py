"""Warm start: the geometry of body and face is fitted to a guess at the template's signed distance before pass I.

Not in the paper, which starts from scratch: supervised distances take seconds where volume rendering takes hours to find
the rough shape. Where the packaged prior (prior.py) has the shape of the avatar's networks and template, the fit goes on
from there. Letters: p points. Root frame for the body, head frame for the face; metres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import safetensors
import safetensors.torch
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.fields.face import FaceField
from avatarrex.fields.orthographic import AXES, SIZE, before, render_places, render_views, seen
from avatarrex.fields.template_distance import TemplateDistance
from avatarrex.files.assets import DATA
from avatarrex.ops.closest_point import closest_point
from avatarrex.ops.crossings import winding
from avatarrex.ops.pseudonormal import pseudonormals
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.search_tree import SearchTree
from avatarrex.signals.driving import Signals
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.training.core.losses import distance_loss

FRAMES = 16
POINTS = 12_000
"""Per frame, held for all steps."""
BATCH = 2500
SPREAD = ((0.004, 0.35), (0.015, 0.35), (0.05, 0.3))
"""Standard deviation of the points off the surface, metres, and the share of each."""
FACE_SPREAD = ((0.002, 0.3), (0.004, 0.3), (0.015, 0.25), (0.05, 0.15))
"""Of a face: lips are thin."""
LOOKS = ((0.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, 0.5, 0.0), (-0.5, -0.5, 0.0), (0.0, 0.7, 0.0))
"""Rotvecs by which a head is turned to see which of its vertices show, by each of the three views: 18 directions."""
CLOSED = 1e6
"""Where a view that is not to tell anything has its surface: before everything, in halves of the box."""
HIDDEN, BESIDE = 0.0015, 0.003
"""Metres behind what a view shows that count as hidden; and about a triangle in which it tells the side."""
RATE = 2e-3
KNOWN_RATE = 5e-4
"""Where the prior has been loaded: only the person's own shape is left to find."""
PRIOR = DATA / "prior.safetensors"
KNOWN = {
    "body": (
        "code_network.decoder.",
        "code_network.encoder.",
        "geometry_local.",
        "geometry_blend.",
        "node_vertex",
        "anchor_vertex",
    ),
    "face": ("geometry.",),
    "face_colour": ("colour_net.",),
}
"""Weights and nodes of each part of the prior."""
Draw = Callable[[np.random.Generator], tuple[Tensor, Tensor]]
"""Predicted and true distances of one step's points."""


@dataclass(frozen=True)
class Distances:
    """Supervision of one frame."""

    position: Tensor
    sdf: Tensor


def distances_around(vertices: Tensor, faces: Tensor, near: Tensor, count: int, rng: np.random.Generator) -> Distances:
    """Points around the vertices of the mask `near` (v,), with the height over its nearest vertex (fields/template_distance.py).

    None that lies above the skin of one limb and within another, or above the inner face and within an eyeball or the tongue:
    there the union is inside, and the height is not.
    """
    chosen = vertices[near][torch.from_numpy(rng.integers(int(near.sum()), size=count))].double().numpy()
    position = chosen + _aside(SPREAD, count, rng)
    mesh, nothing = vertices.double().numpy(), np.zeros(len(vertices))
    skin = TemplateDistance.of(mesh, vertex_normals(vertices, faces).double().numpy(), nothing, nothing)
    guess = skin.query(position).guess
    known = (guess <= 0) | (winding(SearchTree.of_triangles(mesh, faces.numpy()), position) <= 0)
    return Distances(*(torch.as_tensor(values[known], dtype=torch.float32) for values in (position, guess)))


def hidden_at_rest(field: FaceField, rest: Tensor) -> Tensor:
    """(v,) vertices of a face mesh that no look shows while it rests (v, 3), mouth closed and eyes open."""
    return ~_shown(field, rest, *_looks(field, rest, None))


def distances_before(
    field: FaceField, mesh: Tensor, near: Tensor, inner: Tensor, rng: np.random.Generator
) -> Distances:
    """Points around the vertices `near` (v,) of a posed face mesh that can be seen, with the distance to what can be seen.

    What lids and lips hide (the back of the eyeballs, the mouth's cavity) is no surface: it would make bubbles. Inside is
    what is hidden from every look; beside the surface, where views are too coarse, what lies behind the nearest triangle.
    What is hidden at rest (`inner`) is looked at from straight before alone: cheeks and lips that are hollow behind are
    thinner than what the networks tell apart. Where sight ends there is no triangle: no distance is larger than that to
    the nearest point of the other side.
    """
    turned, places = _looks(field, mesh, inner)
    shown = _shown(field, mesh, turned, places)
    chosen = mesh[near & shown][torch.from_numpy(rng.integers(int((near & shown).sum()), size=POINTS))]
    position = chosen + torch.from_numpy(_aside(FACE_SPREAD, POINTS, rng)).to(mesh)
    whole = shown[field.faces].all(1)
    normals = pseudonormals(mesh.double(), field.faces).of(whole)
    sdf = closest_point(mesh, field.faces[whole], position, normals=normals).sdf
    gaps = [before(points, image, field.box) for points, image in zip(_turned(field, position), places)]
    outside = (torch.cat(gaps) < 0).any(0)
    sdf = torch.where(sdf.abs() < BESIDE, sdf, sdf.abs() * torch.where(outside, 1, -1))
    return Distances(position, _consistent(position, sdf))


def _turned(field: FaceField, points: Tensor) -> list[Tensor]:
    """Points (p, 3) of the head frame as each of the `LOOKS` turns them."""
    turns = matrix_from_rotvec(torch.tensor(LOOKS))
    return [(points - field.box_centre) @ turn.T + field.box_centre for turn in turns]


def _looks(field: FaceField, mesh: Tensor, inner: Tensor | None) -> tuple[list[Tensor], list[Tensor]]:
    """The mesh (v, 3) as each look turns it, and the places that its views show: of `inner` vertices (v,) none, but straight
    from before."""
    turned, places = _turned(field, mesh), []
    towards = torch.tensor(AXES)[:, 2, :, None, None].expand(-1, -1, SIZE, SIZE)
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
    return rng.normal(size=(count, 3)) * sigma[:, None]


def _consistent(position: Tensor, sdf: Tensor) -> Tensor:
    """Distances no larger than that to the nearest point of the other side, as signed distances are."""
    inside, limited = sdf < 0, sdf.clone()
    if inside.all() or not inside.any():
        return sdf
    for here in (inside, ~inside):
        reach = torch.from_numpy(cKDTree(position[~here].numpy()).query(position[here].numpy())[0]).to(sdf)
        limited[here] = sdf[here].sign() * sdf[here].abs().minimum(reach)
    return limited


def module_of(part: str) -> str:
    """Name of the avatar's module that a part of the prior belongs to."""
    return part.removesuffix("_colour")


def known_state(state: Mapping[str, Tensor], part: str) -> dict[str, Tensor]:
    """Of a module's state what the prior's `part` holds, named `module.name`."""
    return {f"{module_of(part)}.{name}": value for name, value in state.items() if name.startswith(KNOWN[part])}


def load_prior(avatar: Avatar, part: str) -> bool:
    """Take a part of the packaged prior; False, and nothing changed, where networks or template are others."""
    module = avatar.modules()[module_of(part)]
    own = known_state(module.state_dict(), part)
    with safetensors.safe_open(PRIOR, "pt") as file:
        names, vertices = set(file.keys()), int(file.metadata()["vertices"])
        prior = {name: file.get_tensor(name) for name in own if name in names}
    same = {name: value.shape for name, value in own.items()} == {name: value.shape for name, value in prior.items()}
    if vertices != len(avatar.person.body.v_template) or not same:
        return False
    taken = {name.removeprefix(f"{module_of(part)}."): value for name, value in prior.items()}
    module.load_state_dict({**module.state_dict(), **taken})
    return True


def warm_start(avatar: Avatar, motion: SignalSequence, part: str, steps: int, seed: int) -> float:
    """Load what is known of `body` or `face` and fit its geometry for `steps` steps on frames of a motion.

    Returns the mean error of the last tenth, metres.
    """
    rate = KNOWN_RATE if load_prior(avatar, part) else RATE
    if part == "face":
        load_prior(avatar, "face_colour")
    frames = sorted(set(np.linspace(0, len(motion) - 1, FRAMES).round().astype(int).tolist()))
    rng = np.random.default_rng([seed, 17])
    parameters, draw = supervision(avatar, [motion[index] for index in frames], part, rng)
    return _descend(parameters, draw, steps, rate, rng, f"{part}: warm start")


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
    everywhere = torch.ones(len(avatar.person.body.v_template), dtype=torch.bool)
    bank = [(f, distances_around(f.body.vertices, faces, everywhere, POINTS, rng)) for f in frames]

    def draw(rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        posed, data = bank[rng.integers(len(bank))]
        rows = torch.from_numpy(rng.integers(len(data.sdf), size=BATCH))
        body_frame = field.frame(posed.body, field.code(posed.body_rotation))
        return field.sdf(body_frame, data.position[rows]), data.sdf[rows]

    return draw


def _face(avatar: Avatar, frames: list[PosedPerson], rng: np.random.Generator) -> Draw:
    field, template = avatar.face, avatar.person.face
    near, inner = template.blend_weight > 0, hidden_at_rest(field, template.v_template.float())
    bank = []
    for posed in tqdm(frames, desc="face: distances"):
        mesh = posed.parts["face"]
        driven = field.driven(mesh, posed.coefficients["face"])
        bank.append((driven, distances_before(field, mesh, near, inner, rng)))

    def draw(rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        views, data = bank[rng.integers(len(bank))]
        rows = torch.from_numpy(rng.integers(POINTS, size=2 * BATCH))
        return field.sdf(field.geometry_planes(views), data.position[rows]), data.sdf[rows]

    return draw


def _descend(
    parameters: list[nn.Parameter], draw: Draw, steps: int, rate: float, rng: np.random.Generator, label: str
) -> float:
    for parameter in parameters:
        parameter.requires_grad_(True)
    optimiser = torch.optim.Adam(parameters, lr=rate, fused=True)
    errors = []
    with tqdm(total=steps, desc=label) as bar:
        for step in range(steps):
            optimiser.param_groups[0]["lr"] = rate * 0.05 ** (step / steps)
            predicted, truth = draw(rng)
            optimiser.zero_grad(set_to_none=True)
            (20 * distance_loss(predicted, truth)).backward()
            optimiser.step()
            errors.append(float((predicted - truth).detach().abs().mean()))
            bar.update()
    for parameter in parameters:
        parameter.requires_grad_(False)
    return float(np.mean(errors[-max(1, steps // 10) :])) if errors else float("nan")
