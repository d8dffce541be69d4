"""Any driving signal gives finite pictures: ±π about every joint, shapes of ±5 σ, roots a kilometre away."""

import numpy as np
import pytest
import torch

from avatarrex.avatar import load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.pipeline import RenderSettings, render_frame
from avatarrex.signals.limits import random_signals
from avatarrex.signals.signals import Signals
from avatarrex.templates.posed import pose_person
from avatarrex.volume.build import body_frame

SETTINGS = RenderSettings(voxel=0.04, part_voxel=0.0125)


def half_turns(rng: np.random.Generator) -> Signals:
    """Every joint turned by exactly ±π about one of its axes."""
    pose = np.zeros((55, 3))
    pose[np.arange(55), rng.integers(3, size=55)] = rng.choice([-np.pi, np.pi], 55)
    return Signals.from_full_pose(pose, expression=rng.random(52), shape=rng.uniform(-5, 5, 10))


def anything(rng: np.random.Generator) -> Signals:
    """Rotations up to π about any axis, a root a kilometre away."""
    axis = rng.normal(size=(55, 3))
    pose = axis / np.linalg.norm(axis, axis=1, keepdims=True) * rng.uniform(0, np.pi, (55, 1))
    return Signals.from_full_pose(pose, translation=rng.normal(size=3) * 1000)


KINDS = {"half turns": half_turns, "anything": anything, "within limits": lambda rng: random_signals(rng, 1.0)}


@pytest.mark.parametrize("kind", KINDS)
def test_fields_are_finite_wherever_they_are_asked(kind: str) -> None:
    avatar, rng = load_avatar(), np.random.default_rng(0)
    generator = torch.Generator().manual_seed(0)
    for _ in range(40):
        posed = pose_person(avatar.person, KINDS[kind](rng), Counters(), None)
        frame = body_frame(avatar, posed)
        near = posed.body.vertices[torch.randint(len(posed.body.vertices), (200,), generator=generator)]
        points = torch.cat([near + 0.03 * torch.randn(200, 3, generator=generator), frame.node_position[:8]])
        gaze = torch.nn.functional.normalize(torch.randn(len(points), 3, generator=generator), dim=-1)
        with torch.no_grad():
            assert torch.isfinite(avatar.body.sdf(frame, points)).all()
            colour = avatar.body.colour(frame, avatar.body.patches(frame), points, gaze)
        assert ((colour >= 0) & (colour <= 1)).all()
        for mesh in posed.parts.values():
            assert torch.isfinite(mesh).all()


@pytest.mark.parametrize("kind", KINDS)
def test_whole_frames_are_finite(kind: str) -> None:
    avatar, rng = load_avatar(), np.random.default_rng(1)
    for k in range(4):
        signals = KINDS[kind](rng)
        camera = Camera.orbit(90.0 * k, 10, 2.8, 45, signals.translation, 48, 48)
        frame = render_frame(avatar, signals, camera, SETTINGS)
        assert torch.isfinite(frame.image).all()
        assert torch.isfinite(frame.pointmap.position).all()
        assert frame.pointmap.hit.any()
