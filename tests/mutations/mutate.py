"""A copy of the packages with one text replaced, and the test that guards it run on that copy.

It must fail because it saw wrong numbers, not because the code broke: only assertions count.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from mutations.mutants import Mutant

ROOT = Path(__file__).parents[2]
PACKAGES = {"avatarrex": "avatarrex", "app": "avatarrex_studio", "shaders": "avatarrex_shaders"}
"""Folder of the checkout -> the name that it is imported by."""
OTHERS = [
    "beartype",
    "moderngl",
    "numba",
    "PIL.Image",
    "pytest",
    "scipy.ndimage",
    "scipy.spatial.transform",
    "torch",
    "torch._dynamo",
    "trimesh",
]
"""What mutants need of other packages: nothing of this project, which each has a copy of, nor jaxtyping, whose plugin pytest
has to import itself."""
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(OTHERS)
"""Each mutant has a process of its own, forked from one that has imported `OTHERS`, which takes four seconds."""


def assert_up_to_date(mutant: Mutant) -> None:
    """Its text and its test are there."""
    found = (ROOT / mutant.file).read_text().count(mutant.remedy)
    assert found == 1, f"{mutant.file} holds the remedy {found} times: {mutant.remedy}"
    path, test = mutant.test.split("::")
    assert f"\ndef {test.partition('[')[0]}(" in (ROOT / path).read_text(), f"no such test: {mutant.test}"


def assert_dies(mutant: Mutant, folder: Path) -> None:
    """Its test fails on the copy in `folder`, by an assertion. That the test passes without it is what the suite itself shows."""
    failures, errors, passed = run(mutant, folder)
    assert errors == [], "the test could not run"
    assert failures, f"{mutant.test} passes ({passed}) without: {mutant.remedy}"
    strays = [text for text in failures if not text.startswith(("assert", "AssertionError"))]
    assert strays == [], "failed, but not by an assertion"


def run(mutant: Mutant, folder: Path) -> tuple[list[str], list[str], int]:
    """Messages of failures and of errors, and how many tests passed, in a process that imports the copy in `folder`."""
    copy(mutant, folder)
    report, output = folder / "report.xml", folder / "output.txt"
    process = PROCESSES.Process(target=_test, args=(mutant.test, folder, report, output))
    process.start()
    process.join()
    assert report.exists(), output.read_text()
    cases = list(ElementTree.parse(report).getroot().iter("testcase"))
    failures = [found.get("message", "") for case in cases for found in case.iter("failure")]
    errors = [found.get("message", "") for case in cases for found in case.iter("error")]
    return failures, errors, sum(len(case) == 0 for case in cases)


def _test(test: str, folder: Path, report: Path, output: Path) -> None:
    """The process's main function: one test on the copy in `folder`, which comes before the checkout."""
    with output.open("w") as file:
        for stream in (1, 2):
            os.dup2(file.fileno(), stream)
    absent = set(OTHERS) - set(sys.modules)
    assert not absent, f"not imported before the fork, which passes over what it does not find: {absent}"
    os.environ |= {"PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    sys.dont_write_bytecode = True
    sys.path[:] = [str(folder), *(place for place in sys.path if Path(place) != ROOT)]
    os.chdir(ROOT)
    import torch  # there already

    torch.set_num_threads(1)
    pytest.main(["-q", "-p", "no:cacheprovider", "-o", "addopts=", f"--junitxml={report}", test])


def copy(mutant: Mutant, folder: Path) -> None:
    """The packages under their names as links, but for the mutated file and the folders that lead to it."""
    for source, name in PACKAGES.items():
        link(ROOT / source, folder / name, Path(mutant.file))
    top, *rest = Path(mutant.file).parts
    target = folder.joinpath(PACKAGES[top], *rest)
    text = (ROOT / mutant.file).read_text()
    target.unlink()
    target.write_text(text.replace(mutant.remedy, mutant.without))


def link(source: Path, target: Path, changed: Path) -> None:
    """Link `source`, or make a folder of links where `changed` (from the checkout) lies below it, with copies of the compiled loops:
    numba takes those whose sources are the same (ops/native.py)."""
    if source not in (ROOT / changed).parents:
        target.symlink_to(source)
        return
    target.mkdir()
    for entry in source.iterdir():
        if entry.name != "__pycache__":
            link(entry, target / entry.name, changed)
    for compiled in (source / "__pycache__").glob("*.nb?"):
        (target / "__pycache__").mkdir(exist_ok=True)
        shutil.copy(compiled, target / "__pycache__")
