"""Metrics, their JSON, the gate's verdicts and the plots' arithmetic: no measuring."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from avatarrex.errors import InputError
from avatarrex.measure.bench import gate, plots
from avatarrex.measure.bench.contest import Contest, Contestant, Times, installed, interleaved, ratio
from avatarrex.measure.bench.growth import fitted
from avatarrex.measure.bench.report import FASTER, SLOWER, Metric, Report, describe, device_class
from avatarrex.measure.bench.stages import STAGES, chosen

DEVICE = {"system": "Linux", "vectors": "AVX2", "cores": 2, "gpu": None, "renderer": "llvmpipe (LLVM 15.0.6, 256 bits)"}
ERROR = Metric("sdf.max_error_m", 2e-8, "m", target=1e-6)
SPEED = Metric("sdf.vs_brute", 40.0, FASTER, "higher", target=30.0, tolerance=0.25)
COST = Metric("raycast.vs_sphere", 0.8, SLOWER, target=1.2, tolerance=0.25)
TIME = Metric("frame.new_pose_512_ms", 600.0, "ms", target=500.0)
MISSED = Metric("volume.mib", 14.0, "MiB", target=10.0, tolerance=0.1)
ALL = [ERROR, SPEED, COST, TIME, MISSED]


def report(*metrics: Metric, mode: str = "quick") -> Report:
    return Report(DEVICE, mode, list(metrics), {})


def failed(*metrics: Metric) -> list[str]:
    """Names that fail against the baseline `ALL`."""
    return [v.name for v in gate.compare(report(*metrics), report(*ALL), list(STAGES)) if not v.passed]


def test_json_holds_every_figure_and_comes_back(tmp_path):
    path = tmp_path / "run.json"
    path.write_text(json.dumps(asdict(report(*ALL))))
    data = json.loads(path.read_text())
    assert set(data) == {"device", "mode", "metrics", "absent"}
    for one in data["metrics"]:
        assert list(one) == ["name", "value", "unit", "direction", "error", "target", "tolerance"]
    assert Report.read(path) == report(*ALL)


@pytest.mark.parametrize("text", ["{}", "[]", '{"device": {}, "mode": "full", "metrics": [{"name": "a"}]}', "no"])
def test_a_file_that_is_no_run_is_refused(tmp_path, text):
    path = tmp_path / "run.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"run\.json"):
        Report.read(path)


def test_a_figure_that_is_none_is_an_error():
    with pytest.raises(ArithmeticError, match=r"sdf\.x"):
        Metric("sdf.x", float("nan"), "m")


def test_targets_are_met_from_either_side():
    assert [metric.met for metric in ALL] == [True, True, True, False, False]
    assert Metric("a.b", 1.0, "m").met is None


def test_the_same_run_passes():
    assert failed(*ALL) == []


@pytest.mark.parametrize(
    ("changed", "fails"),
    [
        (replace(ERROR, value=9e-7), False),  # worse than before, within the target
        (replace(ERROR, value=1.1e-6), True),
        (replace(SPEED, value=31.0), False),
        (replace(SPEED, value=29.9), True),  # a quarter less is 30
        (replace(COST, value=0.99), False),
        (replace(COST, value=1.01), True),  # within the target, but a quarter slower than it was
        (replace(TIME, value=1e6), False),
        (replace(MISSED, value=15.3), False),  # was missed before: it may not get worse by more than the tolerance
        (replace(MISSED, value=15.5), True),
    ],
)
def test_what_may_change_and_what_may_not(changed, fails):
    others = [metric for metric in ALL if metric.name != changed.name]
    assert failed(*others, changed) == ([changed.name] if fails else [])


def test_what_is_no_longer_measured_fails_unless_its_stage_was_not_run():
    now = report(*ALL[1:])
    assert [v.name for v in gate.compare(now, report(*ALL), ["sdf"]) if not v.passed] == ["sdf.max_error_m"]
    assert all(v.passed for v in gate.compare(now, report(*ALL), ["raycast"]))


def test_the_table_names_what_failed_first():
    verdicts = gate.compare(report(*ALL[1:], replace(ERROR, value=1.0)), report(*ALL), list(STAGES))
    lines = gate.table(verdicts, gate.baseline_path(report())).splitlines()
    assert lines[1].startswith("FAIL")
    assert "sdf.max_error_m" in lines[1]
    assert (
        lines[-1] == "gate: 1 of 4 failed, against avatarrex/measure/baselines/linux-2-cores-avx2-llvmpipe.quick.json"
    )


def test_a_baseline_of_another_size_is_refused(tmp_path):
    path = tmp_path / "full.json"
    path.write_text(json.dumps(asdict(report(*ALL, mode="full"))))
    with pytest.raises(InputError, match="mode"):
        gate.read_baseline(path, report())


def test_the_device_is_described_without_a_host():
    import platform
    import re

    device = describe()
    assert platform.node() not in re.findall(r"\w+", json.dumps(device))
    assert device_class(device).startswith(platform.system().lower())
    assert device_class({**DEVICE, "gpu": "NVIDIA H100 80GB HBM3"}) == "linux-2-cores-avx2-nvidia-h100-80gb-hbm3"
    assert device_class({**DEVICE, "networks": "cuda:1"}).endswith("-networks-on-cuda-1")


def test_stages_are_known_by_name():
    assert chosen([]) == list(STAGES)
    assert chosen(["raycast", "sdf"]) == ["sdf", "raycast"]
    with pytest.raises(InputError, match="wobble"):
        chosen(["sdf", "wobble"])


def test_contestants_take_turns():
    turns: list[str] = []
    times = interleaved({name: (lambda n=name: turns.append(n)) for name in "ab"}, 2)
    assert turns == list("ababab")
    assert [len(t.wall) for t in times.values()] == [2, 2]


def test_a_ratio_is_the_median_of_the_turns():
    above, below = Times([2, 40, 9], [1, 1, 1]), Times([1, 10, 3], [2, 4, 8])
    assert ratio(above, below) == 3
    assert ratio(above, below, cpu=True) == 0.25


def test_contests_compare_with_ours():
    entries = (
        Contestant("other", Times([6.0], [9.0]), {"max_error_m": 0.0}),
        Contestant("ours", Times([2.0], [1.0]), {"max_error_m": 1.0}, ours=True),
    )
    contest = Contest("sdf.hand", entries, cpu=False)
    assert contest.advantage("other") == 3
    assert "nobody" not in contest.named
    assert [m.name for m in contest.comparison()] == ["peers.sdf.hand.other"]
    assert [m.value for m in contest.metrics()] == [6.0, 2.0]
    assert replace(contest, cpu=True).advantage("other") == 9


def test_what_is_not_installed_is_named():
    absent: dict[str, str] = {}
    ready = installed(
        {"here": (("json",), lambda: list), "gone": (("no_such_module",), lambda: list)}, absent, "sdf.hand"
    )
    assert list(ready) == ["here"]
    assert absent == {"peers.sdf.hand.gone": "not installed: no_such_module"}


def test_exponents_are_found():
    size = np.array([1.0, 2.0, 4.0, 8.0])
    exponent, factor, deviation = fitted(size.tolist(), (3 * size**2.5).tolist())
    assert exponent == pytest.approx(2.5)
    assert factor == pytest.approx(3)
    assert deviation == pytest.approx(0, abs=1e-9)


def test_the_front_is_nobodys_better():
    entries = [("a", 1.0, 9.0, "e"), ("b", 2.0, 10.0, "e"), ("c", 3.0, 1.0, "e"), ("d", 3.0, 2.0, "e")]
    assert plots.front(entries) == [(1.0, 9.0), (3.0, 1.0)]


def test_plots_are_drawn_of_what_was_measured(tmp_path):
    error = {"of": "nodes", "size": [32, 64], "ms": [1.0, 2.0], "factor": 1 / 32, "largest_deviation": 0.0}
    metrics = [
        Metric("sdf.hand.ours.ms", 1.0, "ms", error={"max_error_m": 1e-8}),
        Metric("sdf.hand.libigl.ms", 2.0, "ms", error={"max_error_m": 0.0}),
        Metric("sdf.body.ours.ms", 2.0, "ms", error={"max_error_m": 0.0}),
        Metric("frame.new_pose_512_ms", 2.0, "ms", error={"depth_mean_mm": 0.0}),
        Metric("growth.nodes.exponent", 1.0, "exponent", error=error),
    ]
    assert list(plots.pareto(metrics)) == ["sdf.hand"]
    made = plots.plot(metrics, tmp_path / "plots")
    assert [path.name for path in made] == ["sdf_hand.png", "growth.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in made)
