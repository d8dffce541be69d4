"""Pictures of a body whose cloth slides, registered: the slide is found, and a pose that no picture showed has its own."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.fields.outgrowth import VOXEL, Outgrowth
from avatarrex.fields.slide import JOINTS, Slide, carriers
from avatarrex.signals.driving import Signals
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import pose_person
from avatarrex.training.core import registration
from avatarrex.training.core.projection import paint, project
from avatarrex.training.core.registration import register
from avatarrex.training.core.sighting import Sighting
from avatarrex.training.core.silhouette import Silhouette

HEAD = 15
SEEN = 8000
"""Points of the skin that a picture shows: as many as a relief of its samples needs."""
FEW = 3000
"""That will do for a slide of nodes."""


def pattern(place: Tensor) -> Tensor:
    """Waves of 8 cm at rest."""
    turns = torch.tensor([[80.0, 10, 0], [0, 80, 10], [10, 0, 80]])
    return 0.5 + 0.3 * torch.sin(place @ turns)


@pytest.fixture(scope="module")
def bare() -> Avatar:
    return Avatar.create(load_person(), "compact", 0)


def pictured(avatar: Avatar, share: Tensor, height: Tensor, seed: int, count: int = SEEN) -> Sighting:
    """`count` points of the skin in a pose, painted with the pattern of where its colours come from by `share`: what its pixels show
    stands `height` (v,) metres higher, seen from all sides.
    """
    rng = np.random.default_rng(seed)
    pose = np.zeros((21, 3))
    pose[[11, 12, 13, 15, 16, 17, 18]] = rng.uniform(-0.6, 0.6, (7, 3))  # head, collars, shoulders, elbows
    posed = pose_person(avatar.person, replace(Signals.rest(), body_pose=pose), Counters(), None)
    avatar.body.slide = None
    body_frame = avatar.body.frame(posed.body, avatar.body.code(posed.body_rotation))
    seen = torch.from_numpy(rng.permutation(np.flatnonzero(avatar.person.body.v_template[:, 1] > 0))[:count])
    normal = vertex_normals(posed.body.vertices, avatar.person.body.faces)[seen]
    shown = posed.body.vertices[seen] + height[seen, None] * normal
    avatar.body.add_slide(share)
    beside = body_frame.samples.neighbours_of(shown)
    true = avatar.body.slid(body_frame.samples, posed.body.skinning).painted_position(shown, beside)
    side = torch.from_numpy(rng.standard_normal((count, 3))).float()
    back = torch.nn.functional.normalize(
        normal + torch.nn.functional.normalize(side, dim=1), dim=1
    )  # within 60° of the normal
    parallax = back / (back * normal).sum(1, keepdim=True).clamp_min(0.3)
    position = shown - height[seen, None] * parallax
    return Sighting(posed, np.eye(4), body_frame.samples, {}, position, pattern(true), torch.ones(count), parallax)


def off(avatar: Avatar, one: Sighting, share: Tensor) -> float:
    """Millimetres between where the body says that the picture's colours come from and where by `share` they do."""
    found, own = one.slid(avatar).painted_position(one.position, one.beside), avatar.body.slide
    avatar.body.add_slide(share)
    true = one.slid(avatar).painted_position(one.position, one.beside)
    avatar.body.slide = own
    return 1e3 * float((found - true).norm(dim=1).mean())


def registered(avatar: Avatar, share: Tensor, height: Tensor, slides: bool, rises: bool, count: int = SEEN) -> None:
    """By four pictures, where something slides, else by three."""
    avatar.body.add_detail(0.02)
    detail = avatar.body.detail
    assert detail is not None

    def painted(sightings: Sequence[Sighting]) -> None:
        paint(detail, [project(avatar, one, "body") for one in sightings], "here", 0)

    register(
        avatar,
        [pictured(avatar, share, height, seed, count) for seed in range(4 if slides else 3)],
        [],
        painted,
        slides,
        rises,
    )


def sliding(avatar: Avatar) -> Tensor:
    """A share that is no template's."""
    body, noise = avatar.body, torch.Generator().manual_seed(0)
    mask = carriers(body.node_rest, avatar.person.body.joint_template)
    return mask * 0.03 * torch.randn(JOINTS, generator=noise)


def test_the_slide_is_found_and_holds_in_another_pose(bare: Avatar) -> None:
    body, share, level = bare.body, sliding(bare), torch.zeros(len(bare.person.body.v_template))
    other = pictured(bare, share, level, 100)
    body.add_slide(Slide.none(len(body.node_vertex)).share)
    before = off(bare, other, share)
    registered(bare, share, level, slides=True, rises=False, count=FEW)
    assert body.relief is None
    assert before > 5
    assert off(bare, other, share) < 0.5 * before


