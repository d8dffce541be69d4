"""Which local frame? Error and cost of every `local_frame` on the default person, without any learning.

A *perfect* rest-pose field (the exact signed distance of the rest template) is evaluated at the rest position p̄ that
each choice assigns to true points of the posed surface. There it should read zero: what it reads is the accuracy
ceiling of everything learned on top. Lost: of points that are more than 3 mm inside the posed body, limbs united, about
3 cm off its skin at most, those that come to rest outside: holes, whatever is learned. Step: on straight walks by 0.1 mm
about the skin, the largest step of p̄, p99 of the walks: where it jumps, so does what is learned. Cost:
`BodyField.localise` (p̄, local coordinates and weights of all pairs).

    python -m avatarrex.measure local-frames [--poses 4] [--points 4000] [--seed 0]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from avatarrex.capture.synthetic.winding import RayWinding
from avatarrex.fields.body import BodyField, BodyFrame
from avatarrex.fields.influence import weighted_mean
from avatarrex.fields.presets import COMPACT
from avatarrex.ops.closest_point import closest_point
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.signals.limits import random_signals
from avatarrex.templates.model import PosedTemplate, TemplateModel, pose_template
from avatarrex.templates.person import load_person

CHOICES = [
    ("node", 2048),
    ("blend", 2048),
    *(("anchors", count) for count in (512, 1024, 2048)),
    ("turned", 1024),
    ("turned", 2048),
    ("vertex", 2048),
]
COST_POINTS = 100_000
WALKS, PACES, PACE = 200, 100, 1e-4
"""Straight walks in each pose, paces of each, and metres of one."""
BESIDE = 0.002
"""Metres off the skin at which it is asked whether another limb is there."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many poses and points."""
    parser.add_argument("--poses", type=int, default=4, help="poses per scale")
    parser.add_argument("--points", type=int, default=4000, help="surface points per pose")
    parser.add_argument("--seed", type=int, default=0)


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    model = load_person().body
    print(
        f"{options.poses} poses each at half / full joint limits, {options.points} points per pose, seed {options.seed}"
    )
    print(
        f"{'local frame':<14} {'median mm':>14} {'p95 mm':>14} {'p99 mm':>14} {'lost per 1000':>14} {'step mm':>14}   ms per 100 k points"
    )
    for name, anchors in CHOICES:
        widths = replace(COMPACT, body=replace(COMPACT.body, anchors=anchors))
        torch.manual_seed(options.seed)
        field = BodyField(model, widths, options.seed, name).requires_grad_(False)
        errors = [measure(field, scale, options) for scale in (0.5, 1.0)]
        share = " / ".join(f"{1000 * lost(field, scale, options):.1f}" for scale in (0.5, 1.0))
        columns = [" / ".join(f"{np.percentile(e, q):.2f}" for e in errors) for q in (50, 95, 99)]
        jumps = " / ".join(f"{steps(field, scale, options):.2f}" for scale in (0.5, 1.0)) if name != "node" else "–"
        label = f"{name} {anchors}" if name in ("anchors", "turned") else name
        print(
            f"{label:<14} {columns[0]:>14} {columns[1]:>14} {columns[2]:>14} {share:>14} {jumps:>14}   {cost(field, options.seed):.0f}",
            flush=True,
        )


def measure(field: BodyField, scale: float, options: argparse.Namespace) -> np.ndarray:
    """|perfect field| in mm at true surface points of random poses."""
    rng = np.random.default_rng(options.seed)
    errors = []
    for _ in range(options.poses):
        posed, frame = pose(field, rng, scale)
        points = surface_points(field.template, posed, options.points, rng)
        errors.append(1000 * perfect_field(field, frame, points).abs().numpy())
    return np.concatenate(errors)


def lost(field: BodyField, scale: float, options: argparse.Namespace) -> float:
    """Share of points inside the posed body that the perfect field reads as outside."""
    rng = np.random.default_rng(options.seed)
    found = []
    for _ in range(options.poses):
        posed, frame = pose(field, rng, scale)
        points = surface_points(field.template, posed, options.points, rng).double()
        points += 0.015 * torch.from_numpy(rng.normal(size=points.shape))
        skin, mesh = skin_faces(field.template), posed.vertices.double()
        deep = closest_point(mesh, skin, points).sdf.abs() > 0.003
        inside = deep & torch.from_numpy(RayWinding(mesh.numpy(), skin.numpy())(points.numpy()) > 0)
        found.append((perfect_field(field, frame, points[inside].float()) > 0).numpy())
    return float(np.concatenate(found).mean())


