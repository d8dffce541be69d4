"""The face template: the body's head in the head frame, moved by 52 coefficients, jaw and eyes; ω and albedo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from avatarrex.errors import InputError
from avatarrex.templates.albedo import IRIS, LIPS, PUPIL, TEETH
from avatarrex.templates.face import HEAD, JAW, LEFT_EYE, NECK, FaceTemplate, cut_face, pose_face
from avatarrex.templates.model import TemplateModel, pose_template
from avatarrex.templates.person import load_person


@pytest.fixture(scope="module")
def body() -> TemplateModel:
    return load_person().body


@pytest.fixture(scope="module")
def face() -> FaceTemplate:
    return load_person().face


def posed(face: FaceTemplate, coefficients: dict[str, float] | None = None, **given: torch.Tensor) -> torch.Tensor:
    expression = torch.zeros(52)
    for name, value in (coefficients or {}).items():
        expression[face.model.expression_names.index(name)] = value
    rest = {"jaw_pose": torch.zeros(3), "eye_pose": torch.zeros(2, 3), "shape": torch.zeros(10)}
    return pose_face(face, expression, **{**rest, **given})


def test_the_face_is_the_bodys_face(face: FaceTemplate, body: TemplateModel) -> None:
    """Carried by the head's frame it is the posed body, expression, jaw, eyes and shape included, but for the neck."""
    rng = torch.Generator().manual_seed(0)
    pose = torch.randn(55, 3, generator=rng, dtype=torch.float64)
    shape, expression = torch.randn(10, generator=rng).double() * 2, torch.rand(52, generator=rng).double()
    whole = pose_template(body.double(), pose, shape, expression)
    exact = replace(face, model=face.model.double())
    local = pose_face(exact, expression, pose[JAW], pose[LEFT_EYE : LEFT_EYE + 2], shape)
    frame = whole.joint_transforms[HEAD]
    gap = (local @ frame[:3, :3].T + frame[:3, 3] - whole.vertices[face.body_vertex_ids]).norm(dim=1)
    own = body.weights[:, [HEAD, JAW, LEFT_EYE, LEFT_EYE + 1]].sum(1)[face.body_vertex_ids] > 1 - 1e-6
    assert own.sum() > 3500
    assert gap[own].max() < 1e-6
    assert gap[~own].max() > 1e-3


def test_the_head_is_the_origin_whatever_the_shape(face: FaceTemplate) -> None:
    assert (face.model.joint_template[0] == 0).all()
    assert (face.model.joint_shapedirs[0] == 0).all()
    assert face.model.joint_names == ("head", "jaw", "left_eye", "right_eye")


def test_neutral_is_the_template(face: FaceTemplate) -> None:
    assert (posed(face) - face.v_template).abs().max() < 1e-6


def test_every_coefficient_moves_the_face_alone(face: FaceTemplate) -> None:
    """Each of the 52 moves something, and what moves by more than 2 mm is mostly where ω is 1."""
    for k, name in enumerate(face.model.expression_names):
        moved = (posed(face, {name: 1.0}) - face.v_template).norm(dim=1)
        assert moved.max() > 5e-4, f"{k} {name}"
        assert moved.max() < 0.05, name
        far = moved > 0.75 * moved.max()
        assert face.blend_weight[far].mean() > 0.8, name


def test_the_jaw_opens_downward_and_the_left_blink_is_left(face: FaceTemplate) -> None:
    chin = face.v_template[:, 1] + 10 * (face.v_template[:, 2] < 0.08)
    assert posed(face, {"jawOpen": 1.0})[chin.argmin(), 1] < face.v_template[chin.argmin(), 1] - 0.01
    assert (
        posed(face, jaw_pose=torch.tensor([0.3, 0.0, 0.0]))[chin.argmin(), 1] < face.v_template[chin.argmin(), 1] - 0.01
    )
    blink = (posed(face, {"eyeBlinkLeft": 1.0}) - face.v_template).norm(dim=1)
    assert face.v_template[blink.argmax(), 0] > 0.01


def test_eyes_turn_about_their_own_centres(face: FaceTemplate) -> None:
    turn = torch.tensor([[0.0, 0.4, 0.0], [0.0, 0.0, 0.0]])
    after = posed(face, eye_pose=turn)
    left, right = face.model.groups["left_eye"], face.model.groups["right_eye"]
    centre = face.model.joint_template[2]
    radius = lambda v: (v[left] - centre).norm(dim=1)  # noqa: E731
    assert (radius(after) - radius(face.v_template)).abs().max() < 1e-4
    front = left[face.v_template[left, 2].argmax()]
    assert after[front, 0] > face.v_template[front, 0] + 0.004, "a turn about +Y looks to the person's left"
    assert (after - face.v_template)[right].abs().max() < 1e-6


