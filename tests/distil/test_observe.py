"""What goes with the skin around it, and what is seen between the lips: chains of triangles, a mouth in closed form."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import torch
from scipy.sparse import diags_array
from torch import Tensor
from torch.nn.functional import normalize

from avatarrex.distil.follow import Followed
from avatarrex.distil.observe import SPREAD, Observation, Observer, from_skin_around, seen_between
from avatarrex.distil.pattern import neighbourhoods
from avatarrex.signals.driving import Signals


def chain(length: int) -> np.ndarray:
    """Faces of a strip whose vertices follow each other."""
    return np.arange(length - 2)[:, None] + np.arange(3)


def test_what_is_hidden_goes_with_the_skin_around_it():
    """A strip with skin at one end and, beside it, a triangle on its own: the strip takes the skin's offset as far as it is near."""
    strip = 3 * SPREAD
    faces = np.concatenate([chain(strip), [[strip, strip + 1, strip + 2]]])
    inner = np.arange(strip + 3) >= 2
    offset = np.full((len(inner), 3), 9.0)
    offset[:2] = [[1.0, 2.0, 3.0]] * 2
    found = from_skin_around(offset, inner, neighbourhoods(faces[:0], faces, len(inner))[1])
    near = 2 + 2 * SPREAD  # two vertices a triangle's step
    assert np.allclose(found[:near], [1.0, 2.0, 3.0])
    assert not found[near:].any(), "too far from skin, or joined to none"


def test_between_two_lips_it_is_the_mean_and_skin_keeps_its_own():
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    offset = np.array([[0.0, 0, 1], [9, 9, 9], [9, 9, 9], [0, 0, 3]])
    found = from_skin_around(offset, np.array([False, True, True, False]), neighbourhoods(faces[:0], faces, 4)[1])
    assert np.array_equal(found[[0, 3]], offset[[0, 3]])
    assert np.allclose(found[[1, 2]], [0, 0, 2])


def test_a_mouth_is_coloured_where_a_gaze_from_between_the_lips_meets_it():
    """A cavity of 2 cm behind lips at z = 1 cm, the template's mouth deeper than it: on the wall, facing the viewer, and found."""

    def sdf(position: Tensor) -> Tensor:
        return 0.02 - position.norm(dim=-1)

    position = torch.tensor([[0.01, 0, 0.01], [-0.01, 0, 0.004], [0, 0, -0.05], [0.3, 0, 0.1]])
    mouth, rim = torch.tensor([[False, False, True, False], [True, True, False, False]])
    still, sideways = torch.zeros(4, 3, 4), torch.tensor([[1.0, 0, 0]] * 4)
    followed = Followed(
        position, position, position, still, sideways, torch.tensor([True, True, False, False]), 0 * position
    )
    seen = seen_between(sdf, followed, mouth, rim)
    assert torch.allclose(seen.position[2], torch.tensor([0.0, 0.0, -0.02]), atol=2e-5)
    assert seen.normal[2].tolist() == [0, 0, 1]
    assert seen.found.tolist() == [True, True, True, False]
    others = ~mouth
    assert torch.equal(seen.position[others], position[others])
    assert torch.equal(seen.normal[others], sideways[others])


def test_colours_of_a_face_are_looked_at_as_the_skin_around_faces():
    """A lid's edge faces up, and nobody looks at it from above; other skin is seen along its normal."""
    up, zero = torch.tensor([[0.0, 1, 0]] * 2), torch.zeros(2, 3)
    broad = torch.tensor([[0.0, 0, 1], [0, 0, 0]])
    gaze = Followed(zero, zero, zero, torch.zeros(2, 3, 4), up, torch.ones(2, dtype=torch.bool), broad).gaze
    assert torch.allclose(gaze, torch.tensor([[0, -(0.1**0.5), -(0.9**0.5)], [0, -1, 0]]))


