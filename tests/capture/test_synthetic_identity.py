"""The person who is not the template: how far from it, in order, with expression shapes of its own."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from avatarrex.capture.synthetic.detail import cells, octaves
from avatarrex.capture.synthetic.identity import DIFFERENCE, EYE_RIGID, _bend, _field, other_person, own_expressions
from avatarrex.capture.synthetic.solid_distance import SolidUnion
from avatarrex.capture.synthetic.subject import FACE_SOLIDS, Subject, load_subject
from avatarrex.capture.synthetic.variation import Variation
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.library import named_hand
from avatarrex.templates.model import TemplateModel

EYES = ("left_eye", "right_eye")


@pytest.fixture(scope="module")
def default() -> Subject:
    return load_subject()


@pytest.fixture(scope="module")
def other(default: Subject) -> Subject:
    """Another face on the template's expression shapes."""
    return other_person(default)


@pytest.fixture(scope="module")
def own(other: Subject) -> Subject:
    """With its own."""
    return own_expressions(other)


def part(subject: Subject, name: str) -> np.ndarray:
    """Vertices of a part of the skin."""
    return np.unique(subject.faces[subject.part_of_face == subject.parts.index(name)])


def left_by_the_template(model: TemplateModel, wanted: np.ndarray, rows: np.ndarray) -> float:
    """Millimetres (root mean square) between `wanted` (v, 3) and the nearest face or hand that the template can make of all its
    shape and expression directions, moved, turned and scaled in any way that is linear.
    """
    rest = model.v_template.double().numpy()[rows]
    directions = torch.cat([model.shapedirs, model.expression_dirs], 2).double().numpy()[rows]
    affine = np.concatenate([np.einsum("vc,dk->vdck", rest, np.eye(3)).reshape(len(rows), 3, 9)], 2)
    shift = np.broadcast_to(np.eye(3), (len(rows), 3, 3))
    basis = np.concatenate([directions, affine, shift], 2).reshape(3 * len(rows), -1)
    change = (wanted[rows] - rest).ravel()
    left = change - basis @ np.linalg.lstsq(basis, change, rcond=1e-8)[0]
    return float(1000 * np.sqrt((left.reshape(-1, 3) ** 2).sum(1).mean()))


@pytest.mark.parametrize(("name", "least"), [("face", 1.3), ("left_hand", 1.6), ("right_hand", 1.6)])
def test_the_template_cannot_be_this_person(default: Subject, other: Subject, name: str, least: float) -> None:
    """All shape and expression directions and an affine map leave more than a millimetre; of the template itself they leave nothing."""
    rows = part(default, name)
    assert left_by_the_template(default.model, other.vertices, rows) > least
    shaped = default.vertices + default.model.shapedirs[..., 1].double().numpy()
    assert left_by_the_template(default.model, 1.02 * shaped + 0.01, rows) < 1e-3


def test_it_knows_left_and_right(other: Subject, default: Subject) -> None:
    """Mirror images of the template's vertices are moved to places half a millimetre and more from mirror images."""
    rows = part(default, "face")
    away, twin = cKDTree(default.vertices[rows]).query(default.vertices[rows] * [-1, 1, 1])
    exact = away < 1e-5
    assert exact.sum() > 1000
    moved = other.vertices[rows]
    difference = np.linalg.norm(moved[exact] * [-1, 1, 1] - moved[twin[exact]], axis=1)
    assert np.median(difference) > 5e-4


def test_layers_stay_in_their_order(default: Subject, other: Subject) -> None:
    """The map of space turns nowhere inside out, joints move with it, every solid keeps a positive volume."""
    joints = default.person_joints
    field = _field(joints, default.model.joint_names, np.random.default_rng([7, 0]))
    stretch = np.linalg.det(_bend(field, default.vertices))
    assert 0.5 < stretch.min() < 0.9
    assert 1.1 < stretch.max() < 2.0
    np.testing.assert_allclose(other.model.joint_template.numpy(), joints + field(joints), atol=1e-6)
    for solid in range(1, len(default.names)):
        faces = other.faces[other.solid_of_face == solid]
        volumes = [np.einsum("fi,fi->f", np.cross(v[faces[:, 0]], v[faces[:, 1]]), v[faces[:, 2]]).sum()
                   for v in (default.vertices, other.vertices)]  # fmt: skip
        assert 0.7 < volumes[1] / volumes[0] < 1.4


