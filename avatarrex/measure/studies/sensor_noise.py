"""What would a perfect render reach against noisy pictures? A synthetic capture's subject drawn without sensor noise, against its pictures.

As `evaluate` compares: pictures as the reader gives them (JPEG, lens undone), held-out frames, inside the matte. A sharpness below 1 is
noise that no render has: the gradient energy of a picture is its own and its noise's. Letters: h w pixels.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from avatarrex.capture.readers.calibration import read_calibration
from avatarrex.capture.readers.rigs import Capture, Rig, open_capture
from avatarrex.capture.readers.undistort import source_pixels, undistort
from avatarrex.capture.synthetic.cameras import calibration
from avatarrex.capture.synthetic.make import posed_stage
from avatarrex.capture.synthetic.plan import Plan, RigPlan, plan
from avatarrex.capture.synthetic.variation import Variation
from avatarrex.errors import InputError, check
from avatarrex.gl.context import NoContext
from avatarrex.measure.studies.face_regions import MEASURES, measured
from avatarrex.metrics.table import printed

OPAQUE = 127
"""Matte byte above which a pixel is the subject's."""


def planned(capture: Capture) -> Plan:
    """How `capture make` drew it. Raises `InputError` for a capture that it did not draw, or without sensor noise."""
    expected = "a capture of `capture make --conditions noise`"
    try:
        size, seed, garment, varied = (capture.manifest[key] for key in ("size", "seed", "garment", "variation"))
        made = plan(size, seed, garment, Variation(**{**varied, "conditions": tuple(varied["conditions"])}))
    except (KeyError, TypeError):
        raise InputError(capture.path, "capture.json", expected, "another one") from None
    check(made.variation.has("noise"), capture.path, "capture.json", expected, "one without noise")
    check(
        capture.rigs.keys() == {rig.name for rig in made.rigs},
        capture.path,
        "rigs",
        "body, face",
        ", ".join(capture.rigs),
    )
    return made


def pictures(taken: Rig, drawn: RigPlan, frames: int, cameras: int) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Of every so many held-out frames and cameras: a picture (1, 3, h, w) without sensor noise, the one taken, its matte (1, h, w)."""
    without = tuple(name for name in drawn.variation.conditions if name != "noise")
    quiet = replace(drawn.imaging, variation=replace(drawn.variation, conditions=without))
    lenses = read_calibration(json.dumps(calibration(drawn.cameras, drawn.imaging.distortion)), drawn.name)
    bent = {lens.name: source_pixels(lens) for lens in lenses if lens.distorts}
    chosen = sorted(taken.held_out_frames)[::frames]
    check(chosen, drawn.name, "held-out frames", "one or more", "none")
    for frame, rasteriser in posed_stage(drawn, tqdm(chosen, desc=drawn.name, unit="frame")):
        for view, lens in list(enumerate(lenses))[::cameras]:
            check(taken.views[view].name == lens.name, drawn.name, "cameras", lens.name, taken.views[view].name)
            camera = drawn.cameras[lens.name].seen_from(drawn.world_from_root(frame))
            colour = rasteriser.draw(camera, drawn.imaging.distortion(lens.name)).colour
            levels = np.rint(255 * np.clip(quiet.developed(colour, lens.name, frame)[..., :3], 0, 1)).astype(np.uint8)
            still = undistort(levels, bent[lens.name]) if lens.distorts else levels
            inside = torch.from_numpy(taken.matte(view, frame) > OPAQUE)[None]
            yield _batch(still), _batch(taken.image(view, frame)), inside


def _batch(levels: np.ndarray) -> Tensor:
    return torch.from_numpy(levels / np.float32(255)).permute(2, 0, 1)[None].contiguous()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of which capture, and how many pictures."""
    parser.add_argument("capture", help="a folder or .zip of `capture make` with sensor noise")
    parser.add_argument("--frames", type=int, default=4, metavar="N", help="every N-th held-out frame (4)")
    parser.add_argument("--cameras", type=int, default=3, metavar="N", help="every N-th camera (3)")


def run(options: argparse.Namespace) -> None:
    """Measure and print. Raises `InputError`: see `planned`, no OpenGL, a step below 1."""
    for name in ("frames", "cameras"):
        check(getattr(options, name) > 0, f"--{name}", "", "1 or more", getattr(options, name))
    capture = open_capture(options.capture)
    made = planned(capture)
    row = printed("without sensor noise".ljust(26), "pictures", *MEASURES)
    for rig in made.rigs:
        try:
            taken = capture.rigs[rig.name]
            found = [measured(*each) for each in pictures(taken, rig, options.frames, options.cameras)]
        except NoContext as error:
            raise InputError("measure sensor-noise", "", "OpenGL 4.3 (Mesa's llvmpipe will do)", error) from None
        row(rig.name, len(found), *(f"{value:.3f}" for value in np.mean(found, 0)))
