"""A capture of SMPL-X files before the person of those files: its size without its signals, what is odd about its shape, its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from avatarrex_studio.cli.main import main
from avatarrex_studio.cli.train import _with_body
from capture.smplx_capture import in_smplx
from capture.test_refine import errors, tracked
from capture.tiny_capture import TinyCapture
from scipy.spatial.transform import Rotation

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.capture.fit import refine as schedule
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.fit.person_fit import height
from avatarrex.capture.fit.refining import Refining
from avatarrex.capture.importers.axes import TURNS, turned
from avatarrex.capture.importers.import_capture import in_our_world, rest_pelvis
from avatarrex.capture.importers.source import Reading, Source, SourceView
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.rigs import SMPLX_PELVIS, open_capture
from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person, _load, load_person
from avatarrex.templates.posed import pose_person

SHAPE = TinyCapture.make(()).signals[0].shape
STANDING = {"global_orient": np.zeros(3), "body_pose": np.zeros((21, 3))}


@pytest.fixture
def made(person: Person, tmp_path: Path) -> Path:
    return in_smplx(TinyCapture.make().folder(tmp_path / "c"), person)


def changed(path: Path, **others: np.ndarray) -> None:
    """With other arrays in it."""
    with np.load(path) as file:
        arrays = {**file, **others}
    np.savez(path, **arrays)


def test_its_size_stays_without_the_captures_signals(
    monkeypatch: pytest.MonkeyPatch, folder: Path, person: Person, made: Path, tmp_path: Path
) -> None:
    """At rest, in the avatar's file, and on an avatar to go on from, whose size counts once."""
    _load.cache_clear()
    monkeypatch.setenv("AVATARREX_MODELS", str(folder))
    capture = open_capture(made, template="models")
    wanted = pose_person(person, Signals.rest().replace(shape=SHAPE), Counters(), None)
    found = pose_person(capture.person, Signals.rest(), Counters(), None)
    assert float((found.body.vertices - wanted.body.vertices).abs().max()) < 1e-5
    assert height(capture.person) > height(person) + 0.1
    save_avatar(Avatar.create(capture.person, "compact"), tmp_path / "a.avatar")
    start = load_avatar(tmp_path / "a.avatar")
    assert start.person.fit is not None
    np.testing.assert_allclose(start.person.fit.shape, SHAPE)
    assert start.person.hash == capture.person.hash
    for one in (capture, _with_body(capture, start, "a.avatar")):
        vertices = template_surface(one.person, one.rigs["body"].signals[0].replace(**STANDING))[0]
        assert abs(np.ptp(vertices[:, 1]) - height(capture.person)) < 0.001


def test_shapes_that_are_odd_are_said(folder: Path, made: Path) -> None:
    """Coefficients beyond the tenth, another sex, another body before the other rig."""
    body = made / "body" / "smpl_params.npz"
    betas = SHAPE[None]

    def notes(**others: np.ndarray) -> str:
        changed(body, **others)
        return " | ".join(open_capture(made, template=str(folder)).notes)

    assert "betas" not in notes()
    assert "betas" not in notes(betas=np.pad(betas, ((0, 0), (0, 6))), gender=np.array("neutral"))
    longer = np.pad(betas, ((0, 0), (0, 6)), constant_values=0.1)
    assert "body: betas: 6 beyond the tenth are left out" in notes(betas=longer)
    said = notes(betas=betas, gender=np.array(b"FEMALE"))
    assert "body: betas are the female model's, but the person is the neutral one: another size" in said
    changed(made / "face" / "smpl_params.npz", betas=betas + 0.2)
    assert "face: betas of another body than the body rig's, which are taken for both" in notes()


def test_betas_of_nobody_are_refused_by_file_and_key(folder: Path, made: Path) -> None:
    for betas, said in (
        (40 * np.eye(10)[:1], r"body/smpl_params\.npz: betas: expected numbers up to ±10, found 40"),
        (2.5 * SHAPE[None], r"body/smpl_params\.npz: expected a person 1\.2 to 2\.2 m tall"),
    ):
        changed(made / "body" / "smpl_params.npz", betas=betas)
        with pytest.raises(InputError, match=said):
            open_capture(made, template=str(folder))
        open_capture(made)  # whose size they are not


