"""A learned rival of the avatar: another way to draw a captured person, learnt from the training's pictures around the same fit.

A rival begins at `person_fit`, the template whose skin (and face) were fitted to the capture, as an avatar's training does (of the
studio's own person, which a training takes as it is, the skin is fitted for rivals alone), and learns for as long as an avatar did
(timed_training.py).
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from jaxtyping import Float
from torch import Tensor, nn

from avatarrex.camera import Camera
from avatarrex.metrics.drawing import Drawing
from avatarrex.signals.driving import Signals


class Rival(nn.Module):
    """Networks that are learnt by `loss` and drawn by `draw`, which makes it a `Drawer`."""

    name: str
    rate: float
    """Adam's, at the beginning."""

    @abstractmethod
    def loss(self, rng: np.random.Generator, progress: float) -> Float[Tensor, ""]:
        """Of one random batch; `progress` from 0 to 1 is the share of the training's time that is over."""

    @abstractmethod
    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """See `Drawer`."""
