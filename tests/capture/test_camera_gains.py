"""Cameras of different exposure: gains that are found, that `capture match-exposure` writes, and that the reader multiplies pictures by."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from avatarrex_studio.cli import capture_exposure
from avatarrex_studio.cli.main import main
from PIL import Image
from training.miniature import write_miniature

from avatarrex.capture.fit.camera_gains import FEWEST, camera_gains, gains_of, largest
from avatarrex.capture.fit.matched_capture import gains_of_all
from avatarrex.capture.fit.verdict import judge
from avatarrex.capture.importers.import_capture import calibration
from avatarrex.capture.readers.calibration import read_calibration
from avatarrex.capture.readers.rigs import Rig, open_capture
from avatarrex.templates.person import Person

GAINS = np.array([[0.8, 0.9, 1.0], [1.1, 1.0, 0.8], [0.7, 0.7, 0.7], [1.2, 1.2, 1.0], [0.6, 0.7, 0.8]])
"""Of the five cameras, the last of which is held out."""


def shares(gains: np.ndarray) -> np.ndarray:
    """With a geometric mean of 1."""
    return np.asarray(gains / np.exp(np.log(gains).mean(0)))


def as_taken(colours: np.ndarray) -> np.ndarray:
    """Gains that nobody has applied yet."""
    return np.ones((len(colours), 3))


def seen_by(gains: np.ndarray, rng: np.random.Generator, count: int = 2000) -> np.ndarray:
    """Colours of triangles, each in half of the cameras, as bytes that these multiply."""
    colours = rng.uniform(60, 150, (count, 3)) * gains[:, None]
    colours[rng.random(colours.shape[:2]) < 0.5] = np.nan
    return colours


def test_gains_undo_what_cameras_multiply_by(rng: np.random.Generator) -> None:
    colours = seen_by(GAINS, rng)
    np.testing.assert_allclose(gains_of(colours, as_taken(colours)), 1 / shares(GAINS), rtol=1e-6)
    colours[0, :400] *= rng.uniform(1.5, 3.0, (400, 1))  # gloss in a fifth of one camera's triangles
    np.testing.assert_allclose(gains_of(colours, as_taken(colours)), 1 / shares(GAINS), rtol=0.02)


def test_dark_and_cut_off_colours_say_nothing(rng: np.random.Generator) -> None:
    colours = seen_by(GAINS, rng)
    colours[1, :800] = 3.0
    colours[2, 800:1600] = 255.0
    np.testing.assert_allclose(gains_of(colours, as_taken(colours)), 1 / shares(GAINS), rtol=1e-6)


def test_a_camera_with_little_in_common_keeps_its_exposure(rng: np.random.Generator) -> None:
    colours = np.concatenate([seen_by(GAINS, rng), seen_by(GAINS[:1], rng)])
    colours[5, FEWEST - 1 :] = np.nan
    colours[5] *= 1.5
    found = gains_of(colours, as_taken(colours))
    assert np.isnan(found[5]).all()
    np.testing.assert_allclose(found[:5], 1 / shares(GAINS), rtol=1e-6)


def test_cameras_that_share_nothing_with_the_others_are_even_among_themselves(rng: np.random.Generator) -> None:
    colours = np.full((5, 4000, 3), np.nan)
    colours[:2, :2000], colours[2:, 2000:] = seen_by(GAINS[:2], rng), seen_by(GAINS[2:], rng)
    found = gains_of(colours, as_taken(colours))
    np.testing.assert_allclose(found[:2], 1 / shares(GAINS[:2]), rtol=1e-6)
    np.testing.assert_allclose(found[2:], 1 / shares(GAINS[2:]), rtol=1e-6)


def test_groups_that_one_triangle_joins_are_not_compared() -> None:
    """It may be a triangle that is drawn beside its place, and would decide alone."""
    colours = np.full((4, 2000, 3), np.nan)
    colours[:2, :1000] = 100.0
    colours[2:, 1000:] = 100.0
    colours[2, 0] = 40.0
    np.testing.assert_allclose(gains_of(colours, as_taken(colours)), 1)


def test_limits_are_of_bytes_as_they_were_taken(rng: np.random.Generator) -> None:
    """A gain makes neither black bright nor white grey."""
    colours, before = seen_by(GAINS, rng), np.ones((5, 3))
    before[1], before[2] = 1.8, 0.5
    colours[1, :800], colours[2, 800:1600] = 1.8 * 20, 0.5 * 255
    np.testing.assert_allclose(gains_of(colours, before), 1 / shares(GAINS), rtol=1e-6)


def test_one_camera_or_none_cannot_be_compared() -> None:
    assert np.isnan(gains_of(np.full((1, 500, 3), 90.0), np.ones((1, 3)))).all()
    assert gains_of(np.full((0, 500, 3), 90.0), np.ones((0, 3))).shape == (0, 3)


@pytest.fixture(scope="module")
def uneven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The miniature, whose calibration multiplies pictures by `GAINS`."""
    folder = write_miniature(tmp_path_factory.mktemp("uneven"), "body")
    name = folder / "body" / "calibration_full.json"
    calibration = json.loads(name.read_text())
    for entry, gain in zip(calibration.values(), GAINS):
        entry["gain"] = gain.tolist()
    name.write_text(json.dumps(calibration))
    return folder