def test_a_male_model_alone_is_not_the_neutral_one(folder: Path, made: Path, tmp_path: Path) -> None:
    """Most captures do not say what they are of: neutral, as AvatarReX'."""
    males = tmp_path / "males"
    males.mkdir()
    for file in folder.glob("MANO*"):
        (males / file.name).symlink_to(file)
    (males / "SMPLX_MALE.npz").symlink_to(folder / "SMPLX_NEUTRAL.npz")
    said = (
        "body: betas are the neutral model's, as the file says no other, but the person is the male one: another size"
    )
    assert said in open_capture(made, template=str(males)).notes
    changed(made / "body" / "smpl_params.npz", gender=np.array("male"))
    assert not any("betas" in note for note in open_capture(made, template=str(males)).notes)


@pytest.mark.parametrize("axis", ["-Y", "+Z"])
def test_an_import_that_turned_the_world_keeps_the_place(folder: Path, person: Person, made: Path, axis: str) -> None:
    """It turns about neutral SMPL-X's pelvis; whoever has another one is still where the file has it."""
    file = made / "body" / "smpl_params.npz"
    with np.load(file) as arrays:
        values = dict(arrays)
    over, own = TURNS[axis].inv(), person.pelvis(SHAPE)
    assert np.abs(rest_pelvis(values) - own).max() > 0.02
    pelvis = values["transl"] + own
    orient = (over * Rotation.from_rotvec(values["global_orient"])).as_rotvec()
    lying = {**values, "global_orient": orient, "transl": over.apply(pelvis) - own}
    lenses = [Lens(view.name, view.camera, np.zeros(5)) for view in open_capture(made).rigs["body"].views]
    views = tuple(SourceView(turned(lens, over), {}, {}) for lens in lenses)
    source = Source("AvatarReX", "body", views, len(pelvis), lying)
    np.savez(file, **in_our_world(source, Reading(Archive(made), "", load_person())).parameters)
    again = open_capture(made, template=str(folder)).rigs["body"].signals
    np.testing.assert_allclose([one.translation for one in again], pelvis, atol=1e-6)


@pytest.mark.parametrize("sized", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_its_tracking_is_refined(
    sized: bool, folder: Path, person: Person, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the files' person, whose shape stays in its `betas` and moves its pelvis; one whose size was fitted has joints."""
    monkeypatch.setattr(schedule, "SHAPE_ROUNDS", schedule.SHAPE_ROUNDS[:1])
    monkeypatch.setattr(schedule, "POSE_ROUNDS", schedule.POSE_ROUNDS[:3])
    _load.cache_clear()
    monkeypatch.setenv("AVATARREX_MODELS", str(folder))
    source, out = in_smplx(tracked(np.random.default_rng(0)).folder(tmp_path / "noisy"), person), tmp_path / "fine"
    with np.load(source / "body" / "smpl_params.npz") as file:
        arrays = dict(file)
    shape = arrays["betas"][0]
    if sized:  # as from a world that was turned
        turn = Rotation.from_rotvec([0, 0, 1.0])
        from_rest = person.pelvis(shape) - SMPLX_PELVIS
        arrays |= {"world_turn": turn.as_rotvec(), "transl": arrays["transl"] + from_rest - turn.apply(from_rest)}
    else:
        arrays |= {"shape10": arrays.pop("betas")[0], "transl": arrays["transl"] + person.pelvis(shape)}
    np.savez(source / "body" / "smpl_params.npz", **arrays)
    words = ["capture", "refine", str(source), str(out), "--person", "models", "--no-colours"]
    assert main(words) == 0
    before, after = (open_capture(path, template="models") for path in (source, out))
    assert after.person.name == "models"
    assert Refining(before, tmp_path / "other").key.endswith(f" models {person.hash}")  # to go on with no other files
    assert after.manifest["refined"]["person"] == "models"
    with np.load(out / "body" / "smpl_params.npz") as file:
        assert set(file) & {"betas", "shape10", "tpose_joints"} == {"betas" if sized else "tpose_joints"}
    if sized:
        assert before.person.fit is not None
        assert after.person.fit is not None
        assert np.abs(after.person.fit.shape - before.person.fit.shape).max() > 0.01
        assert not after.person.fit.joint_offsets.any()
        first, last = (capture.rigs["body"].signals[2] for capture in (before, after))
        np.testing.assert_allclose(last.translation, first.translation, atol=1e-9)
    assert (errors(after)[:2] < 0.5 * errors(before)[:2]).all()
