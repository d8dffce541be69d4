"""Distances on spheres and planes, where they are known."""

import numpy as np
import pytest
import trimesh

from avatarrex.camera import Camera
from avatarrex.metrics.mesh import Surface, depth_surface, distances, sampled, silhouette_iou


def sphere(radius, centre=(0, 0, 0), detail=4):
    ball = trimesh.creation.icosphere(subdivisions=detail, radius=radius)
    return Surface.of(ball.vertices + np.array(centre), ball.faces)


def rays(camera):
    """(h, w, 3) directions with camera z = 1, in the world."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    local = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.intrinsics).T
    return local @ camera.camera_from_world[:3, :3]


def seen_sphere(camera, radius):
    """Position, normal and hit of a sphere at the origin, exactly."""
    way = rays(camera)
    a, b, c = (way**2).sum(-1), (way @ camera.centre), (camera.centre**2).sum() - radius**2
    root = b**2 - a * c
    hit = root > 0
    position = camera.centre + way * ((-b - np.sqrt(np.maximum(root, 0))) / a)[..., None]
    position = np.where(hit[..., None], position, 0)
    return position.astype(np.float32), (position / radius).astype(np.float32), hit


def test_concentric_spheres_are_their_radii_apart():
    inner, outer = sphere(0.5), sphere(0.52)
    found = distances(inner.vertices, inner.normals, outer)
    assert found["mean_mm"] == pytest.approx(20, abs=0.8)  # facets of 4 cm sag by 0.4 mm
    assert found["p95_mm"] == pytest.approx(20, abs=0.8)
    assert found["angle_deg"] < 0.5


def test_a_surface_is_at_no_distance_from_itself_and_opposite_its_reverse():
    ball = sphere(0.5)
    found = distances(ball.vertices, ball.normals, ball)
    assert found["mean_mm"] == pytest.approx(0, abs=1e-9)
    reverse = Surface.of(ball.vertices, ball.faces[:, ::-1])
    assert distances(ball.vertices, ball.normals, reverse)["angle_deg"] == pytest.approx(180, abs=1e-3)


def test_the_95th_percentile_is_that_of_the_distances():
    plane = Surface.of(np.array([[-9, -9, 0], [9, -9, 0], [0, 9, 0.0]]), np.array([[0, 1, 2]]))
    height = np.linspace(0, 0.1, 1001)
    points = np.stack([0 * height, 0 * height, height], 1)
    found = distances(points, np.tile([0.0, 0.0, 1.0], (1001, 1)), plane)
    assert found == pytest.approx({"mean_mm": 50, "p95_mm": 95, "angle_deg": 0}, abs=1e-6)


def test_a_depth_map_becomes_the_surface_it_was_taken_of():
    cameras = [Camera.orbit(azimuth, 10, 2.0, 40, width=128, height=96) for azimuth in (0, 120, 240)]
    parts = [depth_surface(*seen_sphere(camera, 0.5), camera) for camera in cameras]
    own, ball = Surface.joined(parts), sphere(0.5, detail=5)
    outward = np.cross(
        own.vertices[own.faces[:, 1]] - own.vertices[own.faces[:, 0]],
        own.vertices[own.faces[:, 2]] - own.vertices[own.faces[:, 0]],
    )
    assert ((outward * own.normals[own.faces[:, 0]]).sum(1) > 0).all()
    points, normals = (np.concatenate(x) for x in zip(*(ball.seen_by(camera) for camera in cameras)))
    found = distances(points, normals, own)
    assert found["mean_mm"] < 0.8  # pixels of 1.5 cm on a radius of 50 sag by 0.1 mm; the rest is the rim
    assert found["p95_mm"] < 3  # at the rim, beyond the last pixel
    assert found["angle_deg"] < 0.5


def test_a_step_of_depth_is_not_bridged():
    camera = Camera.orbit(0, 0, 2.0, 40, width=40, height=40)
    depth = np.where(np.arange(40) < 20, 1.8, 2.2)[None, :, None] * np.ones((40, 40, 1))
    position = (camera.centre + rays(camera) * depth).astype(np.float32)
    normal = np.broadcast_to(np.float32([0, 0, 1]), position.shape)
    surface = depth_surface(position, normal, np.ones((40, 40), bool), camera)
    assert len(surface.faces) == 2 * 39 * 38
    assert np.ptp(surface.vertices[surface.faces][..., 2], axis=1).max() < 1e-6


def test_points_under_the_pixels_of_a_mesh():
    camera = Camera.orbit(30, 20, 2.0, 40, width=64, height=48)
    ball = sphere(0.5)
    points, normals = ball.seen_by(camera)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.5, atol=1e-3)
    np.testing.assert_allclose(normals, points / 0.5, atol=0.02)
    pixel, _ = camera.pixels(points)
    np.testing.assert_allclose(pixel % 1, 0.5, atol=1e-6)


def test_sampling_is_the_same_each_time():
    points = np.arange(30.0).reshape(10, 3)
    one, two = sampled(points, points, 4), sampled(points, points, 4)
    np.testing.assert_array_equal(one[0], two[0])
    np.testing.assert_array_equal(one[0], one[1])
    assert len(np.unique(one[0][:, 0])) == 4
    assert sampled(points, points, 10)[0] is points


def test_overlap_of_shifted_squares():
    a, b = np.zeros((20, 20), bool), np.zeros((20, 20), bool)
    a[5:15, 5:15], b[5:15, 10:20] = True, True
    assert silhouette_iou(a, b) == pytest.approx(1 / 3)
    assert silhouette_iou(a, a) == 1
    assert np.isnan(silhouette_iou(a & ~a, b & ~b))
