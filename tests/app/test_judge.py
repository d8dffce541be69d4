"""`avatarrex-studio judge`: names are hidden, the key tells the truth, swapped sheets are the same sheets."""

from __future__ import annotations

import json
from collections import Counter

import numpy as np
import pytest
from avatarrex_studio.cli import main as cli
from avatarrex_studio.sheets import blind
from avatarrex_studio.sheets.pages import Artist
from capture.tiny_capture import TinyCapture
from PIL import Image

from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError
from avatarrex.training.core import exposure

LEVEL = {blind.AVATAR: 0.2, blind.MESH: 0.7}
"""A grey for each subject."""


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    held_out = {"body": [1, 2], "face": [1, 2]}
    return TinyCapture.make().manifest(held_out_frames=held_out).zip(tmp_path_factory.mktemp("judge") / "tiny.zip")


@pytest.fixture
def greys(monkeypatch):
    """Both subjects are squares of one grey."""

    def grey(name):
        return Artist(
            name, lambda scene: np.dstack([np.full((*scene.seen.shape, 3), LEVEL[name]), np.ones(scene.seen.shape)])
        )

    monkeypatch.setattr(blind.Trial, "_pair", lambda *_: (grey(blind.AVATAR), grey(blind.MESH)))


def judged(capture, out, *words):
    """The key and, in its order, the middle pixels of truth, A and B."""
    assert cli.main(["judge", "default", str(capture), str(out), "--seed", "3", "--views", "7", *words]) == 0
    key = json.loads((out / "key.json").read_text())
    shades = []
    for view in key["views"]:
        with Image.open(out / f"page_{view['page']:02}.png") as image:
            page = np.asarray(image.convert("RGB")) / 255
        row = (view["number"] - 1) % blind.ROWS
        top = 78 + row * (blind.TILE + 30) + blind.TILE // 2
        shades.append([page[top, 24 + k * (blind.TILE + 4) + blind.TILE // 2].mean() for k in range(3)])
    return key, np.array(shades)


def test_the_key_says_who_is_a(capture, greys, tmp_path):
    key, shades = judged(capture, tmp_path / "a")
    assert len(key["views"]) == 7
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == [
        "key.json",
        "page_01.png",
        "page_02.png",
        "page_03.png",
    ]
    for view, (_, first, second) in zip(key["views"], shades):
        assert {view["A"], view["B"]} == set(LEVEL)
        np.testing.assert_allclose((first, second), (LEVEL[view["A"]], LEVEL[view["B"]]), atol=0.01)
    assert Counter(view["A"] for view in key["views"]).most_common()[-1][1] == 3, "each is A in half of the views"
    swapped, other = judged(capture, tmp_path / "b", "--swap")
    np.testing.assert_allclose(other, shades[:, [0, 2, 1]], atol=0.01)
    named = [{**view, "A": view["B"], "B": view["A"]} for view in swapped["views"]]
    assert named == key["views"]


def test_views_are_of_what_was_held_out(capture):
    read = open_capture(capture)
    views = blind.chosen_views(read, 3, 9)
    assert views == blind.chosen_views(read, 3, 9)
    assert views != blind.chosen_views(read, 4, 9)
    assert {view.frame for view in views} <= {1, 2}
    assert Counter((view.rig, bool(view.limb)) for view in views) == {
        ("body", False): 3,
        ("body", True): 3,
        ("face", False): 3,
    }
    for view in views:
        scene = blind.scene_of(read, view)
        own = read.rigs[view.rig].views[view.view].camera
        assert scene.camera.intrinsics[0, 0] == pytest.approx(own.intrinsics[0, 0]), "the photograph's own pixels"
        assert scene.picture.any()


def test_without_a_test_there_is_no_trial(tmp_path):
    capture = TinyCapture.make().zip(tmp_path / "tiny.zip")
    with pytest.raises(InputError, match="pictures that were held out, found none"):
        blind.chosen_views(open_capture(capture), 3, 9)


def test_rigs_are_compared_in_one_exposure(capture, greys, tmp_path, monkeypatch):
    monkeypatch.setattr(exposure, "gain_to", lambda *_: np.full(3, 0.5))
    key, as_taken = judged(capture, tmp_path / "a")
    exposed_key, exposed = judged(capture, tmp_path / "b", "--exposed-as", "body")
    assert (key["exposed_as"], exposed_key["exposed_as"]) == (None, "body")
    face = np.array([view["rig"] == "face" for view in key["views"]])
    assert 0 < face.sum() < len(face)
    assert np.allclose(exposed[~face], as_taken[~face])
    darker = exposed[face, 0] / as_taken[face, 0]
    assert np.isclose(darker.min(), 0.5, atol=0.01), "photographs of the face rig, where there is somebody"
    assert darker.max() <= 1
