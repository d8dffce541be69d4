"""Avatar files: round trip, provenance, and every broken file refused in one line."""

import json
import zipfile
from pathlib import Path

import pytest
import torch

from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.errors import InputError
from avatarrex.files.assets import DATA


def test_the_packaged_avatar_says_what_it_is() -> None:
    path = DATA / "default.avatar"
    assert path.stat().st_size <= 20e6
    meta = load_avatar("default").meta
    assert meta["origin"] == "trained from images in two passes"
    assert {"training", "cost", "licence", "consent"} <= meta.keys()
    measured = meta["held_out"]["splits"]["held-out pose"]
    assert measured["avatar"]["psnr_matte"] > measured["textured mesh"]["psnr_matte"] + 8
    assert measured["avatar"]["iou"] > 0.97
    assert meta["held_out"]["surface"]["held-out pose"]["avatar"]["to_truth"]["mean_mm"] < 5


@pytest.mark.parametrize("name", ["copy.avatar", "folder"])
def test_round_trip_keeps_the_weights(tmp_path: Path, name: str) -> None:
    avatar = load_avatar("default")
    save_avatar(avatar, tmp_path / name)
    again = load_avatar(tmp_path / name)
    for key, value in avatar.state().items():
        kept = value.half().float() if value.is_floating_point() else value
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
