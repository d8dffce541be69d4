"""The body's relief: the surface stands off where the networks have it, in every pose, and nothing else about a frame changes."""

from dataclasses import replace

import pytest
import torch

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.counters import Counters
from avatarrex.fields.body import BodyFrame
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.posed import PosedPerson, pose_person

HEIGHT = 0.006


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar("default")


def posed_as(avatar: Avatar, pose: str) -> PosedPerson:
    return pose_person(avatar.person, replace(Signals.rest(), body_pose=named_pose(pose)), Counters(), None)


def framed(avatar: Avatar, posed: PosedPerson, height: float | None) -> BodyFrame:
    """The body's frame with a relief of `height` metres everywhere."""
    if height is not None:
        avatar.body.raise_surface(torch.full((len(avatar.body.sample_rest),), height))
    frame = avatar.body.frame(posed.body, avatar.body.code(posed.body_rotation))
    avatar.body.relief = None
    return frame


@pytest.mark.parametrize("pose", ["tpose", "squat"])
@torch.no_grad()
def test_the_surface_stands_off_by_the_relief(avatar: Avatar, pose: str) -> None:
    """Where a limb is alone, the distance at a point is that of the point HEIGHT further in without the relief."""
    posed, body = posed_as(avatar, pose), avatar.body
    plain, raised = (framed(avatar, posed, h) for h in (None, HEIGHT))
    outward = vertex_normals(posed.body.vertices, body.template.faces)
    chosen = body.sample_vertex[::7]
    inner = posed.body.vertices[chosen] + outward[chosen] * body.clothing_offset[chosen, None]
    difference = body.sdf(raised, inner + HEIGHT * outward[chosen]) - body.sdf(plain, inner)
    assert difference.abs().median() < 0.0003
    higher = body.sdf(plain, inner) - body.sdf(raised, inner)
    assert higher.median() == pytest.approx(HEIGHT, rel=0.2)  # the learnt field is not quite of slope 1


@torch.no_grad()
def test_a_relief_of_nothing_changes_no_bit(avatar: Avatar) -> None:
    posed = posed_as(avatar, "walk")
    plain, level = (framed(avatar, posed, h) for h in (None, 0.0))
    assert torch.equal(plain.samples.rest_from_posed, level.samples.rest_from_posed)
    assert torch.equal(plain.samples.position, level.samples.position)
