"""Vertices moved onto the zero of the exact field: along their mesh's normals, or along a gaze at them.

Letters: v vertices, f faces. Root frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from avatarrex.distil.exact import ExactPose
from avatarrex.templates.mesh import vertex_normals

SURFACE_STEPS = 3
LONGEST_STEP = 0.01
"""Metres of one step."""
ON_SURFACE = 5e-4
"""Metres of |s| up to which a vertex counts as on the surface."""
GAZE_STEPS = 40
STEEPEST = 0.5
"""Of what the field says: its slope is up to 2 in places."""


@torch.no_grad()
def onto_field(
    exact: ExactPose, start: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"], most: Float[Tensor, " v"]
) -> tuple[Float[Tensor, "v 3"], Float[Tensor, " v"]]:
    """The vertices, moved by at most `most`, and how far off the zero they are; one that does not arrive stays at its start."""
    position, longest = start, torch.tensor(LONGEST_STEP)
    for _ in range(SURFACE_STEPS):
        step = -exact.field.sdf(position)[:, None] * vertex_normals(position, faces)
        position = start + at_most(position + at_most(step, longest) - start, most)
    missed = exact.field.sdf(position).abs()
    return torch.where((missed < ON_SURFACE)[:, None], position, start), missed


@torch.no_grad()
def met_from(
    sdf: Callable[[Tensor], Tensor], eye: Float[Tensor, "3"], position: Float[Tensor, "v 3"]
) -> Float[Tensor, "v 3"]:
    """Where a gaze from `eye` towards each vertex first meets the zero of `sdf`; as far as it came where it meets none."""
    gaze = normalize(position - eye, dim=-1)
    at = eye.expand(len(position), 3)
    for _ in range(GAZE_STEPS):
        at = at + at_most(STEEPEST * sdf(at)[:, None] * gaze, torch.tensor(LONGEST_STEP))
    return at


def at_most(move: Float[Tensor, "v 3"], length: Tensor) -> Float[Tensor, "v 3"]:
    """Moves no longer than `length`, one for all or one for each."""
    shorter: Tensor = (length / move.norm(dim=-1).clamp_min(1e-9)).clamp(max=1)
    return move * shorter[:, None]
