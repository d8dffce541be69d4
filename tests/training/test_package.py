"""A trained avatar is given away with its held-out figures; nobody else's, and none that was not trained."""

import json
from pathlib import Path

import pytest

from avatarrex.avatar import Avatar, load_avatar, save_avatar
from avatarrex.errors import InputError
from avatarrex.templates.person import load_person
from avatarrex.training.package import package

SURFACE = {"avatar": {"to_truth": {"mean_mm": 2.0}, "from_truth": {"mean_mm": 3.0}}}


@pytest.fixture
def trained(tmp_path: Path) -> Path:
    avatar = Avatar.create(load_person(), "compact")
    avatar.meta |= {"origin": "trained from images in two passes", "training": {"recipe": "tiny"}}
    save_avatar(avatar, tmp_path / "trained.avatar")
    return tmp_path / "trained.avatar"


def figures(avatar: Path) -> Path:
    """What `evaluate --json` writes, as far as it matters here."""
    splits = {split: {"avatar": {"psnr_matte": value}} for split, value in (("train", 25.0), ("held-out pose", 24.0))}
    surface = {"train": SURFACE, "held-out pose": SURFACE}
    found = {"avatar": str(avatar), "capture": "captures/small", "frames": [1], "views": ["c0"], "splits": splits}
    path = avatar.with_name("metrics.json")
    path.write_text(json.dumps({**found, "surface": surface}))
    return path


def test_figures_and_cost_go_with_it(trained, tmp_path):
    package(trained, figures(trained), tmp_path / "given.avatar", "default", "an hour")
    meta = load_avatar(tmp_path / "given.avatar").meta
    assert (meta["name"], meta["cost"], meta["training"]) == ("default", "an hour", {"recipe": "tiny"})
    assert meta["held_out"] == {
        "capture": "small", "frames": [1], "views": ["c0"],
        "splits": {"held-out pose": {"avatar": {"psnr_matte": 24.0}}}, "surface": {"held-out pose": SURFACE},
    }  # fmt: skip
    assert "no real person" in meta["consent"]


def test_other_figures_are_refused(trained, tmp_path):
    path = figures(trained)
    path.write_text(path.read_text().replace("trained.avatar", "other.avatar"))
    with pytest.raises(InputError, match=r"metrics.json: avatar: expected .*trained.avatar, found .*other.avatar"):
        package(trained, path, tmp_path / "given.avatar", "default", "an hour")
    assert not (tmp_path / "given.avatar").exists()


def test_what_was_not_trained_is_refused(tmp_path):
    save_avatar(Avatar.create(load_person(), "compact"), tmp_path / "raw.avatar")
    with pytest.raises(InputError, match="expected an avatar trained from images"):
        package(tmp_path / "raw.avatar", figures(tmp_path / "raw.avatar"), tmp_path / "given.avatar", "default", "none")
