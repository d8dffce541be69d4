"""Folds drawn flat: ears of the template; what is smooth stays."""

import numpy as np
import torch

from avatarrex.fields.membrane import membrane
from avatarrex.ops.closest_triangle import closest_triangle
from avatarrex.ops.search_tree import SearchTree
from avatarrex.templates.person import load_person


def test_places_beside_an_ear_follow_each_other() -> None:
    """Walks up past the ear into the hair: on the template their closest places jump by a centimetre, on the membrane they do not."""
    body = load_person().body
    skin = membrane(body.v_template, body.faces).numpy()
    for forward in (0.015, 0.02, 0.025, 0.03):
        walk = np.stack([np.full(300, 0.082), np.linspace(0.685, 0.745, 300), np.full(300, forward)], 1)
        steps = []
        for mesh in (body.v_template.double().numpy(), skin):
            face, weight = closest_triangle(SearchTree.of_triangles(mesh, body.faces.numpy()), walk)
            place = np.einsum("pk,pkc->pc", weight, mesh[body.faces.numpy()[face]])
            steps.append(np.linalg.norm(np.diff(place, axis=0), axis=1).max())
        assert steps[0] > 0.008
        assert steps[1] < 0.004


def test_only_folds_move_and_only_a_little() -> None:
    """Ears do, by 1 to 3 cm; the trunk, toes, eyes and lips, whose membranes would be far, do not."""
    body = load_person().body
    rest = body.v_template.double().numpy()
    moved = np.linalg.norm(membrane(body.v_template, body.faces).numpy() - rest, axis=1)
    ear = (np.abs(rest[:, 0]) > 0.06) & (np.abs(rest[:, 1] - 0.7) < 0.04)
    trunk = (np.abs(rest[:, 0]) < 0.15) & (rest[:, 1] > -0.4) & (rest[:, 1] < 0.5)
    toes, face = rest[:, 1] < -0.9, (rest[:, 2] > 0.1) & (np.abs(rest[:, 0]) < 0.05) & (rest[:, 1] > 0.7)
    assert 0.01 < moved[ear].max() < 0.03
    for still in (trunk, toes, face):
        assert still.sum() > 100
        assert moved[still].max() == 0


def test_a_ball_and_an_island_stay() -> None:
    """No fold; and one that stands on nothing, a small flat bag."""
    corner = torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    faces = torch.tensor([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for size in (torch.tensor([0.1, 0.1, 0.1]), torch.tensor([0.004, 0.004, 0.0005])):
        torch.testing.assert_close(membrane(corner * size, faces), (corner * size).double(), rtol=0, atol=0)
