"""The recipe of tests that train: a few steps of each pass on a few rays."""

from __future__ import annotations

from dataclasses import replace

from avatarrex.training.recipe import SMOKE, LossWeights, Recipe

_ONE = replace(
    SMOKE.face[0], steps=2, rays=40, samples=4, rate=1e-3, decay_steps=10, gamma_steps=10, warm_steps=1, outline=32
)
_TWO = replace(SMOKE.face[1], steps=1)
TINY: Recipe = replace(
    SMOKE,
    name="tiny",
    face=(_ONE, _TWO),
    body=(replace(_ONE, weights=LossWeights(silhouette=1.0)), _TWO),
    interval=2,
)
