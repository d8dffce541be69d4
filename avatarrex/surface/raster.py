"""Pictures of a posed surface by OpenGL, in whichever context is in use (gl/context.py): the window's own, or one without a window.

    colour = clip((albedo(uv)·albedo_scale + tint) · mix(1, E(n), lit))       alpha = covered share of the samples

Light and tint are the vertices', interpolated in a triangle. A picture stays on the graphics card until it is read. Rows are
stored from the top: the texture's first row is the image's, v = 0 its top edge. Samples are averaged sRGB-encoded, as avatars are
composited. The side of a triangle that is seen faces the viewer.

Letters: h w pixels. Root frame, metres, OpenCV camera; pixel centres at +0.5.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import moderngl
import numpy as np
from jaxtyping import Bool, Float, Float32

from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.fields.light import DARKEST
from avatarrex.gl.context import NoContext, current_context, per_context
from avatarrex.gl.shader import draw_program
from avatarrex.surface.extent import Box, Extent
from avatarrex.surface.look import DEPTH_FADE, KINDS, PART_COLOURS, Look
from avatarrex.surface.pose import PosedSurface
from avatarrex.surface.surface import Surface
from avatarrex.surface.upload import CASTER, UploadedSurface

SAMPLES = 4
"""Of a pixel: what every OpenGL 4.3 has, and Mesa's llvmpipe at most."""
TILE = 1024
"""Pixels a side of the multisampled target, 32 MB; a larger picture is drawn in pieces."""
SAMPLES_UNIT = 1
"""Texture unit; the albedo has 0 (`UploadedSurface.bind`)."""
CAST_UNIT = 2
"""Of the key light's map (`KeyShadow`)."""
Target = tuple[tuple[moderngl.Texture, ...], moderngl.Framebuffer]
"""Textures, and the framebuffer that draws into them."""
LOD_BIAS = {1: 0.0, 2: -2.0, 4: -2.0}
"""Of the albedo's mipmaps, by samples: the exact levels take a pixel's colour at its centre. −1 is 1 dB farther from them, no mipmaps at all
0.15 dB nearer, and neither flickers less (docs/experiments.md, 'Surface'). One sample a pixel is for speed: −2 takes a third longer there."""
CONSTANTS = {"DARKEST": DARKEST, "DEPTH_FADE": DEPTH_FADE}


@dataclass(frozen=True, eq=False)
class SurfacePicture:
    """A picture in a context. When nobody has it any more, its texture serves another one."""

    texture: moderngl.Texture
    """RGBA8, premultiplied sRGB-encoded, first row at the top."""

    @property
    def renderer(self) -> str:
        """GL_RENDERER, e.g. `llvmpipe (LLVM 15.0.6, 256 bits)`."""
        return str(self.texture.ctx.info["GL_RENDERER"])

    def read(self, counters: Counters | None = None) -> Float32[np.ndarray, "h w 4"]:
        """The image. Raises `NoContext` where another context than the picture's is in use."""
        with current_context() as context:
            if self.texture.ctx is not context:
                raise NoContext("the picture was drawn in another OpenGL context")
            data = self.texture.read()
        if counters is not None:
            counters.add("bytes_read_back", len(data))
        width, height = self.texture.size
        return np.frombuffer(data, np.uint8).reshape(height, width, 4).astype(np.float32) / 255


@dataclass(frozen=True, eq=False)
class SurfaceGeometry:
    """What is under each pixel's centre; zero where nothing is."""

    position: Float32[np.ndarray, "h w 3"]
    """Root frame, metres."""
    normal: Float32[np.ndarray, "h w 3"]
    """Unit, root frame, of the side that is seen."""
    depth: Float32[np.ndarray, "h w"]
    """Camera z, metres."""
    hit: Bool[np.ndarray, "h w"]
    part: Float32[np.ndarray, "h w 3"]
    """Share of left hand, right hand, face."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A posed surface in a picture."""

    posed: PosedSurface
    harmonics: Float[np.ndarray, "2 8 3"]
    """The avatar's light in the root frame on body and hands (`Irradiance.harmonics`), and on the face (`Irradiance.face`)."""
    view: Camera
    """The picture's camera, seen from this surface's root frame."""
    hidden: frozenset[str] = frozenset()
    """Parts that are not drawn."""
    look: Look | None = None
    """What is shown instead of its colours; of influences the tints of `posed` are the colours."""
    key: KeyShadow | None = None
    """A stage's key light on it."""


