"""Thumbnails: one at a time, kept on the disk by avatar and content, made anew where a file is damaged."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from avatarrex_studio.engine.thumbnails import SIDE, Sitter, Thumbnails
from surface.template_surface import template_surface

from avatarrex.avatar import Avatar
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.templates.person import load_person

REST = Sitter("pose", Signals.rest())
WAVE = Sitter("pose", Signals.rest().replace(body_pose=named_pose("wave")))


@pytest.fixture(scope="module")
def untrained():
    return Avatar.create(load_person(), "compact")


@pytest.fixture
def avatar(untrained):
    return replace(untrained, surface=replace(template_surface(), key="abc"))


@pytest.fixture
def drawn(monkeypatch):
    """What was drawn: grey, half covered."""
    found = []

    def draw(self, avatar, state, size, samples=4):
        found.append(state)
        picture = np.full((*size, 4), 0.5, np.float32)
        return SimpleNamespace(read=lambda: picture)

    monkeypatch.setattr("avatarrex_studio.engine.live.LiveSurface.draw", draw)
    return found


def test_one_a_call_and_the_second_time_from_the_disk(tmp_path, avatar, drawn):
    first = Thumbnails(tmp_path)
    first.see(avatar)
    first.want(REST)
    first.want(WAVE)
    assert first.waiting
    (sitter, pixels) = first.tend()
    assert (sitter, len(drawn)) == (REST, 1)
    assert pixels.shape == (SIDE, SIDE, 4)
    assert tuple(pixels[0, 0]) == (255, 255, 255, 128), "straight alpha"
    assert first.tend()[0] == WAVE
    assert first.tend() is None
    first.want(WAVE)
    assert not first.waiting, "once"
    again = Thumbnails(tmp_path)
    again.see(avatar)
    again.want(REST)
    assert np.array_equal(again.tend()[1], pixels)
    assert len(drawn) == 2
    assert {path.parent.name for path in tmp_path.rglob("*.png")} == {"abc"}


def test_another_avatar_is_another_folder(tmp_path, avatar, drawn):
    thumbnails = Thumbnails(tmp_path)
    thumbnails.see(avatar)
    thumbnails.want(REST)
    thumbnails.tend()
    other = replace(avatar, surface=replace(avatar.surface, key="def"))
    assert thumbnails.see(other)
    thumbnails.want(REST)
    thumbnails.tend()
    assert len(drawn) == 2
    assert {path.parent.name for path in tmp_path.rglob("*.png")} == {"abc", "def"}


@pytest.mark.parametrize("content", [b"", b"no picture", b"\x89PNG\r\n\x1a\n" + bytes(50), bytes(2**19)])
def test_a_damaged_file_is_drawn_anew(tmp_path, avatar, drawn, content):
    path = tmp_path / "abc" / f"{REST.key}.png"
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    thumbnails = Thumbnails(tmp_path)
    thumbnails.see(avatar)
    thumbnails.want(REST)
    assert thumbnails.tend() is not None
    assert len(drawn) == 1
    assert path.read_bytes() != content


def test_an_avatar_without_a_surface_waits_for_none(tmp_path, avatar):
    thumbnails = Thumbnails(tmp_path)
    thumbnails.see(replace(avatar, surface=None))
    thumbnails.want(REST)
    assert not thumbnails.waiting
    assert thumbnails.tend() is None
