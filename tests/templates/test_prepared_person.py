"""`capture prepare` on a user's own models: the first fit, its pictures and what goes on from it rest on the files' person."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli import capture_prepare
from avatarrex_studio.cli.main import main
from capture import filmed
from capture.clothed import Clothed
from capture.test_initial_fit import Moving, fit, off, ring
from official_files import write_smplx
from person_files import person_smplx

from avatarrex.capture.fit.check import posed_in_world
from avatarrex.capture.fit.landmarks import landmarks, landmarks_of
from avatarrex.capture.fit.verdict import Verdict
from avatarrex.capture.importers import preparing
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.person import Person, load_person

NECK = 0.04
"""Metres by which the files' person has a longer neck than the default one: no limb is measured there."""
HEAD = JOINT_NAMES.index("head")
SHEET = np.zeros((4, 4, 3), np.uint8)


@pytest.fixture(scope="module")
def others(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of somebody whose head, jaw and eyes are higher."""
    arrays = person_smplx()
    above = [JOINT_NAMES.index(name) for name in ("head", "jaw", "left_eye", "right_eye")]
    lifted = NECK * arrays["weights"][:, above].sum(1, keepdims=True) * [0, 1, 0]
    made = tmp_path_factory.mktemp("longer")
    for file in folder.glob("MANO*"):
        (made / file.name).symlink_to(file)
    write_smplx(made / "SMPLX_NEUTRAL.npz", {**arrays, "v_template": arrays["v_template"] + lifted})
    return made


@pytest.fixture(scope="module")
def longer(others: Path) -> Person:
    return load_person(others)


def test_the_first_fit_is_of_the_files_person(longer: Person) -> None:
    """Joints as near as the default person's own are; on the default person the head would be 19 mm off."""
    places = filmed.exact_landmarks(Moving(frames=2).motion, longer)
    found = fit(places, ring(places, 6), person=longer)
    joints = found.poses.posed(found.bones)[1]
    assert np.linalg.norm(joints[:, HEAD] - places[:, HEAD], axis=1).max() < 0.01
    assert off(found, places) < 0.006
    assert found.height == pytest.approx(1.78 + NECK, abs=0.03)


def test_landmarks_are_found_on_any_mesh(longer: Person) -> None:
    """Its own vertices, about where the default person has them: what is remeshed is 1 cm off at most, noses are higher."""
    default, found = landmarks_of(load_person()), landmarks_of(longer)
    assert found.names == default.names == landmarks().names
    np.testing.assert_array_equal(found.joints, default.joints)
    assert (found.vertices[55:] != default.vertices[55:]).any()
    assert np.linalg.norm(found.offsets - default.offsets, axis=1).max() < 0.015
    rest = longer.body.v_template.double().numpy()[found.vertices[55:]]
    carriers = longer.body.joint_template.double().numpy()[found.joints[55:]]
    np.testing.assert_allclose(rest, carriers + found.offsets[55:], atol=1e-6)


def test_a_film_is_prepared_on_the_files_and_on_no_others(
    folder: Path,
    others: Path,
    longer: Person,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Its steps, its verdict and the capture are the files' person's; another one is refused before any work, or fitted with --redo."""
    monkeypatch.setenv("AVATARREX_MODELS", str(others))
    drawn: list[str] = []
    judged: list[str] = []
    trained: list[str] = []
    good = (None, None, Verdict(()))
    monkeypatch.setattr(preparing, "contact_sheet", lambda capture, *_: drawn.append(capture.person.name) or SHEET)
    monkeypatch.setattr(capture_prepare, "judge", lambda capture: judged.append(capture.person.name) or good)
    monkeypatch.setattr(capture_prepare, "main", lambda words: trained.extend(words) or 0)
    one = Clothed(cameras=4, frames=2, size=(96, 128))
    source, out = filmed.film(one, tmp_path / "film", person=longer), tmp_path / "out"
    words = ["capture", "prepare", str(source), str(out), "--no-refine"]
    mine = [*words, "--person", "models"]
    assert main([*mine, "--train", "quick"]) == 0
    assert f"on the files of --person models ({longer.hash})" in capsys.readouterr().out
    assert trained == [
        "train",
        str(out / "capture"),
        "--recipe",
        "quick",
        "--person",
        "models",
        "--out",
        str(out / "run"),
    ]
    away = joints_of(out / "capture") - filmed.exact_landmarks(one.motion, longer)[:, :55]
    assert np.linalg.norm(away, axis=2).mean() < 0.008
    assert np.linalg.norm(away[:, HEAD], axis=1).max() < 0.012
    state = (out / "prepare.json").read_text()
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"--person: expected models, which {out / 'prepare.json'} was begun with (or --redo fit, " in line
    assert line.endswith("found default")
    assert (out / "prepare.json").read_text() == state
    for again, done in ((mine, 6), (mine, 4), ([*words, "--redo", "fit"], 4)):
        assert main(again) == 0
        assert capsys.readouterr().out.count("(done before)") == done
        monkeypatch.setenv("AVATARREX_MODELS", str(folder))  # whose files are others
    assert json.loads((out / "prepare.json").read_text())["fit"]["person"] == "default"
    assert drawn == ["models", "models", "default"]
    assert judged == ["models", "models", "models", "default"]


def joints_of(path: Path) -> np.ndarray:
    """(t, 55, 3) world metres, of a capture on the models folder."""
    capture, found = open_capture(path, template="models"), []
    for signals in capture.rigs["body"].signals:
        posed, world = posed_in_world(capture.person, signals)
        found.append(posed.joint_transforms[:, :3, 3].double().numpy() @ world[:3, :3].T + world[:3, 3])
    return np.array(found)
