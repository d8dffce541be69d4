"""`python -m avatarrex.measure error-places`: which pixels are at the rim, and that errors of known places and cameras are found there."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from capture.tiny_capture import TinyCapture

from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError
from avatarrex.measure.__main__ import main
from avatarrex.measure.studies import error_places
from avatarrex.measure.studies.error_places import PLACES, errors, places, squared_errors
from avatarrex.metrics.drawing import Drawing, Truth
from avatarrex.metrics.evaluate import captured


def drawing(image):
    empty = np.zeros((*image.shape[:2], 3), np.float32)
    return Drawing(torch.from_numpy(image), empty, empty, image[..., 3] > 0)


def square():
    """A matte of 16 x 16 pixels of which the lower half is not drawn."""
    matte = np.zeros((24, 30), bool)
    matte[4:20, 7:23] = True
    covered = matte.copy()
    covered[12:20] = False
    return matte, covered


def test_places_of_a_square():
    matte, covered = square()
    inner = np.zeros_like(matte)
    inner[7:12, 10:20] = True
    found = places(covered, matte)
    assert np.array_equal(found["missing"], matte & ~covered)
    assert np.array_equal(found["inside"], inner)
    assert np.array_equal(sum(found.values()), matte.astype(int)), "each pixel of the matte has one place"


def test_a_picture_ends_where_a_matte_does():
    assert places(np.ones((20, 20), bool), np.ones((20, 20), bool))["inside"].sum() == 14 * 14


def test_errors_are_summed_where_they_are():
    matte, covered = square()
    truth = Truth(
        torch.from_numpy(matte[..., None] * np.float32([0.5, 0.5, 0.5])), torch.from_numpy(matte.astype(np.float32))
    )
    image = np.dstack([truth.image.numpy() * covered[..., None], covered.astype(np.float32)])
    image[8, 12, :3] = 0.8
    image[4, 7, 0] = 0.8
    image[1, 1, :3] = 1.0  # outside the matte
    expected = {"missing": 0.25 * 128, "rim": 0.09 / 3, "inside": 0.09}
    found = squared_errors(drawing(image), truth)
    assert dict(zip(PLACES, found)) == pytest.approx(expected, rel=1e-5)
    assert found[3] == 256


class Photograph:
    """Draws what was captured, without its red, before a background that hides nothing."""

    name = "photograph"

    def __init__(self, rig):
        self.rig = rig

    def draw(self, signals, camera):
        view = next(k for k, own in enumerate(self.rig.views) if own.camera is camera)
        frame = next(k for k, own in enumerate(self.rig.signals) if own is signals)
        image = captured(self.rig, view, frame, camera).layers()
        image[..., 0] = 0.0
        image[..., 3] = 1.0
        return drawing(image)


def test_cameras_that_were_held_out_are_kept_apart(tmp_path):
    capture = open_capture(TinyCapture.make(scale=2).zip(tmp_path / "tiny.zip"))
    rig = capture.rigs["body"].holding_out([1], [0])
    found = errors(rig, [Photograph(rig)])
    assert set(found) == {"held-out pose", "held-out both"}
    for split, views in (("held-out both", [0]), ("held-out pose", range(1, len(rig.views)))):
        truths = [captured(rig, view, 1, rig.views[view].camera) for view in views]
        inside = np.concatenate([truth.image.numpy()[truth.matte.numpy() >= 0.5] for truth in truths])
        values = found[split]["photograph"]
        assert values["sum"] == pytest.approx(np.square(inside[:, 0].astype(np.float64)).mean() / 3, rel=1e-5)
        assert values["missing"] == 0
        assert values["pictures"] == len(views)


def test_without_held_out_frames_there_is_nothing_to_measure(tmp_path):
    rig = open_capture(TinyCapture.make(scale=2).zip(tmp_path / "tiny.zip")).rigs["body"].holding_out([], [])
    with pytest.raises(InputError, match="pictures of held-out frames, found none"):
        errors(rig, [])


def test_the_tool_says_how_much_more_held_out_cameras_cost(tmp_path, capsys, monkeypatch):
    """The fit of the mesh, half a minute, has tests of its own."""
    monkeypatch.setattr(error_places, "fitted_meshes", lambda capture, person, seen: [])
    path, out = TinyCapture.make(scale=2).zip(tmp_path / "tiny.zip"), tmp_path / "places.json"
    words = [
        "error-places",
        "default",
        str(path),
        "--held-out-frames",
        "1:2",
        "--held-out-views",
        "0",
        "--json",
        str(out),
    ]
    assert main(words) == 0
    found = json.loads(out.read_text())["mean_squared_error"]
    pose, both = (found[split]["avatar"] for split in ("held-out pose", "held-out both"))
    for values in (pose, both):
        assert values["sum"] == pytest.approx(sum(values[place] for place in PLACES))
    more = [f"{1e4 * (both[key] - pose[key]):+.1f}" for key in (*PLACES, "sum")]
    assert capsys.readouterr().out.splitlines()[-1].split() == ["more", "from", "held-out", "cameras:", "avatar", *more]
