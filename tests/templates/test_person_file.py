"""The packaged person and garments: what their files promise (assets_spec/person.md, garments.json).

Closed forms and invariances of the arrays themselves, then bends: every joint must turn the right way and keep its volume.
"""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from avatarrex.files.arrays import read_arrays
from avatarrex.files.assets import DATA, check_arrays, read_spec
from avatarrex.templates.model import TemplateModel, pose_template
from avatarrex.templates.model_arrays import read_model

SPECS = Path(__file__).parents[2] / "assets_spec"
CLOSED = ("body", "tongue", "left_eye", "right_eye")


@pytest.fixture(scope="module")
def arrays() -> dict[str, np.ndarray]:
    return read_arrays(DATA / "person.npz")


@pytest.fixture(scope="module")
def model(arrays) -> TemplateModel:
    return read_model(arrays, "person.npz").double()


@pytest.fixture(scope="module")
def garments() -> dict[str, np.ndarray]:
    return read_arrays(DATA / "garments.npz")


def faces_of(arrays, group):
    number = list(arrays["group_names"]).index(group)
    return arrays["f"].astype(int)[(arrays["vertex_group"][arrays["f"]] == number).all(1)]


def volume(vertices, faces):
    a, b, c = vertices[faces].swapaxes(0, 1)
    return float((np.cross(a, b) * c).sum() / 6)


def bend(model, expression=None, **turns):
    """Vertices with joints turned by rotation vectors in degrees."""
    pose = torch.zeros(55, 3, dtype=torch.float64)
    for name, turn in turns.items():
        pose[model.joint_names.index(name)] = torch.tensor(turn, dtype=torch.float64).deg2rad()
    coefficients = torch.zeros(52, dtype=torch.float64)
    for name, value in (expression or {}).items():
        coefficients[model.expression_names.index(name)] = value
    return pose_template(model, pose, torch.zeros(10, dtype=torch.float64), coefficients).vertices.numpy()


def test_file_is_the_one_its_spec_describes(arrays):
    spec = read_spec("person")
    check_arrays(arrays, "person.npz", spec)
    assert set(arrays) <= set(spec["arrays"])
    assert hashlib.sha256((DATA / "person.npz").read_bytes()).hexdigest() == spec["packaged"]["sha256"]
    assert (DATA / "person.npz").stat().st_size < 4e6
    assert len(arrays["v_template"]) == spec["packaged"]["v"]


def test_stands_upright_facing_forward(arrays):
    joint = dict(zip(arrays["joint_names"], arrays["J_template"]))
    assert 1.70 < np.ptp(arrays["v_template"][:, 1]) < 1.80
    assert np.abs(joint["pelvis"]).max() == 0
    assert joint["head"][1] > 0.6
    assert joint["left_wrist"][0] > 0.6  # the person's left is +x
    assert joint["left_eye"][2] > joint["head"][2] + 0.05  # facing +z
    assert joint["left_foot"][2] > joint["left_ankle"][2] + 0.1
    assert abs(joint["left_wrist"][1] - joint["left_shoulder"][1]) < 0.06  # T-pose


@pytest.mark.parametrize("group", CLOSED)
def test_group_is_closed_and_faces_outwards(arrays, group):
    faces = faces_of(arrays, group)
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    there, back = ({tuple(edge) for edge in order} for order in (edges.tolist(), edges[:, ::-1].tolist()))
    assert len(there) == len(edges), "an edge is used twice in one direction"
    assert there == back, "an open edge"
    assert volume(arrays["v_template"].astype("f8"), faces) > 0


def test_body_volume_is_a_persons(arrays):
    assert 0.055 < volume(arrays["v_template"].astype("f8"), faces_of(arrays, "body")) < 0.080


def test_left_is_right_mirrored(arrays):
    mirror = np.array([-1, 1, 1])

    def keys(vertices):
        return {tuple(row) for row in np.round(vertices * 1e6).astype(int).tolist()}

    assert keys(arrays["v_template"].astype("f8")) == keys(arrays["v_template"].astype("f8") * mirror)
    left = [name for name in arrays["joint_names"] if name.startswith("left")]
    joint = dict(zip(arrays["joint_names"], arrays["J_template"]))
    for name in left:
        np.testing.assert_allclose(joint[name] * mirror, joint[name.replace("left", "right")], atol=1e-6)


