"""Signed distances by libigl, warp, Open3D and trimesh, and by trying every triangle.

Each takes a case (vertices, faces, points; float64) and gives what measures it once: any tree is built inside, as it is for
every posed hand. Distances in metres, negative inside; NaN, or the bound, beyond a bound.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import torch

from avatarrex.measure.bench.contest import Peers
from avatarrex.ops.closest_point import closest_point
from avatarrex.ops.triangle import closest_on_triangle

BOUND = (-0.05, 0.025)
"""All that the composition uses of a hand's distance (paper eq. 13)."""
Measured = Callable[[], np.ndarray]


def ours(
    vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, bound: bool = True, impl: Any = "auto"
) -> Measured:
    """`ops.closest_point` in float32, what a frame uses."""
    mesh, query = (torch.as_tensor(array, dtype=torch.float32) for array in (vertices, points))
    corners = torch.as_tensor(faces)
    limits = BOUND if bound else None
    return lambda: np.asarray(closest_point(mesh, corners, query, limits, impl).sdf)


def libigl(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, bound: bool = True) -> Measured:
    """AABB tree, pseudonormals."""
    import igl

    low, high = BOUND if bound else (-np.inf, np.inf)
    kind = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    corners = faces.astype(np.int64)
    return lambda: np.asarray(igl.signed_distance(points, vertices, corners, kind, low, high)[0])


def warp(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> Measured:
    """A bounding volume hierarchy on the CPU, pseudonormals, searched as far as the bound."""
    kernel, wp = _warp_kernel()
    query = wp.array(points.astype(np.float32), dtype=wp.vec3, device="cpu")
    corners = np.ascontiguousarray(faces.reshape(-1), dtype=np.int32)

    def measure() -> np.ndarray:
        mesh = wp.Mesh(
            wp.array(vertices.astype(np.float32), dtype=wp.vec3, device="cpu"),
            wp.array(corners, dtype=wp.int32, device="cpu"),
        )
        out = wp.zeros(len(points), dtype=wp.float32, device="cpu")
        wp.launch(kernel, dim=len(points), inputs=[mesh.id, query, 0.05], outputs=[out], device="cpu")
        return np.asarray(out.numpy())

    return measure


@cache
def _warp_kernel() -> tuple[Any, Any]:
    import warp as wp

    wp.config.quiet = True  # it greets on stdout otherwise
    wp.init()
    from avatarrex.measure.bench.warp_kernel import kernel

    return kernel(), wp


def open3d(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> Measured:
    """Embree; the sign by rays."""
    import open3d as o3d

    mesh, query = vertices.astype(np.float32), points.astype(np.float32)

    def measure() -> np.ndarray:
        scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(o3d.core.Tensor(mesh), o3d.core.Tensor(faces.astype(np.uint32)))
        return np.asarray(scene.compute_signed_distance(o3d.core.Tensor(query), nthreads=1).numpy())

    return measure


def trimesh(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> Measured:
    """`trimesh.proximity`: an R-tree and Python."""
    import trimesh as tm

    def measure() -> np.ndarray:
        mesh = tm.Trimesh(vertices, faces, process=False)
        return -np.asarray(tm.proximity.signed_distance(mesh, points))

    return measure


def brute(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> Measured:
    """Every triangle for every point, float32, unsigned."""
    corner = torch.as_tensor(vertices, dtype=torch.float32)[torch.as_tensor(faces)].unbind(1)
    query = torch.as_tensor(points, dtype=torch.float32)

    def measure() -> np.ndarray:
        step = max(1, 1_000_000 // len(faces))
        squares = [closest_on_triangle(some[:, None], *corner)[0].amin(1) for some in torch.split(query, step)]
        return torch.cat(squares).sqrt().numpy()

    return measure


PEERS: Peers = {"libigl": (("igl",), libigl), "warp": (("warp",), warp), "open3d": (("open3d",), open3d)}
SLOW: Peers = {"trimesh": (("trimesh", "rtree"), trimesh), "brute_force": ((), brute)}
"""Measured once, on some of the points; the cost of both is proportional to their number."""
