"""Whom a run that is gone on with trains."""

from __future__ import annotations

import logging
from pathlib import Path

from avatarrex.avatar_file import load_avatar
from avatarrex.errors import InputError
from avatarrex.templates.person import Person
from avatarrex.training.runs.checkpoint import AVATAR_FILE, found

log = logging.getLogger(__name__)


def begun_person(run: Path) -> Person | None:
    """Whom a run has trained until now, by its newest checkpoint whose avatar can be read: what another version, or another machine,
    would fit is somebody else."""
    for entry in reversed(found(run / "checkpoints")):
        try:
            return load_avatar(entry.path / AVATAR_FILE).person
        except InputError as error:
            log.info("%s", error)
    return None
