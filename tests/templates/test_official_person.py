"""A person of SMPL-X, MANO and Faceverse files: the default person's twin, in the published counts, through the one interface."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from avatarrex_studio.cli.main import main
from avatarrex_studio.cli.train import template
from capture.smplx_capture import in_smplx
from capture.tiny_capture import TinyCapture
from official import evaluate
from official_files import write_faceverse, write_smplx
from person_files import J0, LANDMARKS, person_faceverse, person_smplx, remeshed
from python2_pickles import write_python2
from scipy.spatial import cKDTree

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.library import named_pose
from avatarrex.templates.counterpart import counterpart
from avatarrex.templates.official.expression_matrix import FILE, read_matrix, write_matrix
from avatarrex.templates.official.faceverse import AXES
from avatarrex.templates.official.parts import COMMON, driven_body
from avatarrex.templates.official.smplx import SmplxFile
from avatarrex.templates.parts import PART_JOINT, PARTS
from avatarrex.templates.person import Person, _load, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit, SurfaceOffsets
from avatarrex.templates.posed import pose_person
from avatarrex.training.core.warm_start import load_prior


def world(person: Person, part: str, signals: Signals) -> np.ndarray:
    """A part's posed vertices in the root frame."""
    posed = pose_person(person, signals, Counters(), None)
    frame = posed.root_from_part(part)
    return posed.parts[part].double().numpy() @ frame[:3, :3].T + frame[:3, 3]


def test_hands_lie_on_the_body_in_every_pose(person: Person) -> None:
    """Where a hand is blended with the body they are the same surface, wrists bent or not."""
    signals = Signals.rest().replace(body_pose=named_pose("wave"), shape=np.linspace(-1, 1, 10))
    posed = pose_person(person, signals, Counters(), None)
    for name in ("left_hand", "right_hand"):
        template = person.part(name)
        ids = template.body_vertex_ids[:-1]
        assert torch.equal(ids, torch.from_numpy(remeshed()[2][name.removesuffix("_hand")]))
        assert float(template.blend_weight.min()) == 0
        assert float(template.blend_weight.max()) == 1
        away = np.linalg.norm(world(person, name, signals)[:-1] - posed.body.vertices[ids].double().numpy(), axis=1)
        assert away[template.blend_weight[:-1].numpy() > 0].max() < 0.004


def test_the_face_lies_on_the_head_and_smiles(person: Person) -> None:
    """As the default person's does, whose twin it is; landmarks of the files are a few millimetres off each other."""
    default = load_person()
    for expression in (None, "jawOpen", "mouthSmileLeft"):
        values = np.zeros(52)
        if expression:
            values[EXPRESSION_NAMES.index(expression)] = 1
        signals = Signals.rest().replace(expression=values, shape=np.linspace(-1, 1, 10))
        away = np.linalg.norm(world(person, "face", signals) - world(default, "face", signals), axis=1)
        assert away.max() < 0.006
    assert len(LANDMARKS) > 8
    inside = person.face.blend_weight.numpy()
    assert abs(inside.sum() / default.face.blend_weight.numpy().sum() - 1) < 0.1


def test_omega_is_painted_on_the_body(person: Person) -> None:
    assert person.blend_weight.shape == (10475, 3)
    assert ((person.blend_weight > 0).sum(1) <= 1).all()
    assert (person.blend_weight.amax(0) == 1).all()


def test_an_avatar_stands_on_it(person: Person) -> None:
    avatar = Avatar.create(person, "compact")
    assert int(avatar.body.node_vertex.max()) < 10475
    assert len(avatar.ownership) == 3


def test_what_is_missing_is_named_and_what_is_changed_is_another_person(
    folder: Path, person: Person, tmp_path: Path
) -> None:
    with pytest.raises(
        InputError, match=r"SMPLX_NEUTRAL\.npz: expected the file to be there \(https://smpl-x\.is\.tue\.mpg\.de"
    ):
        load_person(tmp_path)
    for file in ("SMPLX_NEUTRAL.npz", "MANO_LEFT.pkl", "MANO_RIGHT.pkl", "MANO_SMPLX_vertex_ids.pkl"):
        (tmp_path / file).symlink_to(folder / file)
    other = load_person(tmp_path)
    assert other.hash != person.hash
    assert (other.face.body_vertex_ids >= 0).all()  # cut out of the body
    assert other.left_hand.model.faces.shape == person.left_hand.model.faces.shape  # but the hands are MANO's
    (tmp_path / "faceverse_simple_v2.npy").symlink_to(folder / "faceverse_simple_v2.npy")
    assert load_person(tmp_path).hash == person.hash  # read anew, since a file has come


