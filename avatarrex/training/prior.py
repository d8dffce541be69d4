"""The prior: body and face geometry fitted to the bare default template, once, for all trainings to start from.

    python -m avatarrex.training.prior OUT [--parts body face face_colour] [--minutes M] [--on] [--package]

Any person of the default template's topology starts pass I from a surface that is right to a millimetre or two under any
pose, before it has seen a picture; what a capture adds are its shape and its clothes. The face's colour networks pass on
the albedo of the template that they are shown: where iris, lips and teeth are is known, how they look is learnt.
Checkpoints every minute; started again, it goes on. Letters: p points. Root frame for the body, head frame for the face;
metres; colours sRGB-encoded.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.fields.orthographic import AXES, render_views
from avatarrex.files.tensors import read_torch
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.library import POSES, named_pose
from avatarrex.signals.limits import random_signals
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import pose_person
from avatarrex.training.core.supervision import Draw, supervision
from avatarrex.training.core.warm_start import PRIOR, Fit, known_state, load_prior, module_of, read_prior

CHECKPOINT_SECONDS = 60
MINUTES = {"body": 24.0, "face": 18.0, "face_colour": 22.0}
"""Of steps, on one core."""
RATE, ON_RATE, DECAY = 4e-3, 2e-3, 0.02
"""Learning rate at the start, from nothing and on from the packaged prior, and what is left of it at the end."""
HALF_POSES, FULL_POSES, MIXTURES, COLOUR_MIXTURES = 60, 40, 120, 120
"""Random body poses at half and at full joint limits beside the named ones; mixed expressions beside every single one,
for geometry and for colour."""
COLOUR_POINTS, COLOUR_BATCH = 20_000, 6000
"""Of each expression; drawn in a step."""
COLOUR_MARGIN, COLOUR_DEPTH = 0.01, 0.003
"""Metres about the face that are coloured, and along a view's axis off the mesh, either way."""
VIEW_SHARE = (1.0, 0.3, 0.3)
"""Of points, by view: eyes and mouth are seen from the front."""
MARKED, MARKED_SHARE = 0.1, 6.0
"""Colours that differ so much from the skin (eyes, brows, lips, teeth) are taken so many times as often."""


def body_poses(rng: np.random.Generator) -> list[Signals]:
    """Named poses and random ones, with flat hands and a neutral face."""
    poses = [named_pose(name) for name in POSES]
    poses += [random_signals(rng, 0.5 if k < HALF_POSES else 1.0).body_pose for k in range(HALF_POSES + FULL_POSES)]
    return [Signals.rest().replace(body_pose=pose) for pose in poses]


def expressions(rng: np.random.Generator, mixtures: int) -> list[Signals]:
    """Neutral, then every coefficient alone, then sparse mixtures with eyes and, now and then, jaw turned."""
    count = len(EXPRESSION_NAMES)
    values = np.concatenate([np.zeros((1, count)), np.eye(count), np.zeros((mixtures, count))])
    for value in values[1 + count :]:
        value[rng.choice(count, rng.integers(3, 9), replace=False)] = rng.random()
    faces = []
    for k, value in enumerate(values):
        jaw, eyes = np.zeros(3), np.zeros((2, 3))
        if k > count:
            jaw[0] = rng.uniform(0, 0.35) * (rng.random() < 0.3)
            eyes[:] = rng.uniform(-1, 1, 3) * (0.3, 0.4, 0)
        faces.append(Signals.rest().replace(expression=value, jaw_pose=jaw, eye_pose=eyes))
    return faces


