"""The readings of the paper's T that the study of local frames compares."""

from __future__ import annotations

import pytest
import torch
from fields.arm import arm_field, arm_frame, near, pose_arm

from avatarrex.measure.studies.local_frames import VARIANTS, Choice, Pose

NAMES = (*VARIANTS, "anchors", "turned")


def choice(name: str, elbow: tuple[float, float, float]) -> tuple[Choice, Pose]:
    """Of an arm, its elbow bent."""
    field = arm_field("anchors" if name in VARIANTS else name, dtype=torch.float64).requires_grad_(False)
    return Choice(name, field), Pose(field, pose_arm(field.template, elbow), arm_frame(field, elbow))


@pytest.mark.parametrize("name", NAMES)
def test_every_reading_of_a_limb_at_rest_is_the_point_itself(name: str) -> None:
    of_arm, pose = choice(name, (0.0, 0.0, 0.0))
    points = near(pose.template, 50)
    pairs, local, weight = of_arm.localise(pose, points, of_arm.field.pairs(pose.frame, points))
    expected = points[pairs.point] - pose.frame.node_rest[pairs.node]
    torch.testing.assert_close(local, expected, atol=1e-7, rtol=0)  # skinning weights sum to 1 ± 6e-8
    assert (weight > 0).all()


def test_the_vertex_frame_returns_vertices_to_rest_exactly() -> None:
    of_arm, pose = choice("vertex", (0.2, 0.0, 1.5))
    found = of_arm.rest_position(pose, pose.template.vertices)
    torch.testing.assert_close(found, of_arm.field.template.v_template, atol=1e-9, rtol=0)


@pytest.mark.parametrize("name", NAMES)
def test_weights_reach_the_bent_arm_alone(name: str) -> None:
    """Finite, and nothing where no node is."""
    of_arm, pose = choice(name, (0.0, 0.4, 0.9))
    points = torch.cat([near(pose.template, 80), torch.full((2, 3), 9.0, dtype=torch.float64)])
    rest = of_arm.rest_position(pose, points)
    assert rest.isfinite().all()
    assert torch.equal(rest[-2:], points[-2:])
    assert (rest[:-2] != points[:-2]).any()
