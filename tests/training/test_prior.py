"""The packaged prior of geometry and of the face's colours: what it fits, what it is right about, what it leaves alone."""

from __future__ import annotations

import numpy as np
import pytest
import safetensors.torch
import torch

import avatarrex.training.prior as prior
from avatarrex.avatar import Avatar
from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.fields.orthographic import project, render_views
from avatarrex.ops.closest_point import closest_point
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.limits import random_signals
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import pose_person
from avatarrex.training.core.supervision import distances_before, hidden_at_rest, supervision
from avatarrex.training.core.warm_start import PRIOR, load_prior, prior_of, read_prior, warm_start
from avatarrex.training.recipe import PAPER, QUICK, Recipe

MOST = {"body": 0.004, "face": 0.004}
"""Metres of mean error at points as far as 15 cm off; where training reads distances it is less."""


def error(avatar: Avatar, part: str, poses: list[Signals]) -> float:
    """Mean error over the points of a warm start."""
    rng = np.random.default_rng(0)
    _, draw = supervision(avatar, poses, part, rng)
    with torch.no_grad():
        pairs = [draw(rng) for _ in range(6)]
    return float(torch.cat([(predicted - truth).abs() for predicted, truth in pairs]).mean())


@pytest.fixture(scope="module")
def compact() -> Avatar:
    avatar = Avatar.create(load_person(), "compact", seed=3)
    assert all(load_prior(avatar, part) for part in prior.MINUTES)
    return avatar


@pytest.mark.parametrize("part", ["body", "face"])
def test_it_knows_the_template_under_poses_it_was_not_fitted_to(compact, part):
    rng = np.random.default_rng(77)
    drawn = [random_signals(rng, 0.4) for _ in range(6)]
    rest = Signals.rest()
    poses = [
        rest.replace(body_pose=signals.body_pose) if part == "body" else rest.replace(expression=signals.expression)
        for signals in drawn
    ]
    known, fresh = error(compact, part, poses), error(Avatar.create(load_person(), "compact", 3), part, poses)
    assert known < MOST[part]
    assert known < fresh / 4


def test_it_passes_on_the_albedo_of_faces_it_was_not_fitted_to(compact):
    """Eyes that look aside beside mixed expressions: irises are found by where the views show them."""
    rng = np.random.default_rng(78)
    faces = prior.expressions(rng, 60)[-6:]
    errors = []
    for avatar in (compact, Avatar.create(load_person(), "compact", 3)):
        _, draw = prior.albedo_supervision(avatar, faces, np.random.default_rng(0))
        with torch.no_grad():
            pairs = [draw(rng) for _ in range(6)]
        errors.append(float(torch.cat([(predicted - truth).abs() for predicted, truth in pairs]).mean()))
    assert errors[0] < 0.03
    assert errors[0] < errors[1] / 4


@pytest.mark.parametrize(
    ("preset", "taken"),
    [
        ("compact/no-patches", {"body", "face", "face_colour"}),
        ("compact/one-network", {"face", "face_colour"}),
        ("compact/face-mlp", {"body"}),
        ("paper", set()),
    ],
)
def test_parts_with_the_same_geometry_take_it_and_others_stay_as_they_are(preset, taken):
    avatar = Avatar.create(load_person(), preset)
    for part in prior.MINUTES:
        module = avatar.modules()[part.removesuffix("_colour")]
        before = {name: value.clone() for name, value in module.state_dict().items()}
        assert load_prior(avatar, part) == (part in taken)
        after = module.state_dict()
        assert all(torch.equal(before[name], value) for name, value in after.items()) == (part not in taken)


def test_the_face_learns_distances_to_what_is_seen_and_not_to_what_lids_hide():
    """The middle of an eyeball is inside, though its mesh is open at the back."""
    person = load_person()
    field, mesh = Avatar.create(person, "compact").face, person.face.v_template.float()
    near = person.face.blend_weight > 0
    position, sdf = distances_before(field, mesh, near, hidden_at_rest(field, mesh), np.random.default_rng(0))
    shown = render_views(mesh, person.face.faces, mesh, field.box)[0]
    eye = mesh[person.face.model.weights[:, 2] > 0.9]
    row, column = ((project(field.box.normalise(eye.mean(0)[None]))[0, 0].flip(0) + 1) * 128).long()
    lens = shown[:3, row - 1 : row + 2, column - 1 : column + 2].reshape(3, -1).T
    assert (lens[:, 2] > eye[:, 2].max() - 0.002).all(), "the front view shows the eyeball"
    ball = (position - eye.mean(0)).norm(dim=-1) < 0.5 * (eye[:, 2].max() - eye[:, 2].mean())
    assert ball.any()
    assert (sdf[ball] < 0).all(), "an eyeball is inside, whatever its back looks at"
    assert 0.2 < float((sdf < 0).float().mean()) < 0.6


