"""The examples run as they stand, and as their first lines say."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_pose
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name: str, *words: str) -> str:
    """What an example prints."""
    done = subprocess.run([sys.executable, EXAMPLES / name, *words], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_each_is_short_and_tested():
    names = {path.name: len(path.read_text().splitlines()) for path in EXAMPLES.glob("*.py")}
    assert set(names) == {"portrait.py", "play_motion.py"}
    assert max(names.values()) <= 40


@pytest.mark.slow
def test_portrait(tmp_path):
    said = run("portrait.py", str(tmp_path / "a.png"), "64")
    assert "another view" in said
    assert " 0 voxels" in said
    with Image.open(tmp_path / "a.png") as image:
        pixels = np.asarray(image.convert("RGB"))
    assert pixels.shape == (64, 64, 3)
    assert 0.2 < (pixels != 255).any(-1).mean() < 0.9
    with np.load(tmp_path / "a.npz") as arrays:
        assert arrays["depth"].dtype == np.float32
        assert 0.8 < arrays["depth"][arrays["depth"] > 0].min() < 1.5


@pytest.mark.slow
def test_play_motion(tmp_path):
    av = pytest.importorskip("av")
    stand = Signals.rest().replace(body_pose=named_pose("stand"))
    frames = tuple(stand.replace(translation=np.array([0.0, 0.0, 0.1 * k])) for k in range(7))
    write_json(tmp_path / "steps.json", SignalSequence(frames, 30.0, "steps"))
    said = run("play_motion.py", str(tmp_path / "steps.json"), str(tmp_path / "steps.mp4"), "64", "10")
    assert "3 frames, 0.2 s" in said
    with av.open(str(tmp_path / "steps.mp4")) as video:
        stream = video.streams.video[0]
        assert float(stream.average_rate) == pytest.approx(10)
        pictures = [frame.to_ndarray(format="rgb24") for frame in video.decode(stream)]
    assert len(pictures) == 3
    for picture in pictures:
        assert picture.shape == (64, 64, 3)
        assert picture.std() > 10, "a person, not a background"
