"""The colour of surface points of one posed avatar: body and parts by their shares (paper eq. 14).

The body's points are grouped by node; parts are evaluated where their ω is not zero. Differentiable in the fields'
parameters: training colours its samples here, too.

Letters: p points. Root frame, metres; colours sRGB-encoded.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from threading import Lock

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.fields.body import BodyFrame
from avatarrex.fields.composition import WHOLE
from avatarrex.fields.light import Irradiance
from avatarrex.fields.limbs import nodes_of
from avatarrex.ops.side_by_side import SideBySide
from avatarrex.parts.part import PartState, SurfacePoints
from avatarrex.shading.known_appearance import COARSEST, KnownAppearance, SeenAppearance, pixel_spacing
from avatarrex.shading.known_loops import TOLD, UNKNOWN
from avatarrex.shading.patch_cache import PatchCache
from avatarrex.templates.parts import PARTS
from avatarrex.templates.posed import PosedPerson

PIECE, LEAST_PIECE = 20_000, 2048
"""Points of the body that one thread colours before it takes others: half a picture at 512², or less where there are fewer. Smaller
pieces share fewer rows of a node (docs/performance.md)."""
OPAQUE = 0.999
"""Summed ω from which the body's own colour is not computed: its share is below 1/255."""


Learnt = tuple[Tensor, ...]
"""Arguments of `KnownAppearance.add`."""


@dataclass(frozen=True)
class EarlierViews:
    """What earlier views of a body pose showed, for a view of today."""

    known: KnownAppearance
    view: Camera
    """Root frame."""
    tolerance: float
    """sRGB."""


@dataclass(frozen=True)
class BodyPoints:
    """Points in which the body has a share."""

    position: Float[Tensor, "p 3"]
    direction: Float[Tensor, "p 3"]
    """Unit, from the eye."""
    limb: Int[Tensor, " p"]
    normal: Float[Tensor, "p 3"] | None

    def __getitem__(self, rows: slice) -> BodyPoints:
        normal = None if self.normal is None else self.normal[rows]
        return BodyPoints(self.position[rows], self.direction[rows], self.limb[rows], normal)


