"""Which local frame? Error and cost of readings of the paper's T on the default person, without any learning.

    node     T = T_i, the node's own skinning matrix: one p̄ per pair
    blend    T = Σ w_i T_i / Σ w_i, gated by the rest distance that the strongest node sees
    vertex   T of the nearest template vertex
    anchors, turned: what avatars have (fields/local_frame.py), by the number of anchors

A *perfect* rest-pose field (the exact signed distance of the rest template) is evaluated at the rest position p̄ that
each choice assigns to true points of the posed surface. There it should read zero: what it reads is the accuracy
ceiling of everything learned on top. Lost: of points that are more than 3 mm inside the posed body, limbs united, about
3 cm off its skin at most, those with a rest position outside: holes, whatever is learned. Step: on straight walks by 0.1 mm
about the skin, the largest step of p̄, p99 of the walks: where it jumps, so does what is learned. Cost: p̄, local
coordinates and weights of all pairs.

    python -m avatarrex.measure local-frames [--poses 4] [--points 4000] [--seed 0]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from avatarrex.fields.body import BodyField, BodyFrame
from avatarrex.fields.influence import Pairs, gate, influence, weighted_mean
from avatarrex.fields.presets import COMPACT
from avatarrex.ops.closest_point import closest_point
from avatarrex.ops.closest_vertex import closest_vertex
from avatarrex.ops.crossings import winding
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.search_tree import SearchTree
from avatarrex.ops.skinning import blend, invert_affine, skin
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
WALKS, STEPS, STEP = 200, 100, 1e-4
"""Straight walks in each pose, steps of each, and metres of one."""
BESIDE = 0.002
"""Metres off the skin at which a point may lie in another limb."""


@dataclass(frozen=True)
class Pose:
    """A posed body without residuals of the nodes."""

    field: BodyField
    template: PosedTemplate
    frame: BodyFrame


RestPosition = Callable[[Pose, Tensor, Pairs], Tensor]
"""p̄ (k, 3) of the pairs of points (p, 3)."""


def of_nodes(pose: Pose, points: Tensor, pairs: Pairs) -> Tensor:
    """By the matrix of the pair's node."""
    return skin(invert_affine(pose.frame.node_from_rest)[pairs.node], points[pairs.point])


def of_blended_nodes(pose: Pose, points: Tensor, pairs: Pairs) -> Tensor:
    """By the influence-weighted blend of the nodes' matrices, one round of gating."""
    matrices, count = pose.frame.node_from_rest, len(points)
    weight = influence((points[pairs.point] - pose.frame.node_position[pairs.node]).square().sum(-1))
    strongest = weight.new_zeros(count).scatter_reduce(0, pairs.point, weight, "amax")
    leader = torch.zeros(count, dtype=torch.int64)
    wins = weight == strongest[pairs.point]
    leader[pairs.point[wins]] = pairs.node[wins]
    guess = skin(invert_affine(matrices)[leader], points)
    weight = weight * gate((guess[pairs.point] - pose.frame.node_rest[pairs.node]).square().sum(-1))
    total = weight.new_zeros(count).index_add(0, pairs.point, weight)
    table = matrices.reshape(-1, 12)
    summed = table.new_zeros(count, 12).index_add(0, pairs.point, weight[:, None] * table[pairs.node])
    reached = (total > 0)[:, None]
    matrix = torch.where(reached, summed / torch.where(reached, total[:, None], 1.0), table[leader])
    return skin(invert_affine(matrix.reshape(-1, 3, 4)), points)[pairs.point]


def of_the_nearest_vertex(pose: Pose, points: Tensor, pairs: Pairs) -> Tensor:
    """By the matrix of the template vertex that is nearest to the point."""
    model, vertices = pose.field.template, pose.template.vertices
    _, nearest = closest_vertex(SearchTree.of_vertices(vertices.numpy()), points.numpy())
    linear = blend(pose.template.skinning, model.weights[nearest])[:, :, :3]
    offset = vertices[nearest] - (linear @ model.v_template[nearest][:, :, None])[:, :, 0]
    return skin(invert_affine(torch.cat([linear, offset[:, :, None]], -1)), points)[pairs.point]


