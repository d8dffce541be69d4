"""Every example runs, small, as its first lines say, and is shown in the gallery."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from avatarrex.gl.context import gl_unavailable
from avatarrex.signals.read import read_motion

ROOT = Path(__file__).parents[1]
EXAMPLES = {path.stem[:2]: path for path in sorted((ROOT / "examples").glob("*.py"))}
MOST_LINES = 45
"""One lesson on one page."""


Run = Callable[[str, Path, int], str]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """What an example prints, by number; it writes `out`. As a process of its own, which takes seconds to import, runs the portrait."""

    def ran(number: str, out: Path, size: int) -> str:
        monkeypatch.setattr(sys, "argv", [str(EXAMPLES[number]), str(out), str(size)])
        runpy.run_path(str(EXAMPLES[number]), run_name="__main__")
        return capsys.readouterr().out

    return ran


def picture(path: Path, height: int, width: int, people: int | None = None) -> np.ndarray:
    """Its pixels; each part that is as wide as high shows somebody, or the first `people` do."""
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB"))
    assert pixels.shape == (height, width, 3)
    for part in np.array_split(pixels, max(width // height, 1), axis=1)[:people]:
        assert part.std() > 10
    return pixels


def numbers(line: str) -> list[float]:
    return [float(word) for word in re.findall(r"(?<![\w.])\d+(?:\.\d+)?", line)]


def test_they_are_numbered_short_and_in_the_gallery() -> None:
    assert list(EXAMPLES) == [f"{k:02}" for k in range(1, len(EXAMPLES) + 1)]
    assert len(EXAMPLES) >= 8
    page = (ROOT / "docs" / "gallery.md").read_text()
    for path in EXAMPLES.values():
        text = path.read_text()
        assert len(text.splitlines()) <= MOST_LINES, path
        assert f"python examples/{path.name} OUT" in text, path
        assert path.name in page, f"the gallery does not show {path.name}"
        assert list((ROOT / "docs" / "gallery").glob(f"{path.stem}.*")), f"no picture of {path.name}: tools/gallery.sh"


@pytest.mark.parametrize("number", EXAMPLES)
def test_options_that_it_has_not_are_refused(number: str, run: Run, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as refused:
        run(number, Path("--help"), 64)
    assert f"python examples/{EXAMPLES[number].name} OUT" in str(refused.value), "a text: printed, and status 1"
    assert not list(tmp_path.iterdir())


def test_portrait(tmp_path: Path) -> None:
    """As the gallery's page says, by the shell."""
    words = [sys.executable, str(EXAMPLES["01"]), str(tmp_path / "a.png"), "64"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "pixels" in done.stdout
    assert 0.2 < (picture(tmp_path / "a.png", 64, 64) != 255).any(-1).mean() < 0.9


def test_motion_to_video(run: Run, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    assert "9 frames, 1.0 s" in run("02", tmp_path / "a.mp4", 64)
    with av.open(str(tmp_path / "a.mp4")) as video:
        stream = video.streams.video[0]
        assert float(stream.average_rate) == pytest.approx(8)
        pictures = [frame.to_ndarray(format="rgb24") for frame in video.decode(stream)]
    assert len(pictures) == 9
    assert all(image.shape == (64, 64, 3) and image.std() > 10 for image in pictures), "a person, not a background"
    assert np.abs(pictures[4].astype(float) - pictures[0]).mean() > 1, "the arm moves"


def test_expressions_and_hands(run: Run, tmp_path: Path) -> None:
    run("03", tmp_path / "a.png", 48)
    pixels = picture(tmp_path / "a.png", 96, 192).astype(float)
    cells = pixels.reshape(2, 48, 4, 48, 3).swapaxes(1, 2)
    for row in cells:
        assert all(np.abs(a - b).mean() > 0.5 for k, a in enumerate(row) for b in row[:k]), "all differ"


def test_levels(run: Run, tmp_path: Path) -> None:
    lines = run("04", tmp_path / "a.png", 48).splitlines()
    picture(tmp_path / "a.png", 48, 240)
    errors = [numbers(line)[1] for line in lines[1:]]
    assert [line.split()[0] for line in lines[1:]] == ["paper", "fast", "balanced", "fine", "quality"]
    assert errors == sorted(errors, reverse=True)


def test_depth_normals_positions(run: Run, tmp_path: Path) -> None:
    run("05", tmp_path / "a.png", 64)
    picture(tmp_path / "a.png", 64, 192)
    with np.load(tmp_path / "a.npz") as arrays:
        hit, depth, normal, position = (arrays[name] for name in ("hit", "depth", "normal", "position"))
    assert 2.0 < depth[hit].min() < depth[hit].max() < 3.2
    np.testing.assert_allclose(np.linalg.norm(normal[hit], axis=-1), 1, atol=1e-4)
    assert abs(np.median(position[hit][:, 0]) - 0.2) < 0.15, "world metres: the person was moved there"


def test_parts_and_patches(run: Run, tmp_path: Path) -> None:
    lines = run("06", tmp_path / "a.png", 64).splitlines()
    body, hand, face = zip(*(numbers(line.split(": ")[1]) for line in lines))
    assert (hand[0] > 0, hand[1], face[2]) == (True, 0, 0)
    assert (body[3], hand[3], face[3]) == (body[0], hand[0], face[0]), "patches change colours alone"
    cells = np.array_split(picture(tmp_path / "a.png", 64, 256), 4, axis=1)
    assert (cells[3] != cells[0]).any()


def test_retarget_a_motion(run: Run, tmp_path: Path) -> None:
    said = run("07", tmp_path / "a.png", 48)
    assert "25 frames at 12 a second" in said
    assert "centimetres" in said
    picture(tmp_path / "a.png", 48, 240)
    assert len(read_motion(tmp_path / "a.json")) == 25


def test_what_is_computed_again(run: Run, tmp_path: Path) -> None:
    lines = run("08", tmp_path / "a.png", 128).splitlines()[1:]  # smaller ones show nothing of the hand
    work = {line[:14].strip(): [int(word) for word in line[14:].split()[1:]] for line in lines}
    assert work["nothing"] == [0, 0, 0, 0, 0]
    voxels, faces, hands, rays, pixels = zip(*(work[name] for name in ("camera", "expression", "a hand", "place")))
    assert set(voxels) == {0}
    assert [count > 0 for count in faces] == [False, True, False, False]
    assert [count > 0 for count in hands] == [False, False, True, False]
    assert min(rays) > 0
    assert min(pixels) > 0


def test_against_the_exact_frame(run: Run, tmp_path: Path) -> None:
    lines = run("09", tmp_path / "a.png", 20).splitlines()
    paper, balanced, quality = (numbers(line)[0] for line in lines)
    assert quality < 0.5 * min(paper, balanced)
    assert max(paper, balanced) < 4
    picture(tmp_path / "a.png", 40, 160, people=1)


@pytest.mark.slow
@pytest.mark.skipif(gl_unavailable() is not None, reason=str(gl_unavailable()))
def test_capture_to_compare(run: Run, tmp_path: Path) -> None:
    lines = run("10", tmp_path / "a.png", 64).splitlines()
    assert lines[0] == "4 cameras, 4 frames"
    assert all(15 < numbers(line)[-1] < 40 for line in lines[1:])
    picture(tmp_path / "a.png", 64, 8 * 48)
