"""Published models: each layout is read as it was written, poses as its formulas say, and its faults are repaired.

The files are generated (`official_files.py`); the second opinion is `official.evaluate`, float64, from the formulas alone.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from official import evaluate, random_pose
from official_files import (
    HEAD_IDS,
    LEFT_IDS,
    RIGHT_IDS,
    VERSIONS,
    faceverse,
    flame,
    hand_joints,
    mano,
    smplx,
    write_chumpy,
    write_faceverse,
    write_smplx,
)  # fmt: skip
from python2_pickles import write_python2

from avatarrex.errors import InputError
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.templates.model import TemplateModel, pose_template
from avatarrex.templates.official.correspondence import (
    check_ids,
    hand_ids,
    head_ids,
    read_hand_ids,
    read_head_ids,
)
from avatarrex.templates.official.faceverse import read_faceverse
from avatarrex.templates.official.flame import read_flame
from avatarrex.templates.official.mano import read_hand, read_hands
from avatarrex.templates.official.smplx import read_smplx

MICROMETRE = 1e-6
RNG = np.random.default_rng(1)


def posed(model: TemplateModel, pose: np.ndarray, shape: np.ndarray, expression: np.ndarray) -> np.ndarray:
    return pose_template(
        model.double(), *(torch.from_numpy(value) for value in (pose, shape, expression))
    ).vertices.numpy()


def off(model: TemplateModel, arrays: dict[str, np.ndarray], n_shape: int, expressions: int) -> float:
    """The largest distance between the model's vertices and the formulas', metres, over random poses and coefficients."""
    worst = 0.0
    for _ in range(2):
        pose = random_pose(RNG, len(model.parents))
        shape, expression = RNG.normal(size=n_shape), RNG.normal(size=expressions)
        wanted = evaluate({**arrays, "n_shape": np.array(n_shape)}, pose, shape, expression)
        found = posed(model, pose, shape, expression)[: len(wanted)]
        worst = max(worst, float(np.linalg.norm(found - wanted, axis=1).max()))
    return worst


@pytest.mark.parametrize(("name", "directions"), [("a.npz", 400), ("a.pkl", 20)])
def test_smplx_is_what_its_formulas_say(tmp_path: Path, name: str, directions: int) -> None:
    arrays = smplx(directions)
    found = read_smplx(write_smplx(tmp_path / name, arrays))
    shapes = {400: 300, 20: 10}[directions]
    assert found.version == f"{shapes} + {directions - shapes}"
    assert found.model.joint_names == JOINT_NAMES
    assert off(found.model, arrays, shapes, directions - shapes) < MICROMETRE
    assert found.hand_components
    np.testing.assert_array_equal(found.landmark_faces, arrays["lmk_faces_idx"])
    assert not found.locked_head


def test_npz_and_pkl_are_the_same_model(tmp_path: Path) -> None:
    both = [read_smplx(write_smplx(tmp_path / name, smplx())) for name in ("a.npz", "a.pkl")]
    assert both[0].hash == both[1].hash
    assert torch.equal(both[0].model.shapedirs, both[1].model.shapedirs)


def test_a_locked_head_is_noticed(tmp_path: Path) -> None:
    arrays = dict(smplx())
    arrays["weights"] = arrays["weights"].copy()
    arrays["weights"][HEAD_IDS] = np.eye(55)[15]
    arrays["shapedirs"] = arrays["shapedirs"].copy()
    assert not read_smplx(write_smplx(tmp_path / "free.npz", arrays)).locked_head
    arrays["shapedirs"][HEAD_IDS, :, :10] = arrays["shapedirs"][HEAD_IDS[0], :, :10]
    assert read_smplx(write_smplx(tmp_path / "locked.npz", arrays)).locked_head


def test_a_model_without_pose_directions_is_read(tmp_path: Path) -> None:
    arrays = {key: value for key, value in smplx().items() if key != "posedirs"}
    found = read_smplx(write_smplx(tmp_path / "a.npz", arrays))
    assert found.model.posedirs is None
    assert off(found.model, arrays, 10, 10) < MICROMETRE


@pytest.mark.parametrize("protocol", [0, 2])
def test_mano_is_what_its_formulas_say(tmp_path: Path, protocol: int) -> None:
    arrays = mano("right")
    hand = read_hand(write_chumpy(tmp_path / "r.pkl", arrays, protocol), "right")
    assert off(hand.model, arrays, 10, 0) < MICROMETRE
    np.testing.assert_allclose(
        hand.model.joint_template - hand.model.joint_template[0], hand_joints("right"), atol=1e-6
    )


def test_the_wrist_is_closed(tmp_path: Path) -> None:
    """Every edge once in each direction; outwards, by the volume; the middle stays in the middle of the rim, however the hand bends."""
    hand = read_hand(write_chumpy(tmp_path / "r.pkl", mano("right")), "right").model
    faces = hand.faces.numpy()
    edges = list(map(tuple, faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()))
    assert len(hand.v_template) == 779
    assert len(set(edges)) == len(edges) == 3 * (1538 + 16)
    assert {edge[::-1] for edge in edges} == set(edges)
    bent = posed(hand, np.zeros((16, 3)), np.full(10, 2.0), np.zeros(0))
    np.testing.assert_allclose(bent[778], bent[:16].mean(0), atol=1e-7)


def test_the_left_hands_shape_is_mirrored_where_it_is_the_rights(tmp_path: Path) -> None:
    """Both files have the same directions: a larger left hand is the mirror image of a larger right one, joints and all."""
    paths = [write_chumpy(tmp_path / f"{side}.pkl", mano(side)) for side in ("left", "right")]
    hands = read_hands(*paths)
    assert (hands["left"].repaired, hands["right"].repaired) == (True, False)
    nearly = {**mano("left"), "shapedirs": mano("left")["shapedirs"] + RNG.normal(size=(778, 3, 10)) * 1e-4}
    assert read_hands(write_chumpy(tmp_path / "nearly.pkl", nearly), paths[1])["left"].repaired
    mirror = np.array([-1, 1, 1])
    shape = RNG.normal(size=10)
    left, right = (
        posed(hands[side].model, np.zeros((16, 3)), shape, np.zeros(0)) - posed(hands[side].model, np.zeros((16, 3)), 0 * shape, np.zeros(0))
        for side in ("left", "right")
    )  # fmt: skip
    assert np.abs(right).max() > 1e-3
    np.testing.assert_allclose(left[:778] * mirror, right[:778], atol=1e-7)
    moved = [hands[side].model.joint_shapedirs.double().numpy() @ shape for side in ("left", "right")]
    np.testing.assert_allclose(moved[0] * mirror, moved[1], atol=1e-7)


def test_a_left_hand_that_is_right_stays(tmp_path: Path) -> None:
    own = dict(mano("left"))
    own["shapedirs"] = own["shapedirs"] * np.array([-1, 1, 1])[:, None]
    hands = read_hands(write_chumpy(tmp_path / "l.pkl", own), write_chumpy(tmp_path / "r.pkl", mano("right")))
    assert not hands["left"].repaired
    assert off(hands["left"].model, own, 10, 0) < MICROMETRE


def test_the_hands_are_not_exchanged(tmp_path: Path) -> None:
    path = write_chumpy(tmp_path / "l.pkl", mano("left"))
    with pytest.raises(
        InputError,
        match=r"l\.pkl: v_template: expected a right hand, with fingers towards -x, found fingers towards \+x",
    ):
        read_hand(path, "right")


def test_flame_is_what_its_formulas_say(tmp_path: Path) -> None:
    """2020's file with chumpy, 2023's without."""
    arrays = flame()
    for path in (
        write_chumpy(tmp_path / "generic_model.pkl", arrays),
        write_python2(tmp_path / "flame2023.pkl", arrays),
    ):
        model = read_flame(path)
        assert off(model, arrays, 300, 100) < MICROMETRE
        assert model.joint_names == ("root", "neck", "jaw", "left_eye", "right_eye")


CONVENTIONS = {1: (0.1, (1, 1, 1)), 2: (0.1, (1, -1, -1)), 3: (0.001, (1, 1, 1)), 4: (0.001, (-1, -1, 1))}
"""Metres of the unit and signs of the axes, one for each version; the loader goes by none of them."""


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("other", [False, True])
def test_faceverse_in_whatever_unit_and_axes(tmp_path: Path, version: int, other: bool) -> None:
    metres, signs = CONVENTIONS[version] if not other else (0.01, (-1, 1, -1))
    fields, truth = faceverse(version, metres, signs)
    found = read_faceverse(write_faceverse(tmp_path / "face.npy", fields))
    assert found.version == version
    assert (found.unit, found.turned) == ({0.1: "decimetres", 0.001: "millimetres", 0.01: "centimetres"}[metres], signs)
    model = found.model
    np.testing.assert_allclose(model.v_template, truth["mean"], atol=1e-6)
    np.testing.assert_array_equal(np.sort(model.faces, 1), np.sort(truth["faces"], 1))
    a, b, c = model.v_template[model.faces].double().unbind(1)
    assert float((torch.linalg.cross(b - a, c - a) * ((a + b + c) / 3 - model.v_template.double().mean(0))).sum()) > 0
    shape, expression = RNG.normal(size=truth["shape"].shape[2]), RNG.normal(size=truth["expression"].shape[2])
    named = np.argsort(np.argsort(EXPRESSION_NAMES)) if version == 2 else np.arange(len(expression))
    wanted = truth["mean"] + truth["shape"] @ shape + truth["expression"] @ expression
    given = np.empty_like(expression)
    given[:] = expression[named] if version == 2 else expression
    moved = posed(model, np.zeros((4, 3)), shape, given)
    np.testing.assert_allclose(moved, wanted, atol=MICROMETRE)


def test_faceverses_52_are_put_in_our_order(tmp_path: Path) -> None:
    """By name, of either spelling; the file's order is another."""
    fields, truth = faceverse(2, 0.1, (1, -1, -1))
    fields["exp_name_list"] = [name.replace("Left", "_L").replace("Right", "_R") if name.endswith(("Left", "Right")) else name.upper()
                             for name in sorted(EXPRESSION_NAMES)]  # fmt: skip
    model = read_faceverse(write_faceverse(tmp_path / "face.npy", fields)).model
    assert model.expression_names == EXPRESSION_NAMES
    jaw = sorted(EXPRESSION_NAMES).index("jawOpen")
    np.testing.assert_allclose(
        model.expression_dirs[..., EXPRESSION_NAMES.index("jawOpen")], truth["expression"][..., jaw], atol=1e-7
    )