def test_the_reader_multiplies_pictures_and_leaves_mattes(
    uneven: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    plain = open_capture(write_miniature(tmp_path_factory.mktemp("even"), "body")).rigs["body"]
    rig = open_capture(uneven).rigs["body"]
    for view, gain in enumerate(GAINS):
        wanted = np.clip(plain.image(view, 0) * gain, 0, 255)
        assert np.abs(rig.image(view, 0) - wanted).max() <= 0.5
        np.testing.assert_array_equal(rig.matte(view, 0), plain.matte(view, 0))


def test_a_matched_capture_has_one_exposure_the_held_out_camera_too(
    uneven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = open_capture(uneven)
    assert before.rigs["body"].held_out_views == {4}
    verdict = judge(before)[2]
    assert any("`capture match-exposure`" in reason.what for reason in verdict.reasons), verdict
    assert main(["capture", "match-exposure", str(uneven), str(tmp_path / "even")]) == 0
    said = capsys.readouterr().out
    assert "c45" in said
    assert "left after it" in said
    after = open_capture(tmp_path / "even")
    assert after.key != before.key
    assert after.manifest["matched"] == before.key
    assert {**after.manifest, "matched": 0} == {**before.manifest, "matched": 0}
    entries = json.loads((tmp_path / "even" / "body" / "calibration_full.json").read_text()).values()
    left = np.array([entry["gain"] for entry in entries])
    np.testing.assert_allclose(left, left[:1].repeat(5, 0), rtol=0.03)
    assert largest(gains_of_all(after.rigs["body"], after.person)) < 0.02
    assert not any("exposure" in reason.what for reason in judge(after)[2].reasons)
    assert after.rigs["body"].held_out_frames == {3}


def test_held_out_pictures_change_nothing_of_what_a_training_sees(uneven: Path, tmp_path: Path) -> None:
    """Neither those of the held-out camera nor those of the held-out frame change the gains of the training's cameras."""
    other = changed(uneven, tmp_path / "other", lambda entry: None)
    for picture in (*(other / "body" / "c45").glob("*.jpg"), *(other / "body").glob("c*/00000003.jpg")):
        noise = np.random.default_rng(0).normal(0, 40, (128, 96, 1))
        Image.fromarray(np.uint8(np.clip(0.6 * np.asarray(Image.open(picture)) + noise, 0, 255))).save(picture)
    one, two = (open_capture(path) for path in (uneven, other))
    found = [gains_of_all(capture.rigs["body"], capture.person) for capture in (one, two)]
    np.testing.assert_array_equal(found[0][:4], found[1][:4])
    assert np.abs(np.log(found[0][4] / found[1][4])).min() > 0.04, "its own"


def test_a_person_whose_size_was_fitted_stands_where_the_fit_has_it(
    uneven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the matched capture is looked at again."""
    unsized = changed(uneven, tmp_path / "unsized", lambda entry: None)
    name = unsized / "body" / "smpl_params.npz"
    with np.load(name) as arrays:
        kept = {key: arrays[key] for key in arrays if key != "shape10"}
    np.savez(name, **kept)
    monkeypatch.setattr(capture_exposure, "fit_size", lambda given: replace(given.moved(-given.pelvis), sized=True))
    assert not open_capture(unsized).sized
    assert np.abs(open_capture(unsized).pelvis).max() > 0.1
    seen: list[np.ndarray] = []

    def watched(rig: Rig, person: Person) -> np.ndarray:
        seen.append(rig.signals[0].translation)
        return gains_of_all(rig, person)

    monkeypatch.setattr(capture_exposure, "gains_of_all", watched)
    assert main(["capture", "match-exposure", str(unsized), str(tmp_path / "even")]) == 0
    assert "left after it" in capsys.readouterr().out
    np.testing.assert_allclose(seen, [open_capture(uneven).rigs["body"].signals[0].translation], atol=1e-9)


def test_gains_are_of_the_trainings_cameras_alone(uneven: Path) -> None:
    capture = open_capture(uneven)
    found = camera_gains(capture.rigs["body"], capture.person)
    assert np.isnan(found[4]).all()
    np.testing.assert_allclose(found[:4], 1 / shares(GAINS[:4]), rtol=0.03)


def changed(folder: Path, out: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """A copy whose calibration's entries are changed."""
    shutil.copytree(folder, out)
    name = out / "body" / "calibration_full.json"
    calibration = json.loads(name.read_text())
    for entry in calibration.values():
        change(entry)
    name.write_text(json.dumps(calibration))
    return out


def test_clipped_pictures_are_found_before_their_gain(uneven: Path, tmp_path: Path) -> None:
    """White pictures say nothing, also where a gain made them grey."""
    factors = iter((0.9, 0.8, 0.7, 0.6, 0.5))
    white = changed(uneven, tmp_path / "white", lambda entry: entry.update(gain=[next(factors)] * 3))
    for picture in (white / "body").glob("c*/*.jpg"):
        Image.new("RGB", (96, 128), "white").save(picture)
    capture = open_capture(white)
    assert np.isnan(camera_gains(capture.rigs["body"], capture.person)).all()


def test_without_anything_to_compare_nothing_is_written(
    uneven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    black = changed(uneven, tmp_path / "black", lambda entry: None)
    for picture in (black / "body").glob("c*/*.jpg"):
        Image.new("RGB", (96, 128)).save(picture)
    assert main(["capture", "match-exposure", str(black), str(tmp_path / "out")]) == 2
    assert "expected two cameras or more whose colours can be compared, found none" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["black"]


def test_gains_that_no_reader_takes_are_not_written(
    uneven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dim = changed(uneven, tmp_path / "dim", lambda entry: entry.update(gain=[0.126] * 3))
    for picture in (path for path in (dim / "body").glob("c*/*.jpg") if path.parent.name != "c0"):
        Image.fromarray(np.uint8(0.6 * np.asarray(Image.open(picture)))).save(picture, quality=95)
    assert main(["capture", "match-exposure", str(dim), str(tmp_path / "out")]) == 2
    assert "c0.gain: expected [r, g, b], factors from 0.125 to 8" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["dim"]


def test_what_cannot_be_written_again_is_named(
    uneven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    odd = changed(uneven, tmp_path / "odd", lambda entry: entry.update(rectifyAlpha=float("nan")))
    assert main(["capture", "match-exposure", str(odd), str(tmp_path / "out")]) == 2
    assert "odd/body/calibration_full.json: expected finite numbers" in capsys.readouterr().err


def test_a_folder_inside_the_capture_is_refused(uneven: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["capture", "match-exposure", str(uneven), str(uneven / "out")]) == 2
    assert "expected a folder outside the capture, found one inside it" in capsys.readouterr().err
    assert not (uneven / "out").exists()


def test_an_import_keeps_gains(uneven: Path) -> None:
    text = (uneven / "body" / "calibration_full.json").read_text()
    written = calibration(read_calibration(text, "calibration"))
    assert [entry["gain"] for entry in written.values()] == GAINS.tolist()


def test_what_lies_in_the_way_is_refused(uneven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert main(["capture", "match-exposure", str(uneven), str(tmp_path)]) == 2
    assert "expected a name that is free, or an empty folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["file"], "nothing half made is left"


def test_how_far_the_farthest_gain_is_from_one() -> None:
    assert largest(np.array([[1.0, 1.1, 0.8]])) == pytest.approx(0.25)
    assert largest(np.ones((3, 3))) == 0
    assert largest(np.full((3, 3), np.nan)) == 0
