"""Stage `sdf`: signed distances of lattice points to a hand, a body's skin and a mesh of slivers, on one core.

Judged in float64: distances by libigl's tree, signs by the winding number; without libigl by trying every triangle, on some
of the points. Errors count inside the band −0.05 … 0.025 m that the composition uses. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from avatarrex.measure.bench.contest import Contest, Contestant, Goal, installed, interleaved, one_core, timed
from avatarrex.measure.bench.report import FASTER, SLOWER, Metric
from avatarrex.measure.bench.sdf_peers import BOUND, PEERS, SLOW, Measured, libigl, ours
from avatarrex.measure.bench.session import SEED, Bench
from avatarrex.ops.closest_point import closest_point
from avatarrex.ops.pseudonormal import winding_number
from avatarrex.templates.model import TemplateModel

POINTS_WITHIN = 0.075
"""Metres around the mesh's vertices in which points lie: the band and what a culling may skip beyond it."""
SIGNED_FROM = 1e-6
"""Metres: nearer to the surface a sign says nothing."""
SLIVER = 1e-4
"""Width over length of the sliver mesh's triangles."""
GOALS = Goal("sdf.vs_libigl", "libigl", SLOWER, 1.0), Goal("sdf.vs_brute", "brute_force", FASTER, 30.0)


