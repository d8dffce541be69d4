"""Fit the fields of an avatar directly to the clothed subject: signed distances and surface colours, no images.

    python -m avatarrex.training.fit OUT [--parts body face hands] [--minutes M] [--package FILE.avatar]

A first avatar to look at, honest about what it is (`avatar.json` says 'fitted to geometry'); training from images replaces
it. The body is fitted beside face and hands, in two processes that checkpoint every minute; started again, they go on.
`--package` joins the parts into one `.avatar` file.

Letters: p points, v vertices. Root frame for the body, head frame for the face; metres; colours sRGB-encoded.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import save_avatar
from avatarrex.capture.synthetic.subject import FACE_SOLIDS, PosedSubject, Subject, load_subject
from avatarrex.counters import Counters
from avatarrex.fields.hand import HandQuery
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.library import POSES, named_pose
from avatarrex.signals.limits import random_signals
from avatarrex.templates.hand import pose_hand
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.training.core.losses import CLAMP, distance_loss

CHECKPOINT_SECONDS = 60
MINUTES = {"body": 66.0, "face": 62.0, "hands": 3.0}
"""Of steps, without the sampling of poses before them (three minutes each for body and face)."""
HALF_POSES, FULL_POSES, MIXTURES = 70, 20, 60
"""Random body poses at half and at full joint limits beside the named ones; mixed expressions beside every single one."""
BODY_POINTS, FACE_POINTS = 14000, 16000
"""Per pose or expression held in the bank; a step draws some of them."""
BODY_BATCH, FACE_BATCH = 3000, 8000
HIDDEN_SHARE = 0.12
"""Of the body's samples: where hands or face have taken over, it is only seen when they are switched off."""
DETAIL_SHARE = 0.45
"""Of the face's samples: eyes, lids, lips and teeth, a tenth of its area."""
BODY_SPREAD = ((0.004, 0.5), (0.012, 0.3), (0.030, 0.2))
FACE_SPREAD = ((0.0015, 0.4), (0.005, 0.4), (0.020, 0.2))
"""Standard deviation of samples off the surface, metres, and the share of each."""
BODY_COLOUR_SPREAD, FACE_COLOUR_SPREAD = 0.005, 0.001
"""How far off the surface its colour is asked for, metres: rays hit the surface that the voxels hold, not the true one."""
JAW_OPEN, BLINK_LEFT, BLINK_RIGHT = (EXPRESSION_NAMES.index(n) for n in ("jawOpen", "eyeBlinkLeft", "eyeBlinkRight"))
FAR = 0.1
"""Share of samples up to `CLAMP` away in any direction."""


@dataclass(frozen=True)
class Samples:
    """Supervision of one pose."""

    position: Tensor
    sdf: Tensor
    surface: Tensor
    normal: Tensor
    colour: Tensor


@dataclass(frozen=True)
class Sampling:
    """How a part's samples lie: triangles with their shares, spreads with theirs, and how far colour is asked for."""

    faces: tuple[tuple[np.ndarray, float], ...]
    spread: tuple[tuple[float, float], ...]
    colour_spread: float
    count: int


def sample_subject(posed: PosedSubject, sampling: Sampling, rng: np.random.Generator, move: np.ndarray) -> Samples:
    """Points around the surface with their signed distance, and surface points with colour, minus `move` (3,)."""
    count = sampling.count
    drawn = [posed.solids.sample(round(count * share), rng, faces) for faces, share in sampling.faces]
    face, bary = (np.concatenate(values) for values in zip(*drawn))
    count = len(face)
    surface, normal = posed.at(face, bary)
    sigma = rng.choice([width for width, _ in sampling.spread], count, p=[share for _, share in sampling.spread])
    points = surface + rng.normal(size=(count, 1)) * sigma[:, None] * normal + rng.normal(size=(count, 3)) * 0.001
    far = rng.random(count) < FAR
    points[far] += rng.uniform(-CLAMP, CLAMP, (int(far.sum()), 3))
    distance = posed.signed_distance(points)
    shown = surface + rng.normal(size=(count, 1)) * sampling.colour_spread * normal

    def tensor(values: np.ndarray) -> Tensor:
        return torch.as_tensor(values, dtype=torch.float32)

    return Samples(
        tensor(points - move),
        tensor(distance),
        tensor(shown - move),
        tensor(normal),
        tensor(posed.colour_at(face, bary)),
    )


def body_bank(subject: Subject, seed: int) -> list[tuple[PosedPerson, Samples]]:
    """Named poses and random ones, all with flat hands and a neutral face (docs/architecture.md)."""
    rng = np.random.default_rng(seed)
    poses = [named_pose(name) for name in POSES]
    poses += [random_signals(rng, 0.5 if k < HALF_POSES else 1.0).body_pose for k in range(HALF_POSES + FULL_POSES)]
    hidden = subject.faces_of("left_hand", "right_hand", "face")
    bank = []
    for pose in tqdm(poses, desc="body poses"):
        signals = Signals.rest().replace(body_pose=pose)
        posed, target = pose_person(subject.person, signals, Counters(), None), subject.pose(signals)
        outer = target.solids.outer
        faces = ((np.setdiff1d(outer, hidden), 1 - HIDDEN_SHARE), (np.intersect1d(outer, hidden), HIDDEN_SHARE))
        sampling = Sampling(faces, BODY_SPREAD, BODY_COLOUR_SPREAD, BODY_POINTS)
        bank.append((posed, sample_subject(target, sampling, rng, np.zeros(3))))
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
            "distance": 20 * distance_loss(predicted, data.sdf[rows]),
            "colour": (colour - data.colour[paint]).abs().mean(),
            "residual": 10 * frame.code.residual.square().mean(),
        }

    return [*field.geometry_parameters(), *field.colour_parameters()], step


