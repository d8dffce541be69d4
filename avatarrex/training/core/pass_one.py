"""Pass I, topology-free training: volume rendering on sparse pixels of a batch of frames (paper sec. 5.1).

A step draws frames, one view and some pixels of each, places samples on their rays (sampling.py), asks the trained part
for distances and, where a sample's share shows, for colours, and compares what the rays see with the pictures.

Letters: r rays, s samples, p points. Root frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.fields.code import embedding_loss, kl_loss, node_loss
from avatarrex.pointmap.rays import RayPlane
from avatarrex.training.core.frames import FrameStore, TrainingFrame
from avatarrex.training.core.losses import eikonal_loss, mask_loss, rgb_loss, silhouette_loss
from avatarrex.training.core.outline import closest
from avatarrex.training.core.pixels import PixelBatch, draw_outline, draw_pixels, training_pairs
from avatarrex.training.core.sampling import Walk, draw, noise_of
from avatarrex.training.core.trained_field import FACE, TrainedBody, TrainedFace, TrainedField, face_alone
from avatarrex.training.core.volume_rendering import render_weights
from avatarrex.training.recipe import PassOne

SHOWN = 1e-3
"""Samples with a smaller share of their ray are not asked for their colour: together below 1/255."""
EIKONAL_POINTS = 256
"""Per frame, half of them at ray samples, half spread over the part's space."""


@dataclass
class StepResult:
    """What one step found."""

    terms: dict[str, Tensor]
    samples_per_ray: float
    """Samples evaluated for each rendered ray that meets the person."""
    pictures: list[tuple[int, int]]
    """(frame, view) that the batch was drawn from."""
    silhouette_rays: int = 0
    """Rays asked for the silhouette term, one distance each."""


class BodyPass:
    """Pass I of body and hands; the face is frozen."""

    def __init__(self, avatar: Avatar, store: FrameStore, recipe: PassOne, seed: int) -> None:
        self.avatar, self.store, self.recipe, self.seed = avatar, store, recipe, seed
        self.pairs = training_pairs(store.rig)
        self.frame_codes = nn.Parameter(torch.zeros(store.rig.frames, avatar.body.widths.latent))

    def parameters(self) -> list[nn.Parameter]:
        """Everything that pass I trains."""
        modules = (self.avatar.body, self.avatar.left_hand, self.avatar.right_hand, self.avatar.tone, self.avatar.light)
        return [*(p for module in modules for p in module.parameters()), self.frame_codes]

    def step(self, step: int, gamma: float) -> StepResult:
        """Losses of one batch; the same for the same step and weights."""
        return run_batch(self, step, gamma)

    def field(self, frame: TrainingFrame, noise: torch.Generator) -> tuple[TrainedField, dict[str, Tensor]]:
        """The body of a frame with a latent drawn from its posterior, and the regularisers."""
        body, rotation = self.avatar.body, frame.posed.body_rotation
        if not self.recipe.latent:
            code = body.code(rotation)
            terms = {
                "node": self.recipe.node * node_loss(code),
                "embedding": embedding_loss(code),
                "tone": self.avatar.tone.deviation(),
            }
            return TrainedBody(self.avatar, frame, body.frame(frame.posed.body, code)), terms
        mean, log_variance = body.code_network.posterior(rotation, self.frame_codes[frame.index])
        latent = mean + torch.exp(log_variance / 2) * torch.randn(mean.shape, generator=noise)
        code = body.code(rotation, latent)
        terms = {
            "node": self.recipe.node * node_loss(code),
            "embedding": embedding_loss(code),
            "kl": kl_loss(mean[None], log_variance[None]),
            "tone": self.avatar.tone.deviation(),
        }
        return TrainedBody(self.avatar, frame, body.frame(frame.posed.body, code)), terms

    def window(self, frame: TrainingFrame, view: int) -> tuple[int, int, int, int] | None:
        """The whole picture."""
        return None

    def ray_weight(self, share: Tensor) -> Tensor:
        """All rays count alike."""
        return torch.ones_like(share[:, 0])

    def painted(self, share: Tensor) -> Tensor:
        """The parts' shares in a colour."""
        return share


class FacePass:
    """Pass I of the face; the body is frozen and only hides what lies behind it."""

    def __init__(self, avatar: Avatar, store: FrameStore, recipe: PassOne, seed: int) -> None:
        self.avatar, self.store, self.recipe, self.seed = avatar, store, recipe, seed
        self.pairs = training_pairs(store.rig)

    def parameters(self) -> list[nn.Parameter]:
        """Everything that pass I trains."""
        return list(self.avatar.face.parameters())

    def step(self, step: int, gamma: float) -> StepResult:
        """Losses of one batch; the same for the same step and weights."""
        return run_batch(self, step, gamma)

    def field(self, frame: TrainingFrame, noise: torch.Generator) -> tuple[TrainedField, dict[str, Tensor]]:
        """The face of a frame."""
        driven = frame.volume.parts["face"].state.driven
        return TrainedFace(self.avatar, frame, self.avatar.face.geometry_planes(driven)), {}

    def window(self, frame: TrainingFrame, view: int) -> tuple[int, int, int, int] | None:
        """The box of pixels around the projected face."""
        return face_window(self.avatar, frame, self.store.rig.views[view].camera)

    def ray_weight(self, share: Tensor) -> Tensor:
        """A ray counts where the face's field has most of the say; hair and neck are the body's."""
        return (2 * share[:, FACE] - 1).clamp_min(0)

    def painted(self, share: Tensor) -> Tensor:
        """The parts' shares in a colour."""
        return face_alone(share)