@pytest.mark.parametrize("change", ["hand ids", "landmarks of the body", "landmarks of the face", "triangles", "eyes"])
def test_whatever_moves_hands_or_face_is_in_the_hash(folder: Path, person: Person, tmp_path: Path, change: str) -> None:
    """Two files that would pose another surface are two persons."""
    for file in folder.glob("*.*"):
        (tmp_path / file.name).symlink_to(file)
    fields = person_faceverse()
    listed, triangles = (np.asarray(fields[key]) for key in ("keypoints", "tri"))
    others = {"landmarks of the face": ("keypoints", listed + (np.arange(68) == 48)),
              "triangles": ("tri", np.roll(triangles, 1, 0)), "eyes": ("ver_inds", [100, 200, 300])}  # fmt: skip
    if change == "hand ids":
        ids = {f"{side}_hand": rows.copy() for side, rows in remeshed()[2].items()}
        ids["left_hand"][:2] = ids["left_hand"][1::-1]
        (tmp_path / "MANO_SMPLX_vertex_ids.pkl").unlink()
        write_python2(tmp_path / "MANO_SMPLX_vertex_ids.pkl", ids)
    elif change == "landmarks of the body":
        (tmp_path / "SMPLX_NEUTRAL.npz").unlink()
        write_smplx(tmp_path / "SMPLX_NEUTRAL.npz", {**person_smplx(), "lmk_bary_coords": np.full((51, 3), 0.3334)})
    else:
        (tmp_path / "faceverse_simple_v2.npy").unlink()
        write_faceverse(tmp_path / "faceverse_simple_v2.npy", {**fields, others[change][0]: others[change][1]})
    assert load_person(tmp_path).hash != person.hash


@pytest.mark.parametrize(
    ("key", "count"), [("keypoints", 468), ("mediapipe_keypoints", 468), ("keypoints_mediapipe", 478)]
)
def test_mediapipes_list_is_told_by_its_length(
    folder: Path, person: Person, tmp_path: Path, key: str, count: int
) -> None:
    """With or without the irises, whatever it is called: the face lies where iBUG's 68 lay it."""
    fields = person_faceverse()
    own = np.asarray(fields.pop("keypoints"))
    listed = np.roll(np.resize(own, count), 5)
    for kinds in (COMMON, AXES):
        listed[list(kinds[True])] = own[list(kinds[False])]
    for file in folder.glob("*[A-Z]*"):
        (tmp_path / file.name).symlink_to(file)
    write_faceverse(tmp_path / "faceverse_v2.npy", {**fields, key: listed})
    assert float((load_person(tmp_path).face.v_template - person.face.v_template).abs().max()) < 1e-6


def test_of_many_shape_directions_ten_are_kept() -> None:
    """Without the memory of the others."""
    still = load_person().body
    many = replace(
        still, shapedirs=still.shapedirs.repeat(1, 1, 30), joint_shapedirs=still.joint_shapedirs.repeat(1, 1, 30)
    )
    body = driven_body(SmplxFile(many, True, np.zeros(0, int), np.zeros((0, 3)), False, ""))
    for values in (body.shapedirs, body.joint_shapedirs):
        assert values.shape[-1] == 10
        assert values.untyped_storage().nbytes() == 4 * values.numel()


def test_few_landmarks_of_the_face_are_not_said_of_the_body(folder: Path, tmp_path: Path) -> None:
    fields = {**person_faceverse(), "keypoints": np.asarray(person_faceverse()["keypoints"])[:40]}
    (tmp_path / "SMPLX_NEUTRAL.npz").symlink_to(folder / "SMPLX_NEUTRAL.npz")
    write_faceverse(tmp_path / "faceverse_v2.npy", fields)
    with pytest.raises(InputError, match="Faceverse: keypoints: expected 68, 468 or 478 landmarks, found 40"):
        load_person(tmp_path)


def test_its_pelvis_is_the_origin_and_the_files_is_known(person: Person) -> None:
    """Signals, floor and motions count from there, with every shape; a capture's `transl` counts from the file's."""
    shape = np.linspace(-2, 2, 10)
    posed = pose_person(person, Signals.rest().replace(shape=shape), Counters(), None)
    assert posed.body.joints[0].abs().max() < 1e-6
    np.testing.assert_allclose(person.pelvis(np.zeros(10)), J0, atol=1e-6)
    arrays = person_smplx()
    shaped = arrays["v_template"] + arrays["shapedirs"][..., :10] @ shape
    np.testing.assert_allclose(person.pelvis(shape), (arrays["J_regressor"] @ shaped)[0], atol=1e-5)


