"""Every remedy against a numerical hazard taken away, and every sabotage of training and distillation, in a copy of the packages: the test
that guards it must fail.

It must fail because it saw wrong numbers, not because the code broke: only assertions count.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from mutations.learning import LEARNING
from mutations.mouth import MOUTH
from mutations.mutants import MUTANTS as HAZARDS
from mutations.mutants import Mutant

ROOT = Path(__file__).parents[2]
MUTANTS = {**HAZARDS, **LEARNING, **MOUTH}
PACKAGES = {"avatarrex": "avatarrex", "app": "avatarrex_studio", "shaders": "avatarrex_shaders"}
"""Folder of the checkout -> the name that it is imported by."""
TABLE = {
    "axis-angle at 0", "axis-angle at π", "blended skinning matrix", "Σw → 0", "Laplace CDF", "transmittance",
    "sliver triangles", "thin parts", "parallel rays", "far from origin", "encoding", "storage", "temporal reuse",
    "surfaces that creep", "parts off screen", "sides not searched", "sharp joints", "limbs that touch",
    "a hand that pierces itself", "rays that share a beam", "small components", "contexts of others",
}  # fmt: skip
"""The hazards of docs/stress.md that have a remedy in the code."""


def test_every_hazard_has_a_mutant() -> None:
    assert {mutant.hazard for mutant in HAZARDS.values()} == TABLE


@pytest.mark.parametrize("name", MUTANTS)
def test_the_list_is_up_to_date(name: str) -> None:
    mutant = MUTANTS[name]
    found = (ROOT / mutant.file).read_text().count(mutant.remedy)
    assert found == 1, f"{mutant.file} holds the remedy {found} times: {mutant.remedy}"
    path, test = mutant.test.split("::")
    assert f"\ndef {test.partition('[')[0]}(" in (ROOT / path).read_text(), f"no such test: {mutant.test}"


@pytest.mark.slow
def test_with_every_remedy_in_place_the_tests_pass(tmp_path: Path) -> None:
    failures, errors, passed = run(tmp_path, sorted({mutant.test for mutant in MUTANTS.values()}))
    assert (failures, errors) == ([], [])
    assert passed >= len({mutant.test for mutant in MUTANTS.values()})


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTANTS)
def test_without_the_remedy_its_test_fails(name: str, tmp_path: Path) -> None:
    mutant = MUTANTS[name]
    failures, errors, passed = run(tmp_path, [mutant.test], mutant)
    assert errors == [], "the test could not run"
    assert failures, f"{mutant.test} passes ({passed}) without: {mutant.remedy}"
    strays = [text for text in failures if not text.startswith(("assert", "AssertionError"))]
    assert strays == [], "failed, but not by an assertion"


def run(folder: Path, tests: list[str], mutant: Mutant | None = None) -> tuple[list[str], list[str], int]:
    """Messages of failures and of errors, and how many tests passed, in a process that imports the copy in `folder`."""
    copy(folder, mutant)
    report = folder / "report.xml"
    # -P: the working folder is the checkout, and must not come before the copy.
    words = [sys.executable, "-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-o", "addopts="]
    environment = {**os.environ, "PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [*words, f"--junitxml={report}", *tests], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    assert report.exists(), done.stdout + done.stderr
    cases = list(ElementTree.parse(report).getroot().iter("testcase"))
    failures = [found.get("message", "") for case in cases for found in case.iter("failure")]
    errors = [found.get("message", "") for case in cases for found in case.iter("error")]
    return failures, errors, sum(len(case) == 0 for case in cases)


def copy(folder: Path, mutant: Mutant | None) -> None:
    """The packages under their names as links, but for the mutated file and the folders that lead to it."""
    for source, name in PACKAGES.items():
        link(ROOT / source, folder / name, Path(mutant.file) if mutant else Path())
    if mutant:
        top, *rest = Path(mutant.file).parts
        target = folder.joinpath(PACKAGES[top], *rest)
        text = (ROOT / mutant.file).read_text()
        target.unlink()
        target.write_text(text.replace(mutant.remedy, mutant.without))


def link(source: Path, target: Path, changed: Path) -> None:
    """Link `source`, or make a folder of links where `changed` (from the checkout) lies below it."""
    if source not in (ROOT / changed).parents:
        target.symlink_to(source)
        return
    target.mkdir()
    for entry in source.iterdir():
        if entry.name != "__pycache__":
            link(entry, target / entry.name, changed)
