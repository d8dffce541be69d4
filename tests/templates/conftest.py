"""The person on generated SMPL-X, MANO and Faceverse files."""

from __future__ import annotations

from pathlib import Path

import pytest
from person_files import write_person

from avatarrex.templates.person import Person, load_person


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_person(tmp_path_factory.mktemp("person") / "models")


@pytest.fixture(scope="module")
def person(folder: Path) -> Person:
    return load_person(folder)
