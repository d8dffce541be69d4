"""Stress: its cases pass, a defect is found, shrunk to what it needs, written, and fails again from the file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from avatarrex_studio.cli import main as cli

from avatarrex.errors import InputError
from avatarrex.fields.hand import HandField
from avatarrex.measure.stress import driving, poison
from avatarrex.measure.stress import run as runs
from avatarrex.measure.stress.case import Entry, Kind, examine, from_json, to_json
from avatarrex.measure.stress.findings import Finding, Findings, Tally
from avatarrex.measure.stress.run import KINDS, make, outcome, plan
from avatarrex.measure.stress.shrink import shrink
from avatarrex.signals.limits import random_signals


def failed(findings: list[Finding]) -> list[str]:
    return [f"{f.check}: {f.figure} {f.note}" for f in findings if f.failed]


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [("points", range(7)), ("picture", (1, 2)), ("mesh", (6, 8)), ("rays", (0, 1)), ("agreement", (5, 6))],
)
def test_cases_of_every_kind_pass(kind: str, numbers: range) -> None:
    """Every family of signals, three cameras, the two meshes that were inside out."""
    for number in numbers:
        assert failed(outcome((kind, number, 0)).findings) == []


@pytest.mark.parametrize("border", poison.BORDERS)
def test_nan_is_refused_at_every_border(border: str) -> None:
    number = list(poison.BORDERS).index(border)
    for turn in range(len(poison.VALUES)):
        inputs = make("poison", number + turn * len(poison.BORDERS), 0)
        assert failed(examine(KINDS["poison"], inputs, False)) == []


def test_the_plan_has_one_frame_in_twenty_and_every_border() -> None:
    kinds = [kind for kind, _ in plan(200)]
    assert (kinds.count("points"), kinds.count("picture")) == (190, 10)
    assert kinds.count("poison") == len(poison.BORDERS)
    assert len(set(plan(200))) == len(plan(200))


def test_the_same_seed_gives_the_same_case() -> None:
    one, two, other = make("points", 3, 5), make("points", 3, 5), make("points", 3, 6)
    assert all(np.array_equal(one[name], two[name]) for name in one)
    assert not np.array_equal(one["body_pose"], other["body_pose"])


def hinge(inputs: dict[str, np.ndarray], found: Findings) -> None:
    """Fails where the left knee turns by more than 0.3 about x while one of the rows is the seventh."""
    found.flag("hinge", not (inputs["body_pose"][3, 0] > 0.3 and 7 in inputs["point_row"]))


HINGE = replace(KINDS["points"], name="hinge", check=hinge)


def test_a_failure_shrinks_to_what_it_needs() -> None:
    inputs = make("points", 2, 0)
    inputs["body_pose"][3, 0] = 3.0
    small = shrink(HINGE, inputs, Finding("hinge", 1.0, 0.0))
    assert np.argwhere(small.inputs["body_pose"][:, 0] != 0).tolist() == [[3]]
    assert 0.3 < small.inputs["body_pose"][3, 0] <= 0.4
    assert small.inputs["point_row"].tolist() == [7]
    assert not small.inputs["shape"].any()
    assert small.finding.failed


def test_a_case_comes_back_from_its_file_to_the_last_bit() -> None:
    inputs = make("points", 3, 0)
    inputs["translation"] = np.array([-0.0, 5e-324, 0.1])
    text = json.dumps(to_json(KINDS["points"], inputs, Finding("a check", 2.0, 1.0)))
    kind, again, check = from_json(text, KINDS, "case.json")
    assert (kind.name, check) == ("points", "a check")
    assert all(again[name].tobytes() == inputs[name].tobytes() for name in inputs)
    nan = make("poison", 0, 0)
    assert np.isnan(from_json(json.dumps(to_json(KINDS["poison"], nan, Finding("", 1, 0))), KINDS, "")[1]["value"])


def document() -> dict:
    return to_json(KINDS["mesh"], make("mesh", 0, 0), Finding("sign", 1.0, 0.0))


BAD = {
    "no JSON": (lambda d: "{", "case.json: expected JSON"),
    "a list": (lambda d: [], "kind: expected a stress case"),
    "another format": (lambda d: d | {"format": 2}, "format: expected 1"),
    "unknown case": (lambda d: d | {"case": "tea"}, "case: expected points or .*found tea"),
    "no inputs": (lambda d: d | {"inputs": None}, "inputs: expected vertices, faces, points"),
    "missing input": (lambda d: d | {"inputs": {"faces": d["inputs"]["faces"]}}, r"found \['faces'\]"),
    "wrong shape": (lambda d: _points(d, shape=[5, 2]), r"points: expected shape \(-1, 3\)"),
    "too many rows": (lambda d: _points(d, shape=[10**12, 3]), "points: expected shape"),
    "truncated values": (lambda d: _points(d, values=["0x0p+0"]), "as many values"),
    "negative shape": (lambda d: _points(d, shape=[-1, -3]), "points: expected shape"),
    "decimal": (lambda d: _points(d, shape=[1, 3], values=["0.1"] * 3), "hexadecimal"),
    "a number": (lambda d: _points(d, shape=[1, 3], values=[0.5] * 3), "hexadecimal"),
    "too large": (lambda d: _points(d, shape=[1, 3], values=["0x1p+9999"] * 3), "double precision"),
    "a face beyond": (lambda d: d | {"inputs": d["inputs"] | {"faces": {"shape": [1, 3], "values": [0, 1, 2**40]}}},
                      "integers from 0 to"),
}  # fmt: skip


def _points(document: dict, **changes: object) -> dict:
    return document | {"inputs": document["inputs"] | {"points": document["inputs"]["points"] | changes}}


@pytest.mark.parametrize("what", BAD)
def test_hostile_files_are_refused(what: str, tmp_path, capsys) -> None:
    change, pattern = BAD[what]
    content = change(document())
    text = content if isinstance(content, str) else json.dumps(content)
    with pytest.raises(InputError, match=pattern):
        from_json(text, KINDS, "case.json")
    (tmp_path / "case.json").write_text(text)
    assert cli.main(["stress", "--replay", str(tmp_path / "case.json")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    "words", [["--n", "0"], ["--n", "x"], ["--seed", "-1"], ["--replay", "/nowhere.json"], ["--processes", "0"]]
)
def test_wrong_options_are_refused(words: list[str], capsys) -> None:
    assert cli.main(["stress", *words]) == 2
    assert words[0].strip("-") in capsys.readouterr().err or words[0] == "--replay"


def test_a_defect_is_found_written_and_fails_again(tmp_path, monkeypatch, capsys) -> None:
    """Hand colours a little too bright: the run says so, and its file fails until the colours are right."""
    right = HandField.colour
    monkeypatch.setattr(HandField, "colour", lambda *given: right(*given) + 0.9)
    monkeypatch.setattr("avatarrex.measure.stress.run.plan", lambda count: [("points", 0), ("mesh", 1)])
    monkeypatch.setattr("avatarrex.measure.stress.shrink.SECONDS", 1.0)
    out, report = tmp_path / "out", tmp_path / "report.json"
    words = ["--n", "1", "--processes", "1", "--out", str(out), "--json", str(report)]
    assert cli.main(["stress", *words]) == 1
    assert "hand colour in 0 to 1" in capsys.readouterr().out
    (file,) = json.loads(report.read_text())["files"]
    assert cli.main(["stress", "--replay", file]) == 1
    assert "hand colour in 0 to 1: fails" in capsys.readouterr().out
    monkeypatch.undo()
    assert cli.main(["stress", "--replay", file]) == 0
    assert "hand colour in 0 to 1: holds" in capsys.readouterr().out


def test_ctrl_c_ends_with_what_was_found(tmp_path, monkeypatch, capsys) -> None:
    def interrupted(cases, seed, processes):
        yield outcome(("mesh", 1, seed))
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "run", interrupted)
    report = tmp_path / "report.json"
    assert cli.main(["stress", "--n", "5", "--json", str(report), "--out", str(tmp_path / "out")]) == 130
    assert "interrupted after 1 of" in capsys.readouterr().out
    assert json.loads(report.read_text())["interrupted"] is True
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_several_processes_find_what_one_finds() -> None:
    cases = [("mesh", 1), ("mesh", 2), ("poison", 3)]
    one, two = ([(o.number, o.findings) for o in runs.run(cases, 0, processes)] for processes in (1, 2))
    assert one == two


def test_what_a_case_raises_and_what_changes_are_findings() -> None:
    count = iter(range(9))

    def moody(inputs: dict[str, np.ndarray], found: Findings) -> None:
        found.finite("numbers", torch.tensor([float(next(count))]))

    def broken(inputs: dict[str, np.ndarray], found: Findings) -> None:
        raise ZeroDivisionError("no")

    kind = Kind("moody", {"x": Entry((1,))}, lambda rng, number: {"x": np.zeros(1)}, moody, 1)
    assert failed(examine(kind, {}, True)) == ["same bits again: 1.0 "]
    assert failed(examine(replace(kind, check=broken), {}, False)) == ["raises nothing: 1.0 ZeroDivisionError: no"]


def test_figures_that_are_no_numbers_fail() -> None:
    found = Findings()
    found.finite("finite", torch.tensor([1.0, torch.nan, torch.inf]))
    found.within("within", torch.tensor([0.5, torch.nan]), 0, 1)
    found.unit("unit", torch.zeros(1, 3), 1e-5)
    found.at_most("empty", torch.zeros(0), 0)
    assert [f.failed for f in found.found] == [True, True, True, False]
    tally = Tally()
    tally.add("kind", 4, found.found, 1.0)
    rows = {row["check"]: row for row in tally.to_json()["checks"]}
    assert rows["finite"]["worst"] == 2
    assert rows["within"]["worst"] is None
    assert rows["within"]["worst_case"] == 4
    assert tally.failures == 3
    assert "within" in tally.text()


def test_signals_go_through_a_case_unchanged() -> None:
    signals = random_signals(np.random.default_rng(0), 1.0)
    assert driving.signals_of(driving.inputs_of(signals)) == signals
