"""Warm start: the geometry of body and face is fitted to a guess at the template's signed distance before pass I.

Not in the paper, which starts from scratch: supervised distances take seconds where volume rendering takes hours to find
the rough shape. Letters: p points. Root frame for the body, head frame for the face; metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.training.losses import distance_loss
from avatarrex.volume.probe import VertexProbe

FRAMES = 16
POINTS = 12_000
"""Per frame, held for all steps."""
BATCH = 2500
SPREAD = ((0.004, 0.35), (0.015, 0.35), (0.05, 0.3))
"""Standard deviation of the points off the surface, metres, and the share of each."""
RATE = 2e-3


@dataclass(frozen=True)
class Distances:
    """Supervision of one frame."""

    position: Tensor
    sdf: Tensor


def distances_around(vertices: Tensor, faces: Tensor, near: Tensor, count: int, rng: np.random.Generator) -> Distances:
    """Points around the vertices of the mask `near` (v,), with the height over its nearest vertex (volume/probe.py)."""
    chosen = vertices[near][torch.from_numpy(rng.integers(int(near.sum()), size=count))].double().numpy()
    sigma = rng.choice([width for width, _ in SPREAD], count, p=[share for _, share in SPREAD])
    position = chosen + rng.normal(size=(count, 3)) * sigma[:, None]
    mesh, nothing = vertices.double().numpy(), np.zeros(len(vertices))
    probe = VertexProbe.of(mesh, vertex_normals(vertices, faces).double().numpy(), nothing, nothing)
    guess = probe.query(position).guess
    return Distances(torch.as_tensor(position, dtype=torch.float32), torch.as_tensor(guess, dtype=torch.float32))


def warm_start(avatar: Avatar, motion: SignalSequence, part: str, steps: int, seed: int) -> float:
    """Fit the geometry of `body` or `face` for `steps` steps on frames of a motion; mean error of the last tenth, metres."""
    frames = sorted(set(np.linspace(0, len(motion) - 1, FRAMES).round().astype(int).tolist()))
    posed = [pose_person(avatar.person, motion[index], Counters(), None) for index in frames]
    rng = np.random.default_rng([seed, 17])
    fit = {"body": _body, "face": _face}[part](avatar, posed, rng)
    parameters = avatar.body.geometry_parameters() if part == "body" else list(avatar.face.geometry.parameters())
    return _descend(parameters, fit, steps, rng, f"{part}: warm start")


def _body(avatar: Avatar, frames: list[PosedPerson], rng: np.random.Generator) -> Callable[[], tuple[Tensor, Tensor]]:
    field, faces = avatar.body, avatar.person.body.faces
    everywhere = torch.ones(len(avatar.person.body.v_template), dtype=torch.bool)
    bank = [(f, distances_around(f.body.vertices, faces, everywhere, POINTS, rng)) for f in frames]

    def draw() -> tuple[Tensor, Tensor]:
        posed, data = bank[rng.integers(len(bank))]
        rows = torch.from_numpy(rng.integers(POINTS, size=BATCH))
        body_frame = field.frame(posed.body, field.code(posed.body_rotation))
        return field.sdf(body_frame, data.position[rows]), data.sdf[rows]

    return draw


def _face(avatar: Avatar, frames: list[PosedPerson], rng: np.random.Generator) -> Callable[[], tuple[Tensor, Tensor]]:
    field, template = avatar.face, avatar.person.face
    bank = []
    for posed in frames:
        mesh = posed.parts["face"]
        near = template.blend_weight > 0
        driven = field.driven(mesh, posed.face_coefficients)
        bank.append((driven, distances_around(mesh, template.faces, near, POINTS, rng)))

    def draw() -> tuple[Tensor, Tensor]:
        views, data = bank[rng.integers(len(bank))]
        rows = torch.from_numpy(rng.integers(POINTS, size=2 * BATCH))
        return field.sdf(field.geometry_planes(views), data.position[rows]), data.sdf[rows]

    return draw


def _descend(
    parameters: list[nn.Parameter],
    draw: Callable[[], tuple[Tensor, Tensor]],
    steps: int,
    rng: np.random.Generator,
    label: str,
) -> float:
    for parameter in parameters:
        parameter.requires_grad_(True)
    optimiser = torch.optim.Adam(parameters, lr=RATE)
    errors = []
    with tqdm(total=steps, desc=label) as bar:
        for step in range(steps):
            optimiser.param_groups[0]["lr"] = RATE * 0.05 ** (step / steps)
            predicted, truth = draw()
            optimiser.zero_grad(set_to_none=True)
            (20 * distance_loss(predicted, truth)).backward()
            optimiser.step()
            errors.append(float((predicted - truth).detach().abs().mean()))
            bar.update()
    for parameter in parameters:
        parameter.requires_grad_(False)
    return float(np.mean(errors[-max(1, steps // 10) :])) if errors else float("nan")
