"""A person's own face: offsets of nodes move the skin about them, at rest and with expressions, and are part of the fit."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.errors import InputError
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.templates.face import pose_face
from avatarrex.templates.face_offsets import FADE, FaceOffsets, mesh_edges, node_weights
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

SMILE = EXPRESSION_NAMES.index("mouthSmileLeft")
UP, WIDE = np.array([0, 0.004, 0]), np.array([0.01, 0, 0])


def lips() -> tuple[int, int]:
    """The vertices in the middle of the upper and of the lower lip: neighbours in space, far from each other along the mesh."""
    body = load_person().body
    jaw = body.expression_dirs[:, 1, EXPRESSION_NAMES.index("jawOpen")].double().numpy()
    rest = body.v_template.double().numpy()
    mouth = rest[body.groups["upper_teeth"].numpy()].mean(0) + np.array([0, 0, 0.012])
    near = np.argsort(np.linalg.norm(rest - mouth, axis=1))[:400]
    near = near[np.abs(rest[near, 0]) < 0.004]
    moves, stays = near[jaw[near] < -0.01], near[np.abs(jaw[near]) < 0.002]
    apart = np.linalg.norm(rest[moves][:, None] - rest[stays][None], axis=-1)
    lower, upper = np.unravel_index(apart.argmin(), apart.shape)
    return int(stays[upper]), int(moves[lower])


def smiling(person: Person, smile: float) -> np.ndarray:
    expression = torch.zeros(52)
    expression[SMILE] = smile
    face = pose_face(person.face, expression, torch.zeros(3), torch.zeros(2, 3), torch.zeros(0))
    found = np.full((len(person.body.v_template), 3), np.nan)
    found[person.face.body_vertex_ids.numpy()] = face.double().numpy()
    return found


@pytest.fixture(scope="module")
def nose() -> int:
    face = load_person().face
    return int(face.body_vertex_ids[face.v_template[:, 2].argmax()])


def of(node: int, moves: np.ndarray = WIDE) -> PersonFit:
    face = FaceOffsets((node,), UP[None], np.eye(52)[[SMILE]], moves[None, :, None])
    return PersonFit(np.zeros(10), np.zeros((55, 3)), face=face)


def test_a_node_moves_what_is_about_it(nose: int) -> None:
    plain, own = load_person(), resize_person(load_person(), of(nose))
    moved = (own.body.v_template - plain.body.v_template).double().numpy()
    np.testing.assert_allclose(moved[nose], UP, atol=1e-6)
    rest = plain.body.v_template.double().numpy()
    far = np.linalg.norm(rest - rest[nose], axis=1) > FADE[1]
    assert far.sum() > 10_000
    assert not moved[far].any()
    assert torch.equal(own.body.joint_template, plain.body.joint_template)


def test_expressions_move_it_further(nose: int) -> None:
    plain, own = load_person(), resize_person(load_person(), of(nose))
    step = smiling(own, 0.5) - smiling(plain, 0.5)
    np.testing.assert_allclose(step[nose], UP + 0.5 * WIDE, atol=1e-6)
    other = torch.ones(52)
    other[SMILE] = 0
    directions = own.body.expression_dirs - plain.body.expression_dirs
    torch.testing.assert_close(directions @ other, torch.zeros(len(directions), 3), atol=1e-6, rtol=0)


def test_what_moves_one_lip_leaves_the_other() -> None:
    upper, lower = lips()
    rest = load_person().body.v_template
    assert (rest[upper] - rest[lower]).norm() < 0.006
    weights = node_weights(load_person().body, (upper, lower)).toarray()
    assert weights[upper, 0] > 0.9
    assert weights[lower, 1] > 0.9
    assert max(weights[upper, 1], weights[lower, 0]) < 0.1


def test_nodes_close_together_move_little_beside_themselves() -> None:
    body = load_person().body
    edges = mesh_edges(body).tocoo()
    pair = int(np.abs(edges.data - 0.005).argmin())
    one, two = int(edges.row[pair]), int(edges.col[pair])
    weights = node_weights(body, (one, two)).toarray()
    assert weights[one, 0] == pytest.approx(weights[two, 1], rel=1e-6)
    assert 0.7 < weights[one, 0] < 0.8


@pytest.mark.parametrize("name", ["left_eye", "right_eye", "upper_teeth", "lower_teeth", "tongue"])
def test_eyeballs_teeth_and_tongue_move_as_a_whole(name: str) -> None:
    body = load_person().body
    piece = body.groups[name]
    front = int(piece[body.v_template[piece, 2].argmax()])
    weights = node_weights(body, (front, 5)).toarray()
    np.testing.assert_allclose(weights[piece, 0], 1)
    assert np.count_nonzero(weights[:, 0]) == len(piece)


def test_an_eye_turns_about_its_own_middle() -> None:
    plain = load_person()
    eye = plain.body.groups["left_eye"]
    front = int(eye[plain.body.v_template[eye, 2].argmax()])
    face = FaceOffsets((front,), UP[None], np.zeros((0, 52)), np.zeros((1, 3, 0)), eye_joints=True)
    fit = PersonFit(np.zeros(10), np.zeros((55, 3)), face=face)
    own = resize_person(load_person(), PersonFit.from_json(fit.to_json(), "fit"))
    gaze = torch.tensor([[0.3, 0.5, 0.0], [0.0, 0.0, 0.0]])
    theirs, ours = (
        pose_face(each.face, torch.zeros(52), torch.zeros(3), gaze, torch.zeros(0)) for each in (plain, own)
    )
    rows = torch.isin(plain.face.body_vertex_ids, eye)
    step = (ours - theirs)[rows].double().numpy()
    np.testing.assert_allclose(step, np.broadcast_to(UP, step.shape), atol=1e-6)
    other = JOINT_NAMES.index("right_eye")
    assert torch.equal(own.body.joint_template[other], plain.body.joint_template[other])
    before = resize_person(load_person(), replace(fit, face=replace(face, eye_joints=False)))
    assert torch.equal(before.body.joint_template, plain.body.joint_template)  # a file that says nothing of it
    assert before.hash != own.hash


def test_weights_add_up_near_nodes_and_fade() -> None:
    body, rng = load_person().body, np.random.default_rng(0)
    nodes = tuple(load_person().face.body_vertex_ids.numpy()[rng.integers(0, 2000, 60)].tolist())
    total = node_weights(body, nodes).sum(1)
    assert total.max() <= 1 + 1e-9
    np.testing.assert_allclose(total[list(nodes)], 1)
    assert (total == 0).sum() > 5000


def test_it_is_part_of_the_fit_bit_for_bit(nose: int) -> None:
    person = resize_person(load_person(), of(nose))
    assert person.fit is not None
    text = json.dumps(person.fit.to_json())
    again = resize_person(load_person(), PersonFit.from_json(json.loads(text), "avatar.json"))
    assert again.hash == person.hash != load_person().hash
    assert torch.equal(again.body.expression_dirs, person.body.expression_dirs)
    assert (
        again.with_template_face.hash == resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3)))).hash
    )
    assert again.naked.fit is not None
    assert again.naked.fit.face is None


@pytest.mark.parametrize(
    ("name", "value", "field"),
    [
        ("vertices", [10**6], r"face\.vertices"),
        ("vertices", [-1], r"face\.vertices"),
        ("vertices", [1.5], r"face\.vertices"),
        ("vertices", [True], r"face\.vertices"),
        ("vertices", {"9": 1}, r"face\.vertices"),
        ("vertices", [float("inf")], r"face\.vertices"),
        ("vertices", [7, 7], r"face\.vertices"),
        ("vertices", list(range(1001)), r"face\.vertices"),
        ("vertices", [], r"face\.vertices"),
        ("rest", [[0.3, 0.0, 0.0]], r"face\.rest"),
        ("directions", [[1.5] * 52], r"face\.directions"),
        ("rest", [[0.1, 0.2]], r"face\.rest"),
        ("rest", [[float("nan")] * 3], r"face\.rest"),
        ("moves", [[[1.0, 2.0]] * 3], r"face\.moves"),
        ("directions", [[1.0] * 51], r"face\.directions"),
        ("directions", "many", "person_fit"),
    ],
)
def test_broken_ones_are_refused(nose: int, name: str, value: object, field: str) -> None:
    data = of(nose).to_json()
    data["face"][name] = value
    with pytest.raises(InputError, match=field):
        resize_person(load_person(), PersonFit.from_json(data, "avatar.json"))


def test_one_expression_alone_says_nothing_of_others(nose: int) -> None:
    alone = FaceOffsets((nose,), UP[None], np.zeros((0, 52)), np.zeros((1, 3, 0)))
    fit = PersonFit(np.zeros(10), np.zeros((55, 3)), face=alone)
    again = PersonFit.from_json(json.loads(json.dumps(fit.to_json())), "avatar.json")
    person = resize_person(load_person(), again)
    assert torch.equal(person.body.expression_dirs, load_person().body.expression_dirs)
    np.testing.assert_allclose((person.body.v_template - load_person().body.v_template)[nose], UP, atol=1e-6)


def gained(gains: np.ndarray) -> PersonFit:
    face = FaceOffsets((5,), np.zeros((1, 3)), np.eye(52)[[SMILE]], np.zeros((1, 3, 1)), gains=gains)
    return PersonFit(np.zeros(10), np.zeros((55, 3)), face=face)


def test_gains_scale_what_expressions_move() -> None:
    """The joints that follow, too; moves of nodes are added to that."""
    gains, jaw = np.ones(52), EXPRESSION_NAMES.index("jawOpen")
    gains[jaw] = 0.4
    plain = load_person()
    follows = torch.ones(55, 3, 52)
    person = replace(plain, body=replace(plain.body, joint_expression_dirs=follows))
    body = resize_person(person, gained(gains)).body
    wanted = torch.from_numpy(gains).float()
    torch.testing.assert_close(body.expression_dirs, plain.body.expression_dirs * wanted, atol=1e-8, rtol=0)
    torch.testing.assert_close(body.joint_expression_dirs, follows * wanted)
    fit = gained(gains)
    moved = replace(fit, face=replace(fit.face, moves=WIDE[None, :, None]))
    step = resize_person(person, moved).body.expression_dirs - body.expression_dirs
    torch.testing.assert_close(step[5, :, SMILE], torch.from_numpy(WIDE).float())
    assert not step[..., jaw].any()


def test_gains_are_part_of_the_file() -> None:
    gains = np.linspace(0, 2, 52)
    fit = gained(gains)
    again = PersonFit.from_json(json.loads(json.dumps(fit.to_json())), "fit")
    np.testing.assert_array_equal(again.face.gains, gains.round(6))
    plain = gained(np.ones(0))
    assert "gains" not in plain.to_json()["face"]
    assert torch.equal(resize_person(load_person(), plain).body.expression_dirs, load_person().body.expression_dirs)
    assert resize_person(load_person(), again).hash != resize_person(load_person(), plain).hash


@pytest.mark.parametrize("gains", [[-0.1] * 52, [5.0] * 52, [float("nan")] * 52, 3.0, [[1.0] * 52], "much", [1.0] * 51])
def test_gains_that_are_none_are_refused(gains: object) -> None:
    data = gained(np.ones(52)).to_json()
    data["face"]["gains"] = gains
    with pytest.raises(InputError, match=r"gains|lists of numbers"):
        resize_person(load_person(), PersonFit.from_json(data, "avatar.json"))