@dataclass
class SurfaceColour:
    """Colours of one frame; what a pose needs is decoded at its first use."""

    avatar: Avatar
    posed: PosedPerson
    body_frame: BodyFrame
    states: Mapping[str, PartState]
    """What each part prepared for this driving signal, by name; parts that are not there have no share in any point."""
    light: Irradiance
    """What falls on the person, root frame."""
    counters: Counters
    patches: PatchCache | None = None
    """Feature patches of this body pose."""
    sparse: bool = False
    """Few points: only the patches of the nodes in reach are decoded, and not kept."""
    earlier: EarlierViews | None = None
    """What earlier views of this body pose showed of it; None: every point is evaluated."""
    told: Float[Tensor, " 3"] | None = None
    """Unit direction, root frame, that the networks get in place of the real one, which texels and `earlier` keep; None: the real one."""
    _decoding: Lock = field(default_factory=Lock)

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
        work, body = SideBySide(), torch.nonzero(weight.sum(-1) < OPAQUE)[:, 0]
        limb = torch.full_like(body, WHOLE) if side is None else side.index_select(0, body)
        place, towards = position.index_select(0, body), self._said(direction.index_select(0, body))
        points = BodyPoints(place, towards, limb, None if normal is None else normal.index_select(0, body))
        seen = None if normal is None else self._seen(work, points.position)
        of_parts = [
            (weight[:, column], self._add_part(work, column, position, direction, weight))
            for column in range(len(PARTS))
        ]
        of_body = self._add_body(work, points, seen)
        run = work.run_in_turn if torch.is_grad_enabled() else work.run
        run()
        colour = torch.zeros_like(position)
        if len(body):
            pieces = [piece.result() for piece in of_body]
            own = torch.cat([found for found, _ in pieces])
            share_of_body = 1 - weight.index_select(0, body).sum(-1, keepdim=True)
            colour = colour.index_copy(0, body, share_of_body * own)
            self._remember([learnt for _, learnt in pieces if learnt])
        for share, (rows, part) in of_parts:
            if part:
                colour = colour.index_add(0, rows, share[rows, None] * part.result())
        return colour

    def _said(self, direction: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """What colour networks get as the viewing direction."""
        return direction if self.told is None else self.told.to(direction).expand_as(direction)

    def _add_part(
        self, work: SideBySide, column: int, position: Tensor, direction: Tensor, weight: Tensor
    ) -> tuple[Tensor, Future[Tensor] | None]:
        """Points in which a part has a share, and their colours to come."""
        rows, name = torch.nonzero(weight[:, column] > 0)[:, 0], PARTS[column]
        if not len(rows):
            return rows, None
        part, state = self.avatar.parts[name], self.states[name]
        part.decode_colour(state, self.counters)
        place, gaze = position.index_select(0, rows), direction.index_select(0, rows)
        points = surface_points(self.posed.root_from_part(name), place, gaze, self.light, self.told)
        return rows, work.add(part.colour, state, points, self.counters)

    def _seen(self, work: SideBySide, position: Tensor) -> Future[SeenAppearance] | None:
        """What earlier views tell, to come, for the body's points; None: every one is evaluated."""
        earlier = self.earlier
        if earlier is None or not len(position) or pixel_spacing(earlier.view, position).mean() >= COARSEST:
            return None
        return work.add(earlier.known.seen_by, earlier.view)

    def _add_body(
        self, work: SideBySide, points: BodyPoints, seen: Future[SeenAppearance] | None
    ) -> list[Future[tuple[Tensor, Learnt | None]]]:
        """Colours of the body to come, in pieces: points that lie together, row by row of the picture."""
        count = len(points.position)
        if count and self.patches is None and not self.sparse:
            self.patches = PatchCache.of(self.avatar.body.patch_network, self.body_frame.code.embedding)
        half = max(-(-count // 2), LEAST_PIECE)
        step = max(count, 1) if torch.is_grad_enabled() else min(half, PIECE)
        return [work.add(self._body, points[first : first + step], seen) for first in range(0, count, step)]

    def _body(self, points: BodyPoints, seen: Future[SeenAppearance] | None) -> tuple[Tensor, Learnt | None]:
        """Colours, and what becomes known. What earlier views tell was added to the work before this piece."""
        position, direction, limb, normal = points.position, points.direction, points.limb, points.normal
        if seen is None or normal is None or self.earlier is None:
            return self.avatar.body.seen(*self._appearance(position, limb), direction), None
        both, answer = seen.result().interpolate(position, normal, limb, self.earlier.tolerance)
        wanted = torch.nonzero(answer != TOLD)[:, 0]
        if len(wanted):
            place, side = position.index_select(0, wanted), limb.index_select(0, wanted)
            both.index_copy_(0, wanted, torch.cat(self._appearance(place, side), -1))
        colour = self.avatar.body.seen(both[:, :-3], both[:, -3:], direction)
        new = torch.nonzero(answer == UNKNOWN)[:, 0]
        return colour, tuple(values.index_select(0, new) for values in (position, normal, limb, both, colour))

    def _remember(self, learnt: list[Learnt]) -> None:
        """What was evaluated becomes known."""
        if self.earlier:
            for points in learnt:
                self.earlier.known.add(*points)

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
            assert self.patches
            with self._decoding:
                self.counters.add("patches_decoded", self.patches.decode(pairs.node))
            patches = self.patches.value
        self.counters.add("body_pixels", len(position))
        self.counters.add("local_mlp_evaluations", len(pairs.point))
        feature, light = body.appearance(frame, patches, position, pairs, light=self.light)
        assert light is not None
        return feature, light


def surface_points(
    root_from_part: np.ndarray,
    position: Float[Tensor, "p 3"],
    gaze: Float[Tensor, "p 3"],
    light: Irradiance,
    told: Float[Tensor, " 3"] | None = None,
) -> SurfacePoints:
    """Root-frame points and unit directions (from the eye) in a part's frame; `root_from_part` rigid (4, 4). `told`: the
    direction that networks get in place of the real one, root frame."""
    part_from_root = torch.as_tensor(np.linalg.inv(root_from_part)).to(position)
    turn = part_from_root[:3, :3].T
    root_turn = torch.as_tensor(root_from_part[:3, :3].copy()).to(position)
    direction = gaze if told is None else told.to(gaze).expand_as(gaze)
    return SurfacePoints(
        position @ turn + part_from_root[:3, 3], gaze @ turn, direction @ turn, direction, root_turn, light
    )
