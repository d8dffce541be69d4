"""Openness of the posed subject's vertices: the share of a uniform sky that reaches them (1 − ambient occlusion).

    openness(v) = Σ_d max(⟨n_v, d⟩, 0) V_d(v) / Σ_d max(⟨n_v, d⟩, 0)

over `count` directions d spread evenly on the sphere, fixed in the root frame, so that it depends on the pose alone. V is read
off a depth map of the whole subject along d, as the share of 3 × 3 texels about v (bilinear at the rim) that do not lie before
it. Vertices are lifted off their own surface by 1.5 texels; the result is averaged over neighbours, so that no
direction draws an edge. Creases narrower than about two texels are missed.

Letters: v vertices, f faces. Root frame, metres.
"""

from __future__ import annotations

import moderngl
import numpy as np

from avatarrex.capture.synthetic.mesh import averaging, smoothed
from avatarrex.gl.context import current_context, gl_context, per_context
from avatarrex.gl.shader import compute_shader, draw_program

LIFT_TEXELS = 1.5
"""Texels along the normal: a plane's own texels lie at most √2 of them away."""
BIAS_TEXELS = 0.5
"""Texels towards the light."""
SMOOTHING_ROUNDS = 2
"""Rounds of neighbour averaging."""


class Occlusion:
    """Openness of one mesh in any pose. Raises `NoContext` without OpenGL 4.3."""

    @current_context()
    def __init__(self, faces: np.ndarray, vertices: int, count: int, size: int) -> None:
        """`faces` (f, 3) of `vertices` vertices; `count` directions; depth maps of `size` texels a side."""
        self.context = context = gl_context()
        self.towards, self.size, self.count = sphere_directions(count), size, vertices
        self.mean = averaging(faces, vertices)
        shaders, gather = ("capture/shadow.vert", "capture/shadow.frag"), "capture/openness.comp"
        self.draw = per_context(context, "capture/shadow", lambda: draw_program(context, *shaders))
        self.gather = per_context(context, gather, lambda: compute_shader(context, gather))
        self.position, self.pairs, self.sums = (context.buffer(reserve=n * vertices) for n in (12, 32, 8))
        index = context.buffer(faces.astype(np.uint32).tobytes())
        self.mesh = context.vertex_array(self.draw, [(self.position, "3f", "in_position")], index)
        self.depth = context.depth_texture((size, size))
        self.depth.compare_func = ""
        self.depth.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.target = context.framebuffer(depth_attachment=self.depth)

    @current_context()
    def openness(self, vertices: np.ndarray, normals: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
        """(v,) in [0, 1]. Depth maps cover a ball of `radius` about `centre`; what lies outside it still casts shadow into
        it, but is itself taken as open where no map shows it.
        """
        self.position.write(vertices.astype(np.float32).tobytes())
        padded = np.insert(np.concatenate([vertices, normals], 1), [3, 6], 0, axis=1)
        self.pairs.write(padded.astype(np.float32).tobytes())
        self.sums.write(bytes(self.sums.size))
        reach = float(np.linalg.norm(vertices - centre, axis=1).max()) + 0.01
        texel = 2 * radius / self.size
        for towards in self.towards:
            self._add(
                towards,
                clip_along(towards, centre, radius, reach),
                LIFT_TEXELS * texel,
                BIAS_TEXELS * texel / (2 * reach),
            )
        visible, possible = np.frombuffer(self.sums.read(), np.float32).reshape(-1, 2).T.astype(np.float64)
        openness = visible / np.maximum(possible, 1e-9)
        return np.asarray(np.clip(smoothed(self.mean, openness, SMOOTHING_ROUNDS), 0, 1))

    def _add(self, towards: np.ndarray, clip: np.ndarray, lift: float, bias: float) -> None:
        matrix = tuple(clip.T.ravel().tolist())
        self.draw["u_clip_from_root"] = matrix
        self.target.use()
        self.target.clear()
        self.context.disable(moderngl.CULL_FACE | moderngl.BLEND)
        self.context.enable(moderngl.DEPTH_TEST)
        self.mesh.render(moderngl.TRIANGLES)
        self.context.disable(moderngl.DEPTH_TEST)
        self.gather["u_clip_from_root"] = matrix
        uniforms = {"towards": tuple(towards.tolist()), "lift": lift, "bias": bias, "count": self.count}
        for name, value in uniforms.items():
            self.gather[f"u_{name}"] = value
        self.depth.use(0)
        self.pairs.bind_to_storage_buffer(0)
        self.sums.bind_to_storage_buffer(1)
        self.gather.run((self.count + 63) // 64)
        self.context.memory_barrier()


def sphere_directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors spread evenly: a Fibonacci spiral about +Y."""
    k = np.arange(count) + 0.5
    y, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - y * y)
    return np.stack([ring * np.cos(turn), y, ring * np.sin(turn)], 1)


def clip_along(towards: np.ndarray, centre: np.ndarray, radius: float, reach: float) -> np.ndarray:
    """(4, 4) parallel projection against `towards`: ± `radius` across, ± `reach` along, nearest to the light first."""
    side = np.cross(towards, [1.0, 0, 0] if abs(towards[0]) < 0.7 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    axes = np.stack([side / radius, np.cross(towards, side) / radius, -towards / reach])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes, -axes @ centre
    return matrix
