"""A training that is gone on with trains the person that it began with, whatever would be fitted by now."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli import train
from capture.tiny_capture import TinyCapture

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.readers.splits import with_validation
from avatarrex.templates.face_offsets import FaceOffsets
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit
from avatarrex.training.runs.begun import begun_person
from avatarrex.training.runs.folder import Run


def somebody(height: float) -> Person:
    """With a nose that stands out so far, metres."""
    face = load_person().face
    nose = int(face.body_vertex_ids[face.v_template[:, 2].argmax()])
    own = FaceOffsets((nose,), np.array([[0, 0, height]]), np.zeros((0, 0)), np.zeros((1, 3, 0)))
    return resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3)), face=own))


def test_the_newest_readable_avatar_says_who_is_trained(tmp_path: Path) -> None:
    with Run.create(tmp_path / "run", {}) as run:
        assert begun_person(run.path) is None
        saved = [run.save(step, {}, Avatar.create(somebody(0.01 * step), "compact")) for step in (1, 2)]
        found = begun_person(run.path)
        assert found is not None
        assert found.hash == somebody(0.02).hash
        (saved[-1] / "avatar.avatar").write_bytes(b"cut off")
        found = begun_person(run.path)
        assert found is not None
        assert found.hash == somebody(0.01).hash


def test_it_is_not_fitted_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = with_validation(open_capture(TinyCapture.make(person=somebody(0.01)).zip(tmp_path / "a.zip")))
    with Run.create(tmp_path / "run", {}) as run:
        run.save(1, {}, Avatar.create(somebody(0.02), "compact"))
    monkeypatch.setattr("avatarrex.capture.fit.capture_fit.fit_geometry", lambda _: somebody(0.03))
    words = {"out": str(tmp_path / "run"), "force": True, "capture": "a.zip", "start": None}
    assert train._fitted(capture, None, Namespace(**words, resume=True)).person.hash == somebody(0.02).hash
    assert train._fitted(capture, None, Namespace(**words, resume=False)).person.hash == somebody(0.03).hash
