"""A small capture on disk, drawn with the template itself: whoever draws the template again finds no error."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image

from avatarrex.camera import Camera
from avatarrex.metrics.baselines import EDGE, MeshDrawer, PosedMesh, lattice
from avatarrex.signals.driving import Signals
from avatarrex.signals.limits import random_signals
from avatarrex.templates.person import load_person

FRAMES, HELD_OUT_FRAME, HELD_OUT_VIEW = 3, 2, "back"
CAMERAS = {"front": 10.0, "side": 100.0, "back": 190.0}


def camera(azimuth: float, size: int = 96) -> Camera:
    """Off-centre and not square in its pixels, as calibrated cameras are."""
    view = Camera.orbit(azimuth, 5, 3.0, 40, (0, -0.1, 0), size, size)
    intrinsics = view.intrinsics.copy()
    intrinsics[0, 2] += 3.3
    intrinsics[1, 1] *= 1.02
    return Camera(intrinsics, view.camera_from_world, size, size)


def painted(mesh: PosedMesh, edge: int = EDGE, wave: float = 25.0) -> MeshDrawer:
    """The template in a pattern of its rest position, smooth unless `wave`, radians a metre, is larger."""
    rest = mesh.person.body.v_template.double().numpy()[mesh.faces]
    place = (lattice(edge)[None, :, :, None] * rest[:, None]).sum(2)
    colour = 0.5 + 0.4 * np.sin(wave * place + np.array([0.0, 1.0, 2.0]))
    return MeshDrawer("painted", mesh, colour.astype(np.float32))


def poses(count: int = FRAMES) -> list[Signals]:
    """The person in light poses, somewhere."""
    rng = np.random.default_rng(3)
    return [random_signals(rng, 0.25).replace(translation=np.array([0.05, 0.02, -0.1])) for _ in range(count)]


def write_capture(folder: Path, size: int = 96) -> Path:
    """`folder` with a body rig: PNG pictures and mattes, parameters, true meshes; a frame and a camera held out."""
    mesh = PosedMesh(load_person())
    drawer, signals = painted(mesh), poses()
    body = folder / "body"
    for number, pose in enumerate(signals):
        for name, azimuth in CAMERAS.items():
            image = drawer.draw(pose, camera(azimuth, size)).image.numpy()
            straight = image[..., :3] / np.maximum(image[..., 3:], 1e-6)
            (body / name / "mask" / "pha").mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.rint(255 * straight).astype(np.uint8)).save(body / name / f"{number:08d}.png")
            matte = np.rint(255 * image[..., 3]).astype(np.uint8)
            Image.fromarray(matte).save(body / name / "mask" / "pha" / f"{number:08d}.png")
    stacked = {
        key: np.stack([getattr(pose, field).reshape(-1) for pose in signals]).astype(np.float64)
        for key, field in (
            ("global_orient", "global_orient"), ("transl", "translation"), ("body_pose", "body_pose"),
            ("jaw_pose", "jaw_pose"), ("eye_pose", "eye_pose"), ("left_hand_pose", "left_hand_pose"),
            ("right_hand_pose", "right_hand_pose"), ("arkit52", "expression"),
        )
    }  # fmt: skip
    from avatarrex.signals.joints import EXPRESSION_NAMES

    np.savez(body / "smpl_params.npz", **stacked, arkit_names=np.array(EXPRESSION_NAMES), shape10=signals[0].shape)
    np.savez(
        body / "ground_truth.npz",
        vertices=np.stack([mesh.surface(pose).vertices for pose in signals]).astype(np.float32),
        faces=mesh.faces.astype(np.int32),
    )
    calibration = {}
    for name, azimuth in CAMERAS.items():
        view = camera(azimuth, size)
        calibration[name] = {
            "K": view.intrinsics.reshape(-1).tolist(),
            "R": view.camera_from_world[:3, :3].reshape(-1).tolist(),
            "T": view.camera_from_world[:3, 3].tolist(),
            "distCoeff": [0.0] * 5,
            "imgSize": [size, size],
        }
    (body / "calibration_full.json").write_text(json.dumps(calibration))
    manifest = {
        "format": 1,
        "held_out_frames": {"body": [HELD_OUT_FRAME]},
        "held_out_cameras": {"body": [HELD_OUT_VIEW]},
        "provenance": {},
        "seed": 0,
        "size": "tiny",
    }
    (folder / "capture.json").write_text(json.dumps(manifest))
    return folder
