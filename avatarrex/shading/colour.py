"""The colour of surface points of one posed avatar: body and parts by their shares (paper eq. 14).

The body's points are grouped by node; parts are evaluated where their ω is not zero. Differentiable in the fields'
parameters: training colours its samples here, too.

Letters: p points. Root frame, metres; colours sRGB-encoded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.fields.body import BodyFrame
from avatarrex.fields.composition import WHOLE
from avatarrex.fields.limbs import nodes_of
from avatarrex.parts.part import PartState, SurfacePoints
from avatarrex.shading.known_appearance import COARSEST, KnownAppearance, pixel_spacing
from avatarrex.shading.known_loops import TOLD, UNKNOWN
from avatarrex.shading.patch_cache import PatchCache
from avatarrex.templates.parts import PARTS
from avatarrex.templates.posed import PosedPerson

OPAQUE = 0.999
"""Summed ω from which the body's own colour is not computed: its share is below 1/255."""


@dataclass(frozen=True)
class EarlierViews:
    """What earlier views of a body pose showed, for a view of today."""

    known: KnownAppearance
    view: Camera
    """Root frame."""
    tolerance: float
    """sRGB."""


@dataclass
class SurfaceColour:
    """Colours of one frame; what a pose needs is decoded at its first use."""

    avatar: Avatar
    posed: PosedPerson
    body_frame: BodyFrame
    states: Mapping[str, PartState]
    """What each part prepared for this driving signal, by name; parts that are not there have no share in any point."""
    counters: Counters
    patches: PatchCache | None = None
    """Feature patches of this body pose."""
    sparse: bool = False
    """Few points: only the patches of the nodes in reach are decoded, and not kept."""
    earlier: EarlierViews | None = None
    """What earlier views of this body pose showed of it; None: every point is evaluated."""

    def colour(
        self,
        position: Float[Tensor, "p 3"],
        direction: Float[Tensor, "p 3"],
        weight: Float[Tensor, "p k"],
        side: Int[Tensor, " p"] | None = None,
        normal: Float[Tensor, "p 3"] | None = None,
    ) -> Float[Tensor, "p 3"]:
        """Colours of points seen along unit `direction` (from the eye), with the parts' shares `weight`.

        `side`: the limb that each point is on (`Composed.side`); None: the whole body. `normal`: of the surface there, which
        `earlier` needs.
        """
        colour = torch.zeros_like(position)
        body = torch.nonzero(weight.sum(-1) < OPAQUE)[:, 0]
        if len(body):
            limb = torch.full_like(body, WHOLE) if side is None else side[body]
            share = 1 - weight[body].sum(-1, keepdim=True)
            coarse = self.earlier is None or pixel_spacing(self.earlier.view, position).mean() >= COARSEST
            if self.earlier is None or normal is None or coarse:
                own = self._body(position[body], direction[body], limb)
            else:
                own = self._body_seen_before(position[body], direction[body], limb, normal[body], self.earlier)
            colour = colour.index_add(0, body, share * own)
        for column, name in enumerate(PARTS):
            rows = torch.nonzero(weight[:, column] > 0)[:, 0]
            if len(rows):
                points = surface_points(self.posed.root_from_part(name), position[rows], direction[rows])
                part = self.avatar.parts[name].colour(self.states[name], points, self.counters)
                colour = colour.index_add(0, rows, weight[rows, column, None] * part)
        return colour

    def _body(self, position: Tensor, direction: Tensor, limb: Tensor) -> Tensor:
        return self.avatar.body.seen(*self._appearance(position, limb), direction)

    def _body_seen_before(
        self, position: Tensor, direction: Tensor, limb: Tensor, normal: Tensor, earlier: EarlierViews
    ) -> Tensor:
        """`_body` where points between known ones are interpolated, and the others become known."""
        both, answer = earlier.known.interpolate(earlier.view, position, normal, limb, earlier.tolerance)
        wanted = torch.nonzero(answer != TOLD)[:, 0]
        if len(wanted):
            both[wanted] = torch.cat(self._appearance(position[wanted], limb[wanted]), -1)
        colour: Tensor = self.avatar.body.seen(both[:, :-3], both[:, -3:], direction)
        new = wanted[answer[wanted] == UNKNOWN]
        earlier.known.add(position[new], normal[new], limb[new], both[new], colour[new])
        return colour

    def _appearance(self, position: Tensor, limb: Tensor) -> tuple[Tensor, Tensor]:
        """Features of the body and the light on it, limb by limb."""
        limbs = limb.unique().tolist()
        if len(limbs) == 1:
            return self._appearance_of(position, limbs[0])
        rows = [torch.nonzero(limb == one)[:, 0] for one in limbs]
        found = [self._appearance_of(position[some], one) for some, one in zip(rows, limbs)]
        back = torch.cat(rows).argsort()
        feature, light = (torch.cat(each).index_select(0, back) for each in zip(*found))
        return feature, light

    def _appearance_of(self, position: Tensor, limb: int) -> tuple[Tensor, Tensor]:
        body = self.avatar.body
        frame = self.body_frame.restricted(nodes_of(self.avatar.ownership, limb))
        pairs = body.pairs(frame, position)
        patches = None
        if not self.sparse:
            if self.patches is None:
                self.patches = PatchCache.of(body.patch_network, frame.code.embedding)
            self.counters.add("patches_decoded", self.patches.decode(pairs.node))
            patches = self.patches.value
        self.counters.add("body_pixels", len(position))
        self.counters.add("local_mlp_evaluations", len(pairs.point))
        feature, light = body.appearance(frame, patches, position, pairs, light=self.avatar.light)
        assert light is not None
        return feature, light


def surface_points(
    root_from_part: np.ndarray, position: Float[Tensor, "p 3"], direction: Float[Tensor, "p 3"]
) -> SurfacePoints:
    """Root-frame points and unit directions (from the eye) in a part's frame; `root_from_part` rigid (4, 4)."""
    part_from_root = torch.as_tensor(np.linalg.inv(root_from_part)).to(position)
    turn = part_from_root[:3, :3].T
    root_turn = torch.as_tensor(root_from_part[:3, :3].copy()).to(position)
    return SurfacePoints(position @ turn + part_from_root[:3, 3], direction @ turn, direction, root_turn)
