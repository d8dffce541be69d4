"""Body and parts are coloured side by side, in pieces: the colours of one piece, each patch decoded once."""

from __future__ import annotations

import pytest
import torch

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.frame import DeferredFrame
from avatarrex.levels import level, moving
from avatarrex.pipeline import render_deferred
from avatarrex.shading import colour
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose


@pytest.fixture(autouse=True)
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("name", ["balanced", "moving"])
def test_pieces_have_the_colours_of_the_whole(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    avatar, signals = load_avatar(), Signals.rest().replace(body_pose=named_pose("hands_on_hips"))
    settings = moving(level("balanced")) if name == "moving" else level("balanced")

    def last(piece: int, least: int) -> list[DeferredFrame]:
        monkeypatch.setattr(colour, "PIECE", piece)
        monkeypatch.setattr(colour, "LEAST_PIECE", least)
        frames: list[DeferredFrame] = []
        for azimuth in (0, 4, 8):
            camera = Camera.orbit(azimuth, 5, 1.1, 40, (0, 0.2, 0), 160, 160)
            frames.append(render_deferred(avatar, signals, camera, settings, frames[-1] if frames else None))
        return frames

    for one, other in zip(last(1 << 30, 1 << 30), last(700, 1)):
        assert one.counters["pixels_shaded"] > 5000
        torch.testing.assert_close(one.image, other.image, atol=2e-6, rtol=0)
        for counter in ("patches_decoded", "body_pixels", "hand_pixels", "face_pixels", "unet_runs"):
            assert one.counters[counter] == other.counters[counter], counter
