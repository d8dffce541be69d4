"""Cameras: where points are in the picture, and parts of it."""

import numpy as np
import pytest

from avatarrex.camera import Camera


@pytest.fixture
def camera() -> Camera:
    return Camera.orbit(30, -20, 2.0, 50, target=(0.3, -0.2, 0.5), width=320, height=200)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def pixels_reference(camera: Camera, point: np.ndarray) -> tuple[float, float, float]:
    """Column, row and depth of one point: K [R | t] in homogeneous coordinates, by elements."""
    k, m = camera.intrinsics, camera.camera_from_world
    x, y, z = (sum(m[row, axis] * point[axis] for axis in range(3)) + m[row, 3] for row in range(3))
    return (k[0, 0] * x + k[0, 1] * y) / z + k[0, 2], k[1, 1] * y / z + k[1, 2], z


def test_pixels_are_the_reference_s(camera, rng):
    skewed = Camera(
        camera.intrinsics + np.array([[0, 7.0, 3.0], [0, 11.0, -5.0], [0, 0, 0]]), camera.camera_from_world, 320, 200
    )
    points = rng.uniform(-0.8, 0.8, (4, 5, 3))
    pixel, depth = skewed.pixels(points)
    wanted = np.array([pixels_reference(skewed, point) for point in points.reshape(-1, 3)]).reshape(4, 5, 3)
    np.testing.assert_allclose(pixel, wanted[..., :2], rtol=1e-12)
    np.testing.assert_allclose(depth, wanted[..., 2], rtol=1e-12)


def test_the_target_is_in_the_middle_and_its_left_on_the_right(camera):
    (middle, left, above), depth = Camera.orbit(target=(1.0, 2, 3)).pixels(
        np.array([[1.0, 2, 3], [1.1, 2, 3], [1, 2.1, 3]])
    )
    np.testing.assert_allclose(middle, [256, 256], atol=1e-9)
    np.testing.assert_allclose(depth, 2.6)
    assert left[0] > 256, "the person's left is on the viewer's right"
    assert above[1] < 256, "row 0 is at the top"


def test_points_that_are_too_near_are_divided_by_the_nearest_depth(camera):
    """At the camera's centre and at its back: finite, and told by their depth."""
    away = camera.camera_from_world[2, :3]
    pixel, depth = camera.pixels(camera.centre + np.outer([0.0, -1.0, 0.005, 1.0], away), nearest=0.01)
    assert np.isfinite(pixel).all()
    np.testing.assert_allclose(depth, [0, -1, 0.005, 1], atol=1e-9)
    np.testing.assert_allclose(pixel[3], [160, 100], atol=1e-9)
    np.testing.assert_allclose(pixel[2], [80, 50], atol=1e-6)


def test_a_cropped_and_a_resized_view_see_a_point_where_the_whole_one_does(camera, rng):
    points = rng.uniform(-0.5, 0.5, (10, 3))
    whole, _ = camera.pixels(points)
    part = camera.cropped(40, 25, 100, 60)
    assert (part.width, part.height) == (100, 60)
    np.testing.assert_allclose(part.pixels(points)[0], whole - [40, 25], atol=1e-9)
    np.testing.assert_allclose(camera.resized(160, 400).pixels(points)[0], whole * [0.5, 2], atol=1e-9)
