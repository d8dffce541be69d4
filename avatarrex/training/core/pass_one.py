"""Pass I, topology-free training: volume rendering on sparse pixels of a batch of frames (paper sec. 5.1).

A step draws frames, one view and some pixels of each, places samples on their rays (sampling.py), evaluates the
trained part's distances and, where a sample's share is visible, its colours, and compares the rendered rays with the pictures.
Where several processes train, each draws the whole batch and evaluates its share of the rays.

Letters: r rays, s samples, p points. Root frame, metres.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.fields.code import embedding_loss, kl_loss, node_loss, sample_latent
from avatarrex.fields.orthographic import front_points
from avatarrex.parts.face import face_state
from avatarrex.pointmap.rays import RayPlane, Rays
from avatarrex.templates.mesh import within_reach
from avatarrex.templates.model import EYES
from avatarrex.training.core.frames import FrameStore, TrainingFrame
from avatarrex.training.core.losses import (
    Mean,
    batch_means,
    eikonal_loss,
    mask_loss,
    of_share,
    rgb_loss,
    silhouette_loss,
    skin_loss,
)
from avatarrex.training.core.outline import closest
from avatarrex.training.core.pixels import Box, PixelBatch, draw_outline, draw_pixels
from avatarrex.training.core.process_group import ALONE, ProcessGroup
from avatarrex.training.core.sampling import RaySamples, Walk, draw, noise_of
from avatarrex.training.core.supervision import hidden_at_rest, shown_skin
from avatarrex.training.core.trained_field import FACE, TrainedBody, TrainedFace, TrainedField, face_alone
from avatarrex.training.core.volume_rendering import render_weights
from avatarrex.training.recipe import PassOne

SHOWN = 1e-3
"""The colour of samples with a smaller share of their ray is not evaluated: together below 1/255."""
SKIN_POINTS, OWN = 1000, 0.999
"""Vertices of a face drawn for the skin term, and ω from which they are the face's alone."""
LIDS = 0.005
"""Metres about an eyeball in which lids are compared as densely as it is."""
EIKONAL_POINTS = 256
"""Per frame, half of them at ray samples, half spread over the part's space."""


@dataclass
class StepResult:
    """What one step found."""

    terms: dict[str, Tensor]
    """Without their weights; this process's part, where several train."""
    samples_per_ray: float = 0.0
    """Samples evaluated for each rendered ray that meets the person."""
    pictures: list[tuple[int, int]] = field(default_factory=list)
    """(frame, view) that the batch was drawn from."""
    silhouette_rays: int = 0
    """Rays queried for the silhouette term, one distance each."""


