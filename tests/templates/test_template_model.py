"""Templates against an evaluation written from the layout's page: the packaged person and ten official-like models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from official import evaluate, random_official, random_pose

from avatarrex.errors import InputError
from avatarrex.files.assets import DATA, read_npz
from avatarrex.templates.model import TemplateModel, pose_template, shape_template
from avatarrex.templates.model_arrays import read_model
from avatarrex.templates.person import load_person
from avatarrex.templates.transform import world_from_root


def double(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.asarray(values, dtype=np.float64))


@pytest.fixture(scope="module")
def body() -> TemplateModel:
    return load_person().body


@pytest.mark.parametrize("seed", range(10))
def test_official_models(seed: int) -> None:
    """10 + 10 directions, all 486 pose directions, joints by regressor (expression included), uint32 root."""
    rng = np.random.default_rng(seed)
    arrays = random_official(seed)
    model = read_model(arrays, "official")
    assert (model.shapedirs.shape[2], model.expression_dirs.shape[2]) == (10, 10)
    pose, shape, expression = random_pose(rng), rng.normal(size=10) * 2, rng.random(10)
    stored = {key: value.astype(np.float32) if value.dtype.kind == "f" else value for key, value in arrays.items()}
    stored["J_regressor"] = arrays["J_regressor"]  # applied in float64 when read
    wanted = evaluate(stored, pose, shape, expression)
    found = pose_template(model.double(), double(pose), double(shape), double(expression))
    assert np.abs(found.vertices.numpy() - wanted).max() < 2e-6  # joints are kept in single precision
    single = pose_template(model, *(torch.from_numpy(a).float() for a in (pose, shape, expression)))
    assert np.abs(single.vertices.numpy() - wanted).max() < 1e-5  # ten levels of random offsets, metres long


def test_the_packaged_person() -> None:
    """To 1e-6 m in single precision, shapes to 5 sigma, half turns included."""
    arrays = read_npz(DATA / "person.npz", "person")
    body = load_person().body
    for seed in range(3):
        rng = np.random.default_rng(seed)
        pose, shape, expression = random_pose(rng), rng.uniform(-5, 5, 10), rng.random(52)
        pose[0] = 0
        wanted = evaluate(arrays, pose, shape, expression)
        exact = pose_template(body.double(), double(pose), double(shape), double(expression)).vertices
        assert np.abs(exact.numpy() - wanted).max() < 2e-7  # the weights' sums are made exact in single precision
        single = pose_template(body, *(torch.from_numpy(a).float() for a in (pose, shape, expression))).vertices
        assert np.abs(single.numpy() - wanted).max() < 1e-6


def test_zero_is_the_template(body: TemplateModel) -> None:
    posed = pose_template(body, torch.zeros(55, 3), torch.zeros(10), torch.zeros(52))
    assert (posed.vertices - body.v_template).abs().max() < 1e-6
    assert (posed.joints - body.joint_template).abs().max() < 1e-6
    assert posed.joint_transforms[0, :3, :3].equal(torch.eye(3))
    assert posed.joints[0].equal(body.joint_template[0]), "the pelvis rests where it is"


def test_weights_are_a_partition(body: TemplateModel) -> None:
    assert body.weights.min() >= 0
    assert (body.weights.sum(1) - 1).abs().max() < 1e-6


def test_the_root_is_a_rigid_motion(body: TemplateModel) -> None:
    """Posing with the global orientation is `world_from_root` after posing without it: the pelvis sits at J_0 + t."""
    rng = np.random.default_rng(0)
    pose, orient, shift = random_pose(rng), np.array([0.4, -2.9, 0.7]), np.array([1.0, 2.0, 3.0])
    shape = double(rng.uniform(-3, 3, 10))
    model, nothing = body.double(), torch.zeros(52, dtype=torch.float64)
    pose[0] = 0
    in_root = pose_template(model, double(pose), shape, nothing)
    pose[0] = orient
    wanted = pose_template(model, double(pose), shape, nothing)
    world = world_from_root(orient, shift, in_root.joints[0].numpy())
    moved = in_root.vertices.numpy() @ world[:3, :3].T + world[:3, 3]
    assert np.abs(moved - (wanted.vertices.numpy() + shift)).max() < 1e-12
    assert (
        np.abs(world @ np.append(in_root.joints[0], 1) - np.append(in_root.joints[0].numpy() + shift, 1)).max() < 1e-12
    )


def test_extreme_shapes_stay_people(body: TemplateModel) -> None:
    for k in range(10):
        for sigma in (-5.0, 5.0):
            vertices, joints = shape_template(body, sigma * torch.eye(10)[k], torch.zeros(52))
            assert vertices.isfinite().all()
            assert (
                0.7 < float(vertices[:, 1].max() - vertices[:, 1].min()) < 2.7
            )  # the first direction is 17 cm a sigma
            assert (joints.amin(0) >= vertices.amin(0)).all()
            assert (joints.amax(0) <= vertices.amax(0)).all()


def test_fewer_coefficients_are_the_leading_ones(body: TemplateModel) -> None:
    shape = torch.tensor([1.0, -2.0, 0.5])
    full, _ = shape_template(body, torch.cat([shape, torch.zeros(7)]), torch.zeros(52))
    assert (shape_template(body, shape, torch.zeros(0))[0] - full).abs().max() < 1e-6


def test_the_cached_shape_is_the_shape(body: TemplateModel) -> None:
    """Back and forth between shapes, in inference mode and out of it, a caller's gradient never meets a stale value."""
    first, second = torch.linspace(-1, 1, 10), torch.linspace(2, -2, 10)
    with torch.inference_mode():
        a = shape_template(body, first, torch.zeros(52))[0].clone()
    b = shape_template(body, second, torch.zeros(52))[0]
    assert not torch.equal(a, b)
    assert torch.equal(shape_template(body, first.clone(), torch.zeros(52))[0], a)
    learnt = first.clone().requires_grad_()
    shape_template(body, learnt, torch.zeros(52))[0].sum().backward()
    assert (learnt.grad - body.shapedirs.double().sum((0, 1))).abs().max() < 1e-2  # sums of 42 000 numbers
    pose = torch.zeros(55, 3, requires_grad=True)
    pose_template(body, pose, first, torch.zeros(52)).vertices.sum().backward()
    assert pose.grad.isfinite().all()