def albedo_supervision(
    avatar: Avatar, faces: list[Signals], rng: np.random.Generator
) -> tuple[list[nn.Parameter], Draw]:
    """Parameters of the face's colour networks, and what draws a step: colours about the mesh beside what its views show.

    A point is taken where a view shows the mesh, and moved along that view's axis: the surface that is learnt from
    pictures lies a little before the eyeballs or beneath the lids, and needs the colours that are seen there.
    """
    field, template = avatar.face, avatar.person.face
    near = template.v_template[template.blend_weight > 0].float()
    low, high = near.amin(0) - COLOUR_MARGIN, near.amax(0) + COLOUR_MARGIN
    axes = torch.tensor(AXES)[:, 2]
    bank = []
    for signals in tqdm(faces, desc="face_colour: expressions"):
        posed = pose_person(avatar.person, signals, Counters(), None)
        mesh = posed.parts["face"]
        views = field.views(mesh)
        place = render_views(mesh, template.faces, mesh, field.box)[:, :3].permute(0, 2, 3, 1)
        here = (views[:, 6] > 0.5) & ((place > low) & (place < high)).all(-1)
        albedo = views[:, :3].permute(0, 2, 3, 1)
        view = torch.nonzero(here)[:, 0]
        marked = (albedo[here] - albedo[here].median(0).values).abs().amax(-1) > MARKED
        chance = torch.tensor(VIEW_SHARE).double()[view] * torch.where(marked, MARKED_SHARE, 1.0)
        rows = torch.from_numpy(rng.choice(len(view), COLOUR_POINTS, p=(chance / chance.sum()).numpy()))
        driven = field.driven(mesh, posed.coefficients["face"])
        bank.append((driven, place[here][rows], axes[view[rows]], albedo[here][rows]))

    def draw(rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        driven, place, axis, albedo = bank[rng.integers(len(bank))]
        rows = torch.from_numpy(rng.integers(COLOUR_POINTS, size=COLOUR_BATCH))
        aside, noise = rng.uniform(-COLOUR_DEPTH, COLOUR_DEPTH, (COLOUR_BATCH, 1)), rng.normal(size=(COLOUR_BATCH, 3))
        gaze = nn.functional.normalize(0.5 * torch.from_numpy(noise).to(place) - axis[rows], dim=-1)
        position = place[rows] + torch.from_numpy(aside).to(place) * axis[rows]
        return field.colour(field.colour_planes(driven), position, gaze), albedo[rows]

    return list(field.colour_net.parameters()), draw


def fit(out: Path, part: str, minutes: float, preset: str = "compact", seed: int = 0, on: bool = False) -> float:
    """Fit one of `MINUTES` for `minutes` in all (time before a resume counts); the last mean error, in metres or of colour.

    `on`: from the packaged prior. Raises FloatingPointError where a loss is not finite.
    """
    avatar = Avatar.create(load_person(), preset, seed)
    anchors = avatar.body.anchor_vertex.clone()
    rate = ON_RATE if on and load_prior(avatar, part) else RATE
    avatar.body.anchor_vertex.copy_(anchors)  # those that are chosen now, not the prior's; they carry no weights
    avatar.body.place()
    work = _work(avatar, part, np.random.default_rng([seed, 5]))
    out.mkdir(parents=True, exist_ok=True)
    path, module, seconds, steps = out / f"{part}.pt", avatar.modules()[module_of(part)], 0.0, 0
    if path.exists():
        saved = read_fitted(path)
        module.load_state_dict(saved["state"])
        work.optimiser.load_state_dict(saved["optimiser"])
        seconds, steps = saved["seconds"], saved["steps"]
    rng = np.random.default_rng([seed, 6, steps])
    budget, saved_at, error = minutes * 60, time.monotonic(), 0.05
    with tqdm(total=round(budget), initial=round(seconds), unit="s", desc=part) as bar:
        while seconds < budget:
            begun = time.monotonic()
            try:
                found = work.step(rng, rate * DECAY ** (seconds / budget) * min(1.0, (steps + 1) / 50))
            except FloatingPointError:
                message = f"{part}: the loss of step {steps} is not finite; the last checkpoint is {path}"
                raise FloatingPointError(message) from None
            error = 0.98 * error + 0.02 * found
            steps += 1
            seconds += time.monotonic() - begun
            bar.n = min(round(seconds), bar.total)
            bar.set_postfix({"step": steps, "error": f"{error:.5f}"})
            if time.monotonic() - saved_at > CHECKPOINT_SECONDS or seconds >= budget:
                content = {"state": module.state_dict(), "optimiser": work.optimiser.state_dict()}
                temporary = path.with_suffix(".tmp")
                torch.save({**content, "seconds": seconds, "steps": steps, "on": on}, temporary)
                os.replace(temporary, path)
                saved_at = time.monotonic()
    return error


def _work(avatar: Avatar, part: str, rng: np.random.Generator) -> Fit:
    """What fits a part."""
    if part == "face_colour":
        return Fit(*albedo_supervision(avatar, expressions(rng, COLOUR_MIXTURES), rng), nn.functional.l1_loss)
    poses = body_poses(rng) if part == "body" else expressions(rng, MIXTURES)
    return Fit(*supervision(avatar, poses, part, rng))


def read_fitted(path: Path) -> dict[str, Any]:
    """A checkpoint of `fit`: `state`, `seconds`, `steps`, and to go on from it `optimiser`. Raises `InputError`."""
    saved = read_torch(path, "a fitted part")
    if not isinstance(saved, dict) or not {"state", "seconds", "steps"} <= set(saved):
        raise InputError(path, "", "a checkpoint of the prior", type(saved).__name__)
    return saved


def package(out: Path, target: Path, preset: str = "compact") -> None:
    """Write what was fitted, in half precision, in place of that part of `target`; the whole prior where there is none.

    Raises `InputError` where a part is neither there nor fitted.
    """
    vertices = len(load_person().body.v_template)
    state, about = read_prior(target) if target.exists() else ({}, {})
    about |= {"preset": preset, "command": "python -m avatarrex.training.prior", "vertices": str(vertices)}
    for part in MINUTES:
        path = out / f"{part}.pt"
        if path.exists():
            saved = read_fitted(path)
            about[part] = f"{saved['steps']} steps, {saved['seconds'] / 60:.1f} minutes on one core"
            about[part] += ", on from the prior before" if saved.get("on") else ""
            known = known_state(saved["state"], part)
            state |= {name: (v.half() if v.is_floating_point() else v).contiguous() for name, v in known.items()}
        elif part not in about:
            raise InputError(path, "", "the fitted part", "nothing there")
    target.parent.mkdir(parents=True, exist_ok=True)
    safetensors.torch.save_file(state, target, about)
    target.chmod(0o644)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder of the checkpoints")
    parser.add_argument("--parts", nargs="+", choices=list(MINUTES), default=list(MINUTES))
    parser.add_argument("--minutes", type=float, help=f"per part (default: {MINUTES})")
    parser.add_argument("--on", action="store_true", help="go on from the packaged prior")
    parser.add_argument("--package", action="store_true", help=f"write what was fitted to {PRIOR.name} in the package")
    options = parser.parse_args()
    if options.package:
        package(options.out, PRIOR)
        return 0
    for part in options.parts:
        fit(options.out, part, options.minutes or MINUTES[part], on=options.on)
    return 0


if __name__ == "__main__":
    sys.exit(main())