def random_face(rng: np.random.Generator, k: int) -> Signals:
    """Neutral, then every coefficient alone, then sparse mixtures in which jaw, lids and gaze move often."""
    value, jaw, eyes = np.zeros(52), np.zeros(3), np.zeros((2, 3))
    if 0 < k <= 52:
        value[k - 1] = 1
    elif k:
        chosen = rng.choice(52, rng.integers(3, 9), replace=False)
        value[chosen] = rng.random(len(chosen))
        value[JAW_OPEN] = rng.random() * (rng.random() < 0.5)
        value[[BLINK_LEFT, BLINK_RIGHT]] = rng.random() * (rng.random() < 0.4)
        jaw[0] = rng.uniform(0, 0.35) * (rng.random() < 0.2)
        eyes[:] = rng.uniform(-1, 1, 3) * (0.3, 0.4, 0) * (rng.random() < 0.5)
    return Signals.rest().replace(expression=value, jaw_pose=jaw, eye_pose=eyes)


def fit_face(
    avatar: Avatar, subject: Subject
) -> tuple[list[torch.nn.Parameter], Callable[[np.random.Generator], dict[str, Tensor]]]:
    """Parameters of the face field and a function that draws one step's losses."""
    rng, person, field = np.random.default_rng(2), subject.person, avatar.face
    head = person.body.joint_template[15].double().numpy()
    near = person.face.v_template[person.face.blend_weight > 0].double().numpy()
    low, high = near.min(0) - 0.02 + head, near.max(0) + 0.02 + head
    detail = np.isin(subject.solid_of_vertex, [subject.names.index(name) for name in FACE_SOLIDS])
    detail |= (subject.masks["lip"] < 0.012) | (subject.masks["lid"] < 0.012)
    detail_faces = np.flatnonzero(detail[subject.faces].all(1))
    bank = []
    for k in tqdm(range(1 + 52 + MIXTURES), desc="expressions"):
        signals = random_face(rng, k)
        posed = subject.pose(signals)
        centre = posed.vertices[posed.faces].mean(1)
        faces = np.intersect1d(np.flatnonzero(((centre > low) & (centre < high)).all(1)), posed.solids.outer)
        groups = ((faces, 1 - DETAIL_SHARE), (np.intersect1d(faces, detail_faces), DETAIL_SHARE))
        sampling = Sampling(groups, FACE_SPREAD, FACE_COLOUR_SPREAD, FACE_POINTS)
        template = pose_person(person, signals, Counters(), None)
        driven = field.driven(template.parts["face"], template.coefficients["face"])
        bank.append((driven, sample_subject(posed, sampling, rng, head)))

    def step(rng: np.random.Generator) -> dict[str, Tensor]:
        views, data = bank[rng.integers(len(bank))]
        rows = torch.as_tensor(rng.integers(len(data.sdf), size=FACE_BATCH))
        predicted = field.sdf(field.geometry_planes(views), data.position[rows])
        gaze = torch.nn.functional.normalize(-data.normal[rows] + 0.5 * torch.randn(FACE_BATCH, 3), dim=-1)
        colour = field.colour(field.colour_planes(views), data.surface[rows], gaze)
        return {
            "distance": 20 * distance_loss(predicted, data.sdf[rows]),
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
            pose = template.coefficients[f"{side}_hand"]
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
    avatar.measure_clothing_offset()
    avatar.meta |= {
        "name": "default",
        "origin": "fitted to geometry: signed distances and surface colours of the synthetic clothed subject; not trained from images",
        "fit": provenance,
        "command": "python -m avatarrex.training.fit",
        "licence": "weights Apache-2.0; template from MakeHuman data, CC0 (see NOTICE)",
        "consent": "synthetic person; no real person is depicted",
    }
    save_avatar(avatar, target)


def _checkpoint(path: Path, avatar: Avatar, part: str, optimiser: torch.optim.Optimizer, state: dict[str, Any]) -> None:
    content = {name: avatar.modules()[name].state_dict() for name in MODULES[part]}
    temporary = path.with_suffix(".tmp")
    torch.save({**content, "optimiser": optimiser.state_dict(), **state}, temporary)
    os.replace(temporary, path)


def _both(out: Path) -> int:
    """Body in one process, face and hands in another, half of the cores each; the first exit status that is not 0."""
    threads = str(max(1, (os.cpu_count() or 2) // 2))
    command = [sys.executable, "-m", "avatarrex.training.fit", str(out), "--parts"]
    groups = (["body"], ["face", "hands"])
    runs = [subprocess.Popen([*command, *parts], env={**os.environ, "OMP_NUM_THREADS": threads}) for parts in groups]
    return next((status for run in runs if (status := run.wait())), 0)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder of the checkpoints")
    parser.add_argument("--parts", nargs="+", choices=list(FITS), help="only these, one after the other")
    parser.add_argument("--minutes", type=float, help=f"per part (default: {MINUTES})")
    parser.add_argument("--package", type=Path, help="join the fitted parts into this .avatar file")
    options = parser.parse_args()
    if options.package:
        package(options.out, options.package)
        return 0
    if not options.parts:
        return _both(options.out)
    for part in options.parts:
        fit(options.out, part, options.minutes or MINUTES[part])
    return 0


if __name__ == "__main__":
    sys.exit(main())
