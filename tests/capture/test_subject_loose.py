"""The second garment: a wide tunic, closed, far off the skin, of another topology than the template."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from avatarrex.capture.synthetic.motions import body_motion
from avatarrex.capture.synthetic.plan import GIRTH
from avatarrex.capture.synthetic.solid_distance import SolidUnion
from avatarrex.capture.synthetic.subject import Subject, load_subject
from avatarrex.signals.driving import Signals


@pytest.fixture
def loose() -> Subject:
    """The packaged subject in the tunic."""
    return load_subject("loose")


def solid(subject: Subject, name: str) -> trimesh.Trimesh:
    """One solid at rest."""
    faces = subject.faces[subject.solid_of_face == subject.names.index(name)]
    return trimesh.Trimesh(subject.vertices, faces, process=False)


def test_every_solid_is_closed_and_faces_outwards(loose: Subject) -> None:
    assert "tunic" in loose.names
    assert "shirt" not in loose.names
    for name in loose.names:
        assert solid(loose, name).is_watertight, name
        assert solid(loose, name).volume > 0, name


def test_the_tunic_stands_off_the_body_and_bridges_the_legs(loose: Subject) -> None:
    person = load_subject("default").person.body
    skin = person.v_template.double().numpy()[person.groups["body"].numpy()]
    cloth = loose.vertices[loose.masks["interior"] > 0.99]
    tunic = cloth[loose.solid_of_vertex[loose.masks["interior"] > 0.99] == loose.names.index("tunic")]
    away = cKDTree(skin).query(tunic)[0]
    assert np.median(away) > 0.03
    assert np.quantile(away, 0.9) > 0.07
    between = np.array([[0.0, -0.22, 0.0], [0.0, -0.30, 0.0]])
    assert cKDTree(skin).query(between)[0].min() > 0.02  # air between the template's thighs
    tunic_faces = loose.faces[loose.solid_of_face == loose.names.index("tunic")]
    assert (SolidUnion(loose.vertices, tunic_faces).winding(between) > 0).all()


def test_bare_hands_are_the_templates_hands(loose: Subject) -> None:
    left = np.unique(loose.faces[loose.faces_of("left_hand")])
    posed, other = (load_subject(name).pose(Signals.rest()) for name in ("loose", "default"))
    np.testing.assert_array_equal(posed.vertices[left], other.vertices[left])


def test_poses_stay_finite_and_hands_outside_the_tunic(loose: Subject) -> None:
    """Hands on hips press into the tunic by less than five centimetres."""
    igl = pytest.importorskip("igl")
    owner = np.array(loose.model.joint_names)[loose.model.weights.argmax(1).numpy()]
    bare = loose.solid_of_vertex == 0
    hand = np.flatnonzero(
        bare & np.array([n.endswith("wrist") or (n[-1].isdigit() and "spine" not in n) for n in owner])
    )[::5]
    tunic = np.ascontiguousarray(loose.faces[loose.solid_of_face == loose.names.index("tunic")])
    for signals in body_motion(80, 0, GIRTH["loose"])[5::9]:
        posed = loose.pose(signals)
        assert np.isfinite(posed.vertices).all()
        inside = igl.fast_winding_number(posed.vertices, tunic, posed.vertices[hand]) > 0.5
        if inside.any():
            squared = igl.point_mesh_squared_distance(posed.vertices[hand][inside], posed.vertices, tunic)[0]
            assert np.sqrt(np.max(squared)) < 0.05