@dataclass(frozen=True)
class Case:
    """A mesh, points around it, and the truth."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    points: np.ndarray
    truth: np.ndarray
    """(p,) float64, NaN where it was not computed."""
    oracle: str

    def error(self, found: np.ndarray, stride: int = 1, signed: bool = True) -> dict[str, Any]:
        """Of distances to every `stride`-th point."""
        truth = self.truth[::stride]
        inside = (truth > BOUND[0]) & (truth < BOUND[1])
        counted = np.abs(found[inside]) - np.abs(truth[inside])
        wrong = np.abs(counted) if not np.isnan(counted).any() else np.array([np.inf])
        error: dict[str, Any] = {"max_error_m": float(wrong.max()), "points": int(inside.sum())}
        if signed:
            clear = inside & (np.abs(truth) > SIGNED_FROM)
            error["sign_errors"] = int(np.sum((found[clear] < 0) != (truth[clear] < 0)))
        return error


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    found = bench.once(contests)
    mine = {contest.case: contest.best.error for contest in found}
    worst = max(error["max_error_m"] for error in mine.values())
    metrics = [
        Metric("sdf.max_error_m", worst, "m", target=1e-6, error=mine),
        Metric("sdf.sign_errors", sum(error["sign_errors"] for error in mine.values()), "points", target=0, error=mine),
    ]
    for goal in GOALS:
        metrics += goal.metrics(found, "by_mesh", max_error_m=worst, cores=1)
    bench.absent |= {goal.name: f"not installed: {goal.peer}" for goal in GOALS if goal.peer not in found[0].named}
    return metrics + [metric for contest in found for metric in contest.metrics()]


def contests(bench: Bench) -> list[Contest]:
    """One per mesh."""
    with one_core():
        return [_contest(bench, case) for case in cases(bench)]


def cases(bench: Bench) -> list[Case]:
    """Hand, body, slivers."""
    person, count = bench.avatar.person, bench.count(64_000, 16_000)
    meshes = {"hand": _skin(person.left_hand.model), "body": _skin(person.body), "sliver": sliver_mesh()}
    return [_case(bench, name, *mesh, count) for name, mesh in meshes.items()]


def _skin(model: TemplateModel) -> tuple[np.ndarray, np.ndarray]:
    """Float64 vertices and faces."""
    used, faces = torch.unique(model.skin_faces(), return_inverse=True)
    return model.v_template.double().numpy()[used], faces.numpy()


def sliver_mesh() -> tuple[np.ndarray, np.ndarray]:
    """A closed tube with a 5 cm radius, 30 cm long, of triangles 15 cm long and 15 µm wide between wide ones."""
    around, length, wide = 64, 0.15, 2 * np.pi / 64
    narrow = SLIVER * length / 0.05
    angles = (wide * np.arange(around)[:, None] + [0, narrow]).reshape(-1)
    rings = [np.stack([0.05 * np.cos(angles), np.full_like(angles, y), 0.05 * np.sin(angles)], 1)
             for y in (-length, 0.0, length)]  # fmt: skip
    a = np.arange(len(angles))
    b, (bottom, middle, top) = np.roll(a, -1), len(angles) * np.arange(3)
    sides = [
        face
        for low, high in ((bottom, middle), (middle, top))
        for face in ((a + low, a + high, b + low), (b + low, a + high, b + high))
    ]
    lids = [(np.full_like(a, 3 * len(a)), a, b), (np.full_like(a, 3 * len(a) + 1), b + top, a + top)]
    vertices = np.concatenate([*rings, [[0, -length, 0], [0, length, 0]]])
    return vertices, np.stack([np.stack(face, 1) for face in (*sides, *lids)], 1).reshape(-1, 3)


def _around(vertices: np.ndarray, count: int) -> np.ndarray:
    """About `count` points of a jittered lattice, in its order, within `POINTS_WITHIN` of the vertices."""
    rng, tree = np.random.default_rng(SEED), cKDTree(vertices)
    low, high = vertices.min(0) - POINTS_WITHIN, vertices.max(0) + POINTS_WITHIN
    spacing = float(np.prod(high - low) / count) ** (1 / 3)
    for _ in range(3):
        axes = [np.arange(a, b, spacing) for a, b in zip(low, high)]
        lattice = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        points = lattice[tree.query(lattice)[0] < POINTS_WITHIN]
        spacing *= (len(points) / count) ** (1 / 3)
    return np.asarray(points + rng.uniform(-0.3, 0.3, points.shape) * spacing)


def _case(bench: Bench, name: str, vertices: np.ndarray, faces: np.ndarray, count: int) -> Case:
    points = _around(vertices, count)
    # Float32, so that every contestant gets the same query.
    vertices, points = (array.astype(np.float32).astype(np.float64) for array in (vertices, points))
    if find_spec("igl") is not None:
        import igl

        distance = np.abs(libigl(vertices, faces, points, bound=False)())
        inside = igl.fast_winding_number(vertices, faces.astype(np.int64), points) > 0.5
        return Case(name, vertices, faces, points, np.where(inside, -distance, distance), "libigl, winding number")
    some = bench.count(1000, 300)
    stride = max(1, len(points) // some)
    mesh, corners, query = torch.as_tensor(vertices), torch.as_tensor(faces), torch.as_tensor(points[::stride])
    distance = closest_point(mesh, corners, query, impl="reference").sdf.abs().numpy()
    inside = (winding_number(mesh, corners, query) > 0.5).numpy()
    truth = np.full(len(points), np.nan)
    truth[::stride] = np.where(inside, -distance, distance)
    return Case(name, vertices, faces, points, truth, "every triangle")


def _contest(bench: Bench, case: Case) -> Contest:
    name, work = f"sdf.{case.name}", (case.vertices, case.faces, case.points)
    ready = installed(PEERS, bench.absent, name, *work)
    runners: dict[str, Measured] = {"ours": ours(*work), **ready}
    if "libigl" in ready:
        runners["ours_by_libigl"] = ours(*work, impl="igl")
    times = interleaved(runners, bench.count(5, 2))
    entries = [
        Contestant(who, times[who], {**case.error(run()), "oracle": case.oracle}, ours=who == "ours")
        for who, run in runners.items()
    ]
    stride = max(1, len(case.points) // bench.count(2000, 600))
    some = case.points[::stride]
    for who, run in installed(SLOW, bench.absent, name, case.vertices, case.faces, some).items():
        found, took = timed(run)
        note = {"measured_points": len(some), "scaled_to": len(case.points)}
        error = case.error(found, stride, signed=who != "brute_force")
        entries.append(Contestant(who, took.scaled(len(case.points) / len(some)), {**error, **note}))
    return Contest(name, tuple(entries), cpu=True)