VARIANTS: dict[str, RestPosition] = {
    "node": of_nodes,
    "blend": of_blended_nodes,
    "vertex": of_the_nearest_vertex,
}
"""Readings that no avatar has."""


@dataclass(frozen=True)
class Choice:
    """A reading of T, on a field with so many anchors."""

    name: str
    field: BodyField

    @classmethod
    def of(cls, model: TemplateModel, name: str, anchors: int, seed: int) -> Choice:
        """Untrained: only places matter here."""
        widths = replace(COMPACT, body=replace(COMPACT.body, anchors=anchors))
        torch.manual_seed(seed)
        local_frame = "anchors" if name in VARIANTS else name
        return cls(name, BodyField(model, widths, seed, local_frame).requires_grad_(False))

    def poses(self, scale: float, options: argparse.Namespace, rng: np.random.Generator) -> Iterator[Pose]:
        """Random body poses within `scale` times the joint limits."""
        for _ in range(options.poses):
            yield self.pose(scale, rng)

    def pose(self, scale: float, rng: np.random.Generator) -> Pose:
        """One of them."""
        model = self.field.template
        rotvec = torch.zeros(len(model.parents), 3)
        rotvec[1:22] = torch.tensor(random_signals(rng, scale).body_pose, dtype=torch.float32)
        posed = pose_template(model, rotvec, torch.zeros(10), torch.zeros(model.expression_dirs.shape[2]))
        code = self.field.code(matrix_from_rotvec(rotvec[1:22]))
        return Pose(self.field, posed, self.field.frame(posed, replace(code, residual=torch.zeros_like(code.residual))))

    def localise(self, pose: Pose, points: Tensor, pairs: Pairs) -> tuple[Pairs, Tensor, Tensor]:
        """Pairs that have weight, local coordinates (k, 3) and weights (k,): `BodyField.localise`, or by a variant."""
        frame = pose.frame
        if self.name not in VARIANTS:
            return self.field.localise(frame, points, pairs)
        local = VARIANTS[self.name](pose, points, pairs) - frame.node_rest[pairs.node]
        squared = (points[pairs.point] - frame.node_position[pairs.node]).square().sum(-1)
        weight = influence(squared) * gate(local.square().sum(-1))
        kept = weight > 0
        return pairs.keep(kept), local[kept], weight[kept]

    def rest_position(self, pose: Pose, points: Tensor) -> Tensor:
        """p̄ of every point, itself where no node has it; not of `node`, where every pair has its own."""
        pairs, local, _ = self.localise(pose, points, self.field.pairs(pose.frame, points))
        one = points.clone()
        one[pairs.point] = local + pose.frame.node_rest[pairs.node]
        return one

    def perfect_field(self, pose: Pose, points: Tensor) -> Tensor:
        """Σ w_i s(p̄_i) / Σ w_i with s the rest template's exact distance, metres."""
        model, faces = self.field.template, skin_faces(self.field.template)
        if self.name != "node":
            return closest_point(model.v_template, faces, self.rest_position(pose, points)).sdf.float()
        pairs, local, weight = self.localise(pose, points, self.field.pairs(pose.frame, points))
        value = closest_point(model.v_template, faces, local + pose.frame.node_rest[pairs.node]).sdf.float()
        return weighted_mean(value[:, None], weight, pairs, len(points))[0][:, 0]


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
    titles = ("median mm", "p95 mm", "p99 mm", "lost per 1000", "step mm")
    print(f"{'local frame':<14}" + "".join(f" {title:>14}" for title in titles) + "   ms per 100 k points")
    for name, anchors in CHOICES:
        choice = Choice.of(model, name, anchors, options.seed)
        errors = [measure(choice, scale, options) for scale in (0.5, 1.0)]
        columns = [" / ".join(f"{np.percentile(e, q):.2f}" for e in errors) for q in (50, 95, 99)]
        columns.append(" / ".join(f"{1000 * lost(choice, scale, options):.1f}" for scale in (0.5, 1.0)))
        jumps = " / ".join(f"{steps(choice, scale, options):.2f}" for scale in (0.5, 1.0)) if name != "node" else "–"
        label = name if name in VARIANTS else f"{name} {anchors}"
        row = "".join(f" {column:>14}" for column in (*columns, jumps))
        print(f"{label:<14}{row}   {cost(choice, options.seed):.0f}", flush=True)