def test_the_gaze_starts_as_far_in_front_as_the_lips_reach():
    """A vertex beside the opening is met along the line from there, not from the middle of the lips' depth."""

    def sdf(position: Tensor) -> Tensor:
        return 0.02 - position.norm(dim=-1)

    position = torch.tensor([[0.01, 0, 0.01], [-0.01, 0, -0.01], [0.05, 0, 0.01]])
    mouth = torch.tensor([False, False, True])
    followed = Followed(
        position, position, position, torch.zeros(3, 3, 4), position, torch.zeros(3, dtype=torch.bool), position
    )
    met = seen_between(sdf, followed, mouth, ~mouth).position[2]
    assert torch.allclose(met, torch.tensor([0.0003**0.5, 0.0, 0.01]), atol=2e-5)


def test_a_mouth_is_looked_at_along_the_gaze_that_meets_it():
    """What lies deeper is seen along that: a molar through the middle of the lips, not straight behind."""
    position = torch.tensor([[0.01, 0, 0.01], [-0.01, 0, 0.01], [0.02, 0, -0.01]])
    mouth = torch.tensor([False, False, True])
    followed = Followed(
        position, position, position, torch.zeros(3, 3, 4), position, torch.zeros(3, dtype=torch.bool), position + 1
    )
    seen = seen_between(lambda place: place[:, 2] + 0.005, followed, mouth, ~mouth)
    line = normalize(torch.tensor([0.02, 0, -0.02]), dim=0)
    assert torch.allclose(seen.gaze[2], line, atol=1e-5)
    assert torch.allclose(seen.position[2], torch.tensor([0.015, 0, -0.005]), atol=2e-4)


def test_eyes_and_mouth_have_no_colours_but_the_texture_s():
    """What turns or opens shows other places at a vertex: no tint of an expression, none of a pose, and none for the skin beside."""
    count = 6
    neutral, turned = (
        Observation(*np.zeros((2, count, 3)), albedo, np.ones(count, bool)) for albedo in np.zeros((2, count, 3))
    )
    turned.albedo[:] = 0.1
    turned.albedo[:2] = 0.9  # an iris where white was
    inner, lips = np.arange(count) < 2, np.arange(count) == 5
    chain = diags_array([np.ones(count - 1), np.ones(count), np.ones(count - 1)], offsets=[-1, 0, 1])
    smooth = (diags_array(1 / chain.sum(1)) @ chain).tocsr()
    observer = SimpleNamespace(neutral=neutral, mesh=SimpleNamespace(inner=inner), lips=lips, smooth=smooth)
    observer._without_gaps = lambda signals, one: one.shift
    assert np.allclose(Observer.tinted(observer, turned)[:, 0], [0, 0, 0.1, 0.1, 0.1, 0])
    found = Observer.residuals(observer, [Signals.rest()], [turned], np.zeros((count, 3)))
    assert np.allclose(found.value[0, :, 3], [0, 0, 0.1, 0.1, 0.1, 0.1])


def test_a_throat_goes_with_the_jaw_as_its_neighbours_do():
    """The cubes' vertices take the mean of what was found around; a lost one says nothing, a face's own stays as it is."""
    count = 7
    rest, opened = (Observation(*np.zeros((2, count, 3)), np.zeros((count, 3)), np.ones(count, bool)) for _ in range(2))
    opened.shift[:4, 1] = -0.02
    opened.shift[5:, 1] = -0.01
    opened.shift[2, 1], opened.found[2] = 0.3, False
    own = np.arange(count) >= 5
    chain = diags_array([np.ones(count - 1), np.ones(count), np.ones(count - 1)], offsets=[-1, 0, 1])
    smooth = (diags_array(1 / chain.sum(1)) @ chain).tocsr()
    mesh = SimpleNamespace(inner=np.zeros(count, bool))
    moved = Observer.moved(SimpleNamespace(neutral=rest, mesh=mesh, own=own, smooth=smooth), opened)[:, 1]
    assert np.allclose(moved[:2], -0.02)
    assert np.allclose(moved[own], -0.01)
    assert -0.02 <= moved[2] < -0.01
    assert (np.diff(moved[:5]) >= -1e-12).all()
