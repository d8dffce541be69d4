"""Every option is either used, with a line that says so, or warned about: never dropped in silence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dialects import DIALECTS, steps, write, write_asf
from test_readers import write_csv

from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import ImportedMotion
from avatarrex.signals.own_motions import MOTIONS
from avatarrex.signals.read import import_motion, write_json
from avatarrex.signals.sequence import SignalSequence

CHOSEN = {
    "up": "+Z", "forward": "+X", "unit": "cm", "fps": 24.0, "joints": (("head", ""),), "rest": "pose", "floor": "each", "lock_feet": True,
    "side": "left", "hand_mean": "flat", "expressions": "map.csv",
}  # fmt: skip
"""Every option of `ImportOptions`."""


def bvh(folder: Path) -> Path:
    write(folder / "m.bvh", DIALECTS["mixamo"], steps())
    return folder / "m.bvh"


def smpl(folder: Path, **more: np.ndarray) -> Path:
    np.savez(folder / "m.npz", **{"poses": np.zeros((3, 165)), **more})
    return folder / "m.npz"


def csv(folder: Path) -> Path:
    write_csv(folder / "m.csv")
    return folder / "m.csv"


def json(folder: Path) -> Path:
    write_json(folder / "m.json", SignalSequence(tuple(steps()[:3]), 30.0))
    return folder / "m.json"


OTHERS = {"side", "hand_mean", "expressions"}
"""Of hands and faces of other makers."""
FILES: dict[str, tuple[Callable[[Path], str | Path], set[str]]] = {
    # what makes it, what of the options it cannot use
    "bvh": (bvh, OTHERS),
    "amc": (lambda folder: write_asf(folder, "07", steps()), OTHERS),
    "smpl": (lambda folder: smpl(folder, trans=np.zeros((3, 3))), {"joints", "rest", "side", "expressions"}),
    "smpl without hands": (lambda folder: smpl(folder, poses=np.zeros((3, 72))), {"unit", "joints", "rest", *OTHERS}),
    "smpl without a path": (smpl, {"unit", "joints", "rest", "side", "expressions"}),
    "csv": (csv, set(CHOSEN) - {"fps"}),
    "json": (json, set(CHOSEN) - {"fps"}),
    **{name: (lambda folder, name=name: name, set(CHOSEN) - {"fps", "unit", "hand_mean"}) for name in MOTIONS},
}


def unused(read: ImportedMotion) -> set[str]:
    """Options that the one warning of them names."""
    lines = [text for text in read.warnings if text.startswith("not used")]
    assert len(lines) <= 1
    return set(lines[0].split(": ")[1].split(", ")) if lines else set()


@pytest.mark.parametrize("name", FILES)
def test_an_option_is_used_or_warned_about(tmp_path: Path, name: str) -> None:
    make, expected = FILES[name]
    path = make(tmp_path)
    read = import_motion(path, ImportOptions(**CHOSEN))
    assert unused(read) == expected
    assert any(note.startswith("warning: not used") for note in read.sequence.notes) is bool(expected)
    said = {guess.option for guess in read.guesses if "chosen" in guess.why}
    assert said | {"joints"} == (CHOSEN.keys() - expected) | {"joints"}
    assert not unused(import_motion(path))


@pytest.mark.parametrize(("name", "option"), [(name, option) for name in FILES for option in sorted(FILES[name][1])])
def test_what_is_warned_about_changes_nothing(tmp_path: Path, name: str, option: str) -> None:
    path = FILES[name][0](tmp_path)
    assert list(import_motion(path, ImportOptions(**{option: CHOSEN[option]})).sequence) == list(
        import_motion(path).sequence
    )
