"""Reading a person: the packaged file, its hash, and every way a file can be wrong."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from official import random_official

from avatarrex.errors import InputError
from avatarrex.files.arrays import read_arrays
from avatarrex.files.assets import DATA, SPECS, check_arrays, read_npz, read_spec
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.templates.model_arrays import hash_arrays, read_model
from avatarrex.templates.person import load_person


def test_the_packaged_person_speaks_the_signals_language() -> None:
    person = load_person()
    assert person.body.joint_names == JOINT_NAMES
    assert person.body.expression_names == EXPRESSION_NAMES
    assert person.body.shapedirs.shape[2] == 10
    assert load_person("default") is person
    assert load_person(str(DATA / "person.npz")).hash == person.hash


def test_a_user_without_a_folder_has_the_packaged_person(monkeypatch: pytest.MonkeyPatch) -> None:
    """The models folder, which is in the user's, is looked for by the person called so alone."""

    def none() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", none)
    for name in ("HOME", "XDG_DATA_HOME", "AVATARREX_MODELS"):
        monkeypatch.delenv(name, raising=False)
    assert load_person().name == "default"
    with pytest.raises(InputError, match=r"HOME: expected the user's folder \(or XDG_DATA_HOME\), found none"):
        load_person("models")


def test_the_blend_weights_are_the_submeshes() -> None:
    """One painting: what a part's mesh says of a body vertex, the body's table says too; parts do not overlap."""
    person = load_person()
    assert person.blend_weight.shape == (len(person.body.v_template), 3)
    for column, part in enumerate((person.left_hand, person.right_hand, person.face)):
        on_body = part.body_vertex_ids >= 0
        assert torch.equal(person.blend_weight[part.body_vertex_ids[on_body], column], part.blend_weight[on_body])
        outside = torch.ones(len(person.blend_weight), dtype=torch.bool)
        outside[part.body_vertex_ids[on_body]] = False
        assert (person.blend_weight[outside, column] == 0).all()
    assert ((person.blend_weight > 0).sum(1) <= 1).all()


def test_the_hash_sees_every_array_that_poses() -> None:
    arrays = random_official(0)
    first = hash_arrays(arrays)
    for key in arrays:
        changed = {**arrays, key: arrays[key].copy()}
        changed[key].flat[1] += 1
        assert hash_arrays(changed) != first, key
    assert hash_arrays({key: np.array(arrays[key]) for key in reversed(arrays)}) == first
    assert hash_arrays({**arrays, "vt": np.zeros((3, 2))}) == first, "texture coordinates pose nothing"


def test_every_spec_is_readable() -> None:
    for path in SPECS.glob("*.json"):
        assert isinstance(json.loads(path.read_text(encoding="utf-8")), dict)
    for rule in read_spec("person")["arrays"].values():
        assert rule["kind"] in ("float", "integer", "text")
        assert rule["what"]


@pytest.fixture
def official(tmp_path: Path) -> tuple[Path, dict[str, np.ndarray]]:
    return tmp_path / "SMPLX_NEUTRAL.npz", random_official(1)


def refuse(path: Path, field: str, found: str = "") -> None:
    with pytest.raises(InputError) as caught:
        read_model(read_npz(path, "person"), path)
    message = str(caught.value)
    assert caught.value.field == field, message
    assert message.startswith(str(path))
    assert "\n" not in message
    assert found in message


def test_object_arrays_that_nobody_needs_are_not_touched(official) -> None:
    path, arrays = official
    np.savez(path, **arrays, joint2num=np.array({"Pelvis": 0}, dtype=object))
    assert len(read_model(read_npz(path, "person"), path).parents) == 55


def test_a_missing_or_unreadable_file(tmp_path: Path, official) -> None:
    path, arrays = official
    refuse(path, "", "nothing there")
    refuse(tmp_path, "")
    for content in (b"", b"not a zip file at all", b"PK\x03\x04" + bytes(40)):
        path.write_bytes(content)
        refuse(path, "")
    path.write_bytes(pickle.dumps({"v_template": [1.0]}))
    refuse(path, "")
    with path.open("wb") as file:
        np.save(file, arrays["v_template"])
    refuse(path, "")


@pytest.mark.parametrize("compressed", [False, True])
def test_a_truncated_or_damaged_file(official, compressed: bool) -> None:
    path, arrays = official
    (np.savez_compressed if compressed else np.savez)(path, **arrays)
    whole = path.read_bytes()
    for kept in (0.05, 0.5, 0.9, 0.999):
        path.write_bytes(whole[: int(kept * len(whole))])
        refuse(path, "")
    for scribble in (b"\x00", b"\x55", b"\xff"):  # over the first array: a wrong sum, or no deflate stream at all
        path.write_bytes(whole[:200] + scribble * 900 + whole[1100:])
        refuse(path, "v_template")