def test_another_size_takes_hands_and_face_along(person: Person) -> None:
    """Hands stay the body's surface; the face goes with the skin about it; a second fit is refused."""
    offsets = np.zeros((55, 3))
    offsets[[15, 22, 23, 24], 1] = 0.04  # a longer neck
    rows = tuple(range(0, 10000, 500))
    surface = SurfaceOffsets(rows, np.full((len(rows), 3), 0.01))
    fitted = resize_person(person, PersonFit(0.5 * np.eye(10)[0], offsets, surface))
    rest = Signals.rest()
    posed = pose_person(fitted, rest, Counters(), None)
    for name in ("left_hand", "right_hand"):
        ids = fitted.part(name).body_vertex_ids[:-1]
        away = np.abs(world(fitted, name, rest)[:-1] - posed.body.vertices[ids].double().numpy())
        assert away.max() < 1e-5
    before = pose_person(person, rest, Counters(), None).body.vertices.double().numpy()
    near = cKDTree(before).query(world(person, "face", rest))[1]
    moved = posed.body.vertices.double().numpy()[near] - before[near]
    np.testing.assert_allclose(world(fitted, "face", rest) - world(person, "face", rest), moved, atol=1e-5)
    assert moved[:, 1].min() > 0.03
    assert fitted.hash != person.hash
    assert fitted.shape_key == "betas"
    assert fitted.naked.face.v_template.shape == person.face.v_template.shape
    with pytest.raises(InputError, match="a person of the original size, found one that is resized"):
        resize_person(fitted, PersonFit(np.zeros(10), np.zeros((55, 3))))


def test_a_capture_of_smplx_says_its_size_and_place(folder: Path, person: Person, tmp_path: Path) -> None:
    """By its `betas`, to this person alone; the default one has to be fitted, and so has this one to the default's shape."""
    made = TinyCapture.make().folder(tmp_path / "own")
    said = open_capture(made)
    unsized = open_capture(made, template=str(folder))
    assert said.sized
    assert not unsized.sized
    assert not unsized.pelvis.any()
    capture = open_capture(in_smplx(made, person), template=str(folder))
    assert capture.sized
    one, other = said.rigs["body"].signals[1], capture.rigs["body"].signals[1]
    assert not other.shape.any()
    np.testing.assert_allclose(other.translation, one.translation, atol=1e-9)
    with np.load(made / "body" / "smpl_params.npz") as file:
        published = evaluate(person_smplx(), other.full_pose(), one.shape, np.zeros(10)) + file["transl"][1]
    away = template_surface(capture.person, other)[0] - published
    assert np.abs(away).max() < 1e-4
    default = open_capture(made)
    assert not default.sized
    assert any("betas belong to the SMPL-X model" in note for note in default.notes)


def test_what_is_drawn_of_the_body_follows_the_parts(person: Person) -> None:
    """Cut parts have the body's own vertices; on Faceverse's mesh these are found, and open the mouth as the default's do."""
    for one in (load_person(), person):
        for name in ("left_hand", "right_hand", "face"):
            part, joint = one.part(name), one.body.joint_template[PART_JOINT[name]]
            rows = torch.nonzero(one.blend_weight[:, PARTS.index(name)] > 0)[:, 0]
            places = counterpart(one, name).posed(part.model.v_template, rows)
            assert (places - (one.body.v_template[rows] - joint)).abs().max() < 1e-5
    jaw = Signals.rest().replace(expression=np.eye(52)[EXPRESSION_NAMES.index("jawOpen")])
    moved = []
    for one in (load_person(), person):
        rows = torch.nonzero(one.blend_weight[:, 2] > 0.5)[:, 0]
        posed = [pose_person(one, signals, Counters(), None).parts["face"] for signals in (Signals.rest(), jaw)]
        moved.append([counterpart(one, "face").posed(vertices.float(), rows).double() for vertices in posed])
    near = cKDTree(moved[0][0].numpy()).query(moved[1][0].numpy())
    close = near[0] < 0.004
    away = (moved[1][1] - moved[1][0]) - (moved[0][1] - moved[0][0])[near[1]]
    assert close.mean() > 0.5
    assert (moved[0][1] - moved[0][0]).norm(dim=1).max() > 0.02
    assert float(away[torch.from_numpy(close)].norm(dim=1).quantile(0.95)) < 0.004


