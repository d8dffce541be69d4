"""The kernel of the warp peer: warp reads its source, and finds no names in annotations that are only text."""

# mypy: ignore-errors

import warp as wp


@wp.kernel
def distance(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), reach: float, out: wp.array(dtype=wp.float32)):
    """Signed distance of each point, `reach` beyond it."""
    i = wp.tid()
    found = wp.mesh_query_point_sign_normal(mesh, points[i], reach)
    if found.result:
        nearest = wp.mesh_eval_position(mesh, found.face, found.u, found.v)
        out[i] = found.sign * wp.length(points[i] - nearest)
    else:
        out[i] = reach
