"""Every sabotage of training and distillation: the test that guards against it must fail."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutations.learning import LEARNING
from mutations.mouth import MOUTH
from mutations.mutate import assert_dies, assert_up_to_date

MUTANTS = {**LEARNING, **MOUTH}


@pytest.mark.parametrize("name", MUTANTS)
def test_the_list_is_up_to_date(name: str) -> None:
    assert_up_to_date(MUTANTS[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTANTS)
def test_its_test_fails(name: str, tmp_path: Path) -> None:
    assert_dies(MUTANTS[name], tmp_path)
