"""Figures while a training runs: the avatar drawn as the renderer draws it, beside pictures kept for validation."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import Rig
from avatarrex.metrics.evaluate import captured
from avatarrex.metrics.image import psnr, ssim
from avatarrex.pipeline import render_frame
from avatarrex.settings import RenderSettings
from avatarrex.shading.colour import OPAQUE
from avatarrex.training.core.pixels import pictures
from avatarrex.training.core.trained_field import FACE
from avatarrex.training.runs.folder import Run

PICTURES = 3
"""Drawn each time: about a second each."""


class HeldOut:
    """A few pictures of a rig sealed to the validation's; to the training's own, where it has none for validation."""

    def __init__(self, avatar: Avatar, rig: Rig, hidden: frozenset[str], run: Run, part: str) -> None:
        self.avatar, self.rig, self.run, self.part = avatar, rig, run, part
        self.settings = RenderSettings(hidden=hidden)
        pairs = pictures(rig, range(rig.frames), range(len(rig.views)))
        chosen = np.linspace(0, len(pairs) - 1, PICTURES).round().astype(int)
        self.pairs = list(dict.fromkeys(pairs[k] for k in chosen)) if pairs else []

    def measure(self, step: int) -> float | None:
        """Report means and keep the pictures; PSNR inside the matte, or None where there is no picture."""
        figures: dict[str, list[float]] = {"psnr": [], "ssim": [], "iou": []}
        for frame, view in self.pairs:
            camera, whole = self.rig.views[view].camera, self.part == "body"
            truth = captured(self.rig, view, frame, camera)
            found = render_frame(self.avatar, self.rig.signals[frame], camera, self.settings)
            image, inside = found.image, (truth.matte > 0.5)[None]
            if not whole:  # the rest of the person is not trained yet
                inside = inside & (found.pointmap.part_weight[None, ..., FACE] > OPAQUE)
            a, b = (picture[None].permute(0, 3, 1, 2) for picture in (image[..., :3], truth.image))
            if inside.any():
                figures["psnr"].append(float(psnr(a, b, inside)))
                figures["ssim"].append(float(ssim(a, b, inside)))
            if whole and inside.any():
                covered = image[..., 3] > 0.5
                figures["iou"].append(float((covered & inside[0]).sum() / (covered | inside[0]).sum()))
            name = f"{self.part}/frame_{frame}_view_{view}"
            self.run.picture(step, f"{name}/render", _bytes(image[..., :3]))
            self.run.picture(step, f"{name}/truth", _bytes(truth.image))
        means = {key: float(np.mean(values)) for key, values in figures.items() if values}
        self.run.scalars(step, {f"{self.part}/heldout/{key}": value for key, value in means.items()})
        return means.get("psnr")


def _bytes(image: Tensor) -> UInt8[np.ndarray, "h w 3"]:
    return torch.round(image.clamp(0, 1) * 255).to(torch.uint8).numpy()
