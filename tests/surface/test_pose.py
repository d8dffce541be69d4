"""`pose_surface`: closed forms, compiled loops against the reference, what is kept from a previous pose."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from surface.template_surface import template_surface

from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.surface.pose import PosedSurface, pose_surface, rings
from avatarrex.templates.model import pose_template
from avatarrex.templates.person import load_person

PERSON = load_person()
ELBOW, WRIST = 18, 20


def drawn(seed: int, scale: float = 0.4) -> Signals:
    """A signal in which everything changes."""
    rng = np.random.default_rng(seed)
    pose = rng.normal(size=(55, 3)) * scale
    return Signals.from_full_pose(pose, expression=rng.uniform(size=52), shape=rng.normal(size=10))


def posed(signals: Signals, amplitude: float = 0.0, **options) -> PosedSurface:
    return pose_surface(template_surface(amplitude), PERSON, signals, **options)


def same(a: PosedSurface, b: PosedSurface) -> bool:
    """Bit for bit."""
    arrays = ("vertices", "normals", "tint", "joint_transforms")
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in arrays)


def test_at_rest_it_is_the_rest_mesh():
    at_rest = posed(Signals.rest())
    assert np.abs(at_rest.vertices - template_surface().vertices).max() < 1e-6
    assert not at_rest.tint.any()
    outward = PERSON.body.normals.numpy()
    assert (at_rest.normals * outward).sum(1).min() > 0.999
    assert np.allclose(np.linalg.norm(at_rest.normals, axis=1), 1, atol=1e-6)


def test_the_root_s_placement_is_not_in_it():
    turned = Signals.rest().replace(global_orient=np.array([0.3, 1.0, -2.0]), translation=np.array([5.0, 0, 1]))
    assert same(posed(turned), posed(Signals.rest()))
    world = posed(turned).world_from_root(turned)
    pelvis = PERSON.body.joint_template[0].double().numpy()
    assert np.allclose(world[:3, :3] @ pelvis + world[:3, 3], pelvis + np.array([5, 0, 1]))
    assert np.allclose(world[:3, :3], Rotation.from_rotvec([0.3, 1.0, -2.0]).as_matrix())


def test_what_one_joint_carries_turns_rigidly_about_it():
    signals = Signals.rest()
    pose = signals.full_pose()
    pose[ELBOW] = (0, -1.2, 0.4)
    bent = posed(Signals.from_full_pose(pose))
    surface, joint = template_surface(), PERSON.body.joint_template[ELBOW].double().numpy()
    carried = (surface.joint[:, 0] == ELBOW) & (surface.weight[:, 0] == 1)
    assert carried.sum() > 20
    turn = Rotation.from_rotvec(pose[ELBOW]).as_matrix()
    wanted = (surface.vertices[carried] - joint) @ turn.T + joint
    assert np.abs(bent.vertices[carried] - wanted).max() < 1e-6
    away = ~(np.isin(surface.joint, _below(ELBOW)) & (surface.weight > 0)).any(1)
    assert away.any()
    assert np.abs(bent.vertices[away] - surface.vertices[away]).max() < 1e-6


def test_a_second_bone_turns_about_where_the_first_has_brought_it():
    pose = np.zeros((55, 3))
    pose[ELBOW], pose[WRIST] = (0, -1.2, 0.4), (0.5, 0, 0.3)
    bent = posed(Signals.from_full_pose(pose))
    rest = PERSON.body.joint_template.double().numpy()
    elbow, wrist = (Rotation.from_rotvec(pose[j]).as_matrix() for j in (ELBOW, WRIST))
    at_wrist = elbow @ (rest[WRIST] - rest[ELBOW]) + rest[ELBOW]
    assert np.allclose(bent.joint_transforms[WRIST, :3, 3], at_wrist)
    assert np.allclose(bent.joint_transforms[WRIST, :3, :3], elbow @ wrist)
    surface = template_surface()
    carried = (surface.joint[:, 0] == WRIST) & (surface.weight[:, 0] == 1)
    wanted = (surface.vertices[carried] - rest[WRIST]) @ (elbow @ wrist).T + at_wrist
    assert np.abs(bent.vertices[carried] - wanted).max() < 1e-6


def test_half_the_weight_on_each_of_two_bones_is_the_mean_of_both():
    surface = template_surface()
    joint, weight = np.zeros_like(surface.joint), np.zeros_like(surface.weight)
    joint[:, 1] = 16
    weight[:, :2] = 0.5
    pose = np.zeros((55, 3))
    pose[16] = (0, 0, 1.0)
    bent = pose_surface(replace(surface, joint=joint, weight=weight), PERSON, Signals.from_full_pose(pose))
    about = PERSON.body.joint_template[16].double().numpy()
    turned = (surface.vertices - about) @ Rotation.from_rotvec(pose[16]).as_matrix().T + about
    assert np.abs(bent.vertices - (surface.vertices + turned) / 2).max() < 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_the_loops_are_the_reference(seed):
    fast, slow = (posed(drawn(seed), 0.002, impl=impl) for impl in ("auto", "reference"))
    assert np.abs(fast.vertices - slow.vertices).max() < 1e-6
    assert np.abs(fast.tint - slow.tint).max() < 1e-6
    assert np.abs(fast.joint_transforms - slow.joint_transforms).max() < 1e-12
    # A millimetre's edge whose ends are rounded to 1e-7 m turns by 1e-4.
    assert np.abs(fast.normals - slow.normals).max() < 1e-3


def test_shape_and_expression_move_it_as_the_template_does():
    signals = drawn(1, 0.0)
    shape, expression = torch.tensor(signals.shape), torch.tensor(signals.expression)
    wanted = pose_template(PERSON.body.double(), torch.zeros(55, 3).double(), shape, expression)
    assert np.abs(posed(signals).vertices - wanted.vertices.numpy()).max() < 1e-5


def test_expressions_tint_what_they_move_and_nothing_else():
    surface, signals = template_surface(), Signals.rest().replace(expression=np.eye(52)[3] * 0.5)
    tint = posed(signals).tint
    assert np.allclose(tint[surface.morph_vertex], 0.01)
    assert not np.delete(tint, surface.morph_vertex, 0).any()


def test_a_correction_is_clipped_to_what_was_fitted():
    base = template_surface(0.001)
    far = drawn(5, 1.5)
    group = len(base.correction.joints)
    tight = replace(
        base.correction, low=np.full((group, 4), -0.01, np.float32), high=np.full((group, 4), 0.02, np.float32)
    )
    clipped, free = (pose_surface(replace(base, correction=c), PERSON, far) for c in (tight, base.correction))
    amount = clipped.state.amount
    assert (amount.min(), amount.max()) == pytest.approx((-0.01, 0.02))
    assert np.abs(free.state.amount).max() == 1
    wanted = np.einsum("vrc,vr->vc", base.correction.basis[..., 3:], amount[base.correction.group])
    morph = np.zeros_like(wanted)
    morph[base.morph_vertex] = 0.02 * far.expression.sum()
    assert np.allclose(clipped.tint, wanted + morph, atol=1e-6)


def test_a_correction_is_by_how_like_the_pose_is_to_those_that_were_fitted():
    base, pose = template_surface(1.0), np.zeros((55, 3))
    pose[ELBOW] = (0.1, 0.2, 0.3)
    own = Rotation.from_rotvec(pose[ELBOW]).as_matrix()
    wanted = np.zeros(4)
    for fitted, weights in zip(base.correction.poses, base.correction.weights[ELBOW].astype(float)):
        other = Rotation.from_rotvec(fitted[ELBOW].astype(float)).as_matrix()
        alike = 0.5 * ((own - np.eye(3)) * (other - np.eye(3))).sum()
        wanted += weights * (alike + np.exp(-0.25 * np.square(own - other).sum()))
    still, amount = (
        pose_surface(base, PERSON, Signals.from_full_pose(turned)).state.amount for turned in (np.zeros((55, 3)), pose)
    )
    assert np.allclose(amount[ELBOW], np.clip(wanted, -1, 1))
    assert np.array_equal(np.delete(amount, ELBOW, 0), np.delete(still, ELBOW, 0))


def changed(before: Signals, after: Signals) -> tuple[int, PosedSurface, PosedSurface]:
    """Vertices placed by the change; the pose with and without a previous one."""
    counters, first = Counters(), posed(before, 0.002)
    second = posed(after, 0.002, previous=first, counters=counters)
    assert same(second, posed(after, 0.002)), "what is kept is what would be computed"
    return counters["surface_vertices"], first, second


def test_nothing_new_is_the_same_object():
    signals = drawn(0)
    placed, first, second = changed(signals, signals)
    assert placed == 0
    assert second is first
    placed, first, second = changed(signals, signals.replace(translation=np.ones(3), global_orient=np.ones(3)))
    assert placed == 0
    assert second is first


def test_an_expression_moves_its_vertices_alone():
    signals = drawn(0)
    placed, _, _ = changed(signals, signals.replace(expression=signals.expression[::-1]))
    assert placed == len(template_surface().morph_vertex)


def test_a_finger_moves_its_hand_alone():
    signals = drawn(0)
    pose = signals.left_hand_pose.copy()
    pose[0] += 0.3
    placed, first, second = changed(signals, signals.replace(left_hand_pose=pose))
    surface = template_surface()
    carried = (np.isin(surface.joint, (25, 26, 27)) & (surface.weight > 0)).any(1)
    assert placed == (carried | np.isin(surface.correction.group, (25, 26, 27))).sum()
    assert (first.normals != second.normals).any(1).sum() > placed, "the faces next to them turn"


def test_a_vertex_that_moves_alone_turns_its_neighbours():
    base = template_surface()
    one = base.morph_vertex[100:101]
    surface = replace(base, morph_vertex=one, morph=base.morph[:, :1] * 0, morph_colour=base.morph_colour[:, :1])
    surface.morph[0, 0] = 0.004, 0.01, 0.02
    smile = Signals.rest().replace(expression=np.eye(52)[0])
    first = pose_surface(surface, PERSON, Signals.rest())
    second = pose_surface(surface, PERSON, smile, first)
    assert same(second, pose_surface(surface, PERSON, smile))
    turned = np.flatnonzero((first.normals != second.normals).any(1))
    assert len(turned) >= 3, "its own is that of the ring about it, and does not"
    assert set(turned) <= set(surface.faces[(surface.faces == one[0]).any(1)].ravel())


@pytest.mark.parametrize("field", ["body_pose", "shape"])
def test_a_pose_or_a_shape_moves_everything_that_it_may(field):
    signals = drawn(0)
    placed, _, _ = changed(signals, signals.replace(**{field: getattr(signals, field) * 0.9}))
    assert placed == len(template_surface().vertices)


def test_a_pose_of_another_surface_or_person_is_not_kept():
    first, other = posed(drawn(0)), dataclasses.replace(template_surface())
    assert pose_surface(other, PERSON, drawn(0), first).surface is other
    stranger = dataclasses.replace(PERSON)
    assert pose_surface(template_surface(), stranger, drawn(0), first).person is stranger


def test_a_shape_that_the_template_does_not_have_is_refused():
    body = replace(
        PERSON.body, shapedirs=PERSON.body.shapedirs[..., :3], joint_shapedirs=PERSON.body.joint_shapedirs[..., :3]
    )
    with pytest.raises(InputError, match="shape"):
        pose_surface(template_surface(), replace(PERSON, body=body), drawn(0))


def test_rings_have_each_face_at_each_of_its_corners():
    start, ring = rings(np.array([[0, 1, 2], [0, 2, 3]], np.int32), 5)
    assert start.tolist() == [0, 2, 3, 5, 6, 6]
    assert ring.tolist() == [[1, 2], [2, 3], [2, 0], [0, 1], [3, 0], [0, 2]]


def test_a_vertex_without_a_face_has_a_unit_normal():
    surface = template_surface()
    lonely = replace(surface, faces=surface.faces[:1], uv_faces=surface.uv_faces[:1])
    for impl in ("auto", "reference"):
        assert np.allclose(np.linalg.norm(pose_surface(lonely, PERSON, drawn(0), impl=impl).normals, axis=1), 1)


def _below(joint: int) -> list[int]:
    """The joint and all that hang on it."""
    found = [joint]
    for child, parent in enumerate(PERSON.body.parents):
        if parent in found:
            found.append(child)
    return found
