"""Pass II, topology-based fine-tuning: patches shaded at the rendered surface, geometry frozen (paper sec. 5.1).

    L_II = L_MSE + λ L_LPIPS        on 128×128 patches; no gradient through the ray marching

Surface points come from the renderer's own volume and raycast. Where either picture has no person, both are black.
Letters: h w pixels of a patch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Rig
from avatarrex.counters import Counters
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.pointmap.raycast import raycast
from avatarrex.shading.colour import SurfaceColour
from avatarrex.training.core.frames import FrameStore, TrainingFrame
from avatarrex.training.core.losses import Mean, batch_means, of_joined, of_share
from avatarrex.training.core.pass_one import StepResult, face_window
from avatarrex.training.core.pixels import foreground
from avatarrex.training.core.process_group import ALONE, WHOLE, ProcessGroup, Share
from avatarrex.training.core.trained_field import FACE, face_alone
from avatarrex.training.recipe import PassTwo
from avatarrex.volume.sdf_volume import sides


@dataclass(frozen=True)
class Patch:
    """A patch that is compared."""

    rendered: Float[Tensor, "h w 3"]
    truth: Float[Tensor, "h w 3"]
    both: Float[Tensor, "h w 1"]
    """Where both pictures have the person."""
    per_ray: float
    """Shaded pixels for each that has the person."""


class PatchPass:
    """Pass II of `body` (with the hands) or `face`."""

    group: ProcessGroup = ALONE
    """That trains it."""

    def __init__(
        self, avatar: Avatar, store: FrameStore, part: str, recipe: PassTwo, perceptual: Perceptual, seed: int
    ) -> None:
        self.avatar, self.store, self.part, self.recipe, self.seed = avatar, store, part, recipe, seed
        self.perceptual = perceptual

    def parameters(self) -> list[nn.Parameter]:
        """The colour networks, and the light on them."""
        if self.part == "face":
            return [*self.avatar.face.colour_parameters(), *self.avatar.light.learnt_with("face")]
        others = (self.avatar.left_hand, self.avatar.right_hand, self.avatar.tone)
        own = (p for module in others for p in module.parameters())
        return [*self.avatar.body.colour_parameters(), *own, *self.avatar.light.learnt_with("body")]

    def step(self, step: int, gamma: float) -> StepResult:
        """Mean of the terms over a batch of patches; the same for the same step and weights.

        Where several processes train, each shades its share of the pixels; a patch of several is compared by each of them.
        """
        count, result = self.recipe.patches, StepResult({})
        own, patches = {share.unit: share for share in self.group.shares(count)}, {}
        for slot in range(count):
            rng = np.random.default_rng([self.seed, 2, step, slot])
            store, index, view = self.store.drawn(rng, self.recipe.close)
            result.pictures.append((index, view))
            if slot in own:
                patches[slot] = self._patch(store, index, view, rng, own[slot])
        if count % self.group.size:
            patches = self._joined(patches, count)
        found = {slot: self._terms(patch, own[slot].size) for slot, patch in patches.items()}
        result.terms = batch_means(found, count, self.group)
        result.samples_per_ray = sum(patch.per_ray for patch in patches.values()) / len(patches)
        return result

    def _patch(self, store: FrameStore, index: int, view: int, rng: np.random.Generator, share: Share) -> Patch:
        """One patch of a picture, this process's share of it shaded."""
        frame, rig = store[index], store.rig
        camera = rig.views[view].camera
        x, y, width, height = self._window(rig, frame, view, rng)
        rows, columns = slice(y, y + height), slice(x, x + width)
        matte, truth = (
            torch.from_numpy(read(view, index)[rows, columns] / np.float32(255)) for read in (rig.matte, rig.image)
        )
        gaze = _anywhere(rng) if rng.random() < self.recipe.view_dropout else None
        rendered, coverage = self.shade(frame, camera.cropped(x, y, width, height), gaze, share)
        both = torch.minimum(coverage, matte)[..., None]
        return Patch(rendered, truth, both, float((coverage > 0).sum()) / max(float((matte > 0.5).sum()), 1.0))

    def _joined(self, patches: dict[int, Patch], count: int) -> dict[int, Patch]:
        """With every process's pixels."""
        side, dtype = self.recipe.patch, self.parameters()[0].dtype
        canvas = [torch.zeros(side, side, 3, dtype=dtype)] * count
        for slot, patch in patches.items():
            height, width, _ = patch.rendered.shape
            canvas[slot] = nn.functional.pad(patch.rendered, (0, 0, 0, side - width, 0, side - height))
        whole = self.group.joined(torch.stack(canvas))
        sizes = {slot: patch.rendered.shape for slot, patch in patches.items()}
        return {slot: replace(patches[slot], rendered=whole[slot, :h, :w]) for slot, (h, w, _) in sizes.items()}

    def _terms(self, patch: Patch, share: float) -> dict[str, Mean]:
        rendered, truth, both = patch.rendered, patch.truth, patch.both
        terms = self._compare(rendered * both, truth * both, both)
        found = {name: of_joined(value, share) for name, value in terms.items()}
        if self.part == "body":
            found["tone"] = of_share(self.avatar.tone.deviation(), share)
        return found

    def shade(
        self, frame: TrainingFrame, camera: Camera, gaze: Float[Tensor, " 3"] | None = None, share: Share = WHOLE
    ) -> tuple[Float[Tensor, "h w 3"], Float[Tensor, "h w"]]:
        """Straight colours, differentiable in the colour networks, of a share of the pixels that count (the others are zero),
        and how much of each pixel counts.

        `gaze`: what the networks are said to be seen along, unit, root frame; None: what they are.
        """
        view, volume = frame.camera(camera), frame.volume
        pointmap = raycast(volume.sdf, view, antialias=True)
        counts = pointmap.coverage
        if self.part == "face":
            counts = counts * (pointmap.part_weight[..., FACE] > 0)
        listed = torch.nonzero(counts > 0)
        seen = tuple(listed[share.rows(len(listed))].T)
        position = pointmap.position[seen].to(self.parameters()[0].dtype)
        direction = torch.nn.functional.normalize(position - torch.as_tensor(view.centre).to(position), dim=-1)
        light = self.avatar.light.over(frame.world_from_root)
        paint = SurfaceColour(
            self.avatar, frame.posed, volume.body_frame, frame.states(), light, Counters(), sparse=True, told=gaze
        )
        image = position.new_zeros(*counts.shape, 3)
        if len(position):
            side = sides(volume.sdf, pointmap.position[seen])
            parts = pointmap.part_weight[seen].to(position)
            colour = paint.colour(position, direction, face_alone(parts) if self.part == "face" else parts, side)
            image = image.index_put(seen, colour)
        return image, counts

    def _compare(self, rendered: Tensor, truth: Tensor, both: Tensor) -> dict[str, Tensor]:
        a, b = (picture.permute(2, 0, 1)[None] for picture in (rendered, truth))
        terms = {"rgb": (rendered - truth).square().sum() / (3 * both.sum().clamp_min(1.0))}
        if self.recipe.weights.perceptual and min(a.shape[-2:]) >= 16:
            terms["perceptual"] = self.perceptual(a, b)
        return terms

    def _window(self, rig: Rig, frame: TrainingFrame, view: int, rng: np.random.Generator) -> tuple[int, int, int, int]:
        """x, y, width, height of a patch about a pixel of the person (of the face, where that is trained)."""
        camera = rig.views[view].camera
        width, height = camera.width, camera.height
        side_x, side_y = min(self.recipe.patch, width), min(self.recipe.patch, height)
        window = face_window(self.avatar, frame, camera) if self.part == "face" else None
        inside, (x0, y0, x1, y1) = foreground(rig, view, frame.index, window)
        ys, xs = np.nonzero(inside)
        if len(ys):
            k = rng.integers(len(ys))
            x, y = xs[k] + x0, ys[k] + y0
        else:
            x, y = rng.integers(x0, x1), rng.integers(y0, y1)
        x, y = np.clip((x - side_x // 2, y - side_y // 2), 0, (width - side_x, height - side_y)).tolist()
        return x, y, side_x, side_y


def _anywhere(rng: np.random.Generator) -> Float[Tensor, " 3"]:
    """A direction, all alike."""
    drawn = rng.normal(size=3)
    return torch.from_numpy(drawn / np.linalg.norm(drawn)).float()
