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
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from avatarrex.fields.body import BodyField, BodyFrame
from avatarrex.fields.influence import Pairs, gate, influence, weighted_mean
from avatarrex.fields.presets import COMPACT
from avatarrex.measure.bench.contest import interleaved
from avatarrex.metrics.table import printed
from avatarrex.ops.closest_point import closest_point
from avatarrex.ops.closest_vertex import closest_vertex
from avatarrex.ops.crossings import winding
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.ops.search_tree import SearchTree
from avatarrex.ops.skinning import blend, invert_affine, skin
from avatarrex.signals.limits import random_signals
from avatarrex.templates.model import PosedTemplate, TemplateModel, pose_template
from avatarrex.templates.person import load_person

ANCHORS = {"node": (2048,), "blend": (2048,), "anchors": (512, 1024, 2048), "turned": (1024, 2048), "vertex": (2048,)}
"""Numbers of anchors that each is measured with."""
COST_POINTS = 100_000
WALKS, WALK_STEPS, WALK_STEP = 200, 100, 1e-4
"""Straight walks in each pose, steps of each, and metres of one."""
OFF_SKIN = 0.002
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
    table = matrices.reshape(-1, 12)
    mean, total = weighted_mean(table[pairs.node], weight, pairs, count)
    matrix = torch.where(total[:, None] > 0, mean, table[leader])
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

    def pose(self, scale: float, rng: np.random.Generator) -> Pose:
        """A random one of the body within `scale` times the joint limits."""
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
        model, faces = self.field.template, self.field.template.skin_faces()
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
    model, scales = load_person().body, (0.5, 1.0)
    print(
        f"{options.poses} poses each at half / full joint limits, {options.points} points per pose, seed {options.seed}"
    )
    titles = ("median mm", "p95 mm", "p99 mm", "lost per 1000", "step mm", "ms per 100 k points")
    row = printed("local frame", *titles, width=14)
    for name, anchors in ((name, anchors) for name, counts in ANCHORS.items() for anchors in counts):
        choice = Choice.of(model, name, anchors, options.seed)
        works = (errors_of, lost_of, steps_of)
        errors, lost, steps = ([over_poses(work, choice, scale, options) for scale in scales] for work in works)
        columns = [" / ".join(f"{np.percentile(e, q):.2f}" for e in errors) for q in (50, 95, 99)]
        columns.append(" / ".join(f"{1000 * found.mean():.1f}" for found in lost))
        columns.append(" / ".join(f"{np.percentile(found, 99):.2f}" for found in steps) if name != "node" else "–")
        row(name if name in VARIANTS else f"{name} {anchors}", *columns, f"{cost(choice, options.seed):.0f}")


Work = Callable[[Choice, Pose, int, np.random.Generator], np.ndarray]
"""What a choice does at so many points of a pose."""


def over_poses(work: Work, choice: Choice, scale: float, options: argparse.Namespace) -> np.ndarray:
    """Of random poses, joined."""
    rng = np.random.default_rng(options.seed)
    return np.concatenate([work(choice, choice.pose(scale, rng), options.points, rng) for _ in range(options.poses)])


def errors_of(choice: Choice, pose: Pose, count: int, rng: np.random.Generator) -> np.ndarray:
    """|perfect field| in mm at true surface points."""
    points = surface_points(choice.field.template, pose.template, count, rng)
    return np.asarray(1000 * choice.perfect_field(pose, points).abs().numpy())


def lost_of(choice: Choice, pose: Pose, count: int, rng: np.random.Generator) -> np.ndarray:
    """Whether the perfect field reads points inside the posed body as outside."""
    points = surface_points(choice.field.template, pose.template, count, rng).double()
    points += 0.015 * torch.from_numpy(rng.normal(size=points.shape))
    faces, mesh = choice.field.template.skin_faces(), pose.template.vertices.double()
    deep = closest_point(mesh, faces, points).sdf.abs() > 0.003
    tree = SearchTree.of_triangles(mesh.numpy(), faces.numpy())
    inside = deep & torch.from_numpy(winding(tree, points.numpy()) > 0)
    return (choice.perfect_field(pose, points[inside].float()) > 0).numpy()


def steps_of(choice: Choice, pose: Pose, count: int, rng: np.random.Generator) -> np.ndarray:
    """Largest step of the rest position in each of `WALKS` that begin about 1 cm off the skin, millimetres."""
    begin = surface_points(choice.field.template, pose.template, WALKS, rng)
    begin = begin + 0.01 * torch.as_tensor(rng.normal(size=begin.shape), dtype=begin.dtype)
    way = torch.nn.functional.normalize(torch.as_tensor(rng.normal(size=begin.shape), dtype=begin.dtype), dim=-1)
    path = begin[:, None] + WALK_STEP * torch.arange(WALK_STEPS)[:, None] * way[:, None]
    rest = choice.rest_position(pose, path.reshape(-1, 3)).reshape(path.shape)
    return np.asarray(1000 * (rest[:, 1:] - rest[:, :-1]).norm(dim=-1).amax(1).numpy())


def surface_points(model: TemplateModel, posed: PosedTemplate, count: int, rng: np.random.Generator) -> Tensor:
    """Uniform by area on the posed skin, of `count` points those that no other limb buries."""
    faces, vertices = model.skin_faces(), posed.vertices.double()
    a, b, c = vertices[faces].unbind(1)
    outward = torch.linalg.cross(b - a, c - a)
    area = outward.norm(dim=-1).numpy()
    pick = rng.choice(len(area), count, p=area / area.sum())
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weight = torch.as_tensor(np.stack([1 - u, u * (1 - v), u * v], 1))
    points = (weight[:, :, None] * vertices[faces[pick]]).sum(1)
    beside = points + OFF_SKIN * torch.nn.functional.normalize(outward[pick], dim=-1)
    tree = SearchTree.of_triangles(vertices.numpy(), faces.numpy())
    return points[torch.from_numpy(winding(tree, beside.numpy()) <= 0)].float()


def cost(choice: Choice, seed: int) -> float:
    """Milliseconds of `localise` for 100 k points near the surface, best of three."""
    rng = np.random.default_rng(seed)
    pose = choice.pose(0.5, rng)
    points = surface_points(choice.field.template, pose.template, COST_POINTS, rng)
    points = (points + 0.03 * torch.randn(points.shape))[points[:, 1].argsort()]
    pairs = choice.field.pairs(pose.frame, points)
    return min(interleaved({"": partial(choice.localise, pose, points, pairs)}, 3, warm=False)[""].wall)
