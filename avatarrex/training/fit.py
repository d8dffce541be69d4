"""Fit the fields of an avatar directly to the clothed subject: signed distances and surface colours, no images.

    python -m avatarrex.training.fit OUT [--part body|face|hands] [--minutes M]

A first avatar to look at, honest about what it is (`avatar.json` says 'fitted to geometry'); training from images replaces
it. Each part is fitted in its own process and checkpoints every minute; started again, it goes on. `--package` joins the
parts into one `.avatar` file.

Letters: p points, v vertices. Root frame for the body, head frame for the face; metres; colours sRGB-encoded.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from avatarrex.avatar import Avatar, save_avatar
from avatarrex.capture.subject import PosedSubject, Subject, load_subject
from avatarrex.counters import Counters
from avatarrex.fields.hand import HandQuery
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.limits import random_signals
from avatarrex.signals.signals import Signals
from avatarrex.templates.face import pose_face
from avatarrex.templates.hand import pose_hand
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import PosedPerson, pose_person

CLAMP = 0.06
"""Metres: farther distances all count the same; the volume's band is as wide."""
CHECKPOINT_SECONDS = 60
HALF_POSES, FULL_POSES, EXPRESSIONS = 34, 10, 44
BODY_POINTS, FACE_POINTS = 14000, 16000
"""Per pose or expression held in the bank; a step draws some of them."""
BODY_BATCH, FACE_BATCH = 3000, 8000
JAW_OPEN, BLINK_LEFT, BLINK_RIGHT = (EXPRESSION_NAMES.index(n) for n in ("jawOpen", "eyeBlinkLeft", "eyeBlinkRight"))


@dataclass(frozen=True)
class Samples:
    """Supervision of one pose."""

    position: Tensor
    sdf: Tensor
    surface: Tensor
    normal: Tensor
    colour: Tensor


def sample_subject(
    posed: PosedSubject, count: int, rng: np.random.Generator, faces: np.ndarray, move: np.ndarray
) -> Samples:
    """Near and far points with their signed distance, and surface points with colour, after subtracting `move` (3,)."""
    face, bary = posed.solids.sample(count, rng, faces)
    surface, normal = posed.at(face, bary)
    spread = np.where(rng.random(count) < 0.6, 0.005, 0.025)
    points = surface + normal * (rng.normal(size=count) * spread)[:, None] + rng.normal(size=(count, 3)) * 0.002
    far = rng.random(count) < 0.1
    points[far] += rng.normal(size=(far.sum(), 3)) * 0.04
    distance = posed.signed_distance(points)

    def tensor(values: np.ndarray) -> Tensor:
        return torch.as_tensor(values, dtype=torch.float32)

    return Samples(
        tensor(points - move),
        tensor(distance),
        tensor(surface - move),
        tensor(normal),
        tensor(posed.colour_at(face, bary)),
    )


def body_bank(subject: Subject, seed: int) -> list[tuple[PosedPerson, Samples]]:
    """Poses at half and at full joint limits, flat hands and a neutral face (docs/architecture.md)."""
    rng = np.random.default_rng(seed)
    bank = []
    for k in tqdm(range(HALF_POSES + FULL_POSES), desc="body poses"):
        signals = random_signals(rng, 0.5 if k < HALF_POSES else 1.0)
        signals = Signals.rest().replace(body_pose=signals.body_pose * (0.0 if k == 0 else 1.0))
        posed, target = pose_person(subject.person, signals, Counters(), None), subject.pose(signals)
        bank.append((posed, sample_subject(target, BODY_POINTS, rng, target.solids.outer, np.zeros(3))))
    return bank


def fit_body(
    avatar: Avatar, subject: Subject
) -> tuple[list[torch.nn.Parameter], Callable[[np.random.Generator], dict[str, Tensor]]]:
    """Parameters of the body field and a function that draws one step's losses."""
    bank, field = body_bank(subject, 1), avatar.body

    def step(rng: np.random.Generator) -> dict[str, Tensor]:
        posed, data = bank[rng.integers(len(bank))]
        frame = field.frame(posed.body, field.code(posed.body_rotation))
        rows = torch.as_tensor(rng.integers(len(data.sdf), size=BODY_BATCH))
        predicted = field.sdf(frame, data.position[rows])
        paint = torch.as_tensor(rng.integers(len(data.sdf), size=BODY_BATCH))
        gaze = torch.nn.functional.normalize(-data.normal[paint] + 0.5 * torch.randn(BODY_BATCH, 3), dim=-1)
        colour = field.colour(frame, field.patches(frame), data.surface[paint], gaze)
        return {
            "distance": 20 * _distance_loss(predicted, data.sdf[rows]),
            "colour": (colour - data.colour[paint]).abs().mean(),
            "residual": 10 * frame.code.residual.square().mean(),
        }

    return [*field.geometry_parameters(), *field.colour_parameters()], step


