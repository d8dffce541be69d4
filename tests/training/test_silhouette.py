"""A silhouette beside its matte: by how much higher the surface has to stand."""

import numpy as np
import pytest
import torch

from avatarrex.camera import Camera
from avatarrex.fields.local_frame import Neighbours, Samples
from avatarrex.pointmap.point_map import PointMap
from avatarrex.training.core.silhouette import FARTHEST, Silhouette, signed_distance

SIDE, FOCAL, AWAY = 128, 1024.0, 2.0
METRES = AWAY / FOCAL
"""A pixel spans so much at the ball."""


class Carried(Samples):
    """Samples of which each carries a point; remembers the points."""

    def __init__(self) -> None:
        self.points: list[torch.Tensor] = []

    def neighbours_of(self, position: torch.Tensor, impl: str = "auto") -> Neighbours:
        self.points.append(position)
        return Neighbours(torch.arange(len(position))[:, None], torch.ones(len(position), 1))


def disc(radius: float) -> np.ndarray:
    """Pixels within so many of the middle."""
    row, column = np.indices((SIDE, SIDE)) + 0.5 - SIDE / 2
    return np.hypot(row, column) < radius


def seen(radius: float) -> tuple[PointMap, Camera]:
    """A ball, as far as its border: a disc of points whose normals point away from its middle; a camera that lies on its side."""
    turned = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, AWAY], [0, 0, 0, 1]])
    intrinsics = np.array([[FOCAL, 0, SIDE / 2], [0, FOCAL, SIDE / 2], [0, 0, 1]])
    camera = Camera(intrinsics, turned, SIDE, SIDE)
    row, column = np.indices((SIDE, SIDE)) + 0.5 - SIDE / 2
    place = METRES * np.stack([column, row, 0 * row], -1) @ turned[:3, :3]
    normal = place / np.linalg.norm(place, axis=-1, keepdims=True)
    drawn = torch.from_numpy(disc(radius))
    covered = drawn[..., None].float()
    points = (torch.from_numpy(each).float() * covered for each in (place, normal))
    depth, zero = torch.full((SIDE, SIDE), AWAY), torch.zeros(SIDE, SIDE)
    return PointMap(*points, depth, drawn, drawn.float(), torch.zeros(SIDE, SIDE, 3), zero, "none"), camera


@pytest.mark.parametrize("matte", [33.0, 30.0, 27.5])
def test_the_surface_has_to_stand_where_the_matte_ends(matte: float) -> None:
    point_map, camera = seen(30.0)
    carried = Carried()
    found = Silhouette.of(point_map, torch.ones(SIDE, SIDE, dtype=torch.bool), disc(matte), camera, carried)
    assert len(found.miss) > 100
    assert abs(float(found.miss.mean()) - (matte - 30) * METRES) < 0.3 * METRES
    assert carried.points[0].norm(dim=1).min() > 28 * METRES, "the border alone"


def test_what_is_another_s_does_not_count() -> None:
    """Border pixels of a part, a matte that ends far off, and one whose edge lies aside."""
    point_map, camera = seen(30.0)
    left = torch.arange(SIDE)[None].expand(SIDE, SIDE) < SIDE // 2
    carried = Carried()
    Silhouette.of(point_map, left, disc(31.0), camera, carried)
    across = carried.points[0] @ torch.from_numpy(camera.camera_from_world[0, :3]).float()
    assert len(across) > 50
    assert across.max() < 0
    everything = torch.ones_like(left)
    far = Silhouette.of(point_map, everything, disc(30.0 + 1.5 * FARTHEST / METRES), camera, carried)
    assert not len(far.miss)
    beside = disc(30.0) & (np.indices((SIDE, SIDE))[1] > SIDE // 2 - 10)
    kept = Silhouette.of(point_map, everything, beside, camera, carried)
    assert 0 < len(kept.miss) < 140, "where the matte is cut off its edge faces another way"


def test_distances_to_an_edge_meet_between_two_pixels() -> None:
    assert np.allclose(signed_distance(np.array([[False, False, True, True]])), [[1.5, 0.5, -0.5, -1.5]])
