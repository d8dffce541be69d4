"""What no side of a head shows: balls in balls, holes that are closed, chains of vertices."""

from __future__ import annotations

import numpy as np
import trimesh
from templates.test_face_labels import lowered

from avatarrex.distil.hidden import caps, hidden, joined_to, shown
from avatarrex.distil.rest_mesh import PART_BEGINS, _inner
from avatarrex.templates.albedo import inside_mouth
from avatarrex.templates.person import load_person


def test_a_ball_in_a_head_is_hidden_until_the_head_is_opened(monkeypatch):
    """With what is in front of it cut away, the front half of the inner ball is seen and its back half is not."""
    monkeypatch.setattr("avatarrex.distil.hidden.SIDE", 256)
    head, ball = trimesh.creation.icosphere(3, 0.1), trimesh.creation.icosphere(2, 0.04)
    vertices = np.concatenate([head.vertices, ball.vertices])
    faces = np.concatenate([head.faces, ball.faces + len(head.vertices)])
    inner = np.arange(len(vertices)) >= len(head.vertices)
    front = np.linalg.norm(vertices, axis=1) > 0.09
    front &= vertices[:, 2] > -0.01
    found = hidden(vertices, faces, inner | front)
    assert found[inner].all()
    assert not found[front].any()
    cut = faces[~((vertices[faces, 2] > 0.02) & ~inner[faces]).any(1)]
    opened = hidden(vertices, cut, inner)
    assert not opened[inner & (vertices[:, 2] > 0.01)].any()
    assert opened[inner & (vertices[:, 2] < -0.035)].all()


def test_a_lid_covers_the_half_of_an_eye_that_it_lies_before():
    """A lid as wide as the ball's upper half: points beneath it are not shown, those below its edge are, the back of the ball is not."""
    ball = trimesh.creation.icosphere(4, 0.012)
    lid = trimesh.creation.icosphere(4, 0.0145)
    upper = lid.faces[(lid.vertices[lid.faces][..., 1] > 0).all(1)]
    vertices = np.concatenate([ball.vertices, lid.vertices])
    faces = np.concatenate([ball.faces, upper + len(ball.vertices)])
    points = np.asarray(ball.vertices)
    found = shown(points, vertices, faces)
    front = points[:, 2] > 0.008
    assert found[front & (points[:, 1] < -0.0005)].all()
    assert not found[points[:, 1] > 0.0015].any()
    assert not found[points[:, 2] < -0.0115].any()
    assert shown(points, vertices, ball.faces)[front].all()


def test_what_is_no_face_is_not_hidden():
    box = trimesh.creation.box()
    assert not hidden(box.vertices, box.faces, np.zeros(8, bool)).any()


def test_a_chain_joins_what_lies_on_it():
    """0-1-2-3 and 4-5-6: from 0, what is within {1, 2, 5} is reached through it alone."""
    faces = np.array([[0, 1, 1], [1, 2, 2], [2, 3, 3], [4, 5, 5], [5, 6, 6]])
    start, within = np.zeros((2, 7), bool)
    start[0], within[[0, 1, 2, 5]] = True, True
    assert np.flatnonzero(joined_to(start, within, faces)).tolist() == [0, 1, 2]


def test_caps_close_a_tube_with_its_orientation():
    """Both ends: a solid of the cylinder's own volume. One end: the other stays open."""
    tube = trimesh.creation.cylinder(1.0, 2.0, sections=16)
    side = tube.faces[np.abs(tube.face_normals[:, 2]) < 0.5]
    rim = np.linalg.norm(tube.vertices[:, :2], axis=1) > 0.5
    whole = trimesh.Trimesh(tube.vertices, np.concatenate([side, caps(side, rim)]), process=False)
    assert whole.is_watertight
    assert whole.is_winding_consistent, "a volume alone is made consistent before it is taken"
    assert np.isclose(whole.volume, tube.volume)
    assert len(caps(side, rim & (tube.vertices[:, 2] > 0))) == 14


def test_a_fitted_chin_is_no_mouth(monkeypatch) -> None:
    """Skin that lies between the teeth and is seen, where the face was fitted lower and farther back."""
    monkeypatch.setattr("avatarrex.distil.hidden.SIDE", 256)
    base, found = load_person().body, {}
    for stay in (True, False):
        person = lowered(stay)
        mouth = _inner(person, person.blend_weight[:, 2].numpy() > PART_BEGINS)[1]
        lies = inside_mouth(person.body.v_template, base.groups) & ~inside_mouth(base.v_template, base.groups)
        found[stay] = (mouth & lies.numpy()).sum()
    assert found[False] > 100
    assert found[True] < 0.5 * found[False]
