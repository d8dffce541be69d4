"""Motions that come with the program, by name: written by tools/make_motions.py, at rest where they begin so that they loop."""

from __future__ import annotations

from pathlib import Path

from avatarrex.files.assets import DATA

MOTIONS = {
    "idle": "stands and breathes, shifts its weight, blinks",
    "wave": "raises the right hand, waves and smiles",
    "walk": "walks in place",
}
"""Names, and what the person does."""


def resolved(path: str | Path) -> Path:
    """The file of one of `MOTIONS`, or `path` itself."""
    return DATA / "motions" / f"{path}.npz" if str(path) in MOTIONS else Path(path)
