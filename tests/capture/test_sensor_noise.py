"""`python -m avatarrex.measure sensor-noise`: noise is measured, and nothing else."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.capture.synthetic import plan as plans
from avatarrex.capture.synthetic.make import make_capture
from avatarrex.capture.synthetic.plan import RigSize, Size
from avatarrex.capture.synthetic.variation import Variation
from avatarrex.errors import InputError
from avatarrex.gl.context import NoContext, gl_unavailable
from avatarrex.measure.studies import sensor_noise
from avatarrex.measure.studies.face_regions import measured
from avatarrex.measure.studies.sensor_noise import add_options, pictures, planned, run

needs_gl = pytest.mark.skipif(gl_unavailable() is not None, reason=str(gl_unavailable()))
TINY = Size(72, 96, 2, 4, RigSize(2, 3, (1,), 128), RigSize(2, 2, (1,), 128))
NOISY = Variation(conditions=("exposure", "lens", "noise", "mattes"))


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Capture]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(plans.SIZES, "little", TINY)
        yield open_capture(make_capture(tmp_path_factory.mktemp("noisy") / "little", "little", 3, variation=NOISY))


def differences(capture: Capture, number: int) -> Iterator[Tensor]:
    drawn = planned(capture).rigs[number]
    for still, real, inside in pictures(capture.rigs[drawn.name], drawn, 1, 1):
        yield (still - real).permute(0, 2, 3, 1)[inside]


@needs_gl
def test_noise_is_what_differs(capture: Capture) -> None:
    """As bright, under the same lens, and as far off as the noise says; a lens or an exposure of its own would be ten times that."""
    for number in (0, 1):
        found = list(differences(capture, number))
        assert len(found) == 2 * len(capture.rigs[("body", "face")[number]].held_out_frames)
        for difference in found:
            assert difference.mean().abs() < 0.002
            assert 0.014 < difference.square().mean().sqrt() < 0.018


@needs_gl
def test_without_noise_nothing_differs(capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for JPEG, which pictures on the disk went through: redrawn with their noise they are nearer."""
    monkeypatch.setattr(sensor_noise, "replace", lambda value, **_: value)
    for difference in differences(capture, 1):
        assert difference.square().mean().sqrt() < 0.0125


def test_measures_are_inside_the_mask() -> None:
    inside = torch.zeros(1, 40, 40, dtype=torch.bool)
    inside[:, 10:30, 10:30] = True
    real = torch.rand(1, 3, 40, 40, generator=torch.Generator().manual_seed(0))
    psnr, _, sharpness = measured(torch.where(inside[:, None], 0.5 + (real - 0.5) / 2, 0), real, inside)
    error = ((real[:, :, 10:30, 10:30] - 0.5) / 2).square().mean().item()
    assert psnr == pytest.approx(-10 * np.log10(error), abs=1e-3)
    assert sharpness == pytest.approx(0.25, rel=1e-4)


def options(*words: str | Path) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_options(parser)
    return parser.parse_args(list(map(str, words)))


@needs_gl
def test_a_row_a_rig(capture: Capture, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(plans.SIZES, "little", TINY)
    every = [
        [measured(*each) for each in pictures(capture.rigs[drawn.name], drawn, 1, 1)] for drawn in planned(capture).rigs
    ]
    chosen = {
        (2, 1): ([0, 1], [0, 1]),
        (1, 2): ([0, 2], [0]),
    }  # two cameras; two held-out frames of the body, one of the face
    for (frames, cameras), numbers in chosen.items():
        run(options(capture.path, "--frames", str(frames), "--cameras", str(cameras)))
        head, *rows = (line.split() for line in capsys.readouterr().out.splitlines())
        assert head[-4:] == ["pictures", "psnr", "ssim", "sharpness"]
        for (name, count, *figures), rig, found, some in zip(rows, ("body", "face"), every, numbers):
            assert (name, int(count)) == (rig, len(some))
            np.testing.assert_allclose(list(map(float, figures)), np.mean([found[k] for k in some], 0), atol=6e-4)
            assert float(figures[-1]) < 1


@needs_gl
def test_bad_input_is_one_line(capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(plans.SIZES, "little", TINY)
    with pytest.raises(InputError, match="--frames"):
        run(options(capture.path, "--frames", "0"))
    with pytest.raises(InputError, match="--cameras"):
        run(options(capture.path, "--cameras", "-1"))
    with pytest.raises(InputError, match="capture make --conditions noise"):
        run(options(make_capture(tmp_path / "exact", "little", 3)))
    for wrong in (
        {},
        {"variation": []},
        {**capture.manifest, "variation": {"conditions": None}},
        {**capture.manifest, "variation": {"conditions": ["lens"]}},
    ):
        with pytest.raises(InputError, match="capture make --conditions noise"):
            planned(replace(capture, manifest=wrong))
    with pytest.raises(InputError, match="rigs"):
        planned(replace(capture, rigs={"face": capture.rigs["face"]}))
    drawn = planned(capture).rigs[0]
    with pytest.raises(InputError, match="held-out frames"):
        next(pictures(capture.rigs["body"].holding_out(), drawn, 1, 1))

    def without(*_: object) -> None:
        raise NoContext("off")

    monkeypatch.setattr(sensor_noise, "posed_stage", without)
    with pytest.raises(InputError, match="OpenGL"):
        run(options(capture.path))
