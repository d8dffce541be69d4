"""Pixels about the outline, and what their rays say of a surface that is off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from capture.tiny_capture import TinyCapture
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Rig, open_capture
from avatarrex.fields.composition import Composed
from avatarrex.pointmap.rays import RayPlane
from avatarrex.reference.solids import body_grid, sphere
from avatarrex.training.core.losses import silhouette_loss
from avatarrex.training.core.outline import SURE, closest
from avatarrex.training.core.pixels import PixelBatch, draw_outline
from avatarrex.volume.sdf_volume import SdfVolume

MIDDLE = (0.3, 0.3, 0.3)
RADIUS = 0.2
CAMERA = Camera.orbit(20, 10, 1.5, 25, MIDDLE, 96, 96)


@pytest.fixture(scope="module")
def rig(tmp_path_factory) -> Rig:
    """A small capture's body."""
    return open_capture(TinyCapture.make(("body",)).folder(tmp_path_factory.mktemp("outline") / "capture")).rigs["body"]


def test_pixels_of_the_outline_lie_about_it_on_both_sides(rig, monkeypatch):
    """Of a disc 500 pixels high: within a few times half a per cent of its height, in equal parts."""
    rows, columns = np.mgrid[:560, :560]
    off = np.hypot(rows - 280, columns - 280) - 250
    matte = (255 * np.clip(0.5 - off, 0, 1)).astype(np.uint8)
    monkeypatch.setattr(Rig, "matte", lambda self, view, frame: matte)
    monkeypatch.setattr(Rig, "image", lambda self, view, frame: np.dstack([matte // 2, matte, matte]))
    drawn = draw_outline(rig, 0, 0, 2000, np.random.default_rng(1), None)
    x, y = (drawn.place.numpy() - 0.5).astype(int).T
    assert len(x) == 2000
    assert 1.2 < np.median(np.abs(off[y, x])) < 2.2
    assert np.quantile(np.abs(off[y, x]), 0.999) < 10
    assert 0.45 < (matte[y, x] > 127).mean() < 0.55
    assert (drawn.matte.numpy() == matte[y, x] / np.float32(255)).all()
    assert torch.equal(drawn.colour[:, 2], drawn.matte.square())


def test_a_picture_without_an_edge_has_no_outline(rig, monkeypatch):
    for value in (0, 255):
        flat = np.full_like(rig.matte(0, 0), value)
        monkeypatch.setattr(Rig, "matte", lambda self, view, frame, flat=flat: flat)
        assert len(draw_outline(rig, 0, 0, 50, np.random.default_rng(1), None).place) == 0


def test_within_a_box_nothing_else_is_drawn(rig):
    ys, xs = np.nonzero(rig.matte(0, 0) > 127)
    box = (int(xs.min()), int(ys.min()), int(xs.mean()), int(ys.mean()))
    place = draw_outline(rig, 0, 0, 200, np.random.default_rng(1), box).place
    assert (place >= torch.tensor(box[:2])).all()
    assert (place < torch.tensor(box[2:])).all()


@dataclass
class Ball:
    """A field with one degree of freedom."""

    radius: Tensor

    def composed(self, position: Tensor) -> Composed:
        """All body."""
        return Composed(self.alone(position), torch.zeros_like(position))

    def alone(self, position: Tensor) -> Tensor:
        """Distance to the ball."""
        return (position - torch.tensor(MIDDLE)).norm(dim=-1) - self.radius

    def around(self, count: int, noise: torch.Generator) -> Tensor:
        """Not evaluated here."""
        raise NotImplementedError

    def paint(self) -> None:
        """Not evaluated here."""
        raise NotImplementedError


@pytest.mark.parametrize("stale", [-0.006, 0.0, 0.006])
def test_the_outline_finds_the_radius(stale):
    """From a stored surface that is 6 mm off to a tenth of a pixel, which spans 7 mm."""
    volume = SdfVolume(body_grid(sphere(MIDDLE, RADIUS + stale), (0, 0, 0), 0.02, (31, 31, 31)))
    plane = RayPlane.of(CAMERA, np.array(MIDDLE))
    place = 96 * torch.rand(6000, 2, generator=torch.Generator().manual_seed(3))
    rays = plane.rays(place)
    along = ((torch.tensor(MIDDLE) - rays.origin) * rays.direction).sum(-1)
    beside = (rays.at(along) - torch.tensor(MIDDLE)).norm(dim=-1) - RADIUS
    near = beside.abs() < 0.02
    matte = (0.5 - beside / (plane.footprint * (1 - along / rays.camera))).clamp(0, 1)[near]
    batch = PixelBatch(place[near], torch.zeros(int(near.sum()), 3), matte)

    def loss(radius: float) -> float:
        found = closest(Ball(torch.tensor(radius)), volume, CAMERA, batch)
        return float(silhouette_loss(found.distance, found.width, found.matte, torch.ones(len(matte))).value)

    tried = RADIUS + torch.linspace(-0.008, 0.008, 161)
    assert abs(float(tried[int(np.argmin([loss(float(radius)) for radius in tried]))]) - RADIUS) <= 7e-4


def test_rays_that_are_right_by_far_are_not_queried():
    volume = SdfVolume(body_grid(sphere(MIDDLE, RADIUS), (0, 0, 0), 0.02, (31, 31, 31)))
    place = 96 * torch.rand(3000, 2, generator=torch.Generator().manual_seed(3))
    rays = RayPlane.of(CAMERA, np.array(MIDDLE)).rays(place)
    along = ((torch.tensor(MIDDLE) - rays.origin) * rays.direction).sum(-1)
    beside = (rays.at(along) - torch.tensor(MIDDLE)).norm(dim=-1) - RADIUS
    matte = (beside < 0).float()
    found = closest(Ball(torch.tensor(RADIUS)), volume, CAMERA, PixelBatch(place, torch.zeros(len(place), 3), matte))
    sure = beside.abs() > SURE + 0.003
    assert sure.sum() > 1000
    assert found.distance[sure].isnan().all()
    wrong = closest(
        Ball(torch.tensor(RADIUS)), volume, CAMERA, PixelBatch(place, torch.zeros(len(place), 3), 1 - matte)
    )
    assert (~wrong.distance.isnan()).sum() > 2 * (~found.distance.isnan()).sum() > 200