class VolumePass(ABC):
    """Pass I of one part."""

    group: ProcessGroup = ALONE
    """That trains it."""

    def __init__(self, avatar: Avatar, store: FrameStore, recipe: PassOne, seed: int) -> None:
        self.avatar, self.store, self.recipe, self.seed = avatar, store, recipe, seed

    @abstractmethod
    def parameters(self) -> list[nn.Parameter]:
        """Everything that the pass trains."""

    @abstractmethod
    def field(self, frame: TrainingFrame, noise: torch.Generator) -> tuple[TrainedField, dict[str, Tensor]]:
        """The trained part of a frame, and its regularisers."""

    def window(self, frame: TrainingFrame, view: int) -> Box | None:
        """Pixels (x0, y0, x1, y1) to draw from; None is the whole picture."""
        return None

    def ray_weight(self, share: Float[Tensor, "r 3"]) -> Float[Tensor, " r"]:
        """Weight of a ray in the losses, of the parts' shares along it."""
        return torch.ones_like(share[:, 0])

    def painted(self, share: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """The parts' shares in a colour."""
        return share

    def step(self, step: int, gamma: float) -> StepResult:
        """Mean of the terms over a batch of frames; the same for the same step and weights."""
        recipe, result = self.recipe, StepResult({})
        own, found = {share.unit: share for share in self.group.shares(recipe.frames)}, {}
        evaluated = met = 0
        for slot in range(recipe.frames):
            rng = np.random.default_rng([self.seed, step, slot])
            store, index, view = self.store.drawn(rng, recipe.close)
            rig = store.rig
            result.pictures.append((index, view))
            if slot not in own:
                continue
            noise, share, frame = noise_of(self.seed, step, slot), own[slot], store[index]
            window = self.window(frame, view)
            pixels = draw_pixels(rig, view, index, recipe.rays // recipe.frames, rng, window)
            pixels = replace(pixels, share=share)
            field, terms = self.field(frame, noise)
            camera = frame.camera(rig.views[view].camera)
            losses, samples = self.render_losses(field, frame, camera, pixels, gamma, noise)
            evaluated, met = evaluated + samples, met + int((pixels.own.matte > 0.5).sum())
            if recipe.outline:
                edge = draw_outline(rig, view, index, recipe.outline // recipe.frames, rng, window)
                losses["silhouette"], queried = self.outline_loss(field, frame, camera, pixels.joined(edge))
                result.silhouette_rays += queried
            found[slot] = losses | {name: of_share(value, share.size) for name, value in terms.items()}
        result.terms = batch_means(found, recipe.frames, self.group)
        result.samples_per_ray = evaluated / max(met, 1)
        return result

    def render_losses(
        self,
        field: TrainedField,
        frame: TrainingFrame,
        camera: Camera,
        pixels: PixelBatch,
        gamma: float,
        noise: torch.Generator,
    ) -> tuple[dict[str, Mean], int]:
        """Colour, mask and eikonal terms of one view (`camera` in the root frame), and how many samples were evaluated.

        Samples are drawn on all rays, so that noise and points of the eikonal term are the same in every process.
        """
        recipe, volume = self.recipe, frame.volume.sdf
        rays = RayPlane.of(camera, volume.middle).rays(pixels.place)
        drawn = draw(Walk(volume, rays), recipe.sampling, recipe.samples, gamma, noise)
        eikonal = _eikonal_points(field, _positions(rays, drawn), noise)[pixels.share.rows(EIKONAL_POINTS)]
        rows, pixels = pixels.share.rows(len(pixels.place)), pixels.own
        rays, drawn = rays[rows], RaySamples(drawn.t[rows], drawn.used[rows])
        ray, slot = torch.nonzero(drawn.used, as_tuple=True)
        position = _positions(rays, drawn)
        composed = field.composed(position)
        sdf = torch.full_like(drawn.t, 1.0).index_put((ray, slot), composed.sdf)
        # Unused slots repeat the last sample: with its distance they weigh nothing, and their gradient is none.
        sdf = sdf.gather(1, torch.arange(sdf.shape[1]).minimum((drawn.used.sum(1) - 1).clamp_min(0)[:, None]))
        weight, opacity = render_weights(sdf, drawn.t, gamma, recipe.quadrature)
        share = weight[ray, slot]
        shown = torch.nonzero(share.detach() > SHOWN)[:, 0]
        colour = torch.zeros_like(pixels.colour)
        if len(shown):
            parts = self.painted(composed.part_weight[shown].detach())
            painted = field.paint().colour(position[shown], rays.direction[ray[shown]], parts)
            colour = colour.index_add(0, ray[shown], share[shown, None] * painted)
        with torch.no_grad():
            presence = share + 1e-3
            total = share.new_zeros(len(rays.origin)).index_add(0, ray, presence)
            parts = share.new_zeros(len(rays.origin), 3).index_add(0, ray, presence[:, None] * composed.part_weight)
            counted = self.ray_weight(parts / total.clamp_min(1e-9)[:, None])
        terms = {
            "rgb": rgb_loss(colour, pixels.colour, counted),
            "mask": mask_loss(opacity, pixels.matte, counted),
            "eikonal": eikonal_loss(field, eikonal),
        }
        return terms, len(position)

    def outline_loss(
        self, field: TrainedField, frame: TrainingFrame, camera: Camera, pixels: PixelBatch
    ) -> tuple[Mean, int]:
        """The silhouette term of one view (`camera` in the root frame), and how many rays were queried for it."""
        found = closest(field, frame.volume.sdf, camera, pixels.own)
        term = silhouette_loss(found.distance, found.width, found.matte, self.ray_weight(found.part_weight))
        return term, int((~found.distance.isnan()).sum())


class BodyPass(VolumePass):
    """Pass I of body and hands; the face is frozen."""

    def __init__(self, avatar: Avatar, store: FrameStore, recipe: PassOne, seed: int) -> None:
        super().__init__(avatar, store, recipe, seed)
        self.frame_codes = nn.Parameter(torch.zeros(store.rig.frames, avatar.body.widths.latent))

    def parameters(self) -> list[nn.Parameter]:
        """See `VolumePass`."""
        modules = (self.avatar.body, self.avatar.left_hand, self.avatar.right_hand, self.avatar.tone)
        own = (p for module in modules for p in module.parameters())
        return [*own, *self.avatar.light.learnt_with("body"), self.frame_codes]

    def field(self, frame: TrainingFrame, noise: torch.Generator) -> tuple[TrainedField, dict[str, Tensor]]:
        """The body with a latent drawn from its posterior."""
        body, rotation = self.avatar.body, frame.posed.body_rotation
        latent: Tensor | None = None
        divergence: dict[str, Tensor] = {}
        if self.recipe.latent:
            mean, log_variance = body.code_network.posterior(rotation, self.frame_codes[frame.index])
            latent = sample_latent(mean, log_variance, noise)
            divergence = {"kl": kl_loss(mean[None], log_variance[None])}
        code = body.code(rotation, latent)
        terms = {"node": node_loss(code), "embedding": embedding_loss(code), **divergence}
        terms["tone"] = self.avatar.tone.deviation()
        return TrainedBody(self.avatar, frame, body.frame(frame.posed.body, code)), terms


class FacePass(VolumePass):
    """Pass I of the face; the body is frozen and only occludes."""

    def __init__(self, avatar: Avatar, store: FrameStore, recipe: PassOne, seed: int) -> None:
        super().__init__(avatar, store, recipe, seed)
        self._skin: dict[int, Tensor] = {}
        self._eyes: dict[int, Tensor] = {}

    def parameters(self) -> list[nn.Parameter]:
        """See `VolumePass`."""
        return [*self.avatar.face.parameters(), *self.avatar.light.learnt_with("face")]

    def field(self, frame: TrainingFrame, noise: torch.Generator) -> tuple[TrainedField, dict[str, Tensor]]:
        """The face; where its mesh is the person's own, the surface stays by it."""
        driven = face_state(frame.volume.states).planes.driven
        planes, terms = self.avatar.face.geometry_planes(driven), {}
        if self._knows_mesh:
            shown = self._shown_skin(frame)
            count = SKIN_POINTS if len(shown) else 0
            chosen = shown[torch.randint(max(len(shown), 1), (count,), generator=noise)]
            points = torch.cat([frame.posed.parts["face"][chosen], self._seen_of_eyes(frame)])
            terms["skin"] = skin_loss(self.avatar.face.sdf(planes, points))
        return TrainedFace(self.avatar, frame, planes), terms

    @cached_property
    def _knows_mesh(self) -> bool:
        """Whether the surface stays by the face's mesh: as it is given, or fitted to pictures of several cameras. One sees no parallax."""
        person = self.avatar.person
        if not self.recipe.weights.skin or not person.own_face:
            return False
        return person.fit is None or len({view for _, view in self.store.pairs}) > 1

    def _shown_skin(self, frame: TrainingFrame) -> Tensor:
        """Vertices of a frame's face that are the face's alone and can be seen, but for eyeballs and what lips and lids hide at rest."""
        if frame.index not in self._skin:
            face, template = self.avatar.face, self.avatar.person.face
            mesh = frame.posed.parts["face"].to(face.box_centre)
            own = shown_skin(face, mesh, self._inner) & (template.blend_weight > OWN) & ~template.model.of_groups(EYES)
            self._skin[frame.index] = torch.nonzero(own)[:, 0]
        return self._skin[frame.index]

    def _seen_of_eyes(self, frame: TrainingFrame) -> Float[Tensor, "p 3"]:
        """Points on a frame's eyeballs and lids, those of every second row of the front view's pixels, a millimetre each: what is seen
        there, open or closed. Hardly a vertex is an eyeball's: compared at vertices alone, the surface closed a millimetre before them."""
        if frame.index not in self._eyes:
            face, mesh = self.avatar.face, frame.posed.parts["face"]
            self._eyes[frame.index] = front_points(mesh, face.faces, self._about_eyes, face.box, rows=2)
        return self._eyes[frame.index]

    @cached_property
    def _about_eyes(self) -> Tensor:
        """(v,) eyeballs, and what lies within `LIDS` of them at rest."""
        template = self.avatar.person.face
        return within_reach(template.v_template, template.model.of_groups(EYES), LIDS)

    @cached_property
    def _inner(self) -> Tensor:
        """Vertices of the face that lips and lids hide at rest; the mouth's all."""
        face, template = self.avatar.face, self.avatar.person.face
        return hidden_at_rest(face, template.v_template.to(face.box_centre)) | template.mouth

    def window(self, frame: TrainingFrame, view: int) -> Box | None:
        """The box of pixels around the projected face."""
        return face_window(self.avatar, frame, self.store.rig.views[view].camera)

    def ray_weight(self, share: Float[Tensor, "r 3"]) -> Float[Tensor, " r"]:
        """A ray counts where the face's field has most of the share; hair and neck are the body's."""
        return (2 * share[:, FACE] - 1).clamp_min(0)

    def painted(self, share: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
        """All of it the face's wherever it has any."""
        return face_alone(share)


def face_window(avatar: Avatar, frame: TrainingFrame, camera: Camera) -> Box | None:
    """(x0, y0, x1, y1) in pixels around the vertices with ω > 0; None where no pixel sees them."""
    mesh = frame.posed.parts["face"][avatar.person.face.blend_weight > 0].double().numpy()
    head, view = frame.posed.root_from_part("face"), frame.camera(camera)
    placed = mesh @ head[:3, :3].T + head[:3, 3]
    pixel, depth = view.pixels(placed)
    if (depth < 0.05).any():
        return None
    low, high = np.floor(pixel.min(0)).astype(int) - 2, np.ceil(pixel.max(0)).astype(int) + 2
    x0, y0 = max(int(low[0]), 0), max(int(low[1]), 0)
    x1, y1 = min(int(high[0]), camera.width), min(int(high[1]), camera.height)
    return (x0, y0, x1, y1) if x1 - x0 > 3 and y1 - y0 > 3 else None


def _positions(rays: Rays, drawn: RaySamples) -> Float[Tensor, "p 3"]:
    """Of the samples that are used, ray by ray."""
    ray, slot = torch.nonzero(drawn.used, as_tuple=True)
    return rays.origin[ray] + drawn.t[ray, slot, None] * rays.direction[ray]


def _eikonal_points(
    field: TrainedField, position: Float[Tensor, "p 3"], noise: torch.Generator
) -> Float[Tensor, "q 3"]:
    """`EIKONAL_POINTS`, half of them of the ray samples at `position`, the others spread over the part's space."""
    near = position
    if len(position):
        near = position[torch.randint(len(position), (EIKONAL_POINTS // 2,), generator=noise)]
    return torch.cat([near, field.around(EIKONAL_POINTS - len(near), noise)])