def test_skin_under_cloth_stays_under_cloth(default: Subject, other: Subject) -> None:
    """As many of the tucked vertices lie inside a garment as of the default subject's, within one in a hundred."""
    pytest.importorskip("igl")
    rows = np.flatnonzero((default.solid_of_vertex == 0) & (default.openness == 0))[::7]
    inside = [(SolidUnion(s.vertices, s.faces).winding(s.vertices[rows]) > 0.5).mean() for s in (default, other)]
    assert inside[0] > 0.5
    assert abs(inside[1] - inside[0]) < 0.01


def test_eyeballs_stay_round_and_lids_on_them(default: Subject, other: Subject) -> None:
    """Distances from each eye's joint are scaled by one number, of the ball and of the lids."""
    factors = []
    for name in EYES:
        centres = [s.model.joint_template.double().numpy()[s.model.joint_names.index(name)] for s in (default, other)]
        near = np.flatnonzero(np.linalg.norm(default.vertices - centres[0], axis=1) < EYE_RIGID)
        assert set(default.solid_of_vertex[near]) >= {0, default.names.index(name)}
        radius = [np.linalg.norm(s.vertices[near] - c, axis=1) for s, c in zip((default, other), centres)]
        factor = radius[1] / radius[0]
        assert np.ptp(factor) < 1e-3
        factors.append(factor.mean())
    assert abs(factors[0] - 1) > 0.005
    assert np.ptp(factors) < 1e-4


def test_expressions_bend_with_the_face(default: Subject, other: Subject) -> None:
    """The moved direction is the difference of the moved ends: D(x + εE) − D(x) + εE over ε."""
    field = _field(default.person_joints, default.model.joint_names, np.random.default_rng([7, 0]))
    rows, step = part(default, "face")[::20], 1e-3
    for name in ("jawOpen", "mouthSmileLeft", "browInnerUp"):
        k = EXPRESSION_NAMES.index(name)
        own = default.model.expression_dirs[rows, :, k].double().numpy()
        ends = default.vertices[rows] + step * own
        moved = (ends + field(ends) - default.vertices[rows] - field(default.vertices[rows])) / step
        found = other.model.expression_dirs[rows, :, k].double().numpy()
        assert np.linalg.norm(found - moved) < 0.01 * np.linalg.norm(moved)
        assert np.linalg.norm(own - moved) > 0.03 * np.linalg.norm(moved)


def test_every_expression_shape_differs_by_its_share(other: Subject, own: Subject) -> None:
    """By a tenth to three tenths, each by another amount, and not by a factor alone."""
    moving = np.isin(np.array(own.names)[own.solid_of_vertex], ("body", *FACE_SOLIDS))
    before, after = (s.model.expression_dirs.double().numpy()[moving].reshape(-1, 52) for s in (other, own))
    share = np.linalg.norm(after - before, axis=0) / np.linalg.norm(before, axis=0)
    assert share.min() >= DIFFERENCE[0] - 1e-4
    assert share.max() <= DIFFERENCE[1] + 1e-4
    assert np.std(share) > 0.03
    factor = (after * before).sum(0) / (before**2).sum(0)
    shape = np.linalg.norm(after - factor * before, axis=0) / np.linalg.norm(before, axis=0)
    assert np.median(shape) > 0.08


def test_lids_still_close(other: Subject, own: Subject) -> None:
    """Within 2 cm of an eye no shape differs; beyond the cheek it does."""
    centres = own.person_joints[[own.model.joint_names.index(name) for name in EYES]]
    away = np.linalg.norm(own.pattern[:, None] - centres, axis=2).min(1)
    change = np.abs((own.model.expression_dirs - other.model.expression_dirs).double().numpy()).max((1, 2))
    assert change[away < 0.019].max() == 0
    assert change[(away > 0.04) & (own.solid_of_vertex == 0) & (own.pattern[:, 1] > 0.6)].max() > 2e-3


def test_fingers_are_thicker_than_the_palm_is_wider(default: Subject, other: Subject) -> None:
    """The middle of each finger's last bone: its girth grows by more than 6 and less than 30 %."""
    weights, names = default.model.weights.double().numpy(), default.model.joint_names
    for finger in ("index1", "middle1", "ring1", "pinky1"):
        column = names.index(f"left_{finger}")
        own = np.flatnonzero((weights[:, column] > 0.95) & (default.solid_of_vertex == 0))
        thick = []
        for subject in (default, other):
            points = subject.vertices[own] - subject.vertices[own].mean(0)
            joints = subject.model.joint_template.double().numpy()
            along = joints[column + 1] - joints[column]
            across = points - np.outer(points @ along, along) / (along @ along)
            thick.append(np.linalg.norm(across, axis=1).mean())
        assert 1.06 < thick[1] / thick[0] < 1.30