@pytest.mark.parametrize("inside", [False, True])
def test_version_threes_52_lie_in_the_dict_or_beside_it(tmp_path: Path, inside: bool) -> None:
    fields, truth = faceverse(3, 0.001, (1, 1, 1))
    fewer = np.asarray(fields["exBase"])[:, :52]
    if inside:
        fields["exBase_52"] = fewer
    else:
        np.save(tmp_path / "exBase_52.npy", fewer)
    fields["exp_name_list"] = list(EXPRESSION_NAMES)
    model = read_faceverse(write_faceverse(tmp_path / "face.npy", fields)).model
    assert model.expression_names == EXPRESSION_NAMES
    np.testing.assert_allclose(model.expression_dirs, truth["expression"][..., :52], atol=1e-6)
    assert read_faceverse(write_faceverse(tmp_path / "fewer.npy", {**fields, "exBase": fewer})).version == 3


def test_eyes_turn_about_their_middle_and_follow_the_shape(tmp_path: Path) -> None:
    """The person's left is the left, in whatever order a version has them."""
    for version in (3, 4):
        fields, truth = faceverse(version, 0.001, (1, 1, 1))
        model = read_faceverse(write_faceverse(tmp_path / f"{version}.npy", fields)).model
        rows = model.groups["left_eye"].numpy()
        assert len(rows) == 30
        assert truth["mean"][rows, 0].mean() > 0.02
        shape = RNG.normal(size=truth["shape"].shape[2])
        pose = np.zeros((4, 3))
        pose[2] = (0, np.pi, 0)
        still, turned = (posed(model, value, shape, np.zeros(0))[rows] for value in (0 * pose, pose))
        np.testing.assert_allclose(
            (still + turned)[:, [0, 2]] / 2, np.broadcast_to(still.mean(0)[[0, 2]], (30, 2)), atol=1e-6
        )


