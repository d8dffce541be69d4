"""Every remedy against a numerical hazard taken away: the test that guards it must fail."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from mutations.mutants import MUTANTS
from mutations.mutate import assert_dies, assert_up_to_date, run

TABLE = {
    "axis-angle at 0", "axis-angle at π", "blended skinning matrix", "Σw → 0", "Laplace CDF", "transmittance",
    "sliver triangles", "thin parts", "parallel rays", "far from origin", "encoding", "storage", "temporal reuse",
    "surfaces that creep", "parts off screen", "sides not searched", "sharp joints", "limbs that touch",
    "a hand that pierces itself", "rays that share a beam", "small components", "contexts of others",
}  # fmt: skip
"""The hazards of docs/stress.md that have a remedy in the code."""


def test_every_hazard_has_a_mutant() -> None:
    assert {mutant.hazard for mutant in MUTANTS.values()} == TABLE


@pytest.mark.parametrize("name", MUTANTS)
def test_the_list_is_up_to_date(name: str) -> None:
    assert_up_to_date(MUTANTS[name])


@pytest.mark.slow
def test_a_copy_with_nothing_taken_away_passes(tmp_path: Path) -> None:
    mutant = MUTANTS["matrix at angle 0"]
    assert run(replace(mutant, without=mutant.remedy), tmp_path) == ([], [], 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTANTS)
def test_without_the_remedy_its_test_fails(name: str, tmp_path: Path) -> None:
    assert_dies(MUTANTS[name], tmp_path)
