"""Pictures of the posed subject for the synthetic capture: OpenGL triangles, independent of the avatar's pipeline.

A picture is the box-filtered mean of `samples`² colours per pixel, drawn in tiles; its coverage is the exact share of those
samples that meet the subject. Depth and normals are those of the triangle under the pixel's centre. Colours are averaged
sRGB-encoded, as avatars are composited. `draw_reference` does the same in NumPy, by another route: `zbuffer.visible_faces`,
the texture itself and `studio_light`.

Letters: h w pixels, v vertices, f faces. Root frame, metres, OpenCV camera; pixel centres at +0.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import moderngl
import numpy as np

from avatarrex.camera import Camera
from avatarrex.capture.readers.undistort import distort
from avatarrex.capture.synthetic import shade
from avatarrex.capture.synthetic.albedo_lattice import AlbedoLattice
from avatarrex.capture.synthetic.mesh import interpolated
from avatarrex.capture.synthetic.subject import PosedSubject
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.gl.context import current_context, gl_context, per_context
from avatarrex.gl.shader import compute_shader, draw_program

TILE_SAMPLES = 2048
"""Samples a side of the largest tile: 64 MB of colour and depth."""
UPRIGHT, IDEAL = np.eye(3), np.zeros(5)
"""Light fixed in the root frame; a lens without distortion."""
NEAR_PLANE, FAR_PLANE = 0.2, 40.0
"""Metres."""


@dataclass(frozen=True)
class Picture:
    """What one camera sees."""

    colour: np.ndarray
    """(h, w, 4) float32, premultiplied sRGB-encoded RGBA."""


@dataclass(frozen=True)
class Geometry:
    """Under each pixel's centre."""

    depth: np.ndarray
    """(h, w) float32 camera z in metres, 0 where nothing is hit."""
    normal: np.ndarray
    """(h, w, 3) float32 unit smooth normal, root frame; 0 where nothing is hit."""


