"""Avatar files: round trip, provenance, and every broken file refused in one line."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.errors import InputError
from avatarrex.fields.detail_texture import TEXELS
from avatarrex.fields.outgrowth import VOXEL, Outgrowth
from avatarrex.fields.slide import JOINTS
from avatarrex.files.assets import DATA
from avatarrex.surface.surface_file import weights_key
from avatarrex.templates.person import load_person

FACES = len(load_person().face.faces)
BARE = (load_person().face.blend_weight[load_person().face.faces].amax(1) == 0).byte()
"""Triangles of the face without texels."""


def test_the_packaged_avatar_says_what_it_is() -> None:
    path = DATA / "default.avatar"
    assert path.stat().st_size <= 20e6
    meta = load_avatar("default").meta
    assert meta["origin"] == "trained from images in two passes"
    assert {"training", "cost", "licence", "consent"} <= meta.keys()
    measured = meta["held_out"]["splits"]["held-out pose"]
    assert measured["avatar"]["psnr_matte"] > measured["fitted textured mesh"]["psnr_matte"] + 3
    assert measured["avatar"]["iou"] > 0.97
    assert meta["held_out"]["surface"]["held-out pose"]["avatar"]["to_truth"]["mean_mm"] < 5


@pytest.mark.parametrize("name", ["copy.avatar", "folder"])
def test_round_trip_keeps_the_weights(tmp_path: Path, name: str) -> None:
    avatar = load_avatar("default")
    save_avatar(avatar, tmp_path / name)
    again = load_avatar(tmp_path / name)
    for key, value in avatar.state().items():
        bytes_keep_it = key.endswith(TEXELS) or not value.is_floating_point()
        kept = value if bytes_keep_it else value.half().float()
        assert torch.equal(kept, again.state()[key]), key
    assert again.meta["origin"] == avatar.meta["origin"]


def _repack(target: Path, **changes: bytes) -> Path:
    with zipfile.ZipFile(DATA / "default.avatar") as source, zipfile.ZipFile(target, "w") as out:
        for name in source.namelist():
            out.writestr(name, changes.get(name.split(".")[0], source.read(name)))
    return target


def test_broken_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing there"):
        load_avatar(tmp_path / "none.avatar")
    (tmp_path / "cut.avatar").write_bytes((DATA / "default.avatar").read_bytes()[:5000])
    with pytest.raises(InputError, match="avatar folder"):
        load_avatar(tmp_path / "cut.avatar")
    with pytest.raises(InputError, match="safetensors file"):
        load_avatar(_repack(tmp_path / "w.avatar", weights=b"not tensors"))
    with pytest.raises(InputError, match="JSON"):
        load_avatar(_repack(tmp_path / "j.avatar", avatar=b"{"))
    with zipfile.ZipFile(DATA / "default.avatar") as source:
        meta = json.loads(source.read("avatar.json"))
    for field, value, message in (
        ("format", 99, "at most"),
        ("preset", "huge", "paper or compact"),
        ("person_hash", "0", "template"),
    ):
        with pytest.raises(InputError, match=message):
            load_avatar(_repack(tmp_path / "m.avatar", avatar=json.dumps({**meta, field: value}).encode()))


def _with_extras() -> Avatar:
    """The packaged avatar with texels, 2 cm apart, that slide, a relief and a ball on its head."""
    avatar = load_avatar("default")
    body = avatar.body
    body.add_detail(0.02)
    assert body.detail is not None
    body.detail.texel.data.copy_(torch.randn(body.detail.texel.shape, generator=torch.Generator().manual_seed(0)))
    body.add_slide(0.1 * torch.randn(len(body.node_vertex), JOINTS, generator=torch.Generator().manual_seed(1)))
    body.raise_surface(0.01 * torch.rand(len(body.sample_rest), generator=torch.Generator().manual_seed(2)))
    first = (body.template.v_template[body.template.v_template[:, 1].argmax()] / VOXEL).round().long() - 10
    place = torch.stack(torch.meshgrid(*[torch.arange(21)] * 3, indexing="ij"), -1)
    ball = Outgrowth(first, (place - 10.0).norm(dim=-1) * VOXEL - 0.04).hanging_on(15, 0.02)
    ball.lay(body.template.v_template)
    body.set_outgrowth(ball)
    return avatar


def test_texels_slide_relief_and_outgrowth_are_kept(tmp_path: Path) -> None:
    avatar = _with_extras()
    for path in (tmp_path / "a.avatar", tmp_path / "b.avatar"):
        save_avatar(avatar, path)
        again = load_avatar(path)
        assert weights_key(again) == weights_key(avatar)
        wanted, found = avatar.state(), again.state()
        albedo = torch.sigmoid(wanted["body.detail.texel"]) - torch.sigmoid(found["body.detail.texel"])
        assert float(albedo.abs().max()) < 0.51 / 255
        assert torch.equal(found["body.detail.edge"], wanted["body.detail.edge"])
        assert torch.equal(found["body.slide.share"], wanted["body.slide.share"].half().float())
        assert torch.equal(found["body.relief"], wanted["body.relief"].half().float())
        assert torch.equal(found["body.detail_height"], wanted["body.detail_height"].half().float())
        assert again.body.detail is not None
        assert avatar.body.detail is not None
        laid, kept = (one.body.detail.lattice.vertices for one in (again, avatar))
        np.testing.assert_allclose(laid, kept, atol=2e-5)
        assert again.body.slide is not None
        assert torch.equal(again.body.slide.reach, avatar.body.slide.reach)
        assert torch.equal(found["body.outgrowth.distance"], wanted["body.outgrowth.distance"].half().float())
        assert int(found["body.outgrowth.joint"]) == 15
        anchor = wanted["body.outgrowth.anchor"].half().float()
        assert torch.equal(found["body.outgrowth.anchor"], anchor)
        assert torch.equal(again.body.sample_rest[-len(anchor) :], anchor)
        avatar = again  # saved once more, nothing changes
    assert (tmp_path / "a.avatar").stat().st_size == pytest.approx((tmp_path / "b.avatar").stat().st_size, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("body.detail.edge", torch.zeros(3, dtype=torch.uint8), "a byte for each of"),
        ("face.detail_behind", torch.zeros(3, dtype=torch.uint8), "face.detail_behind: expected a byte for each of"),
        (
            "face.detail_behind",
            torch.ones(FACES, dtype=torch.uint8),
            "behind: expected some of the triangles that have",
        ),
        ("face.detail_behind", BARE, "behind: expected some of the triangles that have texels"),
        ("body.detail.texel", torch.zeros(5, 3), "bytes"),
        ("body.detail.texel", torch.zeros(5, 3, dtype=torch.uint8), r"body.detail.texel: expected \("),
        ("body.slide.share", torch.zeros(5, 22), "slide.share: expected numbers"),
        ("body.relief", torch.zeros(5), "body.relief: expected numbers"),
        ("body.detail_height", torch.zeros(5), "body.detail_height: expected numbers"),
        ("body.detail_height", torch.full((13_886,), float("nan")), "detail_height: expected 0 to 0.04 metres"),
        ("body.detail_height", torch.full((13_886,), 1e4), "detail_height: expected 0 to 0.04 metres"),
        ("body.detail_height", torch.full((13_886,), -0.01), "detail_height: expected 0 to 0.04 metres"),
        ("body.outgrowth.distance", torch.zeros(4), "3 dimensions"),
        ("body.outgrowth.distance", torch.ones(4, 4, 4), "somewhere inside"),
        ("body.outgrowth.joint", torch.tensor(55), "the number of a joint, 0 to 54, found 55"),
        ("body.outgrowth.joint", torch.tensor([1, 2]), "the number of a joint"),
        ("body.outgrowth.joint", torch.tensor(float("nan")), "the number of a joint"),
        ("body.outgrowth.anchor", torch.zeros(4), r"places \(o, 3\) beside"),
        ("body.outgrowth.anchor", torch.zeros(0, 3), r"places \(o, 3\) beside"),
        ("body.outgrowth.anchor", torch.full((4, 3), float("nan")), r"places \(o, 3\) beside"),
    ],
)
def test_broken_texels_slides_reliefs_and_outgrowths_are_refused(
    tmp_path: Path, name: str, value: torch.Tensor, message: str
) -> None:
    save_avatar(_with_extras(), tmp_path / "good.avatar")
    with zipfile.ZipFile(tmp_path / "good.avatar") as source, zipfile.ZipFile(tmp_path / "bad.avatar", "w") as out:
        weights = safetensors.torch.load(source.read("weights.safetensors")) | {name: value}
        out.writestr("weights.safetensors", safetensors.torch.save(weights))
        out.writestr("avatar.json", source.read("avatar.json"))
    with pytest.raises(InputError, match=message):
        load_avatar(tmp_path / "bad.avatar")
