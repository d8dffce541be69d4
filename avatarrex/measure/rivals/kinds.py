"""The rivals by name, made for a capture."""

from __future__ import annotations

import torch

from avatarrex.capture.readers.rigs import Capture
from avatarrex.capture.readers.splits import sealed
from avatarrex.measure.rivals.canonical_nerf import CanonicalNerf
from avatarrex.measure.rivals.image_translation import ImageTranslation
from avatarrex.measure.rivals.rival import Rival
from avatarrex.metrics.baselines import fitted_meshes, with_fitted_skin
from avatarrex.metrics.evaluate import observations


def make_rival(name: str, capture: Capture, rig: str, seed: int) -> Rival:
    """`image-translation` or `canonical-nerf`, untrained, about the captured person with its skin fitted.

    It reads the training's split alone. Raises `InputError` as fitting does.
    """
    person, learnt = with_fitted_skin(capture, capture.person), sealed(capture, "train").rigs[rig]
    torch.manual_seed(seed)
    if name == "image-translation":
        mesh = fitted_meshes(capture, person, list(observations(capture.rigs[rig])))[-1]
        return ImageTranslation(mesh, learnt)
    if name == "canonical-nerf":
        return CanonicalNerf(person, learnt)
    raise ValueError(f"no rival is called {name}")