def test_gradients() -> None:
    model = read_model(random_official(0, vertices=3), "official").double()
    model = replace(model, faces=model.faces[:1])
    rng = np.random.default_rng(0)
    pose, shape, expression = double(random_pose(rng)), double(rng.normal(size=10)), double(rng.random(10))
    pose[5] = 0
    inputs = [value.requires_grad_() for value in (pose, shape, expression)]
    assert torch.autograd.gradcheck(lambda *x: pose_template(model, *x).vertices, inputs)


def test_posedirs_by_named_columns() -> None:
    """A subset of the 486 columns with `pose_columns` is all of them with zeros elsewhere."""
    arrays = random_official(3)
    columns = np.array([5, 0, 100, 485])
    sparse = {**arrays, "posedirs": arrays["posedirs"][..., columns], "pose_columns": columns}
    zeroed = np.zeros_like(arrays["posedirs"])
    zeroed[..., columns] = arrays["posedirs"][..., columns]
    pose = torch.from_numpy(random_pose(np.random.default_rng(3))).float()
    nothing = torch.zeros(10), torch.zeros(10)
    wanted = pose_template(read_model({**arrays, "posedirs": zeroed}, "full"), pose, *nothing).vertices
    assert (pose_template(read_model(sparse, "sparse"), pose, *nothing).vertices - wanted).abs().max() < 1e-6
    none = {key: value for key, value in arrays.items() if key != "posedirs"}
    assert read_model(none, "none").posedirs is None


def test_the_sparse_regressor_is_the_dense_one() -> None:
    arrays = random_official(4)
    kept = np.where(arrays["J_regressor"] > 0.01, arrays["J_regressor"], 0)
    index = np.argwhere(kept)
    sparse = {key: value for key, value in arrays.items() if key != "J_regressor"}
    sparse |= {"J_idx": index.astype(np.uint16), "J_w": kept[tuple(index.T)]}
    a, b = read_model({**arrays, "J_regressor": kept}, "dense"), read_model(sparse, "sparse")
    assert torch.equal(a.joint_template, b.joint_template)
    assert torch.equal(a.joint_shapedirs, b.joint_shapedirs)


def test_nothing_but_people_in_200_random_poses(body: TemplateModel) -> None:
    rng = np.random.default_rng(7)
    for _ in range(200):
        pose = torch.from_numpy(random_pose(rng)).float()
        posed = pose_template(body, pose, torch.from_numpy(rng.uniform(-5, 5, 10)).float(), torch.rand(52))
        assert posed.vertices.isfinite().all()
        assert posed.skinning.isfinite().all()
        assert posed.vertices.norm(dim=1).max() < 4


def refused(what: str, model: TemplateModel, **given: torch.Tensor) -> None:
    values = {"pose": torch.zeros(55, 3), "shape": torch.zeros(10), "expression": torch.zeros(52), **given}
    with pytest.raises(InputError, match=f"template: {what}") as caught:
        pose_template(model, **values)
    assert "\n" not in str(caught.value)


def test_bad_signals_are_refused(body: TemplateModel) -> None:
    for bad in (float("nan"), float("inf")):
        refused("pose", body, pose=torch.full((55, 3), bad))
        refused("shape", body, shape=torch.full((10,), bad))
        refused("expression", body, expression=torch.full((52,), bad))
    refused("pose", body, pose=torch.zeros(54, 3))
    refused("shape", body, shape=torch.zeros(11))
    refused("expression", body, expression=torch.ones(53))


def test_bad_models_are_refused(body: TemplateModel) -> None:
    for changes, field in (
        ({"faces": body.faces + 10**6}, "faces"),
        ({"parents": body.parents[:-1]}, "parents"),
        ({"parents": (-1, *body.parents[1:-1], 54)}, "parents"),
        ({"parents": (-1, -1, *body.parents[2:])}, "parents"),
        ({"posedirs": torch.zeros(len(body.weights), 3, 7), "pose_columns": None}, "posedirs"),
        ({"posedirs": torch.zeros(len(body.weights), 3, 1), "pose_columns": torch.tensor([486])}, "pose_columns"),
    ):
        with pytest.raises(InputError, match=field):
            replace(body, **changes)


def test_the_world_turns_about_a_pelvis_that_is_not_the_origin() -> None:
    """An official pelvis lies 35 cm below its origin: x = R (x − J_0) + J_0 + t, float64 even 1 km away."""
    pelvis, shift = np.array([0.01, -0.35, 0.02]), np.array([1000.0, 0.0, -2.0])
    world = world_from_root(np.array([0.0, np.pi / 2, 0.0]), shift, pelvis)
    for offset, turned in (([0, 0, 0], [0, 0, 0]), ([0, 0, 1.0], [1.0, 0, 0]), ([0, 1.0, 0], [0, 1.0, 0])):
        assert np.abs(world[:3, :3] @ (pelvis + offset) + world[:3, 3] - (pelvis + shift + turned)).max() < 1e-12
    assert world.dtype == np.float64
    assert world[3].tolist() == [0, 0, 0, 1]