def test_weights_sum_to_one_and_are_sparse(arrays):
    weights = arrays["weights"]
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-6)
    assert (weights > 0).sum(1).max() <= 6


def test_regressor_is_convex_and_near_the_joints(arrays):
    joint, vertex = arrays["J_idx"].T
    sums = np.bincount(joint, arrays["J_w"], 55)
    np.testing.assert_allclose(sums, 1, atol=1e-6)
    assert (arrays["J_w"] > 0).all()
    for beta in (np.zeros(10), np.eye(10)[0], np.eye(10)[3] * -2):
        shaped = arrays["v_template"] + arrays["shapedirs"][..., :10].astype("f8") @ beta
        regressed = np.zeros((55, 3))
        np.add.at(regressed, joint, arrays["J_w"][:, None] * shaped[vertex])
        error = np.linalg.norm(regressed - (arrays["J_template"] + arrays["J_shapedirs"] @ beta), axis=1)
        assert error.mean() < 0.004
        assert error.max() < 0.03  # the knees


@pytest.mark.parametrize("finger", ["index", "middle", "ring", "pinky"])
def test_fingers_curl_into_the_palm(model, finger):
    tip = np.flatnonzero(model.weights[:, model.joint_names.index(f"left_{finger}3")] > 0.9)
    rest = model.v_template.numpy()
    curled = bend(model, **{f"left_{finger}{k}": (0, 0, -60) for k in (1, 2, 3)})
    assert curled[tip, 1].mean() < rest[tip, 1].mean() - 0.02  # palms face down
    assert curled[tip, 0].mean() < rest[tip, 0].mean() - 0.02


def test_limbs_bend_the_right_way(model):
    names = list(model.joint_names)
    hand, foot = (np.flatnonzero(model.weights[:, names.index(n)] > 0.9) for n in ("left_wrist", "left_foot"))
    rest = model.v_template.numpy()
    assert bend(model, left_elbow=(0, -90, 0))[hand, 2].mean() > rest[hand, 2].mean() + 0.2
    assert bend(model, left_shoulder=(0, 0, -70))[hand, 1].mean() < rest[hand, 1].mean() - 0.4
    assert bend(model, left_knee=(90, 0, 0))[foot, 2].mean() < rest[foot, 2].mean() - 0.3
    assert bend(model, left_hip=(-90, 0, 0))[foot, 2].mean() > rest[foot, 2].mean() + 0.6


def test_jaw_opens_and_lids_close(arrays, model):
    rest = model.v_template.numpy()
    lower = model.groups["lower_teeth"].numpy()
    for opened in (bend(model, {"jawOpen": 1.0}), bend(model, jaw=(20, 0, 0))):
        assert opened[lower, 1].mean() < rest[lower, 1].mean() - 0.008
    lids = arrays["region"][:, list(arrays["region_names"]).index("eyelids")] > 0.5
    eye = model.joint_template[model.joint_names.index("left_eye")].numpy()
    lids = np.flatnonzero(lids & (np.abs(rest[:, 0] - eye[0]) < 0.006) & (rest[:, 2] > eye[2]))
    upper = lids[rest[lids, 1] > eye[1]]
    closed = bend(model, {"eyeBlinkLeft": 1.0})
    assert (closed[upper, 1] - rest[upper, 1]).min() < -0.006
    other = bend(model, {"eyeBlinkRight": 1.0})
    assert np.abs(other[upper] - rest[upper]).max() < 1e-3


