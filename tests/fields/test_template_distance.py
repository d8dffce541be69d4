"""What the nearest vertices say about points: ω without steps."""

import numpy as np
import pytest
import torch

from avatarrex.fields.template_distance import AIR, MAX_DEVIATION, TemplateDistance


def plane(weight: np.ndarray, side: int = 21) -> TemplateDistance:
    """Vertices 1 cm apart in the plane z = 0, ω painted as a function of x."""
    x, y = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    vertices = 0.01 * np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    normals = np.tile([0.0, 0, 1], (len(vertices), 1))
    return TemplateDistance.of(vertices, normals, np.repeat(weight, side), np.zeros(len(vertices)))


def test_omega_has_no_steps_where_it_changes() -> None:
    ramp = np.clip((np.arange(21) - 6) / 8, 0, 1)
    skin = plane(ramp)
    along = np.linspace(0.02, 0.18, 4001)
    points = np.stack([along, np.full_like(along, 0.1037), np.full_like(along, 0.004)], -1)
    weight = skin.query(points).weight
    assert np.abs(np.diff(weight)).max() < 0.002  # 0.04 mm steps; a vertex' own ω would jump by 0.125
    assert weight.min() == 0
    assert weight.max() == 1
    np.testing.assert_allclose(weight, np.clip((along / 0.01 - 6) / 8, 0, 1), atol=0.07)


def test_omega_is_the_vertex_own_where_all_agree() -> None:
    skin = plane(np.concatenate([np.zeros(10), [0.5], np.ones(10)]))
    points = np.array([[0.01, 0.05, 0.02], [0.19, 0.05, -0.02]])
    np.testing.assert_array_equal(skin.query(points).weight, [0, 1])


def test_a_field_may_stand_off_farther_than_it_may_be_hollow() -> None:
    depth = np.array([-0.04, -0.01, 0.04])
    here = plane(np.zeros(21)).query(np.stack([0 * depth + 0.1, 0 * depth + 0.1, depth], -1))
    assert here.clamped(torch.full((3,), 0.2)).tolist() == pytest.approx(list(depth + AIR * MAX_DEVIATION))
    assert here.clamped(torch.full((3,), -0.2)).tolist() == pytest.approx(list(depth - MAX_DEVIATION))
    assert here.clamped(torch.full((3,), -0.2), 0.5).tolist() == pytest.approx(list(depth - 0.5 * MAX_DEVIATION))