def test_an_open_mouth_is_taught_distances_of_which_none_contradicts_another():
    """Before the face they are the mesh's own; where sight ends they do not jump."""
    person = load_person()
    signals = Signals.rest().replace(expression=np.eye(52)[EXPRESSION_NAMES.index("jawOpen")])
    mesh = pose_person(person, signals, Counters(), None).parts["face"]
    near, field = person.face.blend_weight > 0, Avatar.create(person, "compact").face
    inner = hidden_at_rest(field, person.face.v_template.float())
    position, sdf = distances_before(field, mesh, near, inner, np.random.default_rng(0))
    outside = sdf > 0
    for here in (outside, ~outside):
        reach = torch.cdist(position[here].double(), position[~here].double()).amin(1)
        assert (sdf[here].abs() <= reach + 1e-6).all()
    whole = closest_point(mesh, person.face.faces, position[outside]).sdf
    exact = (whole - sdf[outside]).abs() < 1e-5
    assert exact.float().mean() > 0.9, "the rest lies in the mouth, or beneath lids"
    assert (position[outside][~exact][:, 1] < mesh[near][:, 1].median()).float().mean() > 0.5


@pytest.mark.slow
def test_a_fit_goes_on_from_its_checkpoint_and_is_packaged(tmp_path, monkeypatch):
    monkeypatch.setattr(prior, "HALF_POSES", 1)
    monkeypatch.setattr(prior, "FULL_POSES", 0)
    monkeypatch.setattr(prior, "POSES", ("stand",))
    prior.fit(tmp_path, "body", minutes=0.03)
    first = torch.load(tmp_path / "body.pt", weights_only=True)
    after = prior.fit(tmp_path, "body", minutes=0.1)
    second = torch.load(tmp_path / "body.pt", weights_only=True)
    assert second["steps"] > first["steps"] > 0
    assert after < 0.05
    with pytest.raises(InputError, match="fitted part"):
        prior.package(tmp_path, tmp_path / "prior.safetensors")
    face = {"state": Avatar.create(load_person(), "compact").face.state_dict(), "seconds": 1.0, "steps": 1}
    torch.save(face, tmp_path / "face.pt")
    torch.save(face, tmp_path / "face_colour.pt")
    prior.package(tmp_path, tmp_path / "prior.safetensors")
    (tmp_path / "face.pt").unlink()
    whole = safetensors.torch.load_file(tmp_path / "prior.safetensors")
    prior.package(tmp_path, tmp_path / "prior.safetensors")
    again = safetensors.torch.load_file(tmp_path / "prior.safetensors")
    assert again.keys() == whole.keys()
    assert all(again[name].equal(value) for name, value in whole.items()), "what was not fitted again stays as it was"
    monkeypatch.setattr("avatarrex.training.core.warm_start.PRIOR", tmp_path / "prior.safetensors")
    avatar = Avatar.create(load_person(), "compact", seed=9)
    assert load_prior(avatar, "body")
    stored = second["state"]["geometry_blend.0.weight"].half().float()
    assert torch.equal(avatar.body.state_dict()["geometry_blend.0.weight"], stored)


@pytest.mark.parametrize("known", [True, False])
def test_a_warm_start_without_the_prior_knows_nothing(known: bool) -> None:
    """Its geometry is right before the first step or not; colours, which a warm start does not fit, are the prior's or as created."""
    avatar, packaged = Avatar.create(load_person(), "compact", 3), read_prior(PRIOR)[0]
    before = {f"face.{name}": value.clone() for name, value in avatar.face.state_dict().items()}
    first = warm_start(avatar, [Signals.rest()], "face", 1, 0, known)
    assert (first < MOST["face"]) == known, "metres off before the first step"
    names = [name for name in prior_of(avatar, "face_colour") if before[name].is_floating_point()]
    expected = packaged if known else before
    assert all(torch.equal(avatar.face.state_dict()[name.removeprefix("face.")], expected[name]) for name in names)
    assert any(not torch.equal(packaged[name], before[name]) for name in names)


def test_stored_passes_of_before_began_with_the_prior_where_they_had_a_warm_start() -> None:
    for recipe in (QUICK, PAPER):
        stored = recipe.to_json()
        for part in ("face", "body"):
            del stored[part][0]["prior"]
        assert Recipe.from_json(stored) == recipe
    assert QUICK.body[0].prior
    assert not PAPER.body[0].prior
