"""OpenGL without a window: the context, shader sources, and what is uploaded."""

from avatarrex.gl.context import (
    NoContext,
    current_context,
    gl_context,
    gl_unavailable,
    in_software,
    per_context,
    renderer_name,
    use_context,
)
from avatarrex.gl.shader import ShaderError, ShaderSource, compute_shader, draw_program, load_shader

__all__ = [
    "NoContext",
    "ShaderError",
    "ShaderSource",
    "compute_shader",
    "current_context",
    "draw_program",
    "gl_context",
    "gl_unavailable",
    "in_software",
    "load_shader",
    "per_context",
    "renderer_name",
    "use_context",
]
