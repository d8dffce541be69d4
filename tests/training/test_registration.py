"""Pictures of a body whose cloth slides, registered: the slide is found, and a pose that no picture showed has its own."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.fields.slide import JOINTS, Slide, carriers
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import pose_person
from avatarrex.training.core.projection import paint, project
from avatarrex.training.core.registration import register
from avatarrex.training.core.sighting import Sighting

SEEN = 3000
"""Points of the skin that a picture shows."""


def pattern(place: Tensor) -> Tensor:
    """Waves of 8 cm at rest."""
    turns = torch.tensor([[80.0, 10, 0], [0, 80, 10], [10, 0, 80]])
    return 0.5 + 0.3 * torch.sin(place @ turns)


@pytest.fixture(scope="module")
def bare() -> Avatar:
    return Avatar.create(load_person(), "compact", 0)


def pictured(avatar: Avatar, share: Tensor, seed: int) -> Sighting:
    """The skin in a pose, painted with the pattern of where its colours come from by `share`."""
    rng = np.random.default_rng(seed)
    pose = np.zeros((21, 3))
    pose[[11, 12, 13, 15, 16, 17, 18]] = rng.uniform(-0.6, 0.6, (7, 3))  # head, collars, shoulders, elbows
    posed = pose_person(avatar.person, replace(Signals.rest(), body_pose=pose), Counters(), None)
    avatar.body.slide = None
    body_frame = avatar.body.frame(posed.body, avatar.body.code(posed.body_rotation))
    chosen = np.flatnonzero(avatar.person.body.v_template[:, 1] > 0)
    position = posed.body.vertices[torch.from_numpy(rng.permutation(chosen)[:SEEN])]
    avatar.body.add_slide(share)
    beside = body_frame.samples.neighbours_of(position)
    true = avatar.body.slid(body_frame.samples, posed.body.skinning).painted_position(position, beside)
    return Sighting(posed, body_frame.samples, {}, position, pattern(true), torch.ones(len(position)))


def off(avatar: Avatar, one: Sighting, share: Tensor) -> float:
    """Millimetres between where the body says that the picture's colours come from and where by `share` they do."""
    found, own = one.slid(avatar).painted_position(one.position, one.beside), avatar.body.slide
    avatar.body.add_slide(share)
    true = one.slid(avatar).painted_position(one.position, one.beside)
    avatar.body.slide = own
    return 1e3 * float((found - true).norm(dim=1).mean())


def test_the_slide_is_found_and_holds_in_another_pose(bare: Avatar) -> None:
    body = bare.body
    noise = torch.Generator().manual_seed(0)
    mask = carriers(bare.person.body.v_template[body.node_vertex], bare.person.body.joint_template)
    share = mask * 0.03 * torch.randn(JOINTS, generator=noise)
    sightings = [pictured(bare, share, seed) for seed in range(6)]
    other = pictured(bare, share, 100)
    body.add_detail(0.02)
    detail = body.detail
    assert detail is not None

    def painted() -> None:
        paint(detail, [project(bare, one, "body") for one in sightings], "here", 0)

    body.add_slide(Slide.none(len(body.node_vertex)).share)
    before = off(bare, other, share)
    register(bare, sightings, painted)
    after = off(bare, other, share)
    assert before > 5
    assert after < 0.5 * before