def random_expression(rng: np.random.Generator, k: int) -> np.ndarray:
    """Neutral first, then sparse mixtures in which jaw and lids move often; (52,)."""
    value = np.zeros(52)
    if k:
        chosen = rng.choice(52, rng.integers(3, 9), replace=False)
        value[chosen] = rng.random(len(chosen))
        value[JAW_OPEN] = rng.random() * (rng.random() < 0.5)
        value[[BLINK_LEFT, BLINK_RIGHT]] = rng.random() * (rng.random() < 0.4)
    return value


def fit_face(
    avatar: Avatar, subject: Subject
) -> tuple[list[torch.nn.Parameter], Callable[[np.random.Generator], dict[str, Tensor]]]:
    """Parameters of the face field and a function that draws one step's losses."""
    rng, person, field = np.random.default_rng(2), subject.person, avatar.face
    head = person.body.joint_template[15].double().numpy()
    near = person.face.v_template[person.face.blend_weight > 0].double().numpy()
    low, high = near.min(0) - 0.02 + head, near.max(0) + 0.02 + head
    bank = []
    for k in tqdm(range(EXPRESSIONS), desc="expressions"):
        expression = random_expression(rng, k)
        posed = subject.pose(Signals.rest().replace(expression=expression))
        centre = posed.vertices[posed.faces].mean(1)
        faces = np.intersect1d(np.flatnonzero(((centre > low) & (centre < high)).all(1)), posed.solids.outer)
        vertices = pose_face(
            person.face,
            torch.as_tensor(expression, dtype=torch.float32),
            torch.zeros(3),
            torch.zeros(2, 3),
            torch.zeros(10),
        )
        bank.append((field.views(vertices), sample_subject(posed, FACE_POINTS, rng, faces, head)))

    def step(rng: np.random.Generator) -> dict[str, Tensor]:
        views, data = bank[rng.integers(len(bank))]
        rows = torch.as_tensor(rng.integers(len(data.sdf), size=FACE_BATCH))
        predicted = field.sdf(field.geometry_planes(views), data.position[rows])
        gaze = torch.nn.functional.normalize(-data.normal[rows] + 0.5 * torch.randn(FACE_BATCH, 3), dim=-1)
        colour = field.colour(field.colour_planes(views), data.surface[rows], gaze)
        return {
            "distance": 20 * _distance_loss(predicted, data.sdf[rows]),
            "colour": (colour - data.colour[rows]).abs().mean(),
        }

    return list(field.parameters()), step


def fit_hands(
    avatar: Avatar, subject: Subject
) -> tuple[list[torch.nn.Parameter], Callable[[np.random.Generator], dict[str, Tensor]]]:
    """Parameters of both hands' colour and a function that draws one step's losses (the geometry is exact)."""
    rng, person = np.random.default_rng(3), subject.person
    arms = np.zeros((21, 3))
    arms[15, 2], arms[16, 2] = -1.0, 1.0
    bank: list[tuple[str, Tensor, HandQuery, Tensor]] = []
    for _ in tqdm(range(40), desc="hand poses"):
        signals = random_signals(rng, 0.8).replace(body_pose=arms, expression=np.zeros(52), shape=np.zeros(10))
        posed = subject.pose(signals)
        template = pose_person(person, signals, Counters(), None)
        for side in ("left", "right"):
            hand = getattr(person, f"{side}_hand")
            pose = template.hand_pose[f"{side}_hand"]
            vertices = pose_hand(hand, pose, torch.zeros(10))
            faces, normals = hand.model.faces, vertex_normals(vertices, hand.model.faces)
            face = torch.as_tensor(rng.integers(len(faces), size=4000))
            bary = torch.as_tensor(rng.dirichlet(np.ones(3), 4000), dtype=torch.float32)
            local = (vertices[faces[face]] * bary[..., None]).sum(1)
            normal = torch.nn.functional.normalize((normals[faces[face]] * bary[..., None]).sum(1), dim=-1)
            pose_matrix = template.root_from_part(f"{side}_hand")
            world = local.double().numpy() @ pose_matrix[:3, :3].T + pose_matrix[:3, 3]
            colour = torch.as_tensor(posed.colour(world), dtype=torch.float32)
            bank.append((f"{side}_hand", pose, HandQuery(torch.zeros(4000), face, bary, normal), colour))

    def step(rng: np.random.Generator) -> dict[str, Tensor]:
        name, pose, query, colour = bank[rng.integers(len(bank))]
        predicted = avatar.hand(name).colour(torch.zeros(0, 3), pose, query)
        return {"colour": (predicted - colour).abs().mean()}

    return [*avatar.left_hand.parameters(), *avatar.right_hand.parameters()], step


FITS = {"body": fit_body, "face": fit_face, "hands": fit_hands}
MODULES = {"body": ("body",), "face": ("face",), "hands": ("left_hand", "right_hand")}


