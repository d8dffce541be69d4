"""Drawing an avatar by volume rendering, as most radiance-field avatars are drawn (paper sec. 4, what is avoided).

Every ray takes `samples` evenly spaced over the volume's box; the trained part's networks are evaluated at each of them, the
other parts are read from their stored boxes, and colours are evaluated where a sample's share shows. Root frame, metres.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.metrics.drawing import Drawing
from avatarrex.parts.face import face_state
from avatarrex.pointmap.rays import RayPlane, Rays, pixel_centres
from avatarrex.settings import RenderSettings
from avatarrex.shading.colour import SurfaceColour
from avatarrex.signals.driving import Signals
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.training.core.frames import TrainingFrame, decode_face
from avatarrex.training.core.pass_one import SHOWN
from avatarrex.training.core.sampling import Walk
from avatarrex.training.core.trained_field import TrainedBody, TrainedFace, TrainedField
from avatarrex.training.core.volume_rendering import Gamma, render_weights
from avatarrex.training.recipe import Quadrature
from avatarrex.volume.build import AvatarVolume, build_volume

RAYS = 512
"""At a time."""


class VolumeDrawer:
    """A `Drawer`; `part` is the one with networks that are evaluated at every sample."""

    def __init__(
        self,
        avatar: Avatar,
        part: str,
        samples: int = 64,
        gamma: float = Gamma().last,
        quadrature: Quadrature = "interval",
        name: str = "volume rendering",
    ) -> None:
        self.avatar, self.part, self.name = avatar, part, name
        self.samples, self.gamma, self.quadrature = samples, gamma, quadrature
        self._previous: tuple[PosedPerson, AvatarVolume] | None = None

    @torch.no_grad()
    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """Colours and opacity of the rays through the pixels' centres; positions are where the light ends on average.

        There is no one surface, and so no normal: zero.
        """
        posed, volume = self._pose(signals)
        world_from_root = posed.world_from_root(signals)
        field = self._field(posed, volume, world_from_root)
        paint, view = field.paint(), camera.seen_from(world_from_root)
        rays = RayPlane.of(view, volume.sdf.middle).rays(pixel_centres(view))
        entry, length = Walk(volume.sdf, rays).span
        image, position = torch.zeros(len(entry), 4), torch.zeros(len(entry), 3)
        for rows in torch.split(torch.nonzero(length > 0)[:, 0], RAYS):
            image[rows], position[rows] = self._march(field, paint, rays[rows], entry[rows], length[rows])
        size = camera.height, camera.width
        hit = (image[:, 3] > 0.5).reshape(size).numpy()
        world = position.double().numpy() @ world_from_root[:3, :3].T + world_from_root[:3, 3]
        seen = np.where(hit[..., None], world.reshape(*size, 3), 0).astype(np.float32)
        return Drawing(image.reshape(*size, 4), seen, np.zeros_like(seen), hit)

    def _march(
        self, field: TrainedField, paint: SurfaceColour, rays: Rays, entry: Tensor, length: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Premultiplied colour with opacity (r, 4), and mean end points (r, 3)."""
        share = (torch.arange(self.samples) + 0.5) / self.samples
        t = entry[:, None] + length[:, None] * share
        place = rays.origin[:, None] + t[..., None] * rays.direction[:, None]
        composed = field.composed(place.reshape(-1, 3))
        weight, opacity = render_weights(composed.sdf.reshape(t.shape), t, self.gamma, self.quadrature)
        ray, slot = torch.nonzero(weight > SHOWN, as_tuple=True)
        colour = torch.zeros(len(t), 3)
        if len(ray):
            parts = composed.part_weight.reshape(*t.shape, -1)[ray, slot]
            painted = paint.colour(place[ray, slot], rays.direction[ray], parts)
            colour = colour.index_add(0, ray, weight[ray, slot, None] * painted)
        depth = (weight * t).sum(-1) / opacity.clamp_min(1e-6)
        return torch.cat([colour, opacity[:, None]], -1).clamp(0, 1), rays.at(depth)

    def _pose(self, signals: Signals) -> tuple[PosedPerson, AvatarVolume]:
        """Cameras after one another on one pose share its volume, as they do in the deferred renderer."""
        posed_before, volume_before = self._previous or (None, None)
        settings = RenderSettings(hidden=self.avatar.hidden)
        posed = pose_person(self.avatar.person, signals, Counters(), posed_before)
        volume = build_volume(self.avatar, posed, settings, Counters(), volume_before)
        self._previous = posed, volume
        return posed, volume

    def _field(self, posed: PosedPerson, volume: AvatarVolume, world_from_root: np.ndarray) -> TrainedField:
        decode_face(self.avatar, volume)
        frame = TrainingFrame(0, posed, world_from_root, volume, 0)
        if self.part == "body":
            return TrainedBody(self.avatar, frame, volume.body_frame)
        return TrainedFace(
            self.avatar, frame, self.avatar.face.geometry_planes(face_state(volume.states).planes.driven)
        )
