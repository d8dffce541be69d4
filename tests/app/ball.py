"""A quick stand-in for the pipeline, for tests of the studio alone: a shaded ball that depends on every signal."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import avatarrex_studio.cli.headless  # noqa: F401  its annotations take the true engine, before a test puts another in its place
import numpy as np
import torch
from avatarrex_studio.engine.engine import Engine

from avatarrex.avatar import Avatar
from avatarrex.counters import NAMES
from avatarrex.frame import DeferredFrame
from avatarrex.pointmap.occlusion_edges import OcclusionEdges
from avatarrex.templates.parts import PARTS
from avatarrex.templates.person import load_person
from avatarrex.volume.sdf_volume import BodyGrid, SdfVolume

VOLUME = SdfVolume(BodyGrid(np.zeros(3), 0.02, torch.ones(64, 64, 64)))
"""One MiB, with nothing in it."""


@dataclass(frozen=True)
class BallMap:
    """The point map of the ball."""

    position: torch.Tensor
    normal: torch.Tensor
    depth: torch.Tensor
    hit: torch.Tensor
    coverage: torch.Tensor
    part_weight: torch.Tensor
    steps: torch.Tensor
    edges: OcclusionEdges = field(default_factory=OcclusionEdges.none)


class BallFrame(DeferredFrame):
    """What the studio reads of a frame, and no more."""

    image = pointmap = volume = view = signals = None
    """Values of its own in place of `DeferredFrame`'s properties."""
    unmixed = property(lambda self: self.image)

    def __init__(self, **values):
        for name, value in values.items():
            object.__setattr__(self, name, value)


def render_ball(avatar, signals, camera, settings, previous=None, between=None):
    """A ball in the image's middle; colours from the signals, size from the camera's distance."""
    height, width = camera.height, camera.width
    numbers = np.concatenate([signals.full_pose().ravel(), signals.expression, signals.translation])
    weights = np.sin(np.arange(1, len(numbers) + 1))
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    distance = float(np.linalg.norm(camera.centre))
    radius = 0.6 * camera.intrinsics[0, 0] / distance
    inside = 1 - ((x - camera.intrinsics[0, 2]) ** 2 + (y - camera.intrinsics[1, 2]) ** 2) / radius**2
    hit = inside > 0
    shade = inside.clamp(min=0).sqrt()
    tint = torch.tensor(0.5 + 0.5 * np.sin([numbers @ weights, 2 * (numbers @ weights) + 1, 2.0]), dtype=torch.float32)
    image = torch.cat([shade[..., None] * tint, hit[..., None].float()], -1)
    normal = torch.stack([x * 0, x * 0, x * 0 + 1], -1) * hit[..., None]
    depth = distance * hit
    covered = hit.float()
    ball = BallMap(normal * 0.5, normal, depth.float(), hit, covered, 0.2 * normal, 20 * covered)
    moved = previous is None or not np.array_equal(previous.key[0], signals.full_pose())
    counters = {**dict.fromkeys(NAMES, 0), "rays": width * height, "voxels_evaluated": 100 * moved}
    ms = {"templates": 1.0, "volume": 2.0, "pointmap": 1e-2 * width * height, "shading": 1.0}
    return BallFrame(
        image=image,
        pointmap=ball,
        camera=camera,
        view=camera,
        signals=signals,
        world_from_root=np.eye(4),
        key=(signals.full_pose(),),
        ms={**ms, "total": sum(ms.values())},
        counters=counters,
        settings=settings,
        volume=SimpleNamespace(sdf=VOLUME, changed=None, parts=dict.fromkeys(PARTS)),
        notes=("rays: ball",),
    )


def ball_engine(render=render_ball, settings=None, device="cpu", between=None):
    """An engine without an avatar file; the person is the true one."""
    avatar = object.__new__(Avatar)
    avatar.meta = {}
    avatar.person = load_person("default")
    avatar.body = torch.nn.Module()
    avatar.body.node_rest = avatar.person.body.v_template[::100]
    return Engine(avatar=avatar, render=render, settings=settings, device=device, between=between)
