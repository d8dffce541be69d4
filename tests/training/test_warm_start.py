"""What the warm start is told about distances."""

from __future__ import annotations

import numpy as np
import torch
import trimesh

from avatarrex.training.core.supervision import distances_around

RADIUS, APART, COUNT = 0.1, 0.12, 6000


def test_points_over_one_limb_and_within_another_are_left_out():
    """Two balls that overlap: over the buried cap of one a point is inside, whatever its height says; both are closed forms."""
    ball = trimesh.creation.icosphere(4, RADIUS)
    aside = np.array([APART, 0, 0])
    both = trimesh.util.concatenate([ball, ball.copy().apply_translation(aside)])
    vertices, faces = torch.tensor(both.vertices).float(), torch.tensor(both.faces).long()
    position, sdf = distances_around(vertices, faces, COUNT, np.random.default_rng(0))
    place = position.double().numpy()
    union = np.minimum(np.linalg.norm(place, axis=1), np.linalg.norm(place - aside, axis=1)) - RADIUS
    wrong = (union < -0.001) & (sdf.numpy() > 0)
    assert wrong.sum() == 0
    assert 0.8 * COUNT < len(sdf) < COUNT
    assert (union > 0.001).sum() > 0.3 * COUNT, "what is outside of both stays"
    assert (union < -0.02).sum() > 0.1 * COUNT, "and what is deep inside"
