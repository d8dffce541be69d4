"""A surface on the graphics card: what never changes is uploaded once, what a pose makes when it is another one.

Backs of triangles are not drawn, which halves the time in software: a surface is closed, but for borders that lie beneath
another part. Triangles that are near each other follow each other: a vertex that is met again soon is not transformed again
(25 000 in place of 47 000 transforms of 19 000 texture vertices in llvmpipe, which remembers 256).

Letters: v vertices, t texture vertices, f faces.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass

import moderngl
import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from avatarrex.gl.context import in_software
from avatarrex.surface.pose import PosedSurface
from avatarrex.surface.surface import Surface
from avatarrex.templates.parts import PARTS

ANISOTROPY = 8.0
"""Texels along the longer side of a pixel's footprint, by graphics hardware; in software it takes 4 ms of a picture of 512² pixels."""
NEAREST_MIPMAP = moderngl.LINEAR_MIPMAP_NEAREST
"""In software one mipmap is read instead of two: a sixth of a picture's time for 0.03 dB (docs/experiments.md, 'Surface')."""
CORNER = np.dtype([("uv", "f4", 2), ("lit", "f4"), ("part", "i4")])
CASTER = "caster"
"""The program that draws what throws a shadow."""
CASTER_CELL = 0.022
"""Metres: vertices that are nearer to each other than this throw one shadow; a texel of it is a centimetre."""
LAYOUT = ("2f 1f 1i", "in_uv", "in_lit", "in_part")
POSED = "in_position", "in_normal", "in_tint"


@dataclass(frozen=True, eq=False)
class Triangles:
    """Those of a surface that are drawn."""

    indices: moderngl.Buffer
    shapes: dict[str, moderngl.VertexArray]
    """By program."""
    count: int

    def release(self) -> None:
        """Give the memory back; the context is current."""
        for shape in self.shapes.values():
            shape.release()
        self.indices.release()


class UploadedSurface:
    """A surface in a context, which is current while this is used."""

    def __init__(self, context: moderngl.Context, surface: Surface) -> None:
        self._context, self._surface = context, weakref.ref(surface)
        corner = np.zeros(len(surface.uv), CORNER)
        vertex = surface.uv_vertex
        corner["uv"], corner["lit"], corner["part"] = surface.uv, surface.lit[vertex], surface.part[vertex]
        self._vertex = vertex
        self._corners = context.buffer(corner.tobytes())
        self._positions = context.buffer(reserve=12 * len(surface.vertices))
        self._posed = [context.buffer(reserve=12 * len(vertex)) for _ in POSED]
        self._current: weakref.ref[PosedSurface] | None = None
        self._triangles: dict[frozenset[str], Triangles] = {}
        self._casters: list[moderngl.Buffer] = []
        self._albedo = context.texture(surface.albedo.shape[1::-1], 3, surface.albedo.tobytes(), alignment=1)
        self._albedo.build_mipmaps()
        self._albedo.repeat_x = self._albedo.repeat_y = False
        software = in_software(context.info["GL_RENDERER"])
        self._albedo.filter = (NEAREST_MIPMAP if software else moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        self._albedo.anisotropy = 1.0 if software else min(ANISOTROPY, context.max_anisotropy)

    def bind(self, posed: PosedSurface) -> int:
        """Bind the albedo (unit 0), upload the pose where it is another one; the bytes that were uploaded.

        Corners get their vertices' values here: a shader that looks them up itself costs a tenth of a picture in software.
        """
        self._albedo.use(0)
        if self._current is not None and self._current() is posed:
            return 0
        self._current = weakref.ref(posed)
        arrays = [array.take(self._vertex, 0) for array in (posed.vertices, posed.normals, posed.tint)]
        for buffer, array in zip((self._positions, *self._posed), (np.ascontiguousarray(posed.vertices), *arrays)):
            buffer.write(array)
        return posed.vertices.nbytes + sum(array.nbytes for array in arrays)

    def triangles(self, hidden: frozenset[str], programs: dict[str, moderngl.Program]) -> Triangles:
        """Those that do not belong to the parts `hidden`."""
        if hidden not in self._triangles:
            surface = self._surface()
            assert surface is not None, "a surface is drawn while it is there"
            of = surface.part[surface.faces]
            unseen = np.asarray(np.isin(of, [PARTS.index(name) + 1 for name in hidden]).all(1))
            faces = surface.uv_faces[~unseen]
            faces = faces[np.argsort(z_order(surface.vertices[surface.uv_vertex[faces]].mean(1)), kind="stable")]
            indices = self._context.buffer(faces.astype(np.uint32).tobytes())
            posed = [(buffer, "3f", name) for buffer, name in zip(self._posed, POSED)]
            shapes = {
                name: self._context.vertex_array(
                    program, [(self._corners, *LAYOUT), *posed], indices, index_element_size=4, skip_errors=True
                )
                for name, program in programs.items()
                if name != CASTER
            }
            shapes[CASTER] = self._caster(programs[CASTER], unseen)
            self._triangles[hidden] = Triangles(indices, shapes, len(faces))
        return self._triangles[hidden]

    def _caster(self, program: moderngl.Program, unseen: Bool[np.ndarray, " f"]) -> moderngl.VertexArray:
        """The coarse triangles that throw the surface's shadow, without those `unseen`."""
        surface = self._surface()
        assert surface is not None
        corners = np.unique(coarse_faces(surface, surface.faces[~unseen]).astype(np.uint32), axis=0)
        indices = self._context.buffer(corners.tobytes() or bytes(12))
        self._casters.append(indices)
        positions = [(self._positions, "3f", "in_position")]
        return self._context.vertex_array(program, positions, indices, index_element_size=4)

    def release(self) -> None:
        """Give the memory back."""
        for triangles in self._triangles.values():
            triangles.release()
        for buffer in (self._corners, self._positions, *self._posed, *self._casters):
            buffer.release()
        self._albedo.release()


def coarse_faces(surface: Surface, faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "g 3"]:
    """Triangles of fewer vertices: one of all that lie in a cell of `CASTER_CELL` at rest and are carried by the same joint."""
    cell = np.floor(surface.vertices / CASTER_CELL).astype(np.int64)
    _, first, number = np.unique(
        np.column_stack([cell, surface.joint[:, 0]]), axis=0, return_index=True, return_inverse=True
    )
    coarse = first[number.reshape(-1)][faces]
    a, b, c = coarse.T
    return np.asarray(coarse[(a != b) & (b != c) & (c != a)])


def z_order(points: Float[np.ndarray, "p 3"]) -> UInt64[np.ndarray, " p"]:
    """Each point's place on Morton's curve through their box, 2¹⁰ cells a side: near on it, near in space."""
    low = points.min(0, initial=np.inf)
    cell = (1023 * (points - low) / max((points - low).max(initial=0), 1e-9)).astype(np.uint64)
    place = np.zeros(len(points), np.uint64)
    for bit in range(10):
        for axis in range(3):
            place |= (cell[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return place
