"""How much of a key light and of the sky points see, marched through a distance field.

A cone of half angle α from a point: with d the distance at t along its axis and w = tan α,

    r = min_t d / (w t) ∈ [−1, 1]      share = ¼ (1 + r)² (2 − r)          (Quilez, 'soft shadows'; Aaltonen, GDC 2018)

which is 0 where the cone is filled, ½ where an edge halves it, 1 where it is free. The key light is one cone, as narrow as the
light; the sky nine of 60°, one along the normal and eight about it, weighed by the cosine.

Letters: p points, c cones. Root frame, metres. `_reference` reads like the equations; `shaders/stage/visibility.comp` has
the same steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import moderngl
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.gl.context import current_context, gl_context, gl_unavailable, per_context
from avatarrex.gl.grids import GridTextures
from avatarrex.gl.shader import compute_shader
from avatarrex.stage.distance import DistanceGrid

KEY_STEPS = 72
REACH = 3.2
"""Metres along the key light: the shadow of a raised hand by a light at 30°."""
LEAST_STEP, LONGEST_STEP, STEP = 0.008, 0.12, 0.8
"""Metres; and the share of the distance that a step takes, for the distance is interpolated."""
SKY_STEPS, SKY_START, SKY_GROWTH = 11, 0.02, 1.5
"""Steps of a wide cone are 2 cm, 3 cm … 1.2 m from its point."""
SKY_WIDTH = math.tan(math.radians(30))
AROUND = 8
"""Cones about the normal, at 60° from it."""
CENTRE, RING = 0.25, 0.75 / AROUND
"""Weights of the cone along the normal and of each about it: the integral of the cosine over what each stands for."""
RAMP = (-0.15, 0.35)
"""Cosines of normal and light between which a surface turns out of the light."""
GROUP = 64
CONSTANTS = {
    "KEY_STEPS": KEY_STEPS, "REACH": REACH, "LEAST_STEP": LEAST_STEP, "LONGEST_STEP": LONGEST_STEP, "STEP": STEP,
    "SKY_STEPS": SKY_STEPS, "SKY_START": SKY_START, "SKY_GROWTH": SKY_GROWTH, "SKY_WIDTH": SKY_WIDTH, "AROUND": AROUND,
    "CENTRE": CENTRE, "RING": RING, "RAMP_FROM": RAMP[0], "RAMP_TO": RAMP[1],
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Cone:
    """What a light fills, seen from anywhere."""

    direction: Float[np.ndarray, "3"]
    """Unit, towards the light."""
    width: float
    """Tangent of its angular radius."""


def available() -> tuple[str, ...]:
    """Names of the implementations that run here."""
    return ("reference",) if gl_unavailable() else ("reference", "gl")


def visibility(
    grid: DistanceGrid,
    points: Float[Tensor, "p 3"],
    normals: Float[Tensor, "p 3"],
    key: Cone,
    start: float,
    impl: str = "auto",
) -> Float[Tensor, "p 2"]:
    """Shares of the key light, which fills the cone `key`, and of the sky.

    Cones begin `start` metres off the points along the unit normals, so that a surface does not shade itself.
    `impl`: `auto`, `gl`, `reference`.
    """
    if impl == "auto":
        impl = available()[-1]
    made = _by_shader if impl == "gl" else _reference
    return made(grid, points + start * normals, normals, key)


def _reference(grid: DistanceGrid, origin: Tensor, normals: Tensor, key: Cone) -> Float[Tensor, "p 2"]:
    towards = torch.as_tensor(key.direction).to(origin).expand_as(origin)
    facing = ((normals * towards).sum(-1) - RAMP[0]) / (RAMP[1] - RAMP[0])
    facing = facing.clamp(0, 1)
    lit = facing * facing * (3 - 2 * facing) * _narrow_cone(grid, origin, towards, key.width)
    weights = [CENTRE] + [RING] * AROUND
    sky = sum(weight * _wide_cone(grid, origin, axis) for weight, axis in zip(weights, _axes(normals)))
    return torch.stack([lit, torch.as_tensor(sky)], -1)


def _share(free: Tensor) -> Tensor:
    """Of a cone, by the least r along it."""
    r = free.clamp(-1, 1)
    return 0.25 * (1 + r) ** 2 * (2 - r)


def _narrow_cone(grid: DistanceGrid, origin: Tensor, axis: Tensor, width: float) -> Tensor:
    t, free = torch.full_like(origin[:, 0], LEAST_STEP), torch.ones_like(origin[:, 0])
    for _ in range(KEY_STEPS):
        d = grid.sample(origin + t[:, None] * axis)
        free = torch.where(t < REACH, free.minimum(d / (width * t)), free)
        t = t + (STEP * d.abs()).clamp(LEAST_STEP, LONGEST_STEP)
    return _share(free)


def _wide_cone(grid: DistanceGrid, origin: Tensor, axis: Tensor) -> Tensor:
    free = torch.ones_like(origin[:, 0])
    for step in range(SKY_STEPS):
        t = SKY_START * SKY_GROWTH**step
        free = free.minimum(grid.sample(origin + t * axis) / (SKY_WIDTH * t))
    return _share(free)


def _axes(normals: Tensor) -> list[Tensor]:
    """Of the cones, (p, 3) each."""
    side = torch.tensor([1.0, 0.0, 0.0]).to(normals).expand_as(normals)
    other = torch.tensor([0.0, 0.0, 1.0]).to(normals).expand_as(normals)
    side = torch.where(normals[:, :1].abs() > 0.8, other, side)
    across = torch.nn.functional.normalize(torch.linalg.cross(normals, side), dim=-1)
    along = torch.linalg.cross(normals, across)
    turns = [2 * math.pi * k / AROUND for k in range(AROUND)]
    lean = math.sqrt(0.75)
    ring = [0.5 * normals + lean * (math.cos(a) * across + math.sin(a) * along) for a in turns]
    return [normals, *ring]


@current_context()
def _by_shader(grid: DistanceGrid, origin: Tensor, normals: Tensor, key: Cone) -> Float[Tensor, "p 2"]:
    context = gl_context()
    return per_context(context, "stage visibility", lambda: _Marcher(context)).march(grid, origin, normals, key)


class _Marcher:
    """The program and textures of one context."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context, self._textures = context, GridTextures(context)
        self._program = compute_shader(context, "stage/visibility.comp", CONSTANTS)

    def march(self, grid: DistanceGrid, origin: Tensor, normals: Tensor, key: Cone) -> Float[Tensor, "p 2"]:
        """See `visibility`."""
        count = len(origin)
        if not count:
            return origin.new_zeros(0, 2)
        rows = np.zeros((count, 8), np.float32)
        rows[:, :3], rows[:, 4:7] = origin.numpy(), normals.numpy()
        places, shares = self._context.buffer(rows.tobytes()), self._context.buffer(reserve=8 * count)
        self._textures.bind("stage distance", grid.values, 0)
        program = self._program
        program["u_origin"], program["u_voxel"] = tuple(np.asarray(grid.origin).tolist()), grid.voxel
        program["u_last"] = tuple(side - 1 for side in grid.values.shape[::-1])
        program["u_key"], program["u_width"] = tuple(key.direction.tolist()), key.width
        program["u_count"] = count
        places.bind_to_storage_buffer(0)
        shares.bind_to_storage_buffer(1)
        groups = -(-count // GROUP)
        program.run(min(groups, 32768), -(-groups // 32768))
        self._context.memory_barrier()
        found = np.frombuffer(shares.read(), np.float32).reshape(count, 2).copy()
        places.release()
        shares.release()
        return torch.from_numpy(found)
