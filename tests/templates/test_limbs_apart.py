"""Offsets of the skin move their own limb and finger alone, and take each other's place without a step."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from avatarrex.capture.fit import surface_fit
from avatarrex.errors import InputError
from avatarrex.signals.joints import FINGERS, JOINT_NAMES
from avatarrex.templates.face_offsets import mesh_edges
from avatarrex.templates.person import Person, load_person
from avatarrex.templates.person_fit import PersonFit, SurfaceOffsets, places


@pytest.fixture(scope="module")
def person() -> Person:
    return load_person()


@pytest.fixture(scope="module")
def field(person: Person) -> surface_fit._Field:
    return surface_fit._Field(person)


def finger_of(person: Person) -> np.ndarray:
    """Which finger of which hand carries a vertex alone; −1 for none."""
    weights, owner = person.body.weights.numpy(), np.full(len(person.body.weights), -1)
    chains = [[f"{side}_{finger}{k}" for k in (1, 2, 3)] for side in ("left", "right") for finger in FINGERS]
    for number, chain in enumerate(chains):
        owner[weights[:, [JOINT_NAMES.index(joint) for joint in chain]].sum(1) > 0.98] = number
    return owner


def shared(weights: csr_array, owner: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Of every finger's vertices, the weight of another finger's offsets."""
    table = weights.tocoo()
    theirs = (owner[nodes][table.col] != owner[table.row]) & (owner[nodes][table.col] >= 0) & (owner[table.row] >= 0)
    return np.bincount(table.row[theirs], table.data[theirs], minlength=len(owner))


def test_a_finger_follows_its_own_offsets(person: Person, field: surface_fit._Field) -> None:
    owner = finger_of(person)
    assert (np.bincount(owner[owner >= 0]) > 100).all()
    assert (np.bincount(owner[field.nodes][owner[field.nodes] >= 0]) >= 9).all()
    assert shared(field.weights, owner, field.nodes).max() < 0.05  # where fingers begin
    together = SurfaceOffsets(field.still.vertices, field.still.offsets, eyes_stay=True).weights(person.body)
    assert shared(together, owner, field.nodes).max() > 0.3  # by distance alone


def test_weights_take_each_others_place_without_a_step(person: Person, field: surface_fit._Field) -> None:
    """Along an edge of the mesh no weight changes by more than the way along it, in units of the spacing, allows."""
    edges, hand = mesh_edges(person.body).tocoo(), person.hand_weight.numpy() == 1
    both = (hand[edges.row] & hand[edges.col]) & (edges.row < edges.col)
    ends = np.stack([edges.row[both], edges.col[both]], 1)
    apart = np.linalg.norm(np.diff(places(person.body)[ends], axis=1)[:, 0], axis=1)
    ends, apart = ends[apart < 0.002], apart[apart < 0.002]
    assert len(ends) > 400

    def steepest(weights: csr_array) -> float:
        change = abs(weights[ends[:, 0]] - weights[ends[:, 1]]).max(axis=1).toarray().ravel()
        return float((change * surface_fit.HAND_NODE_SPACING / apart).max())

    together = SurfaceOffsets(field.still.vertices, field.still.offsets, eyes_stay=True).weights(person.body)
    assert steepest(field.weights) < 1
    assert steepest(together) > 1.5  # those of before


def test_weights_sum_to_one_and_nodes_are_as_near_as_told(person: Person, field: surface_fit._Field) -> None:
    near_eyes = SurfaceOffsets(field.still.vertices, field.still.offsets, limbs_apart=True).weights(person.body)
    np.testing.assert_allclose(near_eyes.sum(1), 1, atol=1e-12)
    assert (near_eyes.data >= 0).all()
    place = places(person.body)
    away = cKDTree(place[field.nodes]).query(place)[0]
    hand = person.hand_weight.numpy() > 0
    assert away[hand].max() < surface_fit.HAND_NODE_SPACING
    assert surface_fit.HAND_NODE_SPACING < away[~hand].max() < surface_fit.NODE_SPACING


def test_offsets_that_are_too_few_or_elsewhere_are_named(person: Person) -> None:
    def weights(*vertices: int, apart: bool = True) -> csr_array:
        return SurfaceOffsets(vertices, np.zeros((len(vertices), 3)), limbs_apart=apart).weights(person.body)

    assert weights(*range(0, 800, 100), apart=False).shape == (len(person.body.weights), 8)
    assert np.isfinite(weights(*range(0, 900, 100), *[5] * 9).data).all()
    for broken in (range(0, 800, 100), [5] * 20, [*range(0, 900, 100), 10**6], [*range(0, 900, 100), -1]):
        with pytest.raises(InputError, match=r"surface\.vertices"):
            weights(*broken)


def test_the_file_says_which(field: surface_fit._Field) -> None:
    fit = PersonFit(np.zeros(10), np.zeros((55, 3)), field.still)
    written = fit.to_json()
    again = PersonFit.from_json(written, "avatar.json").surface
    assert again is not None
    assert again.limbs_apart
    assert again.eyes_stay
    del written["surface"]["limbs_apart"]
    before = PersonFit.from_json(written, "avatar.json").surface
    assert before is not None
    assert not before.limbs_apart
    written["surface"]["limbs_apart"] = 1
    with pytest.raises(InputError, match=r"avatar\.json: person_fit\.surface\.limbs_apart"):
        PersonFit.from_json(written, "avatar.json")
