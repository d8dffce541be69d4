"""What would a perfect render reach against noisy pictures? The synthetic subject drawn without sensor noise against the same with it.

`other` under all conditions of `capture make` (exposure, lens, noise …), in its held-out frames, inside the matte. A sharpness below 1 is
noise that no render has: the gradient energy of a picture is its own and its noise's. Letters: h w pixels.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from avatarrex.capture.synthetic.make import posed_stage
from avatarrex.capture.synthetic.plan import SIZES, RigPlan, plan
from avatarrex.capture.synthetic.variation import CONDITIONS, Variation
from avatarrex.metrics.image import Similarity, gradient_energy, psnr
from avatarrex.metrics.table import printed

MEASURES = ("psnr", "ssim", "sharpness")


def pictures(rig: RigPlan, frames: list[int], serials: list[str]) -> Iterator[tuple[Tensor, Tensor]]:
    """Each picture (1, 4, h, w) as it would be without sensor noise, and as it is; encoded in 8 bits."""
    without = tuple(name for name in rig.variation.conditions if name != "noise")
    quiet = replace(rig.imaging, variation=replace(rig.variation, conditions=without))
    for frame, rasteriser in posed_stage(rig, tqdm(frames, desc=rig.name, unit="frame")):
        for serial in serials:
            camera = rig.cameras[serial].seen_from(rig.world_from_root(frame))
            drawn = rasteriser.draw(camera, rig.imaging.distortion(serial)).colour
            still, real = (_encoded(each.developed(drawn.copy(), serial, frame)) for each in (quiet, rig.imaging))
            yield still, real


def measured(still: Tensor, real: Tensor) -> list[float]:
    """`MEASURES` of (1, 4, h, w) against another, inside its matte."""
    inside, one, other = real[:, 3] > 0.5, still[:, :3].contiguous(), real[:, :3].contiguous()
    similarity = Similarity.of(one, other, levels=1).ssim(inside)
    sharpness = gradient_energy(one, inside) / gradient_energy(other, inside)
    return [value.item() for value in (psnr(one, other, inside), similarity, sharpness)]


def _encoded(picture: Float[np.ndarray, "h w 4"]) -> Tensor:
    levels = np.rint(255 * np.clip(picture, 0, 1)) / 255
    return torch.from_numpy(levels).float().permute(2, 0, 1)[None].contiguous()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of which capture, and how many pictures."""
    parser.add_argument("--size", choices=SIZES, default="small", help="of `capture make` (small)")
    parser.add_argument("--frames", type=int, default=4, metavar="N", help="every N-th held-out frame (4)")
    parser.add_argument("--cameras", type=int, default=3, metavar="N", help="every N-th camera (3)")


def run(options: argparse.Namespace) -> None:
    """Measure and print. Raises `InputError` for no OpenGL."""
    row = printed("without sensor noise".ljust(26), "pictures", *MEASURES)
    for rig in plan(options.size, 0, "printed", Variation("other", conditions=CONDITIONS)).rigs:
        frames, serials = rig.held_out_frames[:: options.frames], list(rig.cameras)[:: options.cameras]
        found = [measured(*pair) for pair in pictures(rig, frames, serials)]
        row(rig.name, len(found), *(f"{value:.3f}" for value in np.mean(found, 0)))