def fit(
    out: Path, part: str, minutes: float, preset: str = "compact", rate: float = 4e-3, seed: int = 0
) -> dict[str, float]:
    """Fit one part for `minutes` in all (time spent before a resume counts); returns the last averaged losses."""
    avatar, subject = Avatar.create(load_person(), preset, seed), load_subject()
    parameters, step = FITS[part](avatar, subject)
    for parameter in parameters:
        parameter.requires_grad_(True)
    optimiser = torch.optim.Adam(parameters, lr=rate, fused=True)
    out.mkdir(parents=True, exist_ok=True)
    path, state = out / f"{part}.pt", {"seconds": 0.0, "steps": 0}
    if path.exists():
        saved = torch.load(path, weights_only=True)
        for name in MODULES[part]:
            avatar.modules()[name].load_state_dict(saved[name])
        optimiser.load_state_dict(saved["optimiser"])
        state = {"seconds": saved["seconds"], "steps": saved["steps"]}
    mean: dict[str, float] = {}
    rng = np.random.default_rng([seed, int(state["steps"])])
    torch.manual_seed(seed + int(state["steps"]))
    budget, saved_at = minutes * 60, time.monotonic()
    with tqdm(total=round(budget), initial=round(state["seconds"]), unit="s", desc=part) as bar:
        while state["seconds"] < budget:
            begun = time.monotonic()
            for group in optimiser.param_groups:
                group["lr"] = rate * 0.02 ** (state["seconds"] / budget) * min(1.0, (state["steps"] + 1) / 50)
            losses = step(rng)
            total = torch.stack(list(losses.values())).sum()
            if not torch.isfinite(total):
                raise FloatingPointError(f"{part}: step {state['steps']}: {losses}; the last checkpoint is {path}")
            optimiser.zero_grad(set_to_none=True)
            total.backward()
            optimiser.step()
            for name, value in losses.items():
                mean[name] = 0.98 * mean.get(name, float(value)) + 0.02 * float(value)
            state["steps"] += 1
            state["seconds"] += time.monotonic() - begun
            bar.n = min(round(state["seconds"]), bar.total)
            bar.set_postfix({"step": state["steps"], **{k: f"{v:.4f}" for k, v in mean.items()}})
            if time.monotonic() - saved_at > CHECKPOINT_SECONDS:
                _checkpoint(path, avatar, part, optimiser, state)
                saved_at = time.monotonic()
    _checkpoint(path, avatar, part, optimiser, state)
    return mean


def package(out: Path, target: Path, preset: str = "compact", seed: int = 0) -> None:
    """Join the fitted parts in `out` into one avatar at `target`."""
    avatar = Avatar.create(load_person(), preset, seed)
    provenance: dict[str, Any] = {}
    for part, names in MODULES.items():
        saved = torch.load(out / f"{part}.pt", weights_only=True)
        for name in names:
            avatar.modules()[name].load_state_dict(saved[name])
        provenance[part] = {"steps": saved["steps"], "minutes": round(saved["seconds"] / 60, 1)}
    avatar.meta |= {
        "name": "default",
        "origin": "fitted to geometry: signed distances and surface colours of the synthetic clothed subject; not trained from images",
        "fit": provenance,
        "command": "python -m avatarrex.training.fit",
        "licence": "weights Apache-2.0; template from MakeHuman data, CC0 (see NOTICE)",
        "consent": "synthetic person; no real person is depicted",
    }
    save_avatar(avatar, target)


def _distance_loss(predicted: Tensor, target: Tensor) -> Tensor:
    """Mean absolute error of clamped distances, near the surface counted more; in metres."""
    weight = 1 / (1 + target.abs() / 0.01)
    return (weight * (predicted.clamp(-CLAMP, CLAMP) - target.clamp(-CLAMP, CLAMP)).abs()).mean()


def _checkpoint(path: Path, avatar: Avatar, part: str, optimiser: torch.optim.Optimizer, state: dict[str, Any]) -> None:
    content = {name: avatar.modules()[name].state_dict() for name in MODULES[part]}
    temporary = path.with_suffix(".tmp")
    torch.save({**content, "optimiser": optimiser.state_dict(), **state}, temporary)
    os.replace(temporary, path)


def _parts(choice: str | None) -> Iterator[str]:
    yield from ([choice] if choice else FITS)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder of the checkpoints")
    parser.add_argument("--part", choices=list(FITS), help="only this part (default: all, one after the other)")
    parser.add_argument("--minutes", type=float, default=0, help="per part (default: body 40, face 40, hands 3)")
    parser.add_argument("--package", type=Path, help="join the fitted parts into this .avatar file")
    options = parser.parse_args()
    if options.package:
        package(options.out, options.package)
        return
    for part in _parts(options.part):
        fit(options.out, part, options.minutes or {"body": 40.0, "face": 40.0, "hands": 3.0}[part])


if __name__ == "__main__":
    main()
