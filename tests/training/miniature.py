"""A miniature textured capture, and a perturbed avatar that is to learn from it.

Five body cameras and four face cameras see the default template in a smooth pattern, four frames each. The last frame and
the last camera of a rig are held out, as in any capture: its frames are the training's, the held-out ones the test's.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from capture.tiny_capture import jpeg, npz, parameters

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.fields.body import SDF_UNIT
from avatarrex.fields.face import OUTPUT
from avatarrex.metrics.baselines import EDGE, MeshDrawer, PosedMesh, lattice
from avatarrex.metrics.drawing import AvatarDrawer
from avatarrex.metrics.evaluate import Choice, evaluate
from avatarrex.metrics.face_region import face_alone
from avatarrex.metrics.measures import Networks
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.signals.driving import Signals
from avatarrex.signals.limits import random_signals
from avatarrex.templates.person import load_person
from avatarrex.training.core.trainer import Trainer
from avatarrex.training.core.warm_start import load_prior
from avatarrex.training.core.work import Work
from avatarrex.training.recipe import Recipe
from avatarrex.training.runs.folder import Run

Look = Callable[[int, dict[str, float]], None]
"""Of a step and its figures."""
FRAMES = 4
CAMERAS = {
    "body": {f"c{azimuth}": Camera.orbit(azimuth, 5, 3.0, 40, (0, -0.05, 0), 96, 128) for azimuth in (0, 90, 180, 270, 45)},
    "face": {f"f{azimuth}": Camera.orbit(azimuth, 0, 0.8, 24, (0, 0.62, 0), 96, 96) for azimuth in (0, 35, -35, 15)},
}  # fmt: skip
"""By rig and name; the last of each is held out."""
WAVES = {"body": 25.0, "face": 60.0}
"""Radians a metre of the pattern: a quarter of a metre and a tenth."""
OFF = {"body": 0.012, "face": 0.004}
"""Metres by which a perturbed surface stands off the template."""


def poses(part: str, seed: int = 3) -> list[Signals]:
    """Light poses of a body, or expressions of a face."""
    rng = np.random.default_rng(seed)
    found = [random_signals(rng, 0.25) for _ in range(FRAMES)]
    if part == "body":
        return found
    return [Signals.rest().replace(expression=some.expression) for some in found]


def write_miniature(folder: Path, part: str, seed: int = 3) -> Path:
    """`folder` with one rig."""
    mesh, signals, rig = PosedMesh(load_person()), poses(part, seed), folder / part
    rest = mesh.person.body.v_template.double().numpy()[mesh.faces]
    place = (lattice(EDGE)[None, :, :, None] * rest[:, None]).sum(2)
    colour = 0.5 + 0.4 * np.sin(WAVES[part] * place + np.array([0.0, 1.0, 2.0]))
    drawer = MeshDrawer("painted", mesh, colour.astype(np.float32))
    for name, camera in CAMERAS[part].items():
        (rig / name / "mask" / "pha").mkdir(parents=True)
        for number, pose in enumerate(signals):
            image = drawer.draw(pose, camera).image.numpy()
            straight = image[..., :3] / np.maximum(image[..., 3:], 1e-6)
            (rig / name / f"{number:08d}.jpg").write_bytes(jpeg(np.rint(255 * straight).astype(np.uint8)))
            matte = np.rint(255 * image[..., 3]).astype(np.uint8)
            (rig / name / "mask" / "pha" / f"{number:08d}.jpg").write_bytes(jpeg(matte))
    calibration = {
        name: {
            "K": camera.intrinsics.ravel().tolist(),
            "R": camera.camera_from_world[:3, :3].ravel().tolist(),
            "T": camera.camera_from_world[:3, 3].tolist(),
            "distCoeff": [0.0] * 5,
            "imgSize": [camera.width, camera.height],
        }
        for name, camera in CAMERAS[part].items()
    }
    (rig / "calibration_full.json").write_text(json.dumps(calibration))
    (rig / "smpl_params.npz").write_bytes(npz(**parameters(signals, own=True)))
    truth = {"vertices": np.stack([mesh.surface(pose).vertices for pose in signals]), "faces": mesh.faces}
    (rig / "ground_truth.npz").write_bytes(npz(**truth))
    held_out = {"held_out_frames": {part: [FRAMES - 1]}, "held_out_cameras": {part: [list(CAMERAS[part])[-1]]}}
    (folder / "capture.json").write_text(json.dumps({"format": 1, **held_out}))
    return folder


def uncoloured(seed: int) -> Avatar:
    """The prior's surface; colours that know nothing of the pattern."""
    avatar = Avatar.create(load_person(), "compact", seed)
    assert load_prior(avatar, "body")
    assert load_prior(avatar, "face")
    return avatar


def perturbed(part: str, seed: int) -> Avatar:
    """`uncoloured`, the surface moved outwards by `OFF` and roughened."""
    avatar = uncoloured(seed)
    geometry = avatar.body.geometry_blend if part == "body" else avatar.face.geometry.mlp
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in geometry.parameters():
            parameter.add_(0.03 * parameter.std(correction=0) * torch.randn(parameter.shape, generator=generator))
        list(geometry.parameters())[-1].sub_(OFF[part] / (SDF_UNIT if part == "body" else OUTPUT))
    return avatar


def held_out_figures(capture: Capture, avatar: Avatar) -> dict[str, float]:
    """PSNR inside the matte (of a face: of the face alone), silhouette IoU and surface distance of the held-out frame."""
    ((part, rig),) = capture.rigs.items()
    drawers = [AvatarDrawer(avatar)]
    if part == "face":
        rig, drawers = face_alone(capture.person, rig, drawers)
    views = (0, len(rig.views) - 1)
    found = evaluate(capture, rig, drawers, Networks(None, None, {}), Choice((FRAMES - 1,), views))
    picture = {key: np.mean([one.values[key] for one in found.pictures]) for key in ("psnr_matte", "iou")}
    return {
        "psnr": float(picture["psnr_matte"]),
        "iou": float(picture["iou"]),
        "surface_mm": float(found.surfaces[0]["to_truth"]["mean_mm"]) if found.surfaces else float("inf"),
    }


@dataclass(frozen=True)
class Milestone:
    """A figure to be reached after so many steps."""

    step: int
    figure: str
    bound: float

    def reached(self, figures: dict[str, float]) -> bool:
        """Distances are to be small, all else is to be large."""
        found = figures[self.figure]
        return found <= self.bound if self.figure.endswith("_mm") else found >= self.bound


class Watched(Trainer):
    """A training that shows its figures in place of its checkpoints."""

    def __init__(self, capture: Capture, recipe: Recipe, run: Run, start: Avatar) -> None:
        super().__init__(capture, recipe, run, start)
        self.perceptual = Perceptual(None, "1 − MS-SSIM")
        self.whole, self.looks = capture, dict[int, Look]()

    def _save(self, stage: int, step: int, work: Work | None, score: float | None = None) -> None:
        if look := self.looks.pop(step, None):
            look(step, held_out_figures(self.whole, self.avatar))


def learn(path: Path, recipe: Recipe, run: Run, start: Avatar, looks: dict[int, Look]) -> None:
    """Train `start` as `train` does; at each step of `looks`, multiples of the recipe's interval, its look gets step and figures."""
    with run:
        trainer = Watched(open_capture(path), recipe, run, start)
        trainer.looks |= looks
        trainer.train()
