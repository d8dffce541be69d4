"""The clothed subject: closed solids, exact distances, colours, and poses that stay finite."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree

from avatarrex.camera import Camera
from avatarrex.capture.synthetic.rasteriser import draw_reference
from avatarrex.capture.synthetic.subject import PosedSubject, Subject, load_subject
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.templates.model import pose_template
from avatarrex.templates.person import load_person

igl = pytest.importorskip("igl")


def bent(**angles: tuple[float, float, float]) -> Signals:
    """Signals with some joints turned, degrees."""
    names = load_subject().model.joint_names
    pose = np.zeros((55, 3))
    for name, angle in angles.items():
        pose[names.index(name)] = np.radians(angle)
    return Signals.from_full_pose(pose)


@lru_cache(maxsize=1)
def crouched() -> PosedSubject:
    """A pose in which solids cut deep into each other; shared, for its distance structure takes a second."""
    return load_subject().pose(
        bent(
            left_hip=(-90, 0, 10), right_hip=(-70, 0, -10), left_knee=(110, 0, 0), spine1=(20, 10, 0),
            left_shoulder=(0, 20, -60), right_shoulder=(0, 0, 70), left_elbow=(0, -100, 0), left_index1=(0, 0, -60),
        )
    )  # fmt: skip


def near(posed: PosedSubject, count: int, rng: np.random.Generator, spread: float) -> tuple[np.ndarray, np.ndarray]:
    """Points at Gaussian `spread` metres off the outer surface along its normal, and their distance."""
    position, normal = posed.at(*posed.sample(count, rng))
    points = position + normal * rng.normal(0, spread, (count, 1))
    return points, posed.signed_distance(points)


@pytest.fixture
def subject() -> Subject:
    """The packaged subject."""
    return load_subject()


def test_hands_and_nearly_all_of_the_face_are_the_templates(subject: Subject) -> None:
    """At rest, to a micrometre; what README and avatar.json say of the packaged avatar."""
    person = load_person()
    apart = cKDTree(subject.vertices).query(person.body.v_template.double().numpy())[0]
    same = apart < 1e-6
    assert all(same[hand.body_vertex_ids.numpy()].all() for hand in (person.left_hand, person.right_hand))
    face = same[person.face.body_vertex_ids.numpy()]
    assert round(face[person.face.blend_weight.numpy() > 0.5].mean(), 2) == 0.95


def test_every_solid_is_closed_and_faces_outwards(subject: Subject) -> None:
    assert set(subject.names) >= {"body", "shirt", "trousers", "left_shoe", "right_shoe", "hair", "left_eye", "tongue"}
    for number, name in enumerate(subject.names):
        faces = subject.faces[subject.solid_of_face == number]
        solid = trimesh.Trimesh(subject.vertices, faces, process=False)
        assert solid.is_watertight, name
        assert solid.is_winding_consistent, name
        assert solid.volume > 0, name


def test_bare_hands_are_the_templates_hands(subject: Subject) -> None:
    """Hands and wrists are the person's own vertices under the person's own skinning, bit for bit."""
    signals = bent(left_wrist=(0, 20, 30), left_index1=(0, 0, -50), right_elbow=(0, 60, 0), right_thumb2=(20, 0, 0))
    pose = torch.as_tensor(np.array(signals.full_pose()), dtype=torch.float32)
    body = subject.person.body
    posed = pose_template(body, pose, torch.zeros(10), torch.zeros(52))
    hands = (subject.person.blend_weight[:, :2].amax(1) > 0).nonzero()[:, 0].numpy()
    found = subject.pose(signals).vertices[hands]
    np.testing.assert_allclose(found, posed.vertices.double().numpy()[hands], atol=2e-7)


def test_cloth_stands_off_the_skin_and_the_skin_below_is_hidden(subject: Subject) -> None:
    rest = subject.pose(Signals.rest())
    body = load_subject().person.body
    skin = body.v_template[body.groups["body"]].double().numpy()
    covered = (skin[:, 1] > -0.75) & (skin[:, 1] < 0.35)
    depth = rest.signed_distance(np.ascontiguousarray(skin[covered & (np.abs(skin[:, 0]) < 0.3)]))
    assert depth.max() < 0, "no skin shows, even untucked"
    assert np.quantile(depth, 0.995) < -0.003, "cloth is 3 mm off the skin but where a hem's lip dips into the trousers"
    assert np.median(depth) < -0.008


def test_distance_sign_and_gradient(rng: np.random.Generator) -> None:
    posed = crouched()
    points, distance = near(posed, 400, rng, 0.01)
    inside = igl.winding_number(posed.vertices, posed.faces, points) > 0.5
    np.testing.assert_array_equal(inside, distance < 0)
    on, _ = posed.at(*posed.sample(1000, rng))
    assert np.abs(posed.signed_distance(on)).max() < 1e-9
    step = 1e-6
    slopes = [posed.signed_distance(points + e) - posed.signed_distance(points - e) for e in np.eye(3) * step]
    length = np.linalg.norm(np.stack(slopes, 1) / (2 * step), axis=1)
    assert np.quantile(np.abs(length - 1), 0.98) < 1e-3, "|∇s| = 1 but on the medial axis"


def test_no_sample_is_buried(rng: np.random.Generator) -> None:
    posed = crouched()
    face, bary = posed.sample(2000, rng)
    position, colour = posed.at(face, bary)[0], posed.colour_at(face, bary)
    far = posed.signed_distance(position)
    assert np.abs(far).max() < 1e-9
    face, bary = posed.sample(150, rng, "trousers")
    corners = posed.vertices[posed.faces[face]]
    lift = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lift *= 3e-4 / np.linalg.norm(lift, axis=1, keepdims=True)
    outside = igl.winding_number(posed.vertices, posed.faces, posed.at(face, bary)[0] + lift)
    assert (outside < 0.5).mean() > 0.99, "a few lie within 0.1 mm of another solid"
    assert colour.min() >= 0
    assert colour.max() <= 1


def test_known_points(subject: Subject) -> None:
    rest = subject.pose(Signals.rest())
    far = np.array([[0, 0, 3.0], [0, 0.2, 0.0], [0.1, -0.3, 0.0], [0, 2.0, 0], [0.55, 0.455, 0.0]])
    distance = rest.signed_distance(far)
    assert distance[0] > 2.7
    assert distance[1] < -0.08
    assert distance[2] < -0.04
    assert 1.0 < distance[3] < 1.2
    assert distance[4] < -0.02


def test_colour_has_an_iris_a_print_and_stripes(subject: Subject) -> None:
    rest = subject.pose(Signals.rest())
    x = np.zeros(400)
    column = np.stack([x, np.linspace(0.0, 0.25, 400), x + 0.3], 1)
    brightness = rest.colour(column).mean(1)
    assert np.abs(np.diff(brightness > 0.55)).sum() >= 8, "stripes cross the belly"
    eye = np.array([[0.0305, 0.7230, 0.1305], [0.0305 + 0.0095, 0.7225, 0.128]])
    pupil, white = rest.colour(eye)
    assert pupil.max() < 0.2
    assert white.min() > 0.4


def test_part_labels(subject: Subject) -> None:
    rest = subject.pose(Signals.rest())
    points = np.array([[0.85, 0.45, 0.2], [-0.85, 0.45, 0.2], [0, 0.69, 0.4], [0, 0.2, 0.5], [0.14, -0.4, 0.4]])
    found = [subject.parts[k] for k in subject.part_of_face[rest.closest(points)[0]]]
    assert found == ["left_hand", "right_hand", "face", "shirt", "trousers"]
    with pytest.raises(InputError, match="one of skin"):
        subject.faces_of("wings")


def test_wrinkles_follow_the_pose(subject: Subject) -> None:
    assert not subject.pose(Signals.rest()).wrinkle.any()
    knee = subject.pose(bent(left_knee=(100, 0, 0))).wrinkle
    moved = np.abs(knee) > 1e-3
    assert 0.003 < np.abs(knee).max() < 0.009
    assert moved.sum() > 100
    assert (subject.vertices[moved, 0] > 0).all(), "the other knee stays smooth"


def test_mouth_opens_and_lids_close(subject: Subject) -> None:
    names = subject.model.expression_names

    def label(**coefficients: float) -> str:
        expression = np.array([coefficients.get(name, 0.0) for name in names])
        posed = subject.pose(Signals.rest().replace(expression=expression))
        camera = Camera.orbit(0.0, 0.0, 0.3, 20.0, (0.0305, 0.7230, 0.0), 9, 9)
        return subject.parts[subject.part_of_face[visible_faces(posed.vertices, posed.faces, camera)[0][4, 4]]]

    assert label() == "left_eye"
    assert label(eyeBlinkLeft=1.0) == "face"
    open_mouth = subject.pose(Signals.rest().replace(expression=np.array([float(n == "jawOpen") for n in names])))
    closed = subject.pose(Signals.rest())
    between = np.array([[0.0, 0.640, 0.125]])
    assert closed.solids.winding(between)[0] >= 1
    assert open_mouth.solids.winding(between)[0] == 0


def test_deterministic(subject: Subject) -> None:
    signals = bent(left_hip=(-40, 0, 0))
    a, b = subject.pose(signals), load_subject().pose(signals)
    np.testing.assert_array_equal(a.vertices, b.vertices)
    one = a.sample(50, np.random.default_rng(3))
    two = b.sample(50, np.random.default_rng(3))
    np.testing.assert_array_equal(one[1], two[1])


def test_extreme_poses_stay_finite(subject: Subject, rng: np.random.Generator) -> None:
    for k in range(2):
        pose = rng.uniform(-np.pi, np.pi, (55, 3)) if k else np.full((55, 3), np.pi)
        posed = subject.pose(Signals.from_full_pose(pose, expression=rng.random(52)))
        assert np.isfinite(posed.vertices).all()
        points, distance = near(posed, 200, rng, 0.02)
        assert np.isfinite(distance).all()
        assert np.isfinite(posed.colour(points)).all()


def test_root_motion_is_left_out(subject: Subject) -> None:
    moved = Signals.rest().replace(global_orient=np.array([0.3, 1.0, 0]), translation=np.array([5.0, 0, 0]))
    np.testing.assert_array_equal(subject.pose(moved).vertices, subject.pose(Signals.rest()).vertices)


def test_the_reference_picture_shows_the_person(subject: Subject) -> None:
    """You should see a person in a striped shirt: shirt, skin and background where they belong."""
    camera = Camera.orbit(0.0, 0.0, 2.9, 40.0, (0.0, -0.05, 0.0), 64, 64)
    picture = draw_reference(subject.pose(Signals.rest()), subject.openness, camera, 2).colour
    assert picture.shape == (64, 64, 4)
    assert (picture[0, 0] == 0).all()
    solid = picture[picture[..., 3] == 1, :3]
    assert (solid.std(1) > 0.03).sum() > 150


def test_a_subject_of_another_person_is_refused(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "subject.npz"
    np.savez(path, person_hash=np.array("0123"))
    with pytest.raises(InputError, match="build_subject"):
        load_subject(str(path))
