"""Texels on triangles: what is linear along the surface is given back, whatever triangle and place."""

import numpy as np
import pytest
import torch
from torch import Tensor

from avatarrex.fields.detail_texture import OFF, DetailTexture, from_bytes, logit, texel_count, to_bytes


def roof() -> tuple[Tensor, Tensor]:
    """Two tilted squares of 10 cm that meet in a ridge, and a small triangle apart."""
    ridge = [[0, 0, 0.05], [0, 0.1, 0.05]]
    sides = [[-0.1, 0, 0], [-0.1, 0.1, 0], [0.1, 0, 0], [0.1, 0.1, 0]]
    vertices = torch.tensor([*ridge, *sides, [0, 0.5, 0], [0.001, 0.5, 0], [0, 0.501, 0]])
    faces = torch.tensor([[0, 1, 2], [1, 3, 2], [0, 4, 1], [1, 4, 5], [6, 7, 8]])
    return vertices, faces


def laid(spacing: float = 0.004) -> DetailTexture:
    vertices, faces = roof()
    return DetailTexture.of(vertices, faces, spacing, torch.ones(len(faces), dtype=torch.bool))


def on_faces(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.integers(0, 5, count), rng.dirichlet([0.5] * 3, count)


@pytest.mark.parametrize("spacing", [0.2, 0.02, 0.0037])
def test_what_is_linear_is_given_back(spacing: float) -> None:
    texture, (face, weight) = laid(spacing), on_faces(500)
    weight[:3] = np.eye(3)  # corners
    weight[3:6] = (1 - np.eye(3)) / 2  # edges
    texture.texel.data.copy_(torch.from_numpy(texture.lattice.position))
    found = texture(texture.places_on(face, weight, np.zeros((len(face), 3)))).detach()
    np.testing.assert_allclose(found, texture.lattice.at(face, weight), atol=1e-6)


def test_a_texel_is_as_large_as_it_was_wished() -> None:
    """Of an equilateral triangle of 6 cm edges: 15 intervals of 4 mm, 136 texels, neighbours 4 mm apart."""
    vertices = torch.tensor([[0, 0, 0], [0.06, 0, 0], [0.03, 0.06 * 0.75**0.5, 0]])
    texture = DetailTexture.of(vertices, torch.tensor([[0, 1, 2]]), 0.004, torch.ones(1, dtype=torch.bool))
    assert texture.edge.tolist() == [15]
    assert len(texture.texel) == int(texel_count(np.array([15]))[0]) == 136
    place = texture.lattice.position
    apart = np.linalg.norm(place[:, None] - place, axis=-1) + np.eye(136)
    np.testing.assert_allclose(apart.min(1), 0.004, atol=1e-7)


def test_triangles_that_are_not_shown_have_none() -> None:
    vertices, faces = roof()
    texture = DetailTexture.of(vertices, faces, 0.004, torch.tensor([True, False, True, True, False]))
    assert (texture.edge > 0).tolist() == [True, False, True, True, False]
    texture.texel.data.copy_(torch.from_numpy(texture.lattice.position))
    below = torch.tensor([[-0.05, 0.05, 0.025]])  # on the ridge's left side, one half of which has none
    assert texture(texture.places(below)).isfinite().all()


def test_detail_fades_out_off_the_surface() -> None:
    texture = laid()
    texture.texel.data.fill_(1.0)
    up = torch.tensor([-0.05, 0, 0.1]) / torch.tensor([-0.05, 0, 0.1]).norm()
    base = torch.tensor([-0.05, 0.05, 0.025])
    heights = (0.0, OFF[0] - 1e-4, sum(OFF) / 2, OFF[1] + 1e-4)
    found = texture(texture.places(torch.stack([base + height * up for height in heights])))[:, 0]
    assert found.tolist() == pytest.approx([1, 1, 0.5, 0], abs=1e-3)


def test_compiled_loops_are_the_reference() -> None:
    texture = laid()
    points = torch.from_numpy(np.random.default_rng(1).normal(0, 0.06, (3000, 3))).float()
    ours, reference = (texture.places(points, impl) for impl in ("auto", "reference"))
    assert torch.equal(ours.texel, reference.texel)
    assert torch.equal(ours.share, reference.share)


def test_gradients_reach_the_texels() -> None:
    texture, (face, weight) = laid(0.05), on_faces(20)
    texture.double()
    places = texture.places_on(face, weight, np.zeros((len(face), 3)))
    wanted = torch.rand(20, 3, dtype=torch.double)
    texture(places).backward(wanted)
    assert texture.texel.grad is not None
    expected = torch.zeros_like(texture.texel)
    for k in range(3):
        expected.index_add_(0, places.texel[:, k], places.share[:, k, None].double() * wanted)
    torch.testing.assert_close(texture.texel.grad, expected)


def test_unseen_texels_continue_with_their_nearest_seen_ones_colour() -> None:
    texture = laid()
    place = torch.from_numpy(texture.lattice.position)
    known = place[:, 0] < 0
    albedo = torch.where(known[:, None], torch.tensor([0.2, 0.4, 0.6]), torch.tensor([1.0, 1.0, 1.0]))
    texture.paint(texture.continued(albedo.float(), known))
    torch.testing.assert_close(torch.sigmoid(texture.texel), torch.tensor([[0.2, 0.4, 0.6]]).expand(len(place), 3))


def test_bytes_are_the_rounded_albedo() -> None:
    texel = logit(torch.rand(1000, 3, generator=torch.Generator().manual_seed(0)))
    back = torch.sigmoid(from_bytes(to_bytes(texel)))
    assert float((back - torch.sigmoid(texel)).abs().max()) <= 0.501 / 255
    assert torch.equal(to_bytes(from_bytes(to_bytes(texel))), to_bytes(texel))
