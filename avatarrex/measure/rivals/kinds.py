"""The rivals by name, made for a capture."""

from __future__ import annotations

import torch

from avatarrex.capture.readers.drawn import light_frame
from avatarrex.capture.readers.rigs import Capture
from avatarrex.capture.readers.splits import sealed
from avatarrex.measure.rivals.canonical_nerf import CanonicalNerf
from avatarrex.measure.rivals.image_translation import ImageTranslation
from avatarrex.measure.rivals.rival import Rival
from avatarrex.metrics.baselines import fitted_meshes, with_fitted_skin
from avatarrex.metrics.evaluate import observations
from avatarrex.training.core.exposure import exposed_as


def make_rival(name: str, capture: Capture, rig: str, seed: int) -> Rival:
    """`image-translation` or `canonical-nerf`, untrained, about the captured person with its skin fitted.

    It reads the training's split alone. Raises `InputError` as fitting does.
    """
    person, rigs = with_fitted_skin(capture, capture.person), sealed(capture, "train").rigs
    torch.manual_seed(seed)
    if name == "image-translation":
        mesh = fitted_meshes(capture, person, list(observations(capture.rigs[rig])))[-1]
        return ImageTranslation(mesh, rigs[rig], light_frame(capture))
    if name == "canonical-nerf":
        close = rigs.get("face") if rig == "body" else None
        return CanonicalNerf(person, rigs[rig], None if close is None else exposed_as(close, rigs[rig], person))
    raise ValueError(f"no rival is called {name}")