def test_blend_weight_covers_the_face(face: FaceTemplate, body: TemplateModel) -> None:
    omega, v = face.blend_weight, face.v_template
    eyes = face.model.joint_template[2:].mean(0)
    for name in ("left_eye", "right_eye", "upper_teeth", "lower_teeth", "tongue"):
        assert (omega[face.model.groups[name]] == 1).all(), name
    skin = torch.zeros(len(omega), dtype=torch.bool)
    skin[face.model.groups["body"]] = True
    front = skin & (v[:, 0].abs() < 0.03) & (v[:, 2] > eyes[2] + 0.005)
    chin = v[skin & (v[:, 2] > 0.08), 1].min()
    middle = front & (v[:, 1] > chin) & (v[:, 1] < eyes[1] + 0.025)
    assert middle.sum() > 200
    assert omega[middle].min() > 0.95, "brows, nose, mouth, chin"
    assert omega[v[:, 1] > eyes[1] + 0.07].max() == 0, "scalp"
    assert omega[skin & (v[:, 2] < 0)].max() == 0, "ears and back of the head"
    assert omega[skin & (body.weights[face.body_vertex_ids, NECK] > 0.3)].max() < 0.35, "throat"
    edge = face.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    undirected, count = torch.unique(edge.sort(1).values, dim=0, return_counts=True)
    rim = torch.unique(undirected[count == 1])
    assert omega[rim[skin[rim]]].max() == 0, "nothing of the face hangs on the mesh's open rim"


def test_the_ramp_is_smooth_on_the_skin(face: FaceTemplate) -> None:
    """Over the outer skin ω's slope stays that of three smoothsteps of 4 cm at once."""
    edge = face.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    inner = torch.ones(len(face.blend_weight), dtype=torch.bool)
    inner[face.v_template[:, 2] > 0.03] = False  # the mouth's cavity, painted 1, ends in front of here
    change = (face.blend_weight[edge[:, 0]] - face.blend_weight[edge[:, 1]]).abs()
    length = (face.v_template[edge[:, 0]] - face.v_template[edge[:, 1]]).norm(dim=1)
    outer = inner[edge].any(1)
    assert (change[outer] <= 1.5 * 3**0.5 * length[outer] / 0.04 + 1e-5).all()


def test_colours_are_where_they_belong(face: FaceTemplate) -> None:
    """You would see teeth, brown-red lips below the nose, and a pupil in each eye looking ahead."""
    assert face.albedo.min() >= 0
    assert face.albedo.max() <= 1
    is_colour = lambda value: (face.albedo - torch.tensor(value)).abs().amax(1) < 1e-6  # noqa: E731
    assert is_colour(TEETH)[face.model.groups["upper_teeth"]].all()
    lips = face.v_template[is_colour(LIPS)]
    assert len(lips) > 100
    assert lips[:, 1].max() < face.model.joint_template[2, 1] - 0.04
    for eye, name in ((2, "left_eye"), (3, "right_eye")):
        ball = torch.zeros(len(face.albedo), dtype=torch.bool)
        ball[face.model.groups[name]] = True
        for colour in (IRIS, PUPIL):
            seen = face.v_template[ball & is_colour(colour)]
            assert len(seen) > 0
            assert (seen[:, 2] > face.model.joint_template[eye, 2] + 0.01).all()


def test_finite_for_extreme_signals(face: FaceTemplate) -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        turns = torch.from_numpy(rng.uniform(-np.pi, np.pi, (3, 3))).float()
        shape = torch.from_numpy(rng.uniform(-5, 5, 10)).float()
        found = pose_face(face, torch.from_numpy(rng.uniform(-1, 2, 52)).float(), turns[0], turns[1:], shape)
        assert found.isfinite().all()


def test_bad_values_are_refused(face: FaceTemplate) -> None:
    for name, shape in (("jaw_pose", (3,)), ("eye_pose", (2, 3)), ("shape", (10,))):
        with pytest.raises(InputError):
            posed(face, **{name: torch.full(shape, torch.nan)})
    with pytest.raises(InputError, match="expression"):
        posed(face, {"jawOpen": float("inf")})


def test_a_body_without_a_chin_is_refused(body: TemplateModel) -> None:
    weights = body.weights.clone()
    weights[:, HEAD] += weights[:, JAW]
    weights[:, JAW] = 0
    with pytest.raises(InputError, match="chin"):
        cut_face(replace(body, weights=weights))


def test_official_expressions_that_move_joints(body: TemplateModel) -> None:
    """Joints that follow the expression (a regressor's) do so about the head joint, jaw pose directions too."""
    rng = torch.Generator().manual_seed(0)
    official = replace(
        body,
        joint_expression_dirs=torch.randn(55, 3, 52, generator=rng) * 1e-3,
        posedirs=torch.randn(len(body.weights), 3, 486, generator=rng) * 1e-4,
        pose_columns=None,
    )
    cut = cut_face(official)
    assert cut.model.posedirs is not None
    assert cut.model.posedirs.shape[2] == 27
    pose, expression = torch.zeros(55, 3), torch.rand(52, generator=rng)
    pose[JAW : JAW + 3] = torch.randn(3, 3, generator=rng) * 0.3
    whole = pose_template(official, pose, torch.zeros(10), expression)
    found = pose_face(cut, expression, pose[JAW], pose[JAW + 1 : JAW + 3], torch.zeros(10))
    own = official.weights[cut.body_vertex_ids, NECK] == 0
    assert (found - (whole.vertices[cut.body_vertex_ids] - whole.joints[HEAD]))[own].abs().max() < 2e-6
