"""The orthographic views of the face mesh drawn by OpenGL; `orthographic.py` says what they are and checks them.

Letters: v vertices, f faces, h w pixels.
"""

from __future__ import annotations

import moderngl
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatarrex.gl.context import current_context, gl_context, per_context
from avatarrex.gl.shader import draw_program

SHADERS = ("templates/face_view.vert", "templates/face_view.frag")


@current_context()
def draw_views(
    place: Float[Tensor, "v 3"],
    albedo: Float[Tensor, "v 3"],
    normal: Float[Tensor, "v 3"],
    faces: Int[Tensor, "f 3"],
    axes: Float[Tensor, "views 3 3"],
    size: int,
) -> Float[Tensor, "views 7 h w"]:
    """Draw vertices at `place` in [−1, 1]³ along every row triple of `axes`. Raises `NoContext`."""
    context = gl_context()
    program = per_context(context, SHADERS, lambda: draw_program(context, *SHADERS))
    targets = per_context(context, (*SHADERS, size), lambda: _targets(context, size))
    corner = torch.cat([place, albedo, normal], 1).float().cpu().numpy()
    vertices = context.buffer(np.ascontiguousarray(corner).tobytes())
    indices = context.buffer(np.ascontiguousarray(faces.cpu().numpy().astype("u4")).tobytes())
    mesh = context.vertex_array(program, [(vertices, "3f 3f 3f", "in_position", "in_albedo", "in_normal")], indices)
    before = context.fbo
    try:
        context.disable(moderngl.CULL_FACE | moderngl.BLEND)
        context.enable(moderngl.DEPTH_TEST)
        images = [_draw(mesh, *targets, view) for view in axes.cpu().numpy()]
    finally:
        context.disable(moderngl.DEPTH_TEST)
        if before is not None:
            before.use()
        for used in (mesh, indices, vertices):
            used.release()
    return torch.from_numpy(np.stack(images)).to(place.device)


def _targets(context: moderngl.Context, size: int) -> tuple[moderngl.Framebuffer, list[moderngl.Texture]]:
    textures = [context.texture((size, size), 4, dtype="f4") for _ in range(2)]
    return context.framebuffer(textures, context.depth_renderbuffer((size, size))), textures


def _draw(
    mesh: moderngl.VertexArray, target: moderngl.Framebuffer, textures: list[moderngl.Texture], axes: np.ndarray
) -> np.ndarray:
    """(7, h, w): albedo, normal, mask."""
    mesh.program["u_axes_from_head"] = tuple(axes.T.reshape(9).tolist())
    target.use()
    target.clear()
    mesh.render()
    albedo_mask, normal = (
        np.frombuffer(texture.read(), "f4").reshape(texture.height, texture.width, 4) for texture in textures
    )
    return np.concatenate([albedo_mask[..., :3], normal[..., :3], albedo_mask[..., 3:]], -1).transpose(2, 0, 1).copy()