class Rasteriser:
    """Draws one subject; call `pose` for each frame, then `draw` for each camera. Raises `NoContext` without OpenGL 4.3."""

    @current_context()
    def __init__(self, faces: np.ndarray, lattice: AlbedoLattice, samples: int) -> None:
        """`faces` (f, 3); `samples` along each side of a pixel."""
        self.context = context = gl_context()
        self.samples, self.corners = samples, faces.size
        storage = (faces.astype(np.uint32), lattice.lattice, lattice.samples)
        self.faces, self.lattice, self.albedo = (context.buffer(np.ascontiguousarray(a).tobytes()) for a in storage)
        self.vertices = context.buffer(reserve=32 * (int(faces.max()) + 1))
        self.lit = _program(context, "capture/lit.frag")
        self.plain = _program(context, "capture/geometry.frag")
        self.resolve = compute_shader(context, "capture/resolve.comp", {"SCALE": samples})
        for name in ("warm", "cool"):
            self.lit[f"u_{name}"] = tuple(getattr(shade, name.upper()).tolist())
        self.position = np.zeros((0, 3))
        self._packed = np.zeros((0, 8))
        self._shapes = [context.vertex_array(program, []) for program in (self.lit, self.plain)]

    @current_context()
    def pose(self, posed: PosedSubject, openness: np.ndarray, light_from_root: np.ndarray = UPRIGHT) -> None:
        """Take the posed mesh, its openness (v,) and the frame of the light, a rotation (3, 3), for the pictures that follow."""
        self._packed = np.concatenate([posed.vertices, openness[:, None], posed.normals, posed.wrinkle[:, None]], 1)
        for name in ("key", "fill", "rim"):
            self.lit[f"u_{name}"] = tuple((light_from_root.T @ getattr(shade, name.upper())).tolist())
        self.lit["u_up"] = tuple(light_from_root[1].tolist())
        self._place(posed.vertices)

    @current_context()
    def draw(self, camera: Camera, distortion: np.ndarray = IDEAL) -> Picture:
        """A picture from a camera with the root frame as its world, whose lens has `distortion` (5,); only the tiles about
        the subject are drawn. A lens moves the corners of the triangles, which are small: their edges stay straight.
        """
        exact = self.position
        if distortion.any():
            self._place(bent(exact, camera, distortion))
            picture = self._drawn(camera)
            self._place(exact)
            return picture
        return self._drawn(camera)

    def _place(self, position: np.ndarray) -> None:
        """Draw the vertices at `position` (v, 3)."""
        self.position = position
        self._packed[:, :3] = position
        self.vertices.write(self._packed.astype(np.float32).tobytes())

    def _drawn(self, camera: Camera) -> Picture:
        side = TILE_SAMPLES // self.samples
        colour = np.zeros((camera.height, camera.width, 4), np.float32)
        left, top, right, bottom = self._bounds(camera)
        for y in range(top, bottom, side):
            for x in range(left, right, side):
                w, h = min(side, right - x), min(side, bottom - y)
                colour[y : y + h, x : x + w] = self._tile(camera, (x, y, w, h))
        return Picture(colour)

    @current_context()
    def geometry(self, camera: Camera) -> Geometry:
        """Depth and normals from a camera with the root frame as its world."""
        h, w = camera.height, camera.width
        target, _ = per_context(self.context, ("capture geometry", w, h), lambda: _target(self.context, (w, h), "f4"))
        self._render(1, target, clip_from_root(camera, (0, 0, w, h)), (w, h))
        read = np.frombuffer(target.read(components=4, dtype="f4"), np.float32).reshape(h, w, 4)
        return Geometry(read[..., 3].copy(), read[..., :3].copy())

    def _bounds(self, camera: Camera) -> tuple[int, int, int, int]:
        """Left, top, right, bottom in pixels of all that the picture may show of the subject."""
        size = np.array([camera.width, camera.height])
        pixel, depth = camera.pixels(self.position)
        if depth.min() < NEAR_PLANE:
            return 0, 0, camera.width, camera.height
        low = np.clip(np.floor(pixel.min(0)), 0, size).astype(int)
        high = np.clip(np.ceil(pixel.max(0)), low, size).astype(int)
        return int(low[0]), int(low[1]), int(high[0]), int(high[1])

    def _tile(self, camera: Camera, tile: tuple[int, int, int, int]) -> np.ndarray:
        """(h, w, 4) of the tile (left, top, width, height)."""
        context, side = self.context, TILE_SAMPLES // self.samples
        samples, sampled = per_context(
            context, "capture samples", lambda: _target(context, (TILE_SAMPLES, TILE_SAMPLES), "f2")
        )
        means, mean = per_context(context, ("capture means", side), lambda: _target(context, (side, side), "f4"))
        size = tile[2:]
        self._render(0, samples, clip_from_root(camera, tile), (size[0] * self.samples, size[1] * self.samples))
        sampled.use(0)
        mean.bind_to_image(0, read=False, write=True)
        self.resolve["u_size"] = size
        self.resolve.run((size[0] + 7) // 8, (size[1] + 7) // 8)
        context.memory_barrier()
        read = means.read(viewport=(0, 0, *size), components=4, dtype="f4")
        return np.frombuffer(read, np.float32).reshape(size[1], size[0], 4)

    def _render(self, which: int, target: moderngl.Framebuffer, clip: np.ndarray, size: tuple[int, int]) -> None:
        context = self.context
        for binding, buffer in enumerate((self.faces, self.vertices, self.lattice, self.albedo)):
            buffer.bind_to_storage_buffer(binding)
        (self.lit, self.plain)[which]["u_clip_from_root"] = tuple(clip.T.ravel().tolist())
        target.use()
        target.viewport = (0, 0, *size)
        target.clear()
        context.disable(moderngl.CULL_FACE | moderngl.BLEND)
        context.enable(moderngl.DEPTH_TEST)
        self._shapes[which].render(moderngl.TRIANGLES, vertices=self.corners)
        context.disable(moderngl.DEPTH_TEST)


def clip_from_root(camera: Camera, tile: tuple[int, int, int, int]) -> np.ndarray:
    """(4, 4): the tile (left, top, width, height) in pixels fills [−1, 1]², rows downwards; w is the camera's z."""
    left, top, width, height = tile
    k = camera.intrinsics
    project = np.array([
        [2 * k[0, 0] / width, 2 * k[0, 1] / width, 2 * (k[0, 2] - left) / width - 1, 0],
        [0, 2 * k[1, 1] / height, 2 * (k[1, 2] - top) / height - 1, 0],
        [0, 0, (FAR_PLANE + NEAR_PLANE) / (FAR_PLANE - NEAR_PLANE), -2 * FAR_PLANE * NEAR_PLANE / (FAR_PLANE - NEAR_PLANE)],
        [0, 0, 1, 0],
    ])  # fmt: skip
    return np.asarray(project @ camera.camera_from_world)


def bent(points: np.ndarray, camera: Camera, distortion: np.ndarray) -> np.ndarray:
    """Where an ideal pinhole sees (p, 3) `points` as the lens does, at the same camera z. x_d of undistort.py."""
    seen = camera.seen(points)
    depth = np.maximum(seen[:, 2:], NEAR_PLANE)
    seen[:, :2] = distort(seen[:, :2] / depth, distortion) * depth
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    return np.asarray((seen - translation) @ rotation)


def draw_reference(
    posed: PosedSubject, openness: np.ndarray, camera: Camera, samples: int, light_from_root: np.ndarray = UPRIGHT
) -> Picture:
    """`Rasteriser.draw` without OpenGL and without the lattice: every sample's exact albedo, lit in NumPy."""
    face, bary, _ = visible_faces(
        posed.vertices, posed.faces, camera.resized(camera.width * samples, camera.height * samples)
    )
    hit = face >= 0
    face, bary = face[hit], bary[hit]
    corners = posed.faces[face]
    at = [interpolated(bary, value[corners]) for value in (openness, posed.wrinkle)]
    colour = np.zeros((*hit.shape, 4))
    normal = posed.at(face, bary)[1] @ light_from_root.T
    colour[hit, :3] = shade.studio_light(posed.subject.albedo(face, bary), normal, *at)
    colour[hit, 3] = 1
    blocks = colour.reshape(camera.height, samples, camera.width, samples, 4)
    return Picture(blocks.mean((1, 3)).astype(np.float32))


def _program(context: moderngl.Context, fragment: str) -> moderngl.Program:
    return per_context(
        context, fragment, lambda: draw_program(context, "capture/mesh.vert", fragment, {"WRAP": shade.WRAP})
    )


def _target(
    context: moderngl.Context, size: tuple[int, int], kind: str
) -> tuple[moderngl.Framebuffer, moderngl.Texture]:
    texture = context.texture(size, 4, dtype=kind)
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return context.framebuffer([texture], context.depth_renderbuffer(size)), texture
