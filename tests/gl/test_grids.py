"""Tensors as textures: what is uploaded, and when."""

import torch

from avatarrex.gl import gl_context
from avatarrex.gl.grids import GridTextures


def test_a_grid_is_uploaded_once_and_again_when_it_is_another_one():
    textures = GridTextures(gl_context())
    grid = torch.rand(3, 6, 5)
    assert textures.bind("body", grid, 0) == 360
    assert textures.bind("body", grid, 0) == 0
    assert textures.bind("body", grid.clone(), 0) == 360
    assert textures.bind("body", torch.rand(3, 3, 3, 2), 0) == 216
    assert textures.bind("other", None, 1) == 0


def test_half_precision_takes_half_the_bytes():
    textures = GridTextures(gl_context())
    assert textures.bind("body", torch.rand(3, 3, 3).half(), 0) == 54


def test_a_new_tensor_at_an_old_address_is_not_taken_for_the_old_one():
    textures = GridTextures(gl_context())
    for _ in range(3):
        grid = torch.rand(5, 5, 5)
        assert textures.bind("body", grid, 0) == 500
        del grid


def test_no_side_is_a_power_of_two_and_the_border_is_repeated():
    context = gl_context()
    textures = GridTextures(context)
    grid = torch.rand(1, 8, 5)
    assert textures.bind("body", grid, 0) == 3 * 9 * 5 * 4
    texture = textures._textures["body"][1]
    assert texture.size == (5, 9, 3)
    stored = torch.frombuffer(bytearray(texture.read(alignment=1)), dtype=torch.float32).reshape(3, 9, 5)
    assert torch.equal(stored[0, :8], grid[0])
    assert torch.equal(stored[2, 8], grid[0, 7])
