"""The face as a part: tri-planes of this expression near the face mesh, ω of its nearest vertices (paper sec. 3.3).

Expressions that no picture of its training showed are carried by the template (`carried.py`).
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.fields.detail_texture import TexelPlaces
from avatarrex.fields.face import FaceField, surface_normal
from avatarrex.fields.face_sheets import share_beside
from avatarrex.fields.template_distance import TemplateDistance
from avatarrex.fields.tone import ToneMap
from avatarrex.ops.mesh_lattice import Grid, nearest_vertex
from avatarrex.ops.outer_triangle import outer_triangle
from avatarrex.ops.search_tree import SearchTree
from avatarrex.ops.side_by_side import SideBySide
from avatarrex.parts.carried import MOVED, REACH, Carried, PosedMesh, Seen
from avatarrex.parts.known_expressions import KnownExpressions
from avatarrex.parts.part import CLAMP, Impl, Part, PartState, Start, SurfacePoints
from avatarrex.parts.reshaped import Reshaped
from avatarrex.templates.blend_weight import smooth_ramp
from avatarrex.templates.face import FaceTemplate
from avatarrex.templates.mesh import vertex_normals

FACE_BAND = 0.03
"""Metres around the face mesh in which the face field is evaluated and blended: from +0.025 on it is not used."""
FIRST_BAND = 0.012
"""Metres from the face mesh that are evaluated at the coarse level; from there the surface is followed."""

WIDER = (0.004, 0.012)
"""Metres by which a jaw goes beyond the known ones where the mouth begins to have the template's colours, and has no others."""
THROUGH = (0.004, 0.15)
"""Metres before and behind a point in which a triangle is seen through it: a throat lies 11 cm behind lips."""
ROUNDED = 1e-6
"""Metres by which a known mesh differs from itself, carried from one expression or another."""
SHADOW = 0.6
"""Of the template's colours, within lips."""

Met = tuple[Int[np.ndarray, " p"], Float[np.ndarray, "p 3"], Float[np.ndarray, "p 3"]]