def measure(choice: Choice, scale: float, options: argparse.Namespace) -> np.ndarray:
    """|perfect field| in mm at true surface points of random poses."""
    rng, errors = np.random.default_rng(options.seed), []
    for pose in choice.poses(scale, options, rng):
        points = surface_points(choice.field.template, pose.template, options.points, rng)
        errors.append(1000 * choice.perfect_field(pose, points).abs().numpy())
    return np.concatenate(errors)


def lost(choice: Choice, scale: float, options: argparse.Namespace) -> float:
    """Share of points inside the posed body that the perfect field reads as outside."""
    rng, found = np.random.default_rng(options.seed), []
    for pose in choice.poses(scale, options, rng):
        points = surface_points(choice.field.template, pose.template, options.points, rng).double()
        points += 0.015 * torch.from_numpy(rng.normal(size=points.shape))
        faces, mesh = skin_faces(choice.field.template), pose.template.vertices.double()
        deep = closest_point(mesh, faces, points).sdf.abs() > 0.003
        inside = deep & torch.from_numpy(
            winding(SearchTree.of_triangles(mesh.numpy(), faces.numpy()), points.numpy()) > 0
        )
        found.append((choice.perfect_field(pose, points[inside].float()) > 0).numpy())
    return float(np.concatenate(found).mean())


def steps(choice: Choice, scale: float, options: argparse.Namespace) -> float:
    """Largest step of the rest position in a walk that begins about 1 cm off the skin, p99 of the walks; millimetres."""
    rng, found = np.random.default_rng(options.seed), []
    for pose in choice.poses(scale, options, rng):
        begin = surface_points(choice.field.template, pose.template, WALKS, rng)
        begin = begin + 0.01 * torch.as_tensor(rng.normal(size=begin.shape), dtype=begin.dtype)
        way = torch.nn.functional.normalize(torch.as_tensor(rng.normal(size=begin.shape), dtype=begin.dtype), dim=-1)
        path = begin[:, None] + STEP * torch.arange(STEPS)[:, None] * way[:, None]
        rest = choice.rest_position(pose, path.reshape(-1, 3)).reshape(path.shape)
        found.append((rest[:, 1:] - rest[:, :-1]).norm(dim=-1).amax(1).numpy())
    return float(1000 * np.percentile(np.concatenate(found), 99))


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
    tree = SearchTree.of_triangles(posed.vertices.double().numpy(), skin_faces(model).numpy())
    return points[torch.from_numpy(winding(tree, (points + BESIDE * outward).numpy()) <= 0)].float()


def cost(choice: Choice, seed: int) -> float:
    """Milliseconds of `localise` for 100 k points near the surface, best of three."""
    rng = np.random.default_rng(seed)
    pose = choice.pose(0.5, rng)
    points = surface_points(choice.field.template, pose.template, COST_POINTS, rng)
    points = (points + 0.03 * torch.randn(points.shape))[points[:, 1].argsort()]
    pairs = choice.field.pairs(pose.frame, points)
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        choice.localise(pose, points, pairs)
        best = min(best, time.perf_counter() - start)
    return 1000 * best
