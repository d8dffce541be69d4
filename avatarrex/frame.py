"""A rendered frame and every intermediate that led to it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.surface import VisibleSurface
from avatarrex.settings import RenderSettings
from avatarrex.shading.shade import Shading
from avatarrex.signals.driving import Signals
from avatarrex.templates.posed import PosedPerson
from avatarrex.volume.build import AvatarVolume


@dataclass(frozen=True, kw_only=True)
class Frame(ABC):
    """One picture of an avatar with its point map, times and counters.

    Given to the next `render` as `previous`, what has not changed since is not computed again.
    """

    signals: Signals
    camera: Camera
    """In the world."""
    settings: RenderSettings
    world_from_root: np.ndarray
    """(4, 4) float64: the point map lives in the root frame."""
    ms: dict[str, float]
    """Wall-clock milliseconds by stage, and `total`."""
    counters: dict[str, int]
    """Work by name (counters.py)."""
    notes: tuple[str, ...]
    """What a person should know: the renderer."""
    device: str = "cpu"
    """Where the networks ran."""

    @property
    @abstractmethod
    def image(self) -> Float32[Tensor, "h w 4"]:
        """Premultiplied sRGB-encoded colour and coverage, row 0 at the top."""

    @property
    def unmixed(self) -> Float32[Tensor, "h w 4"]:
        """`image` before sheets of the surface are mixed at occlusion edges: the colours of the point map's points."""
        return self.image

    @property
    @abstractmethod
    def pointmap(self) -> PointMap:
        """Where the rays meet the avatar, Step II."""

    @property
    def view(self) -> Camera:
        """`camera` as seen from the root frame."""
        return self.camera.seen_from(self.world_from_root)


@dataclass(frozen=True, kw_only=True)
class DeferredFrame(Frame):
    """A frame of the deferred pipeline (pipeline.py): every level but `live`."""

    surface: VisibleSurface
    """Results of the stages templates, volume and pointmap."""
    shading: Shading

    @property
    def image(self) -> Float32[Tensor, "h w 4"]:
        """Premultiplied sRGB-encoded colour and coverage, row 0 at the top."""
        return self.shading.image

    @property
    def unmixed(self) -> Float32[Tensor, "h w 4"]:
        """`image` before sheets of the surface are mixed at occlusion edges: the colours of the point map's points."""
        return self.shading.unmixed

    @property
    def posed(self) -> PosedPerson:
        """The posed templates."""
        return self.surface.posed

    @property
    def volume(self) -> AvatarVolume:
        """The SDF volume, Step I."""
        return self.surface.volume

    @property
    def pointmap(self) -> PointMap:
        """Where the rays meet the avatar, Step II."""
        return self.surface.pointmap

    @property
    def view(self) -> Camera:
        """`camera` as seen from the root frame."""
        return self.surface.view