def test_it_is_one_person(other: Subject) -> None:
    """The same each time, and the default subject is left as it was."""
    before = load_subject().vertices.copy()
    again = other_person(load_subject())
    np.testing.assert_array_equal(again.vertices, other.vertices)
    np.testing.assert_array_equal(load_subject().vertices, before)
    np.testing.assert_array_equal(other.pattern, before)
    assert not load_subject().palette


def test_its_colours_sit_where_they_were_painted(default: Subject, other: Subject, rng: np.random.Generator) -> None:
    """The palette alone changes: a point's colour is linear in the default's, whatever the geometry did."""
    face = rng.integers(0, len(default.faces), 4000)
    bary = rng.dirichlet(np.ones(3), 4000)
    painted, dyed = default.albedo(face, bary), other.albedo(face, bary)
    solids = np.array(default.names)[default.solid_of_face[face]]
    for name in np.unique(solids):
        here = solids == name
        expected = painted[here] @ other.palette.get(str(name), np.eye(3)).T
        np.testing.assert_allclose(dyed[here], np.clip(expected, 0, 1), atol=1e-12)
    body = solids == "body"
    assert np.abs(painted[body] - dyed[body]).mean() > 0.1


def test_fists_and_fingers_stay_outside_in(other: Subject) -> None:
    """A fist of the other hand is as closed as the default's: fingertips end within 2 cm of where that one's do, by length."""
    tips = []
    for subject in (load_subject(), other):
        signals = Signals.rest().replace(left_hand_pose=named_hand("fist", "left"))
        posed, joints = subject.pose(signals).vertices, subject.model.joint_template.double().numpy()
        hand = part(subject, "left_hand")
        length = np.linalg.norm(joints[subject.model.joint_names.index("left_middle1")] - joints[20])
        tips.append(np.ptp(posed[hand], axis=0) / length)
    np.testing.assert_allclose(tips[1], tips[0], rtol=0.25)


def test_detail_is_photographic(default: Subject, rng: np.random.Generator) -> None:
    """Every solid's colour changes by 1 to 15 %, its mean by less than 4 %; points of one triangle differ more than without."""
    detailed = Variation(conditions=("texture",)).applied(default)
    face = rng.integers(0, len(default.faces), 20_000)
    bary = rng.dirichlet(np.ones(3), 20_000)
    plain, rich = default.albedo(face, bary), detailed.albedo(face, bary)
    solids = np.array(default.names)[default.solid_of_face[face]]
    beside = rng.dirichlet(np.ones(3), 20_000)
    steps = [np.abs(s.albedo(face, beside) - s.albedo(face, bary)).mean(1) for s in (default, detailed)]
    for name in ("body", "shirt", "trousers", "left_shoe", "hair"):
        here = solids == name
        assert 0.01 < np.abs(rich[here] - plain[here]).mean() < 0.15, name
        assert np.abs(rich[here].mean(0) - plain[here].mean(0)).max() < 0.06, name
        assert steps[1][here].mean() > 1.2 * steps[0][here].mean(), name
    np.testing.assert_array_equal(default.albedo(face, bary), plain)


def test_noise_has_every_scale(rng: np.random.Generator) -> None:
    """Octaves: points 1 mm apart already differ, points 6 cm apart do more; seeds of cells are as far apart as their number says."""
    at = rng.uniform(-1, 1, (20_000, 3))
    steps = [np.std(octaves(at + np.array([d, 0, 0])) - octaves(at)) for d in (0.0005, 0.004, 0.06)]
    assert 0.01 < steps[0] < steps[1] < steps[2] < 1.5
    distance, number = cells(at, 0.01)
    assert 0 <= number.min() < 0.01 < 0.99 < number.max() < 1
    assert distance.max() < 0.01 * np.sqrt(3)
    # a Poisson-like scatter of one seed to a cube: the mean distance is about 0.55 of its side
    assert distance.mean() == pytest.approx(0.0051, abs=0.0008)