@dataclass(frozen=True, eq=False)
class KeyShadow:
    """What of a surface is in a key light."""

    texture: moderngl.Texture
    """Least height over the floor along each ray of the light, and the negative of the greatest."""
    map_from_root: Float[np.ndarray, "4 4"]
    """(u, v, height): where in the texture a ray of the light through a point is, and the point's metres over the floor."""
    direction: Float[np.ndarray, "3"]
    """Unit, towards the light, root frame."""
    gains: tuple[float, float]
    """What colours are multiplied by in the shadow, and how much that grows in the light."""


def draw_surfaces(shown: Sequence[Placed], samples: int = SAMPLES, counters: Counters | None = None) -> SurfacePicture:
    """At least one surface in one picture, nearer ones before farther ones; nothing is read back.

    `samples` 1, 2 or 4. `counters`: `surface_triangles` in sight or not, `bytes_uploaded`. Raises `NoContext` without OpenGL 4.3.
    """
    with current_context() as context:
        raster = per_context(context, Raster, lambda: Raster(context))
        return raster.draw(shown, samples, counters or Counters())


def draw_surface(
    posed: PosedSurface,
    harmonics: Float[np.ndarray, "2 8 3"],
    view: Camera,
    samples: int = SAMPLES,
    hidden: frozenset[str] = frozenset(),
    counters: Counters | None = None,
) -> SurfacePicture:
    """`posed` alone seen by `view`, whose world is the root frame, without the parts `hidden`; see `draw_surfaces`."""
    return draw_surfaces([Placed(posed, np.asarray(harmonics, np.float64), view, hidden)], samples, counters)


def surface_geometry(
    posed: PosedSurface, view: Camera, hidden: frozenset[str] = frozenset(), counters: Counters | None = None
) -> SurfaceGeometry:
    """Positions, normals and depth of the same; they are read back. Raises `NoContext`."""
    with current_context() as context:
        raster = per_context(context, Raster, lambda: Raster(context))
        return raster.geometry(posed, view, hidden, counters or Counters())


