"""`python -m avatarrex.measure sensor-noise`: noise is measured, and nothing else."""

from __future__ import annotations

import argparse

import pytest
import torch

from avatarrex.capture.synthetic.plan import Plan, RigPlan, plan
from avatarrex.capture.synthetic.variation import CONDITIONS, Variation
from avatarrex.measure.studies import sensor_noise
from avatarrex.measure.studies.sensor_noise import add_options, measured, pictures, run


def test_noise_is_measured_and_nothing_else() -> None:
    rig = plan("smoke", 0, "printed", Variation("other", conditions=("exposure", "noise", "mattes"))).rigs[1]
    ((still, real),) = pictures(rig, rig.held_out_frames[:1], list(rig.cameras)[:1])
    torch.testing.assert_close(still[:, 3], real[:, 3], rtol=0, atol=0)
    inside = (real[:, 3] > 0.5)[:, None]
    assert abs((still - real)[:, :3].masked_select(inside).mean()) < 0.002  # as bright
    psnr, ssim, sharpness = measured(still, real)
    assert 30 < psnr < 45
    assert 0.8 < ssim < 0.999
    assert 0.5 < sharpness < 0.99


def test_a_row_a_rig(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    asked: list[tuple[str, list[int], list[str]]] = []
    rigs = plan("smoke", 0, "printed").rigs

    def simple(size: str, seed: int, garment: str, variation: Variation) -> Plan:
        assert variation == Variation("other", conditions=CONDITIONS)
        return plan(size, seed, garment)  # the other person takes ten seconds

    def flat(rig: RigPlan, frames: list[int], serials: list[str]) -> list[tuple[torch.Tensor, torch.Tensor]]:
        asked.append((rig.name, frames, serials))
        real = torch.rand(1, 4, 32, 32, generator=torch.Generator().manual_seed(0)).clamp_min(0.6)
        return [(real, real)] * len(frames) * len(serials)

    monkeypatch.setattr(sensor_noise, "pictures", flat)
    monkeypatch.setattr(sensor_noise, "plan", simple)
    parser = argparse.ArgumentParser()
    add_options(parser)
    run(parser.parse_args(["--size", "smoke", "--frames", "1", "--cameras", "2"]))
    head, *rows = (line.split() for line in capsys.readouterr().out.splitlines())
    assert head[-4:] == ["pictures", "psnr", "ssim", "sharpness"]
    assert asked == [(rig.name, list(rig.held_out_frames), list(rig.cameras)[::2]) for rig in rigs]
    assert [row[:2] for row in rows] == [["body", "2"], ["face", "4"]]
    assert all(row[3:] == ["1.000", "1.000"] for row in rows)