def face_window(avatar: Avatar, frame: TrainingFrame, camera: Camera) -> tuple[int, int, int, int] | None:
    """(x0, y0, x1, y1) in pixels around the vertices with ω > 0; None where no pixel sees them."""
    mesh = frame.posed.parts["face"][avatar.person.face.blend_weight > 0].double().numpy()
    head, view = frame.posed.root_from_part("face"), frame.camera(camera)
    placed = mesh @ head[:3, :3].T + head[:3, 3]
    seen = placed @ view.camera_from_world[:3, :3].T + view.camera_from_world[:3, 3]
    if (seen[:, 2] < 0.05).any():
        return None
    pixel = (seen @ view.intrinsics.T)[:, :2] / seen[:, 2:]
    low, high = np.floor(pixel.min(0)).astype(int) - 2, np.ceil(pixel.max(0)).astype(int) + 2
    x0, y0 = max(int(low[0]), 0), max(int(low[1]), 0)
    x1, y1 = min(int(high[0]), camera.width), min(int(high[1]), camera.height)
    return (x0, y0, x1, y1) if x1 - x0 > 3 and y1 - y0 > 3 else None


def run_batch(stage: BodyPass | FacePass, step: int, gamma: float) -> StepResult:
    """Mean of the terms over the batch's frames."""
    recipe, rig = stage.recipe, stage.store.rig
    rng = np.random.default_rng([stage.seed, step])
    summed: dict[str, Tensor] = {}
    evaluated = met = asked = 0
    pictures = []
    for slot in range(recipe.frames):
        index, view = stage.pairs[rng.integers(len(stage.pairs))]
        pictures.append((index, view))
        noise = noise_of(stage.seed, step, slot)
        frame = stage.store[index]
        window = stage.window(frame, view)
        pixels = draw_pixels(rig, view, index, recipe.rays // recipe.frames, rng, window)
        field, terms = stage.field(frame, noise)
        camera = rig.views[view].camera
        losses, samples = _render_losses(stage, field, frame, camera, pixels, gamma, noise)
        evaluated, met = evaluated + samples, met + int((pixels.matte > 0.5).sum())
        if recipe.outline:
            edge = draw_outline(rig, view, index, recipe.outline // recipe.frames, rng, window)
            losses["silhouette"], more = _outline_loss(stage, field, frame, camera, pixels.joined(edge))
            asked += more
        for name, value in (losses | terms).items():
            summed[name] = summed.get(name, torch.zeros(())) + value / recipe.frames
    return StepResult(summed, evaluated / max(met, 1), pictures, asked)


def _render_losses(
    stage: BodyPass | FacePass,
    field: TrainedField,
    frame: TrainingFrame,
    camera: Camera,
    pixels: PixelBatch,
    gamma: float,
    noise: torch.Generator,
) -> tuple[dict[str, Tensor], int]:
    """Colour, mask and eikonal terms of one view, and how many samples were evaluated."""
    recipe, volume = stage.recipe, frame.volume.sdf
    plane = RayPlane.of(frame.camera(camera), volume.middle)
    rays = plane.rays(pixels.place)
    walked = Walk(volume, rays)
    drawn = draw(walked, recipe.sampling, recipe.samples, gamma, noise)
    ray, slot = torch.nonzero(drawn.used, as_tuple=True)
    position = rays.origin[ray] + drawn.t[ray, slot, None] * rays.direction[ray]
    evaluated = len(position)
    composed = field.composed(position)
    sdf = torch.full_like(drawn.t, 1.0).index_put((ray, slot), composed.sdf)
    # Unused slots repeat the last sample: with its distance they weigh nothing, and their gradient is none.
    sdf = sdf.gather(1, torch.arange(sdf.shape[1]).minimum((drawn.used.sum(1) - 1).clamp_min(0)[:, None]))
    weight, opacity = render_weights(sdf, drawn.t, gamma, recipe.quadrature)
    share = weight[ray, slot]
    shown = torch.nonzero(share.detach() > SHOWN)[:, 0]
    colour = torch.zeros_like(pixels.colour)
    if len(shown):
        painted = field.paint().colour(
            position[shown], rays.direction[ray[shown]], stage.painted(composed.part_weight[shown].detach())
        )
        colour = colour.index_add(0, ray[shown], share[shown, None] * painted)
    with torch.no_grad():
        presence = share + 1e-3
        total = share.new_zeros(len(rays.origin)).index_add(0, ray, presence)
        parts = share.new_zeros(len(rays.origin), 3).index_add(0, ray, presence[:, None] * composed.part_weight)
        counted = stage.ray_weight(parts / total.clamp_min(1e-9)[:, None])
    near = (
        position.detach()[torch.randint(max(len(position), 1), (EIKONAL_POINTS // 2,), generator=noise)]
        if len(position)
        else position
    )
    spread = field.around(EIKONAL_POINTS - len(near), noise)
    terms = {
        "rgb": rgb_loss(colour, pixels.colour, counted),
        "mask": mask_loss(opacity, pixels.matte, counted),
        "eikonal": eikonal_loss(field, torch.cat([near, spread])),
    }
    return terms, evaluated


def _outline_loss(
    stage: BodyPass | FacePass, field: TrainedField, frame: TrainingFrame, camera: Camera, pixels: PixelBatch
) -> tuple[Tensor, int]:
    """The silhouette term, and how many rays were asked for it."""
    found = closest(field, frame.volume.sdf, frame.camera(camera), pixels)
    counted = stage.ray_weight(found.part_weight)
    term = silhouette_loss(found.distance, found.width, found.matte, counted)
    return stage.recipe.silhouette * term, int((~found.distance.isnan()).sum())
