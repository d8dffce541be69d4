"""Tone mapping: the identity until trained, one matrix per pair of directions, older avatars without it."""

from __future__ import annotations

import json
import zipfile

import safetensors.torch
import torch

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.fields.presets import COMPACT
from avatarrex.fields.tone import ToneMap
from avatarrex.templates.person import load_person


def directions(count: int) -> torch.Tensor:
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(1)), dim=-1)


def test_it_starts_as_the_identity():
    tone, colour = ToneMap(COMPACT), torch.rand(7, 3)
    assert torch.equal(tone(colour, directions(7), directions(7).flip(0)), colour)
    assert float(tone.deviation().detach()) == 0


def test_it_learns_a_cast_of_colour():
    torch.manual_seed(0)
    tone, seen = ToneMap(COMPACT), directions(64)
    colour, cast = torch.rand(64, 3), torch.tensor([1.1, 0.95, 0.9])
    optimiser = torch.optim.Adam(tone.parameters(), lr=1e-2)
    for _ in range(150):
        optimiser.zero_grad()
        loss = (tone(colour, seen, seen.flip(0)) - cast * colour).square().mean()
        loss.backward()
        optimiser.step()
    assert float(loss.detach()) < 2e-5
    assert 1e-3 < float(tone.deviation().detach()) < 0.05


def test_an_avatar_of_format_1_has_none(tmp_path):
    avatar = Avatar.create(load_person(), "compact")
    save_avatar(avatar, tmp_path / "new.avatar")
    with zipfile.ZipFile(tmp_path / "new.avatar") as archive:
        meta = json.loads(archive.read("avatar.json"))
        state = safetensors.torch.load(archive.read("weights.safetensors"))
    old = {name: value for name, value in state.items() if not name.startswith("tone.")}
    with zipfile.ZipFile(tmp_path / "old.avatar", "w") as archive:
        archive.writestr("avatar.json", json.dumps(meta | {"format": 1}))
        archive.writestr("weights.safetensors", safetensors.torch.save(old))
    assert float(load_avatar(tmp_path / "old.avatar").tone.deviation().detach()) == 0


def test_untrained_parts_are_hidden():
    avatar = Avatar.create(load_person(), "compact")
    avatar.meta["untrained"] = ["face"]
    assert avatar.hidden == {"face"}
