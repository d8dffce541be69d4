"""`evaluate` from the command line: refusals before work, and one true run of the default avatar."""

import json

import pytest
from avatarrex_studio.cli import main
from drawn_capture import write_capture
from PIL import Image


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
        (["--rig", "face"], "--rig: expected one of body, found face"),
        (["--sheet", "sheet.jpg"], "sheet.jpg: expected OUT.png, found .jpg"),
        (["--vgg", "nowhere.pth"], "nowhere.pth: expected a weights file such as vgg16-397923af.pth"),
    ],
)
def test_wrong_options_are_one_line(capture, capsys, words, message):
    assert main(["evaluate", "default", capture, *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1


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
    assert set(data["splits"]) == {"held-out pose", "held-out both"}
    values = data["splits"]["held-out pose"]["avatar"]
    assert values["iou"] > 0.6  # the template it is a dressed version of
    assert data["surface"]["held-out pose"]["avatar"]["to_truth"]["mean_mm"] < 60
    with Image.open(sheet) as picture:
        assert picture.width > 300