class PosedTriangles:
    """The triangles of a posed face; trees of them are made when a point is first coloured. Each method returns triangles, barycentrics on
    them, and what the points are off these places, metres."""

    def __init__(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
        self.vertices, self.faces = vertices, faces
        self._outer: SearchTree | None = None

    @cached_property
    def _whole(self) -> SearchTree:
        return SearchTree.of_triangles(self.vertices, self.faces)

    def outer(
        self, shown: Int[np.ndarray, " s"], points: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"]
    ) -> Met:
        """Of points of a surface (head frame) with its unit normals the outer one of the `shown` triangles there, which are the same at each
        call."""
        if self._outer is None:
            self._outer = SearchTree.of_triangles(self.vertices, self.faces[shown])
        row, weight = outer_triangle(self._outer, points, normals, REACH)
        return self._met(shown[row], weight, points)

    def seen(self, points: Float[np.ndarray, "p 3"], back: Float[np.ndarray, "p 3"]) -> Met:
        """Of points with unit directions `back` to the eye the first triangle of the mesh that is seen through them; where none is, the
        closest."""
        return self._met(*outer_triangle(self._whole, points, back, THROUGH, faces=0.0), points)

    def _met(self, face: Int[np.ndarray, " p"], weight: Float[np.ndarray, "p 3"], points: np.ndarray) -> Met:
        return face, weight, points - np.einsum("pk,pkc->pc", weight, self.vertices[self.faces[face]])


@dataclass(eq=False)
class FacePlanes:
    """Views and tri-planes of an expression that the networks know, each made when it is first wanted."""

    field: FaceField
    vertices: Float[Tensor, "v 3"]
    coefficients: Float[Tensor, " 61"]
    impl: Impl
    colour: Float[Tensor, "..."] | None = None
    """Colour tri-planes; decoded when a point is first coloured."""

    def serve(self, vertices: Float[Tensor, "v 3"], coefficients: Float[Tensor, " 61"]) -> bool:
        """Whether they are the tri-planes of this mesh and these coefficients, too: vertices may differ by `ROUNDED`."""
        same = torch.equal(coefficients, self.coefficients)
        return same and bool(torch.allclose(vertices, self.vertices, rtol=0, atol=ROUNDED))

    @cached_property
    def driven(self) -> Float[Tensor, "..."]:
        """Orthographic views of the mesh (3, 7, 256, 256), or what else drives the field."""
        return self.field.driven(self.vertices.float(), self.coefficients.float(), self.impl).to(self.vertices.dtype)

    @cached_property
    @torch.no_grad()
    def geometry(self) -> Float[Tensor, "..."]:
        """Geometry tri-planes."""
        return self.field.geometry_planes(self.driven)


@dataclass(eq=False)
class FaceState(PartState):
    """A posed face."""

    skin: TemplateDistance
    planes: FacePlanes
    """Of this expression, or of the one that is carried."""
    triangles: PosedTriangles
    """Of all the mesh, in the trained shape."""
    carried: Carried | None = None
    """From the nearest known expression; None where this one is known."""
    reshaped: Reshaped | None = None
    """From the trained shape; None where this is it."""

    def trained(self, position: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """Where points are in the trained shape, in the same expression."""
        return position if self.reshaped is None else self.reshaped.back(position)

    def apart(self) -> FaceState:
        """See `PartState`."""
        return replace(self, planes=copy.copy(self.planes))


def face_state(states: Mapping[str, PartState]) -> FaceState:
    """The face's, of the parts' states by name."""
    state = states["face"]
    assert isinstance(state, FaceState)
    return state


@dataclass(frozen=True)
class Face(Part[FaceState]):
    """The face of an avatar."""

    field: FaceField
    tone: ToneMap
    template: FaceTemplate
    known: KnownExpressions | None
    """What it was trained on, where that is known."""

    @classmethod
    def of(cls, field: FaceField, template: FaceTemplate, tone: ToneMap, known: KnownExpressions | None) -> Face:
        """The face of an avatar."""
        return cls(
            name="face",
            blend_weight=template.blend_weight,
            margin=FACE_BAND,
            halvings=1,
            work="face_evaluations",
            field=field,
            tone=tone,
            template=template,
            known=known,
        )

    @torch.no_grad()
    def prepare(
        self,
        vertices: Tensor,
        coefficients: Tensor,
        counters: Counters,
        impl: Impl = "auto",
        before: FaceState | None = None,
    ) -> FaceState:
        """Views of the posed mesh in single precision, and three U-Net runs on them, when a value is first chosen for; those of the
        face `before` and its trees where that was carried from the same known expression.
        """
        mesh, normals = vertices.double().numpy(), vertex_normals(vertices, self.field.faces).double().numpy()
        skin = TemplateDistance.of(mesh, normals, self.blend_weight.double().numpy(), np.zeros(len(mesh)))
        reshaped = self._reshaped(vertices, coefficients)
        trained = vertices if reshaped is None else (vertices.double() - reshaped.way).to(vertices)
        carried, known = self._carried(trained, coefficients)
        seen = trained if carried is None else carried.known.vertices.to(vertices)
        if before is not None and before.planes.serve(seen, known):
            planes = before.planes
            if carried is not None and before.carried is not None:
                carried = replace(carried, known=before.carried.known)
        else:
            planes = FacePlanes(self.field, seen, known, impl)
            counters.add("unet_runs", 3)
        triangles = PosedTriangles(trained.double().numpy(), self.field.faces.cpu().numpy())
        return FaceState(skin, planes, triangles, carried, reshaped)

    def _reshaped(self, vertices: Tensor, coefficients: Tensor) -> Reshaped | None:
        """What carries the trained shape to that of the `vertices`; None where it is theirs, or nobody knows it."""
        if self.known is None:
            return None
        rest = self.template.v_template
        trained = self.template.posed(coefficients.to(rest), torch.from_numpy(self.known.shape).to(rest))
        way = vertices.double() - trained.double()
        return Reshaped(vertices.double(), self.template.skin, way) if way.norm(dim=-1).max() > MOVED else None

    def _mesh(self, vertices: Tensor) -> PosedMesh:
        faces = self.template.faces
        return PosedMesh(vertices.double(), faces, ~self.template.teeth[faces].any(1))

    def _carried(self, vertices: Tensor, coefficients: Tensor) -> tuple[Carried | None, Tensor]:
        """What carries the nearest known expression to this one, and its coefficients; None where this one is known."""
        known = coefficients if self.known is None else self.known.nearest(coefficients)
        if torch.equal(known, coefficients):
            return None, coefficients
        rest = self.template.v_template
        now, before = (self.template.posed(one.to(rest), rest.new_zeros(0)) for one in (coefficients, known))
        return Carried(self._mesh(vertices), self._mesh(vertices.double() - (now - before))), known

    def _sdf(self, state: FaceState, position: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
        """s_F of the expression, known or carried, of points in the trained shape."""
        if state.carried is None:
            return self.field.sdf(state.planes.geometry, position)
        way = state.carried.back(position)
        return way.distance(self.field.sdf(state.planes.geometry, way.place))

    def start(self, state: FaceState, grid: Grid, everywhere: bool) -> Start:
        """The template's distance; points near the mesh are evaluated first. Beside it the tri-planes are made."""
        work = SideBySide()
        planes = work.add(getattr, state.planes, "geometry")
        start = work.add(self._start, state, grid, everywhere)
        work.run()
        planes.result()
        return start.result()

    def _start(self, state: FaceState, grid: Grid, everywhere: bool) -> Start:
        distance, nearest = (found.ravel() for found in nearest_vertex(state.skin.vertices, grid, FACE_BAND))
        near = np.flatnonzero(nearest >= 0)
        here = state.skin.of_nearest(grid.position(near), distance[near], nearest[near])
        used = here.weight > 0
        values = np.zeros((len(nearest), 2), np.float32)
        values[:, 0] = CLAMP
        values[near[used]] = np.stack([here.guess.clip(-CLAMP, CLAMP), here.weight], -1)[used]
        unused = np.ones(len(nearest), bool)
        unused[near[used]] = False
        first = used if everywhere else used & (np.abs(here.guess) < FIRST_BAND)
        return Start(values, near[first], unused)

    def evaluate(self, state: FaceState, position: Float[Tensor, "p 3"]) -> Float[Tensor, "p 1"]:
        """G_F (paper eq. 11); ω stays that of the start."""
        return self._sdf(state, state.trained(position)).float().clamp(-CLAMP, CLAMP)[:, None]

    def distance(self, state: FaceState, position: Tensor, impl: Impl = "auto") -> tuple[Tensor, Tensor]:
        """See `Part`; +∞ where ω is 0 and nothing is evaluated."""
        here = state.skin.query(position.double().numpy())
        omega = torch.as_tensor(np.where(here.distance < FACE_BAND, here.weight, 0)).to(position)
        used = torch.arange(len(omega)) if impl == "reference" else torch.nonzero(omega > 0)[:, 0]
        sdf = torch.full_like(omega, torch.inf)
        sdf[used] = self._sdf(state, state.trained(position[used]))
        return sdf, omega

    @torch.no_grad()
    def _normal(self, state: FaceState, position: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        return surface_normal(partial(self._sdf, state), position.detach())

    def decode_colour(self, state: FaceState, counters: Counters) -> Float[Tensor, "..."]:
        """The colour tri-planes of `state`, decoded once: three U-Net runs."""
        if state.planes.colour is None:
            state.planes.colour = self.field.colour_planes(state.planes.driven)
            counters.add("unet_runs", 3)
        return state.planes.colour

    def places(
        self, state: FaceState, position: Float[Tensor, "p 3"], gaze: Float[Tensor, "p 3"]
    ) -> tuple[TexelPlaces | None, Float[Tensor, "p 3"]]:
        """Texels about what is seen at points of the surface (head frame) in unit directions `gaze`, None where it has none; and the
        surface's unit normals there."""
        trained = state.trained(position)
        normal = self._normal(state, trained)
        return self._places(state, trained, normal, gaze), normal

    @torch.no_grad()
    def _places(
        self,
        state: FaceState,
        position: Float[Tensor, "p 3"],
        normal: Float[Tensor, "p 3"],
        gaze: Float[Tensor, "p 3"],
    ) -> TexelPlaces | None:
        """Of points in the trained shape, with the surface's normals there.

        They are what the posed mesh has outermost: the closest triangle of a closed lid would often be the eyeball's. Where that lies
        beside a point, as between open lips, they are what is seen through it.
        """
        detail, sheets = self.field.detail, self.field.sheets
        if detail is None or sheets is None:
            return None
        points, normals = (each.detach().double().cpu().numpy() for each in (position, normal))
        face, weight, off = state.triangles.outer(sheets.outer, points, normals)
        places = detail.places_on(face, weight, off)
        if not sheets.end:
            return places
        kept = share_beside(off, normals)
        beside = np.flatnonzero(kept < 1)
        if not len(beside):
            return places
        back = -gaze.detach().double().cpu().numpy()[beside]
        past = self._seen_through(state, points[beside], back).faded(1 - kept[beside])
        return places.faded(kept).with_more(beside, past)

    def _seen_through(
        self, state: FaceState, points: Float[np.ndarray, "p 3"], back: Float[np.ndarray, "p 3"]
    ) -> TexelPlaces:
        """Texels that are seen through points with directions `back` to the eye, however deep teeth lie behind them."""
        detail, sheets = self.field.detail, self.field.sheets
        assert detail is not None
        assert sheets is not None
        face, weight, off = state.triangles.seen(points, back)
        share = share_beside(off, back) * sheets.laid[face]
        off = np.where(sheets.behind[face, None], 0.0, off)
        return detail.places_on(np.where(sheets.laid[face], face, sheets.outer[0]), weight, off).faded(share)

    def colour(self, state: FaceState, points: SurfacePoints, counters: Counters, impl: Impl = "auto") -> Tensor:
        """C_F (paper eq. 12) times the light on the surface's normal, brought to the body's tone."""
        planes = self.decode_colour(state, counters)
        counters.add("face_pixels", len(points.position))
        trained = state.trained(points.position)
        if state.carried is None and self.field.detail is None and points.light.face is None:
            own = self.field.colour(planes, trained, points.direction)  # no normal counts
        else:
            normal = self._normal(state, trained)
            own = self._albedo(state, planes, trained, normal, points)
            own = own * points.light.on_face(normal @ points.root_from_part.T)
        colour: Tensor = self.tone(own, points.root_direction, points.direction)
        return colour

    def _albedo(
        self, state: FaceState, planes: Tensor, trained: Tensor, normal: Tensor, points: SurfacePoints
    ) -> Tensor:
        """C_F of the expression, known or carried, with its texels, at points that are `trained` in the trained shape."""
        places = self._places(state, trained, normal, points.gaze)
        if state.carried is None:
            return self.field.colour(planes, trained, points.direction, places)
        seen = state.carried.seen(trained, normal)
        return self._in_mouth(state.carried, seen, self.field.colour(planes, seen.place, points.direction, places))

    def _in_mouth(self, carried: Carried, seen: Seen, colour: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """Of points within a mouth that opens wider than any picture showed the template's colours, in its shadow: of what comes to
        light there nothing was learnt."""
        corners, mouth = self.template.faces[seen.face], self.template.mouth
        opened = carried.way[mouth].norm(dim=-1).amax() if mouth.any() else torch.zeros(())
        share = smooth_ramp(opened, *WIDER) * (seen.weight * mouth[corners]).sum(-1)
        albedo = SHADOW * (seen.weight[..., None] * self.template.albedo[corners]).sum(1)
        return colour + share[:, None].to(colour) * (albedo.to(colour) - colour)
