"""The table of measured errors: one entry per level, figures or nothing."""

from __future__ import annotations

import json

import pytest

from avatarrex.errors import InputError
from avatarrex.levels import LEVELS
from avatarrex.reference.level_errors import LevelError, level_errors


def test_every_level_has_its_entry():
    assert set(level_errors()) == set(LEVELS)


def test_figures_are_read(tmp_path):
    path = tmp_path / "errors.json"
    path.write_text(json.dumps({"fast": {"depth_mean_mm": 0.5, "depth_p99_mm": 3}, "paper": None}))
    assert level_errors(path) == {"fast": LevelError(0.5, 3), "paper": None}


@pytest.mark.parametrize(
    "entry",
    [7, {}, {"depth_mean_mm": -1, "depth_p99_mm": 3}, {"depth_mean_mm": "0.1", "depth_p99_mm": 3}],
)
def test_a_wrong_entry_is_refused(entry, tmp_path):
    path = tmp_path / "errors.json"
    path.write_text(json.dumps({"fast": entry}))
    with pytest.raises(InputError, match=r"errors\.json"):
        level_errors(path)
