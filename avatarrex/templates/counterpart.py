"""Where the body's vertices lie on a part's own mesh: the same vertices of a part that is cut out, else the closest points at rest.

Letters: v vertices of the body, p of the part. Metres, in the frame of the part's first joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.ops.closest_point import closest_point
from avatarrex.templates.parts import PART_JOINT
from avatarrex.templates.person import Person


@dataclass(frozen=True, eq=False)
class Counterpart:
    """By vertex of the body."""

    corners: Int[Tensor, "v 3"]
    """Vertices of the part's mesh."""
    shares: Float[Tensor, "v 3"]
    """Of each corner; they sum to one."""
    aside: Float[Tensor, "v 3"]
    """How far off the point at rest."""

    def posed(self, vertices: Float[Tensor, "p 3"], rows: Int[Tensor, " _n"]) -> Float[Tensor, "_n 3"]:
        """Where `rows` of the body are on the part's posed `vertices`."""
        return (vertices[self.corners[rows]] * self.shares[rows, :, None]).sum(1) + self.aside[rows]


@lru_cache(maxsize=8)
@torch.inference_mode(False)
def counterpart(person: Person, name: str) -> Counterpart:
    """Of one of `PARTS`."""
    model, ids = person.part(name).model, person.part(name).body_vertex_ids
    place = person.body.v_template - person.body.joint_template[PART_JOINT[name]]
    known = ids >= 0
    rows = torch.nonzero(known)[:, 0]
    if len(rows):
        corners = torch.zeros(len(place), 3, dtype=torch.long)
        corners[ids[known]] = rows[:, None]
        shares = torch.eye(3)[:1].repeat(len(place), 1)
        return Counterpart(corners, shares, torch.zeros(len(place), 3))
    found = closest_point(model.v_template, model.faces, place, None)
    corners, shares = model.faces[found.face], found.barycentric.to(place)
    return Counterpart(corners, shares, place - (model.v_template[corners] * shares[..., None]).sum(1))
