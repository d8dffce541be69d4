"""`python -m avatarrex.measure error-places`: which pixels are at the rim, and that errors of known places and cameras are found there."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from capture.tiny_capture import TinyCapture

from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError
from avatarrex.measure.__main__ import main
from avatarrex.measure.studies import error_places
from avatarrex.measure.studies.error_places import LIMBS, PLACES, TORSO, errors, limbs, places, squared_errors
from avatarrex.metrics.drawing import Drawing, Truth
from avatarrex.metrics.evaluate import captured
from avatarrex.templates.person import load_person


def drawing(image):
    empty = np.zeros((*image.shape[:2], 3), np.float32)
    return Drawing(torch.from_numpy(image), empty, empty, image[..., 3] > 0)


def square():
    """A matte of 16 x 16 pixels, and a coverage that is too small in its lower half."""
    matte = np.zeros((24, 30), bool)
    matte[4:20, 7:23] = True
    coverage = np.where(matte, np.float32(0.5), np.float32(1.0))
    coverage[12:20, 7:23] = 0.49
    return matte, coverage


def test_places_of_a_square():
    matte, coverage = square()
    inner = np.zeros_like(matte)
    inner[7:12, 10:20] = True
    found = places(coverage, matte)
    assert np.array_equal(found["not covered"], matte & (coverage < 0.495))
    assert np.array_equal(found["inside"], inner)
    assert np.array_equal(sum(found.values()), matte.astype(int)), "each pixel of the matte has one place"


def test_distances_to_the_outline_are_straight():
    matte = np.ones((20, 20), bool)
    matte[10, 10] = False
    found = places(np.ones((20, 20)), matte)
    assert found["inside"].sum() == 14 * 14 - 29, "29 pixels lie within 3 of one; a picture ends where a matte does"


def test_errors_are_summed_where_they_are():
    matte, coverage = square()
    grey = matte[..., None] * np.float32([0.5, 0.5, 0.5])
    truth = Truth(torch.from_numpy(grey), torch.from_numpy(matte.astype(np.float32)))
    image = np.dstack([grey * (coverage[..., None] >= 0.5), coverage])
    image[8, 12, :3] = 1.5  # shown as 1
    image[4, 7, 0] = 0.8
    image[1, 1, :3] = 1.0  # outside the matte
    expected = {"not covered": 0.25 * 128, "rim": 0.09 / 3, "inside": 0.25}
    found = squared_errors(drawing(image), truth)[""]
    assert dict(zip(PLACES, found)) == pytest.approx(expected, rel=1e-5)
    assert found[3] == 256


def test_limbs_are_where_their_joints_are(tmp_path):
    rig = body(tmp_path, [1], [0])
    person, signals, camera = load_person(), rig.signals[1], rig.views[1].camera
    found = limbs(person, signals, camera)
    assert np.array_equal(sum(found.values()), np.ones((camera.height, camera.width), int)), "each pixel has one"
    joints = camera.pixels(template_surface(person, signals)[1])[0]
    for joint, limb in (
        ("head", "head"),
        ("left_wrist", "hands"),
        ("right_elbow", "arms"),
        ("left_knee", "legs"),
        ("right_foot", "feet"),
        ("spine1", TORSO),
    ):
        column, row = np.floor(joints[person.body.joint_names.index(joint)]).astype(int)
        assert found[limb][row, column], joint


def test_errors_of_limbs_add_up(tmp_path):
    rig = body(tmp_path, [1], [0])
    found = errors(rig, [Photograph(rig)], load_person())["held-out pose"]
    assert list(found) == ["photograph", *(f"photograph, {limb}" for limb in (*LIMBS, TORSO))]
    whole, *parts = found.values()
    for place in (*PLACES, "sum"):
        assert sum(part[place] for part in parts) == pytest.approx(whole[place], rel=1e-9)
    assert min(part["sum"] for part in parts) > 0


class Photograph:
    """Draws what was captured without its red, and covers every pixel."""

    name = "photograph"

    def __init__(self, rig):
        self.rig = rig

    def draw(self, signals, camera):
        view = next(k for k, own in enumerate(self.rig.views) if own.camera is camera)
        frame = next(k for k, own in enumerate(self.rig.signals) if own is signals)
        image = captured(self.rig, view, frame, camera).layers()
        image[..., 0], image[..., 3] = 0.0, 1.0
        return drawing(image)


def body(tmp_path, frames, views):
    rig = open_capture(TinyCapture.make(scale=2).zip(tmp_path / "tiny.zip")).rigs["body"]
    return rig.holding_out(frames, views)


def without_red(rig, views):
    """Per pixel of the mattes of frame 1."""
    truths = [captured(rig, view, 1, rig.views[view].camera) for view in views]
    inside = np.concatenate([truth.image.numpy()[truth.matte.numpy() >= 0.5] for truth in truths])
    return np.square(inside[:, 0].astype(np.float64)).mean() / 3


def test_cameras_that_were_held_out_are_kept_apart(tmp_path):
    rig = body(tmp_path, [1], [0])
    found = errors(rig, [Photograph(rig)])
    assert list(found) == ["held-out pose", "held-out both"]
    others = range(1, len(rig.views))
    for split, views in (("held-out both", [0]), ("held-out pose", others)):
        values = found[split]["photograph"]
        assert values["sum"] == pytest.approx(without_red(rig, views), rel=1e-5)
        assert values["not covered"] == 0
        assert min(values["rim"], values["inside"]) > 0


@pytest.mark.parametrize(
    ("frames", "views", "found"),
    [([], [], "pictures of held-out frames"), ([1], [0, 1, 2], "cameras that were trained on")],
)
def test_what_cannot_be_measured_is_refused(frames, views, found, tmp_path):
    rig = body(tmp_path, frames, views)
    assert len(rig.views) == 3
    with pytest.raises(InputError, match=f"expected {found}, found none"):
        errors(rig, [])


@pytest.fixture
def trained(tmp_path):
    """An avatar that says it was trained on a capture without frame 1 and the first camera."""
    path = TinyCapture.make(scale=2).zip(tmp_path / "tiny.zip")
    capture, avatar = open_capture(path), load_avatar()
    first = capture.rigs["body"].views[0].name
    kept = {"test": {"frames": "1:2", "cameras": [first]}, "validation": {"frames": "", "cameras": []}}
    avatar.meta["training"] = {"capture_key": capture.key, "splits": {"body": kept}}
    avatar = replace(avatar, surface=None)
    save_avatar(avatar, tmp_path / "me.avatar")
    return str(tmp_path / "me.avatar"), str(path)


def test_the_avatars_own_split_is_measured_beside_meshes_that_do_not_see_it(trained, tmp_path, capsys, monkeypatch):
    """The fit of the meshes, half a minute, has tests of its own."""
    given = {}

    def meshes(capture, fitted, seen):
        given.update(capture=capture, fitted=fitted, seen=seen)
        return [Photograph(capture.rigs["body"])]

    monkeypatch.setattr(error_places, "fitted_meshes", meshes)
    out = tmp_path / "places.json"
    assert main(["error-places", *trained, "--json", str(out)]) == 0
    rig = given["capture"].rigs["body"]
    assert (rig.held_out_frames, rig.held_out_views) == ({1}, {0})
    assert all(one.signals is not rig.signals[1] for one in given["seen"]), "no test picture"
    found = json.loads(out.read_text())["squared_error_per_pixel"]
    assert found["held-out both"]["photograph"]["sum"] == pytest.approx(without_red(rig, [0]), rel=1e-5)
    pose, both = (found[split]["avatar"] for split in ("held-out pose", "held-out both"))
    assert min(pose["sum"], both["sum"]) > 1e-3
    lines = capsys.readouterr().out.splitlines()
    added = [f"{1e4 * (both[key] - pose[key]):+.1f}" for key in (*PLACES, "sum")]
    assert lines[-2].split() == ["added", "by", "held-out", "cameras:", "avatar", *added]


def test_another_capture_is_refused(trained, tmp_path, capsys):
    other = TinyCapture.make(scale=1).zip(tmp_path / "other.zip")
    assert main(["error-places", trained[0], str(other)]) == 2
    assert "was trained on, found another one" in capsys.readouterr().err
