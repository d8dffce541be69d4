"""How well are eyes drawn? PSNR, SSIM and sharpness where a capture's camera sees eyeballs, lids and lashes.

The face's rig, frames that were held out; the avatar beside the textured mesh that is fitted to the same mattes. Pictures are not
cut: windows of SSIM reach into the skin around. The region is where the posed template shows triangles within `REACH` of an eye's
centre at rest; closed eyes count, too. An avatar is drawn in the exposure of its body's pictures: where rigs differ, `--exposed-as`
makes them one. Letters: h w pixels, f faces.
"""

from __future__ import annotations

import argparse
import math

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor
from tqdm import tqdm

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Rig, open_capture
from avatarrex.capture.readers.splits import with_validation
from avatarrex.errors import check
from avatarrex.files.json_text import write_json
from avatarrex.metrics.baselines import PosedMesh, fitted_meshes
from avatarrex.metrics.drawing import AvatarDrawer, Drawer
from avatarrex.metrics.evaluate import captured, observations
from avatarrex.metrics.image import Similarity, gradient_energy, psnr
from avatarrex.metrics.own_training import as_trained
from avatarrex.metrics.table import printed
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.person import Person
from avatarrex.training.core.exposure import factors, one_exposure

REACH = 0.022
"""Metres about an eye's centre: the ball, both lids to their creases, and the corners."""
MEASURES = ("psnr", "ssim", "sharpness")


class Eyes:
    """Where cameras see the eyes of a person."""

    def __init__(self, person: Person) -> None:
        self._mesh = PosedMesh(person)
        joints = person.body.joint_template.double().numpy()
        eyes = joints[[JOINT_NAMES.index(name) for name in ("left_eye", "right_eye")]]
        rest = person.body.v_template.double().numpy()
        near = np.linalg.norm(rest[:, None] - eyes[None], axis=-1).min(1) < REACH
        self.faces: Bool[np.ndarray, " f"] = near[self._mesh.faces].all(1)

    def seen(self, signals: Signals, camera: Camera) -> Bool[np.ndarray, "h w"]:
        """Pixels whose centre's ray first meets one of them."""
        face = self._mesh.visible(signals, camera)[0]
        return np.asarray((face >= 0) & self.faces[face])


def measure(
    person: Person, rig: Rig, drawers: list[Drawer], pairs: list[tuple[int, int]]
) -> dict[str, dict[str, float]]:
    """By drawer its means of `MEASURES` over the pictures `pairs` (view, frame) in which eyes are seen, and how many."""
    eyes = Eyes(person)
    found: dict[str, list[list[float]]] = {drawer.name: [] for drawer in drawers}
    for view, frame in tqdm(pairs, unit="picture"):
        camera, signals = rig.views[view].camera, rig.signals[frame]
        inside = torch.from_numpy(eyes.seen(signals, camera))[None]
        if not inside.any():
            continue
        truth = _batch(captured(rig, view, frame, camera).image)
        for drawer in drawers:
            found[drawer.name].append(measured(_batch(drawer.draw(signals, camera).image[..., :3]), truth, inside))
    check(any(found.values()), rig.name, "", "pictures in which eyes are seen", "none")
    return {
        name: {**dict(zip(MEASURES, np.mean(rows, 0).tolist())), "pictures": len(rows)} for name, rows in found.items()
    }


def measured(render: Tensor, truth: Tensor, inside: Tensor) -> list[float]:
    """`MEASURES` of (1, 3, h, w) in the mask (1, h, w)."""
    similarity = Similarity.of(render, truth, levels=1).ssim(inside)
    sharpness = gradient_energy(render, inside) / gradient_energy(truth, inside)
    return [value.item() for value in (psnr(render, truth, inside), similarity, sharpness)]


def _batch(image: Tensor) -> Tensor:
    return image.permute(2, 0, 1)[None].clamp(0, 1).contiguous()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of whom, against what."""
    parser.add_argument("avatar", help="name, folder or .avatar file")
    parser.add_argument("capture", help="a folder or .zip with a face rig")
    exposed = "pictures as the cameras of another rig would have taken them"
    parser.add_argument("--exposed-as", metavar="RIG", help=exposed)
    parser.add_argument("--json", metavar="FILE.json")


def run(options: argparse.Namespace) -> None:
    """Measure and print. Raises `InputError` for a capture without a face rig or held-out frames, and what `one_exposure` raises."""
    avatar = load_avatar(options.avatar)
    capture, own = as_trained(
        avatar, options.avatar, with_validation(open_capture(options.capture, template=avatar.person.name))
    )
    check("face" in capture.rigs, options.capture, "", "a face rig", ", ".join(capture.rigs))
    person = avatar.person if own else capture.person
    if options.exposed_as:
        capture = one_exposure(capture, options.exposed_as, person)
    rig = capture.rigs["face"]
    pairs = [(v, f) for f in sorted(rig.held_out_frames) for v in range(len(rig.views)) if rig.available(v, f)]
    check(pairs, options.capture, "face rig", "pictures of held-out frames", "none")
    drawers: list[Drawer] = [AvatarDrawer(avatar), *fitted_meshes(capture, person, list(observations(rig)))]
    found = measure(person, rig, drawers, pairs)
    row = printed("eyes".ljust(26), "pictures", *MEASURES)
    for name, values in found.items():
        row(name, int(values["pictures"]), *(_shown(values[key]) for key in MEASURES))
    if options.json:
        write_json(
            options.json,
            {
                "avatar": options.avatar,
                "capture": options.capture,
                "exposed_as": {"rig": options.exposed_as, "gain": factors(rig)} if options.exposed_as else None,
                "frames": sorted(rig.held_out_frames),
                "eyes": found,
            },
        )


def _shown(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "n/a"