def test_the_relief_is_found_beside_the_slide(bare: Avatar) -> None:
    """A surface that stands up to 12 mm off, in waves of 31 cm, while what is painted on it slides."""
    body, share = bare.body, sliding(bare)
    height = 0.004 + 0.008 * torch.sin(20 * bare.person.body.v_template[:, 1])
    registered(bare, share, height, slides=True, rises=True)
    assert body.relief is not None
    assert body.slide is not None
    shown = body.sample_rest[:, 1] > 0.05
    found, true = body.relief[body.sample_anchor][shown], height[body.sample_vertex][shown]
    body.relief = None
    assert (found - true).abs().mean() < 0.35 * true.abs().mean()


def test_the_relief_is_found_alone_and_stays_within_cloth(bare: Avatar, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cloth stands up to 4 mm off here, what is below the chest 6 mm. A surface 5 cm off is no cloth."""
    monkeypatch.setattr(registration, "HIGHEST", 0.004)
    body, nothing = bare.body, torch.zeros(len(bare.body.node_vertex), JOINTS)
    height = torch.where(bare.person.body.v_template[:, 1] > 0.3, 0.05, 0.006)
    registered(bare, nothing, height, slides=False, rises=True)
    assert body.relief is not None
    found = body.relief[body.sample_anchor]
    body.relief = None
    assert body.slide is None
    assert found.abs().max() <= 0.004 + 1e-6
    low = (body.sample_rest[:, 1] > 0.05) & (body.sample_rest[:, 1] < 0.2)
    assert found[low].median() > 0.003


def test_silhouettes_say_how_high_plain_cloth_stands(bare: Avatar) -> None:
    """Colours that are the same everywhere tell nothing; a border in five that ends far off is another thing's."""
    body, share = bare.body, torch.zeros(len(bare.body.node_vertex), JOINTS)
    body.add_detail(0.02)
    height = 0.004 + 0.004 * torch.sin(20 * bare.person.body.v_template[:, 1])
    sighting = pictured(bare, share, height, 0)
    plain = replace(sighting, colour=torch.full_like(sighting.colour, 0.5))
    miss = plain.beside.mean(height[body.sample_vertex, None])[:, 0]
    miss[::5] = 0.018
    detail = body.detail
    assert detail is not None
    blank = torch.full((len(detail.texel), 3), 0.5)
    register(bare, [plain], [Silhouette(plain.beside, miss)], lambda _: detail.paint(blank), False, True)
    assert body.relief is not None
    shown = torch.unique(plain.beside.index[:, 0])
    found, true = body.relief[body.sample_anchor][shown], height[body.sample_vertex][shown]
    body.relief = None
    assert (found - true).abs().mean() < 0.35 * true.abs().mean()


def test_borders_of_what_hangs_on_a_joint_do_not_raise_the_skin(bare: Avatar) -> None:
    """A ball at the head's joint, 2 cm off the nape: whether its outline ends short of the mattes or not."""
    body, share = bare.body, torch.zeros(len(bare.body.node_vertex), JOINTS)
    nape = body.template.joint_template[HEAD] + torch.tensor([0.0, -0.1, -0.12])
    first = (nape / VOXEL).round().long() - 10
    place = torch.stack(torch.meshgrid(*[torch.arange(21)] * 3, indexing="ij"), -1)
    body.set_outgrowth(Outgrowth(first, (place - 10.0).norm(dim=-1) * VOXEL - 0.03).hanging_on(HEAD, 0.02))
    body.add_detail(0.02)
    detail, found = body.detail, []
    assert detail is not None
    try:
        sighting = pictured(bare, share, torch.zeros(len(bare.person.body.v_template)), 0)
        plain = replace(sighting, colour=torch.full_like(sighting.colour, 0.5))
        of_ball = plain.samples.neighbours_of(plain.samples.position[len(body.sample_anchor) :])
        assert (of_ball.index >= len(body.sample_anchor)).any(1).all()
        blank = torch.full((len(detail.texel), 3), 0.5)
        for short in (0.0, 0.003):
            borders = [
                Silhouette(plain.beside, torch.full((len(plain.position),), 0.002)),
                Silhouette(of_ball, torch.full((len(of_ball.index),), short)),
            ]
            register(bare, [plain], borders, lambda _: detail.paint(blank), False, True)
            assert body.relief is not None
            found.append(body.relief.clone())
            body.relief = None
    finally:
        body.set_outgrowth(None)
    assert found[0].abs().max() > 0.001
    assert torch.equal(*found)