def steps(field: BodyField, scale: float, options: argparse.Namespace) -> float:
    """Largest step of the rest position in a walk that begins about 1 cm off the skin, p99 of the walks; millimetres."""
    rng = np.random.default_rng(options.seed)
    found = []
    for _ in range(options.poses):
        posed, frame = pose(field, rng, scale)
        begin = surface_points(field.template, posed, WALKS, rng)
        begin = begin + 0.01 * torch.as_tensor(rng.normal(size=begin.shape), dtype=begin.dtype)
        way = torch.nn.functional.normalize(torch.as_tensor(rng.normal(size=begin.shape), dtype=begin.dtype), dim=-1)
        path = begin[:, None] + PACE * torch.arange(PACES)[:, None] * way[:, None]
        rest = rest_position(field, frame, path.reshape(-1, 3)).reshape(path.shape)
        found.append((rest[:, 1:] - rest[:, :-1]).norm(dim=-1).amax(1).numpy())
    return float(1000 * np.percentile(np.concatenate(found), 99))


def pose(field: BodyField, rng: np.random.Generator, scale: float) -> tuple[PosedTemplate, BodyFrame]:
    """A random body pose within `scale` times the joint limits, with no residual of the nodes."""
    model = field.template
    rotvec = torch.zeros(len(model.parents), 3)
    rotvec[1:22] = torch.tensor(random_signals(rng, scale).body_pose, dtype=torch.float32)
    posed = pose_template(model, rotvec, torch.zeros(10), torch.zeros(model.expression_dirs.shape[2]))
    code = field.code(matrix_from_rotvec(rotvec[1:22]))
    return posed, field.frame(posed, replace(code, residual=torch.zeros_like(code.residual)))


def skin_faces(model: TemplateModel) -> Tensor:
    """The outer skin: no teeth, tongue or eyeballs."""
    inner = torch.zeros(len(model.v_template), dtype=torch.bool)
    for name, vertices in model.groups.items():
        if name != "body":
            inner[vertices] = True
    return model.faces[~inner[model.faces].any(1)]


def surface_points(model: TemplateModel, posed: PosedTemplate, count: int, rng: np.random.Generator) -> Tensor:
    """Uniform by area on the posed skin, of `count` points those that no other limb buries."""
    a, b, c = posed.vertices[skin_faces(model)].double().unbind(1)
    area = torch.linalg.cross(b - a, c - a).norm(dim=-1).numpy()
    pick = rng.choice(len(area), count, p=area / area.sum())
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weight = torch.as_tensor(np.stack([1 - u, u * (1 - v), u * v], 1))
    corners = torch.stack([a[pick], b[pick], c[pick]], 1)
    points = (weight[:, :, None] * corners).sum(1)
    outward = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=-1)[pick]
    buried = (
        RayWinding(posed.vertices.double().numpy(), skin_faces(model).numpy())((points + BESIDE * outward).numpy()) > 0
    )
    return points[torch.from_numpy(~buried)].float()


def perfect_field(field: BodyField, frame: BodyFrame, points: Tensor) -> Tensor:
    """Σ w_i s(p̄_i) / Σ w_i with s the rest template's exact distance, metres."""
    model, faces = field.template, skin_faces(field.template)
    if field.local_frame == "node":
        pairs, local, weight = field.localise(frame, points, field.pairs(frame, points))
        value = closest_point(model.v_template, faces, local + frame.node_rest[pairs.node]).sdf.float()
        return weighted_mean(value[:, None], weight, pairs, len(points))[0][:, 0]
    return closest_point(model.v_template, faces, rest_position(field, frame, points)).sdf.float()


def rest_position(field: BodyField, frame: BodyFrame, points: Tensor) -> Tensor:
    """p̄ of every point, itself where no node has it; not of `node`, where every pair has its own."""
    pairs, local, _ = field.localise(frame, points, field.pairs(frame, points))
    one = points.clone()
    one[pairs.point] = local + frame.node_rest[pairs.node]
    return one


def cost(field: BodyField, seed: int) -> float:
    """Milliseconds of `localise` for 100 k points near the surface, best of three."""
    rng = np.random.default_rng(seed)
    posed, frame = pose(field, rng, 0.5)
    points = surface_points(field.template, posed, COST_POINTS, rng)
    points = (points + 0.03 * torch.randn(points.shape))[points[:, 1].argsort()]
    pairs = field.pairs(frame, points)
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        field.localise(frame, points, pairs)
        best = min(best, time.perf_counter() - start)
    return 1000 * best