class Raster:
    """What one context draws surfaces with; it is current while this is used."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._programs = {
            name: draw_program(context, "surface/mesh.vert", f"surface/{name}.frag", CONSTANTS)
            for name in ("colour", "geometry", "look")
        }
        self._programs["lit"] = draw_program(
            context, "surface/mesh.vert", "surface/colour.frag", CONSTANTS | {"LIT": 1, "CAST_UNIT": CAST_UNIT}
        )
        self._programs[CASTER] = draw_program(context, "surface/caster.vert", "surface/caster.frag")
        self._surfaces: weakref.WeakKeyDictionary[Surface, UploadedSurface] = weakref.WeakKeyDictionary()
        self._gone: list[UploadedSurface] = []
        """Of surfaces that are no more."""
        self._free: list[Target] = []
        """Of pictures that are no more."""

    def draw(self, shown: Sequence[Placed], samples: int, counters: Counters) -> SurfacePicture:
        """See `draw_surfaces`."""
        view = shown[0].view
        extent = Extent.around([found for one in shown if (found := Extent.of(one.posed.bounds, one.view))])
        picture = self._picture((view.width, view.height), samples == 1)
        with target_kept(self._context):
            picture[1].clear()
            for name in ("colour", "lit"):
                self._programs[name]["u_lod_bias"] = LOD_BIAS[samples]
            if extent:
                for tile in extent.tiles(TILE):
                    sampled = self._begin(picture[1], samples, tile)
                    for one in shown:
                        self._draw(one, extent.clip_from_root(one.view, tile), counters)
                    if sampled:
                        self._average(sampled, samples, picture[1], tile)
        drawn = SurfacePicture(picture[0][0])
        weakref.finalize(drawn, self._free.append, picture).atexit = False
        return drawn

    def _draw(self, one: Placed, clip: np.ndarray, counters: Counters) -> None:
        """One of them, into the target in use."""
        uploaded, program = self.bound(one.posed, counters), self._programs["look"]
        if one.look:
            program["u_look"] = KINDS.index(one.look.kind)
            program["u_depth"] = tuple(one.view.camera_from_world[2].tolist())
            program["u_range"] = (one.look.near, one.look.far)
            program["u_parts"] = [tuple(row) for row in PART_COLOURS.tolist()]
            self.render("look", uploaded, one.hidden, clip, counters)
            return
        name = "lit" if one.key else "colour"
        program = self._programs[name]
        program["u_albedo_scale"] = one.posed.surface.albedo_scale
        for uniform, harmonics in zip(("u_harmonics", "u_face_harmonics"), one.harmonics.tolist()):
            program[uniform] = [tuple(row) for row in harmonics]
        if one.key:
            one.key.texture.use(CAST_UNIT)
            program["u_map_from_root"] = tuple(one.key.map_from_root.T.ravel().tolist())
            program["u_key"], program["u_gains"] = tuple(one.key.direction.tolist()), one.key.gains
        self.render(name, uploaded, one.hidden, clip, counters)

    def geometry(
        self, posed: PosedSurface, view: Camera, hidden: frozenset[str], counters: Counters
    ) -> SurfaceGeometry:
        """See `surface_geometry`."""
        uploaded, extent = self.bound(posed, counters), Extent.of(posed.bounds, view)
        target = per_context(self._context, "surface geometry", lambda: self._target((TILE, TILE), "f4", 3))
        found = np.zeros((view.height, view.width, 3, 4), np.float32)
        with target_kept(self._context):
            clips = [(tile, extent.clip_from_root(view, tile)) for tile in extent.tiles(TILE)] if extent else []
            for tile, clip in clips:
                self._use(target, tile)
                self.render("geometry", uploaded, hidden, clip, counters)
                left, top, width, height = tile
                for index in range(3):
                    data = target[1].read((0, 0, width, height), 4, attachment=index, dtype="f4")
                    counters.add("bytes_read_back", len(data))
                    read = np.frombuffer(data, np.float32).reshape(height, width, 4)
                    found[top : top + height, left : left + width, index] = read
        position, normal, part = (found[:, :, index, :3].copy() for index in range(3))
        hit, row = found[:, :, 0, 3] > 0, view.camera_from_world[2]
        depth = np.where(hit, position @ row[:3] + row[3], 0).astype(np.float32)
        return SurfaceGeometry(position, normal, depth, hit, part)

    def bound(self, posed: PosedSurface, counters: Counters) -> UploadedSurface:
        """The surface with this pose, bound."""
        while self._gone:
            self._gone.pop().release()
        surface = posed.surface
        if surface not in self._surfaces:
            self._surfaces[surface] = uploaded = UploadedSurface(self._context, surface)
            weakref.finalize(surface, self._gone.append, uploaded).atexit = False
        counters.add("bytes_uploaded", self._surfaces[surface].bind(posed))
        return self._surfaces[surface]

    def _begin(self, picture: moderngl.Framebuffer, samples: int, tile: Box) -> Target | None:
        """What follows goes into the tile of a picture that is clear, or into several `samples` a pixel, the target that is given."""
        if samples == 1:
            picture.use()
            picture.viewport = tile
            return None
        sampled = per_context(self._context, ("surface", samples), lambda: self._target((TILE, TILE), "f1", 1, samples))
        self._use(sampled, tile)
        return sampled

    def _use(self, target: Target, tile: Box) -> None:
        """What follows goes into the target's first pixels, as many as the tile has."""
        viewport = (0, 0, *tile[2:])
        target[1].use()
        target[1].viewport = viewport
        target[1].clear(viewport=viewport)

    def render(
        self, name: str, uploaded: UploadedSurface, hidden: frozenset[str], clip: np.ndarray, counters: Counters
    ) -> None:
        """Into the target in use."""
        context, triangles = self._context, uploaded.triangles(hidden, self._programs)
        self._programs[name]["u_clip_from_root"] = tuple(clip.T.ravel().tolist())
        context.disable(moderngl.BLEND)
        context.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        context.front_face = "cw"  # rows run downwards
        triangles.shapes[name].render(moderngl.TRIANGLES)
        context.disable(moderngl.CULL_FACE)
        context.disable(moderngl.DEPTH_TEST)
        context.front_face = "ccw"
        counters.add("surface_triangles", triangles.count)

    def cast(
        self, posed: PosedSurface, hidden: frozenset[str], clip: Float[np.ndarray, "4 4"], counters: Counters
    ) -> None:
        """Heights (clip z) of the sides away from the light into the target in use, whose channels keep the least: of height and −height.

        The lowest point of a ray is on such a side; and what is below the highest of them is in another limb's shadow, not its own.
        """
        context, triangles = self._context, self.bound(posed, counters).triangles(hidden, self._programs)
        self._programs[CASTER]["u_clip_from_root"] = tuple(clip.T.ravel().tolist())
        context.disable(moderngl.DEPTH_TEST)
        context.enable(moderngl.BLEND | moderngl.CULL_FACE)
        context.blend_equation = (moderngl.MIN, moderngl.MIN)
        triangles.shapes[CASTER].render(moderngl.TRIANGLES)
        context.blend_equation = (moderngl.FUNC_ADD, moderngl.FUNC_ADD)
        context.disable(moderngl.BLEND | moderngl.CULL_FACE)

    def _average(self, sampled: Target, samples: int, picture: moderngl.Framebuffer, tile: Box) -> None:
        """The samples' mean into the tile of the picture."""
        program, viewport = per_context(self._context, ("surface average", samples), lambda: self._averaging(samples))
        program["u_corner"] = tile[:2]
        program["u_samples"] = SAMPLES_UNIT
        sampled[0][0].use(SAMPLES_UNIT)
        picture.use()
        picture.viewport = tile
        viewport.render(moderngl.TRIANGLES, vertices=3)

    def _averaging(self, samples: int) -> tuple[moderngl.Program, moderngl.VertexArray]:
        program = draw_program(self._context, "surface/average.vert", "surface/average.frag", {"SAMPLES": samples})
        return program, self._context.vertex_array(program, [])

    def _picture(self, size: tuple[int, int], deep: bool) -> Target:
        """A texture that no picture needs, with a depth of its own where `deep`; those of other sizes are given back."""
        found = None
        while self._free:
            textures, framebuffer = self._free.pop()
            depth = framebuffer.depth_attachment
            if found is None and textures[0].size == size and deep == (depth is not None):
                found = textures, framebuffer
            else:
                if depth:
                    depth.release()
                framebuffer.release()
                textures[0].release()
        if found is not None:
            return found
        texture = self._context.texture(size, 4)
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        texture.repeat_x = texture.repeat_y = False
        return (texture,), self._context.framebuffer(
            [texture], self._context.depth_renderbuffer(size) if deep else None
        )

    def _target(self, size: tuple[int, int], kind: str, count: int, samples: int = 0) -> Target:
        context = self._context
        textures = tuple(context.texture(size, 4, samples=samples, dtype=kind) for _ in range(count))
        return textures, context.framebuffer(textures, context.depth_renderbuffer(size, samples=samples))


@contextmanager
def target_kept(context: moderngl.Context) -> Iterator[None]:
    """What was drawn into before is drawn into after it."""
    before = context.fbo
    try:
        yield
    finally:
        context.fbo = before
        if before is not None:
            before.use()