def test_an_avatar_on_it_is_read_with_the_same_files_alone(
    monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    """Its size included; another folder is refused, and so is none, each in a line that says what is needed."""
    _load.cache_clear()
    monkeypatch.setenv("AVATARREX_MODELS", str(folder))
    fitted = resize_person(load_person("models"), PersonFit(0.5 * np.eye(10)[0], np.zeros((55, 3))))
    save_avatar(Avatar.create(fitted, "compact"), tmp_path / "a.avatar")
    found = load_avatar(tmp_path / "a.avatar").person
    assert (found.name, found.hash) == ("models", fitted.hash)
    assert torch.equal(found.face.v_template, fitted.face.v_template)
    others = tmp_path / "others"
    others.mkdir()
    for file in ("SMPLX_NEUTRAL.npz", "MANO_LEFT.pkl", "MANO_RIGHT.pkl", "MANO_SMPLX_vertex_ids.pkl"):
        (others / file).symlink_to(folder / file)
    for models, said in (
        (others, "person_hash: expected the template it was made on"),
        (tmp_path / "none", "SMPLX_NEUTRAL.npz: expected the"),
    ):
        monkeypatch.setenv("AVATARREX_MODELS", str(models))
        with pytest.raises(InputError, match=said):
            load_avatar(tmp_path / "a.avatar")


def test_the_person_of_a_training_is_the_starts() -> None:
    assert template(None, None) == "default"
    assert template("models", None) == "models"
    start = SimpleNamespace(person=SimpleNamespace(name="models"))
    assert template(None, start) == "models"
    with pytest.raises(
        InputError, match="--person: expected models, which the avatar to go on from has, found default"
    ):
        template("default", start)


def test_the_prior_is_carried_over(person: Person) -> None:
    """Nodes lie where they lay on the default person; geometry is known to a few millimetres before a step."""
    avatar, default = Avatar.create(person, "compact", 3), Avatar.create(load_person(), "compact", 3)
    anchors = avatar.body.anchor_vertex.clone()
    assert all(load_prior(one, part) for one in (avatar, default) for part in ("body", "face", "face_colour"))
    assert (avatar.body.node_rest - default.body.node_rest).norm(dim=1).max() < 0.03
    assert torch.equal(avatar.body.anchor_vertex, anchors)
    posed = pose_person(person, Signals.rest(), Counters(), None)
    with torch.no_grad():
        frame = avatar.body.frame(posed.body, avatar.body.code(posed.body_rotation))
        depth = avatar.body.sdf(frame, posed.body.vertices[::7].float())
    assert float(depth.abs().median()) < 0.004


def test_unnamed_coefficients_follow_a_table(folder: Path, person: Person, tmp_path: Path) -> None:
    """Of another basis without names: refused in a line that says how to write one, which then moves the face as the names do."""
    fields = dict(person_faceverse())
    mix = np.random.default_rng(1).normal(size=(52, 74)) / 7
    fields |= {"exBase": np.asarray(fields["exBase"]) @ mix, "exp_name_list": []}
    models = tmp_path / "models"
    models.mkdir()
    for file in folder.glob("*.*"):
        (models / file.name).symlink_to(file)
    (models / "faceverse_simple_v2.npy").unlink()
    write_faceverse(models / "faceverse_v1.npy", fields)
    with pytest.raises(
        InputError, match=r"or faceverse_expressions\.csv \(`avatarrex-studio models matrix` writes one"
    ):
        load_person(str(models))
    assert main(["models", "matrix", "--folder", str(models)]) == 0
    made = load_person(models)
    away = made.face.model.expression_dirs - person.face.model.expression_dirs
    assert away.norm(dim=1).max() < 0.003
    assert person.face.model.expression_dirs.norm(dim=1).max() > 0.02
    assert main(["models", "matrix", "--folder", str(models)]) == 2  # one that was edited stays
    table = models / FILE
    read = read_matrix(table, 74)
    write_matrix(table, np.roll(read, 1, 1))
    other = load_person(models.rename(tmp_path / "edited"))
    assert other.hash != made.hash


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace("jawOpen", "jawopen"), "line 1: expected the 52 names, each once, found jawopen"),
        (lambda text: text.replace("jawOpen", "jawLeft"), "line 1: expected the 52 names, each once, found 51 names"),
        (
            lambda text: text + ",".join(["0"] * 52) + "\n",
            "expected 3 lines of numbers, one a coefficient of the face, found 4",
        ),
        (lambda text: text.replace("\n1,", "\nx,"), "line 2: expected numbers, found could not convert"),
        (lambda text: text.replace("\n1,", "\nnan,"), "line 2: expected finite numbers up to 10000, found nan"),
        (lambda text: text.replace("\n1,", "\n"), "line 2: expected 52 numbers, found 51"),
        (lambda text: text + "9" * 140_000 + "\n", "m.csv: expected a readable CSV file, found field larger than"),
        (lambda text: "", "line 1: expected the 52 names, each once, found 0 names"),
    ],
)
def test_a_table_that_is_wrong_is_told_by_its_line(change, said: str, tmp_path: Path) -> None:
    write_matrix(tmp_path / "m.csv", np.eye(52)[:3])
    np.testing.assert_array_equal(read_matrix(tmp_path / "m.csv"), np.eye(52)[:3])
    (tmp_path / "m.csv").write_text(change((tmp_path / "m.csv").read_text()))
    with pytest.raises(InputError, match=re.escape(said)):
        read_matrix(tmp_path / "m.csv", 3)