def pinch(model, joint, turn):
    """Area of the skin between the two bones relative to rest: what linear blending loses."""
    first = model.joint_names.index(joint)
    tree = [k for k in range(55) if k == first or model.parents[k] == first]
    share = model.weights[:, tree].sum(1).numpy()
    faces = model.faces.numpy()
    faces = faces[((share[faces] > 0.2) & (share[faces] < 0.8)).all(1)]

    def area(vertices):
        a, b, c = vertices[faces].swapaxes(0, 1)
        return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()

    return area(bend(model, **{joint: turn})) / area(model.v_template.numpy())


@pytest.mark.parametrize(("joint", "turn"), [("left_elbow", (70, 0, 0)), ("left_shoulder", (70, 0, 0))])
def test_pose_offsets_keep_a_twisted_limb_full(arrays, joint, turn):
    plain = {key: value for key, value in arrays.items() if key not in ("posedirs", "pose_columns")}
    without = pinch(read_model(plain, "person.npz").double(), joint, turn)
    assert pinch(read_model(arrays, "person.npz").double(), joint, turn) > without + 0.01


def test_bent_body_keeps_its_volume(arrays, model):
    faces = faces_of(arrays, "body")
    squat = {
        f"{side}_{joint}": turn
        for side in ("left", "right")
        for joint, turn in (("hip", (-100, 0, 0)), ("knee", (120, 0, 0)))
    }
    ratio = volume(bend(model, **squat), faces) / volume(model.v_template.numpy(), faces)
    assert 0.95 < ratio < 1.05


def test_pose_offsets_spare_hands_and_face(arrays):
    offset = np.abs(arrays["posedirs"].astype("f8")).max((1, 2))
    joint = dict(zip(arrays["joint_names"], arrays["J_template"]))
    for side in ("left", "right"):
        near = np.linalg.norm(arrays["v_template"] - joint[f"{side}_wrist"], axis=1) < 0.08
        assert offset[near].max() == 0
    head = arrays["weights"][:, [15, 22, 23, 24]].sum(1)
    assert offset[head > 0.5].max() == 0
    assert offset.max() > 0.01


def test_regions_lie_where_they_should(arrays):
    region = dict(zip(arrays["region_names"], arrays["region"].astype("f8").T))
    vertices, joint = arrays["v_template"], dict(zip(arrays["joint_names"], arrays["J_template"]))
    for name, mask in region.items():
        assert mask.min() >= 0, name
        assert mask.max() == 1, name
        assert mask[arrays["vertex_group"] != 0].max() == 0, name
    assert vertices[region["lips"] > 0.5][:, 1].max() < joint["left_eye"][1]
    assert vertices[region["brows"] > 0.5][:, 1].min() > joint["left_eye"][1]
    assert vertices[region["scalp"] > 0.5][:, 1].min() > joint["neck"][1]
    assert np.abs(vertices[region["fingernails"] > 0.5][:, 0]).min() > abs(joint["left_thumb2"][0])
    assert vertices[region["toenails"] > 0.5][:, 1].max() < joint["left_ankle"][1]


def test_garments_are_as_their_spec_says(garments):
    spec = json.loads((SPECS / "garments.json").read_text(encoding="utf-8"))
    assert list(garments["names"]) == list(spec["pieces"])
    for name, piece in spec["pieces"].items():
        own = {key: garments[f"{name}_{key}"] for key in spec["per_piece"]}
        check_arrays(own, "garments.npz", {"arrays": spec["per_piece"]})
        assert (len(own["v"]), len(own["f"])) == (piece["v"], piece["f"])
        assert own["f"].max() == len(own["v"]) - 1
        np.testing.assert_allclose(own["weights"].sum(1), 1, atol=1e-6)


def test_tights_lie_on_the_body(arrays, garments):
    """Each vertex of the suit within 4 cm of the skin, and moving with it: bound to the same joints."""
    step = slice(None, None, 25)
    suit, skin = garments["tights_v"][step], arrays["v_template"][arrays["vertex_group"] == 0]
    distance = np.linalg.norm(suit[:, None] - skin, axis=2)
    near = distance.argmin(1)
    assert distance.min(1).max() < 0.04
    difference = np.abs(garments["tights_weights"][step] - arrays["weights"][: len(skin)][near]).sum(1)
    assert difference.mean() < 0.3
