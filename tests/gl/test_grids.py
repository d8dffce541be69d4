"""Tensors as textures: what is uploaded, and when."""

import torch

from avatarrex.gl import gl_context
from avatarrex.gl.grids import GridTextures


def test_a_grid_is_uploaded_once_and_again_when_it_is_another_one():
    textures = GridTextures(gl_context())
    grid = torch.rand(3, 4, 5)
    assert textures.bind("body", grid, 0) == 240
    assert textures.bind("body", grid, 0) == 0
    assert textures.bind("body", grid.clone(), 0) == 240
    assert textures.bind("body", torch.rand(2, 2, 2, 2), 0) == 64
    assert textures.bind("other", None, 1) == 0


def test_half_precision_takes_half_the_bytes():
    textures = GridTextures(gl_context())
    assert textures.bind("body", torch.rand(3, 3, 3).half(), 0) == 54


def test_a_new_tensor_at_an_old_address_is_not_taken_for_the_old_one():
    textures = GridTextures(gl_context())
    for _ in range(3):
        grid = torch.rand(4, 4, 4)
        assert textures.bind("body", grid, 0) == 256
        del grid
