"""`evaluate` from the command line: refusals before work, and one true run of the default avatar."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from avatarrex_studio.cli.main import main
from drawn_capture import write_capture
from PIL import Image

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.metrics.drawing import AvatarDrawer
from avatarrex.metrics.face_region import face_alone
from avatarrex.templates.person import load_person, resize_person
from avatarrex.templates.person_fit import PersonFit


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return str(write_capture(tmp_path_factory.mktemp("command"), size=64))


@pytest.fixture(autouse=True)
def no_weights(monkeypatch, tmp_path):
    for name in ("AVATARREX_VGG", "AVATARREX_LPIPS", "AVATARREX_INCEPTION"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("torch.hub.get_dir", lambda: str(tmp_path))
    monkeypatch.setattr("avatarrex.metrics.perceptual.importlib.util.find_spec", lambda name: None)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--size", "9"], "--size: expected 32 to 8192 pixels of the longer side, found 9"),
        (
            ["--views", "front,nobody"],
            "--views: expected cameras 0 to 2 or their names, front, side, back …, found nobody",
        ),
        (["--frames", "5:9"], "--frames: expected some of the 3 frames"),
        (["--held-out-views", "3"], "--held-out-views: expected cameras 0 to 2"),
        (["--samples", "0"], "--samples: expected 1 to 8 samples along a pixel's side, found 0"),
        (["--levels", "live,best"], "--levels: expected some of live,"),
        (["--rig", "face"], "--rig: expected one of body, found face"),
        (["--exposed-as", "face"], "--exposed-as: expected a capture with two rigs, found the body rig alone"),
        (["--sheet", "sheet.jpg"], "sheet.jpg: expected OUT.png, found .jpg"),
        (["--vgg", "nowhere.pth"], "nowhere.pth: expected a weights file such as vgg16-397923af.pth"),
    ],
)
def test_wrong_options_are_one_line(capture, capsys, words, message):
    assert main(["evaluate", "default", capture, *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1


def test_the_face_alone_is_a_part_of_the_picture(capture, capsys, tmp_path):
    """In front of the face it is; from the back there is none, and nothing to measure."""
    rig = open_capture(capture).rigs["body"]
    cut, (drawer,) = face_alone(load_person(), rig, [AvatarDrawer(load_avatar())])
    whole, face = rig.matte(0, 0), cut.matte(0, 0)
    assert 0 < (face > 127).sum() < 0.3 * (whole > 127).sum()
    assert not (face > whole).any()
    drawn = drawer.draw(rig.signals[0], rig.views[0].camera)
    assert (drawn.hit[face > 127]).mean() > 0.9
    assert not drawn.image[~torch.from_numpy(drawn.hit)].any()
    assert not (cut.matte(2, 0) > 127).any()
    figures = tmp_path / "face.json"
    words = ["--frames", "0:1", "--views", "front", "--face-only", "--json", str(figures)]
    assert main(["evaluate", "default", capture, *words]) == 0
    capsys.readouterr()
    data = json.loads(figures.read_text())
    assert "surface" not in data or not data["surface"]
    assert 0 < data["splits"]["train"]["avatar"]["psnr_matte"] < 60


def test_a_rig_in_the_exposure_of_the_other(capture, capsys, tmp_path):
    """Both rigs see the same, one of them dimmed: in its own exposure it is another picture, in the other's the same."""
    folder, figures = tmp_path / "two", tmp_path / "found.json"
    for rig in ("body", "face"):
        shutil.copytree(Path(capture) / "body", folder / rig)
    for picture in (folder / "face").glob("*/*.png"):
        Image.fromarray(np.rint(np.array(Image.open(picture)) * [0.6, 0.7, 0.8]).astype(np.uint8)).save(picture)
    words = ["--frames", "0:1", "--views", "front", "--json", str(figures)]

    def psnr(*more):
        assert main(["evaluate", "default", str(folder), *words, *more]) == 0
        return json.loads(figures.read_text())["splits"]["train"]["avatar"]["psnr"], capsys.readouterr().err

    body, _ = psnr("--rig", "body")
    dimmed, _ = psnr("--rig", "face")
    bright, said = psnr("--rig", "face", "--exposed-as", "body")
    assert abs(dimmed - body) > 0.3
    assert bright == pytest.approx(body, abs=0.1)
    assert "face rig: pictures times 1.67, 1.43, 1.25, as the body rig's" in said
    exposed = json.loads(figures.read_text())["exposed_as"]
    assert (exposed["rig"], exposed["gain"]) == ("body", pytest.approx([1.67, 1.43, 1.25], abs=0.01))
    psnr("--rig", "face", "--exposed-as", "body", "--face-only")


def test_the_default_avatar_is_measured(capture, capsys, tmp_path):
    figures, sheet = tmp_path / "out" / "metrics.json", tmp_path / "sheet.png"
    words = ["--frames", "held-out", "--views", "0,side", "--size", "48", "--baselines", "--held-out-views", "side"]
    assert main(["evaluate", "default", capture, *words, "--json", str(figures), "--sheet", str(sheet)]) == 0
    text = capsys.readouterr().out
    assert "held-out both" in text
    assert "n/a (no weights: pt_inception-2015-12-05-6726825d.pth)" in text
    data = json.loads(figures.read_text())
    assert data["size"] == [48, 48]
    assert data["frames"] == [2]
    assert data["held_out"] == {"frames": [2], "views": ["side"]}
    assert set(data["splits"]) == {"test", "held-out pose", "held-out both"}
    values = data["splits"]["held-out pose"]["avatar"]
    assert values["iou"] > 0.6  # the template it is a dressed version of
    assert data["surface"]["held-out pose"]["avatar"]["to_truth"]["mean_mm"] < 60
    with Image.open(sheet) as picture:
        assert picture.width > 300


def test_levels_are_subjects_of_their_own(capture, capsys, tmp_path):
    """Each is drawn with its own settings: their figures differ, and `balanced` keeps its name."""
    figures = tmp_path / "levels.json"
    words = ["--frames", "0:1", "--views", "front", "--levels", "live,balanced,fine", "--json", str(figures)]
    assert main(["evaluate", "default", capture, *words]) == 0
    assert "avatar, live" in capsys.readouterr().out
    found = json.loads(figures.read_text())["splits"]["train"]
    assert list(found) == ["avatar, live", "avatar", "avatar, fine"]
    assert len({values["psnr"] for values in found.values()}) == 3


def test_the_avatars_own_skin_has_a_baseline_of_its_own(capture, capsys, tmp_path):
    person = resize_person(load_person(), PersonFit(np.eye(10)[0], np.zeros((55, 3))))
    avatar = Avatar.create(person, "compact")
    avatar.meta["untrained"] = ["face", "left_hand", "right_hand"]
    save_avatar(avatar, tmp_path / "me.avatar")
    words = [
        "--frames",
        "0:1",
        "--views",
        "front",
        "--size",
        "32",
        "--baselines",
        "--json",
        str(tmp_path / "found.json"),
    ]
    assert main(["evaluate", str(tmp_path / "me.avatar"), capture, *words]) == 0
    found = json.loads((tmp_path / "found.json").read_text())["splits"]["train"]
    assert list(found) == ["avatar", "naked textured mesh", "mean-colour mesh", "fitted textured mesh"]
    assert found["fitted textured mesh"]["iou"] != found["naked textured mesh"]["iou"]