def test_a_face_of_no_unit_or_mirrored_is_refused(tmp_path: Path) -> None:
    for change, said in (((3.0, (1, 1, 1)), "a face 9 to 21 cm wide"), ((0.1, (-1, 1, 1)), "a mirrored face")):
        fields, _ = faceverse(2, *change)
        with pytest.raises(InputError, match=said):
            read_faceverse(write_faceverse(tmp_path / "face.npy", fields))


WRONG_FACES: dict[str, tuple[dict[str, object], str]] = {
    "names of a number": ({"exp_name_list": 5}, "exp_name_list: expected a list of names, found int"),
    "ragged landmarks": ({"keypoints": [[1], [2, 3]] * 40}, "keypoints: expected a list of whole numbers, found list"),
    "landmarks of words": ({"keypoints": np.array(["a"] * 68)}, "keypoints: expected a list of whole numbers, found <U1"),
    "endless landmarks": ({"keypoints": np.full(68, np.inf)}, "keypoints: expected a list of whole numbers, found float64"),
    "ragged ends": ({"ver_inds": [[1], [2, 3]]}, "ver_inds: expected a list of whole numbers, found list"),
    "unsigned ends that fall": ({"ver_inds": np.array([9, 6, 8], np.uint32)}, "ver_inds: expected ends of skin and eyes"),
    "far vertices": ({"meanshape": np.full((6335, 3), 1e300)}, r"meanshape: expected numbers up to 1e\+07, found 1e\+300"),
    "far directions": ({"exBase": np.full((3 * 6335, 52), 1e300)}, r"exBase: expected numbers up to 1e\+07, found 1e\+300"),
    "far triangles": ({"tri": np.full((4, 3), 1e300)}, r"tri: expected numbers up to 1e\+07"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_FACES)
def test_a_wrong_face_is_refused_by_key(tmp_path: Path, name: str) -> None:
    change, said = WRONG_FACES[name]
    fields = {**faceverse(2, 0.1, (1, -1, -1))[0], **change}
    with pytest.raises(InputError, match=said):
        read_faceverse(write_faceverse(tmp_path / "face.npy", fields))


def test_a_name_that_is_no_text_is_none_of_the_52(tmp_path: Path) -> None:
    """A number of five thousand digits cannot even be written as one."""
    fields = {**faceverse(2, 0.1, (1, -1, -1))[0], "exp_name_list": [16**5000] * 52}
    assert read_faceverse(write_faceverse(tmp_path / "face.npy", fields)).model.expression_names == ()


BROKEN = {
    "another count": (lambda a: {**a, "v_template": a["v_template"][:-1]}, r"v_template: expected shape \(10475, 3\), found \(10474, 3\)"),
    "no weights": (lambda a: {k: v for k, v in a.items() if k != "weights"}, "weights: expected the key to be there"),
    "NaN": (lambda a: {**a, "shapedirs": a["shapedirs"] * np.float32(np.nan)}, "shapedirs: expected finite numbers"),
    "a face beyond": (lambda a: {**a, "f": a["f"] + 10475}, "f: expected vertex indices below 10475"),
    "30 directions": (lambda a: {**a, "shapedirs": np.zeros((10475, 3, 30))}, "n_shape: expected 0 to 30"),
    "a landmark beyond": (lambda a: {**a, "lmk_faces_idx": a["lmk_faces_idx"] + 20908}, "lmk_faces_idx: expected triangles from 0 to 20907"),
    "a landmark before": (lambda a: {**a, "lmk_faces_idx": a["lmk_faces_idx"] - 20908}, "lmk_faces_idx: expected triangles from 0 to 20907"),
    "a landmark far away": (lambda a: {**a, "lmk_bary_coords": a["lmk_bary_coords"] + 1e300}, "lmk_bary_coords: expected numbers up to"),
    "text": (lambda a: {**a, "weights": "none"}, "weights: expected an array, found str"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_wrong_file_is_refused_by_key(tmp_path: Path, name: str) -> None:
    change, said = BROKEN[name]
    with pytest.raises(InputError, match=said):
        read_smplx(write_smplx(tmp_path / "a.pkl", change(smplx())))


def test_a_regressor_that_claims_gigabytes_is_refused(tmp_path: Path) -> None:
    import scipy.sparse

    arrays = {**mano("right"), "J_regressor": scipy.sparse.csc_matrix((10**9, 778))}
    with pytest.raises(InputError, match=r"J_regressor: expected shape \(16, 778\), found \(1000000000, 778\)"):
        read_hand(write_python2(tmp_path / "r.pkl", arrays), "right")


@pytest.fixture(scope="module")
def body(tmp_path_factory: pytest.TempPathFactory) -> TemplateModel:
    return read_smplx(write_smplx(tmp_path_factory.mktemp("body") / "a.npz", smplx())).model


def test_published_correspondences_are_read_and_checked(tmp_path: Path, body: TemplateModel) -> None:
    path = write_python2(tmp_path / "MANO_SMPLX_vertex_ids.pkl", {"left_hand": LEFT_IDS, "right_hand": RIGHT_IDS})
    ids = read_hand_ids(path)
    left, right = (
        read_hand(write_chumpy(tmp_path / f"{side}.pkl", mano(side)), side).model for side in ("left", "right")
    )
    check_ids(ids["left"], left, body, path)
    check_ids(ids["right"], right, body, path)
    with pytest.raises(
        InputError,
        match=r"MANO_SMPLX_vertex_ids\.pkl: expected vertices by which 99% of the triangles are the body's, found 0\.0%",
    ):
        check_ids(ids["left"], right, body, path)
    np.save(tmp_path / "head.npy", HEAD_IDS)
    check_ids(
        read_head_ids(tmp_path / "head.npy"), read_flame(write_chumpy(tmp_path / "f.pkl", flame())), body, "head.npy"
    )
    np.save(tmp_path / "twice.npy", np.zeros(5023, int))
    with pytest.raises(InputError, match="different vertices from 0 to 10474"):
        read_head_ids(tmp_path / "twice.npy")


def test_correspondences_are_found_without_the_files(tmp_path: Path, body: TemplateModel) -> None:
    """On meshes that differ by some millimetres and lie elsewhere: all vertices of both hands and the head."""
    for side, wanted in (("left", LEFT_IDS), ("right", RIGHT_IDS)):
        hand = read_hand(write_chumpy(tmp_path / f"{side}.pkl", mano(side)), side).model
        found = hand_ids(hand, body, side)
        np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(head_ids(read_flame(write_chumpy(tmp_path / "f.pkl", flame())), body), HEAD_IDS)


def test_other_triangles_are_not_forced_upon_the_body(tmp_path: Path, body: TemplateModel) -> None:
    arrays = {**mano("right"), "f": np.random.default_rng(2).permutation(778)[mano("right")["f"].astype(int)]}
    hand = read_hand(write_chumpy(tmp_path / "r.pkl", arrays), "right").model
    with pytest.raises(
        InputError, match=r"MANO_SMPLX_vertex_ids\.pkl: expected this file, since the meshes do not tell"
    ):
        hand_ids(hand, body, "right")
