"""A trained avatar is given away with its held-out figures: its own, of what the training did not see."""

import json
from pathlib import Path

import pytest
from capture.tiny_capture import TinyCapture

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.errors import InputError
from avatarrex.templates.person import load_person
from avatarrex.training.package import package
from avatarrex.training.runs.folder import Run

SURFACE = {"avatar": {"to_truth": {"mean_mm": 2.0}, "from_truth": {"mean_mm": 3.0}}}


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A finished run of the body, the last frame and the second camera held out; and what `evaluate --json` writes of it."""
    folder = tmp_path_factory.mktemp("package")
    capture = TinyCapture.make(("body",)).folder(folder / "capture")
    avatar = Avatar.create(load_person(), "compact")
    avatar.meta |= {"origin": "trained from images in two passes", "training": {"recipe": "tiny"}}
    config = {"capture": str(capture), "held_out": {"body": {"frames": [2], "views": [1]}}}
    with Run.create(folder / "run", config) as opened:
        opened.save(7, {}, avatar)
    splits = {split: {"avatar": {"psnr_matte": value}} for split, value in (("train", 25.0), ("held-out pose", 24.0))}
    found = {
        "avatar": str(folder / "run/checkpoints/step_00000007/avatar.avatar"), "capture": str(capture), "rig": "body",
        "frames": [0, 2], "views": ["c0"], "held_out": {"frames": [2], "views": ["c1"]}, "splits": splits,
        "surface": {"train": SURFACE, "held-out pose": SURFACE},
    }  # fmt: skip
    (folder / "metrics.json").write_text(json.dumps(found))
    return folder / "run"


def test_figures_and_cost_go_with_it(run, tmp_path):
    package(run, run.with_name("metrics.json"), tmp_path / "given.avatar", "default", "an hour")
    meta = load_avatar(tmp_path / "given.avatar").meta
    assert (meta["name"], meta["cost"], meta["training"]) == ("default", "an hour", {"recipe": "tiny"})
    assert meta["held_out"] == {
        "capture": "capture", "frames": [0, 2], "views": ["c0"],
        "splits": {"held-out pose": {"avatar": {"psnr_matte": 24.0}}}, "surface": {"held-out pose": SURFACE},
    }  # fmt: skip
    assert "no real person" in meta["consent"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"avatar": "other.avatar"},
            "metrics.json: avatar: expected .*step_00000007/avatar.avatar, found other.avatar",
        ),
        ({"capture": "elsewhere"}, "metrics.json: capture: expected .*capture, found elsewhere"),
        (
            {"held_out": {"frames": [0], "views": ["c1"]}},
            "metrics.json: held_out: expected .*2.*c1.* as in the training",
        ),
        ({"splits": {"train": {}}}, "metrics.json: splits: expected pictures that were held out, found train"),
        ({"surface": ...}, "metrics.json: surface: expected a field that `evaluate --json` writes"),
    ],
)
def test_other_figures_are_refused(run, tmp_path, change, message):
    found = {**json.loads(run.with_name("metrics.json").read_text()), **change}
    path = tmp_path / "metrics.json"
    path.write_text(json.dumps({key: value for key, value in found.items() if value is not ...}))
    with pytest.raises(InputError, match=message):
        package(run, path, tmp_path / "given.avatar", "default", "an hour")
    assert not (tmp_path / "given.avatar").exists()


def test_an_unfinished_run_is_refused(tmp_path):
    Run.create(tmp_path / "run", {}).close("stopped")
    with pytest.raises(InputError, match="state: expected a finished training, found stopped"):
        package(tmp_path / "run", tmp_path / "none.json", tmp_path / "given.avatar", "default", "an hour")