def test_a_pickled_array(official) -> None:
    path, arrays = official
    np.savez(path, **{**arrays, "weights": np.array(["surprise", None], dtype=object)})
    refuse(path, "weights", "(no pickled objects), found shape (2,) of object")


@pytest.mark.parametrize("key", ["v_template", "f", "shapedirs", "weights", "kintree_table"])
def test_a_missing_key(official, key: str) -> None:
    path, arrays = official
    del arrays[key]
    np.savez(path, **arrays)
    refuse(path, key, "only ")


def test_no_joints_at_all(official) -> None:
    path, arrays = official
    del arrays["J_regressor"]
    np.savez(path, **arrays)
    refuse(path, "J_template")


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("v_template", np.zeros((90, 2)), "(90, 2)"),
        ("v_template", np.zeros((90, 3), dtype=np.int64), "int64"),
        ("v_template", np.full((90, 3), np.nan), "270 NaN or Inf"),
        ("shapedirs", np.zeros((89, 3, 20)), "(89, 3, 20)"),
        ("shapedirs", np.full((90, 3, 20), np.inf), "NaN or Inf"),
        ("f", np.zeros((4, 3)), "float64"),
        ("f", np.full((4, 3), 90), "90"),
        ("f", np.zeros((0, 3), dtype=np.int64), "none"),
        ("weights", np.zeros((90, 55)), "sums 0 to 0"),
        ("weights", np.zeros((90, 54)), "kintree_table"),
        ("kintree_table", np.zeros((2, 55), dtype=np.int64), "[0, 0, 0"),
        ("J_regressor", np.zeros((55, 89)), "(55, 89)"),
        ("posedirs", np.zeros((90, 3, 485)), "485"),
        ("pose_columns", np.arange(3), "(3,)"),
        ("n_shape", np.array(21), "21"),
    ],
)
def test_a_wrong_array(official, key: str, value: np.ndarray, found: str) -> None:
    path, arrays = official
    np.savez(path, **{**arrays, key: value})
    with pytest.raises(InputError) as caught:
        read_model(read_npz(path, "person"), path)
    assert found in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_tree_with_a_loop(official) -> None:
    path, arrays = official
    arrays["kintree_table"][0, 3] = 6
    np.savez(path, **arrays)
    with pytest.raises(InputError, match="parents"):
        read_model(read_npz(path, "person"), path)


def test_unnamed_direction_counts_are_requested(official) -> None:
    path, arrays = official
    arrays["shapedirs"] = arrays["shapedirs"][..., :13]
    np.savez(path, **arrays)
    refuse(path, "n_shape")


def test_a_person_needs_hands_and_a_head(official) -> None:
    """A soup of random triangles reads as a model, but no hand can be cut from it: one line, no crash."""
    path, arrays = official
    np.savez(path, **arrays)
    with pytest.raises(InputError, match="hand"):
        load_person(path)


def test_letters_bind_within_a_file() -> None:
    spec = {"arrays": {"a": {"shape": ["n", 2], "kind": "float"}, "b": {"shape": ["n"], "kind": "integer"}}}
    check_arrays({"a": np.zeros((3, 2)), "b": np.zeros(3, int)}, "x", spec)
    with pytest.raises(InputError, match="b: expected shape \\(3,\\), found \\(4,\\)"):
        check_arrays({"a": np.zeros((3, 2)), "b": np.zeros(4, int)}, "x", spec)


def test_read_arrays_reads_what_is_requested(official) -> None:
    path, arrays = official
    np.savez(path, **arrays)
    assert set(read_arrays(path)) == set(arrays)
    assert set(read_arrays(path, ["f", "nonsense"])) == {"f"}


def test_vertices_of_named_groups() -> None:
    body, face = load_person().body, load_person().face
    chosen = body.of_groups(("left_eye", "no_such_group", "tongue"))
    wanted = {vertex for name in ("left_eye", "tongue") for vertex in body.groups[name].tolist()}
    assert set(torch.nonzero(chosen)[:, 0].tolist()) == wanted
    teeth = {vertex for name in ("upper_teeth", "lower_teeth") for vertex in face.model.groups[name].tolist()}
    assert set(torch.nonzero(face.teeth)[:, 0].tolist()) == teeth
