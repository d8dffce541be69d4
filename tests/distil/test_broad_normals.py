"""Normals of a face that its colours are looked up along."""

from __future__ import annotations

import numpy as np
import torch
import trimesh

from avatarrex.distil.follow import broad_normals
from avatarrex.templates.mesh import vertex_normals


def degrees(one, other):
    return np.degrees(np.arccos((one * other).sum(-1).clamp(-1, 1).numpy()))


def test_a_fold_is_seen_as_the_skin_around_and_a_cheek_along_its_normal():
    side = 41
    x, y = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    ridge = np.where(abs(x - 20) < 2, 4.0 * (2 - abs(x - 20)), 0.0)  # as steep as a lid's edge
    vertices = torch.tensor(np.stack([x, y, ridge], -1).reshape(-1, 3), dtype=torch.float32)
    corner = (x[:-1, :-1] * side + y[:-1, :-1]).ravel()
    faces = torch.tensor(
        np.concatenate([[corner, corner + side, corner + 1], [corner + 1, corner + side, corner + side + 1]], 1).T
    )
    normal, up = vertex_normals(vertices, faces), torch.tensor([0.0, 0.0, 1.0])
    middle = torch.tensor(((abs(x - 20) == 1) & (abs(y - 20) < 5)).ravel())
    assert degrees(normal[middle], up).min() > 45
    assert degrees(broad_normals(normal, faces)[middle], up).max() < 12
    ball = trimesh.creation.icosphere(4)
    around = torch.tensor(ball.vertices, dtype=torch.float32)
    faces = torch.tensor(ball.faces.astype(np.int64))
    assert degrees(broad_normals(vertex_normals(around, faces), faces), around).max() < 3
