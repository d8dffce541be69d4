"""`python -m avatarrex.measure`: every tool is found by its name, says its options, and refuses wrong words in one line."""

from __future__ import annotations

import json

import pytest

from avatarrex.measure.__main__ import PROGRAM, TOOLS, main, run
from avatarrex.metrics.table import aligned, printed


@pytest.mark.parametrize("name", TOOLS)
def test_every_tool_says_its_options(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: {PROGRAM} {name} ")


def test_the_list_of_tools(capsys):
    assert main([]) == main(["--help"]) == 0
    said = capsys.readouterr().out
    assert all(f"  {name} " in said for name in TOOLS)


def test_a_stage_is_measured(tmp_path, capsys):
    out = tmp_path / "run.json"
    assert main(["bench", "skinning", "--quick", "--json", str(out)]) == 0
    assert json.loads(out.read_text())["mode"] == "quick"
    assert "skinning.max_error_m" in capsys.readouterr().out


def test_a_case_of_stress_is_run(tmp_path, capsys):
    assert main(["stress", "--replay", str(tmp_path / "none.json")]) == 2
    assert capsys.readouterr().err.startswith(f"{PROGRAM}: error: {tmp_path}")


@pytest.mark.parametrize("words", [["ablation"], ["bench", "ablation"]])
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--variants", "face-mlp"], "--variants: expected variants of the body: full"),
        (["--arms", "face-mlp"], "--variants: expected variants of the body: full"),
        (["--recipe", "huge"], "--recipe: expected one of paper, paper+, quick, long, refine, smoke, found huge"),
        (["--preset", "huge"], "--recipe: expected one of paper, paper+, quick, long, refine, smoke, found huge"),
        (["--minutes", "-1"], "--minutes: expected a positive number, found -1"),
        (["--scale", "much"], "--scale: expected a positive number, found much"),
        (["--seeds", "x"], "--seeds: expected integers from 0"),
    ],
)
def test_ablation_is_a_tool_and_a_word_of_bench(words, options, said, tmp_path, capsys):
    given = [*words, str(tmp_path / "no_capture"), "--out", str(tmp_path / "study"), *options]
    assert main(given) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [["wobble"], ["bench", "wobble"], ["stress", "--n", "0"]])
def test_wrong_words_are_one_line(words, capsys):
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"{PROGRAM}: error: ")
    assert error.count("\n") == 1


def test_another_program_has_its_own_name(capsys):
    with pytest.raises(SystemExit) as ended:
        run(["bench", "--wobble"], "avatarrex-studio")
    assert ended.value.code == 2
    assert capsys.readouterr().err == "avatarrex-studio: error: unrecognized arguments: --wobble\n"


def test_columns_end_where_they_should(capsys):
    assert aligned([("a", "1", "x"), ("bcd", "22", "y")], right=(1,)) == ["a     1  x", "bcd  22  y"]
    row = printed("name", "value", width=6)
    row("wave", 1.5)
    assert capsys.readouterr().out == "name    value\nwave      1.5\n"
