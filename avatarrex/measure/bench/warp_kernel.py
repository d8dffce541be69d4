"""The kernel of the warp peer. Its types are given when it is compiled: as annotations, type checkers would read them, too."""

import inspect
from typing import Any

import warp as wp


def _distance(mesh: Any, points: Any, reach: Any, out: Any) -> None:
    """Signed distance of each point, `reach` beyond it."""
    i = wp.tid()
    found = wp.mesh_query_point_sign_normal(mesh, points[i], reach)
    if found.result:
        nearest = wp.mesh_eval_position(mesh, found.face, found.u, found.v)
        out[i] = found.sign * wp.length(points[i] - nearest)
    else:
        out[i] = reach


def kernel() -> Any:
    """Compiled when it is launched first."""
    plain = inspect.unwrap(_distance)
    plain.__annotations__ = {
        "mesh": wp.uint64,
        "points": wp.array(dtype=wp.vec3),
        "reach": float,
        "out": wp.array(dtype=wp.float32),
    }
    return wp.kernel(plain)
