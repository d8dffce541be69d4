"""A small capture of the default person, drawn in flat colours: three body cameras, one face camera, three frames."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import silhouette, template_surface
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.person import Person, load_person

FRAMES = 3
WIDTH, HEIGHT = 60, 80


def cameras(rig: str, scale: int = 1) -> dict[str, Camera]:
    """Cameras by name, about a person at (0.2, 1, −0.1), `scale` times 60×80 pixels."""
    size = (WIDTH * scale, HEIGHT * scale)
    if rig == "face":
        return {"f0": Camera.orbit(10, 0, 0.9, 35, (0.2, 1.7, -0.1), *size)}
    return {f"c{k}": Camera.orbit(120 * k + 10, 5, 3.0, 50, (0.2, 0.95, -0.1), *size) for k in range(3)}


def motion(rng: np.random.Generator, shape: np.ndarray) -> list[Signals]:
    """Three frames of somebody who stands at (0.2, 1, −0.1) and moves a little."""
    rest = Signals.rest()
    return [
        rest.replace(
            translation=np.array([0.2, 1.0, -0.1]) + 0.05 * rng.standard_normal(3),
            global_orient=np.array([0.05, 0.4 * k, 0.02]),
            body_pose=0.15 * rng.standard_normal((21, 3)),
            left_hand_pose=0.2 * rng.standard_normal((15, 3)),
            right_hand_pose=0.2 * rng.standard_normal((15, 3)),
            jaw_pose=np.array([0.1 * k, 0, 0]),
            eye_pose=0.1 * rng.standard_normal((2, 3)),
            expression=rng.uniform(0, 0.5, 52),
            shape=shape,
        )
        for k in range(FRAMES)
    ]


@dataclass
class TinyCapture:
    """A capture's files, in memory: change what a test is about, then write."""

    signals: list[Signals]
    files: dict[str, bytes] = field(default_factory=dict)

    @classmethod
    def make(
        cls, rigs: tuple[str, ...] = ("body", "face"), seed: int = 3, person: Person | None = None, scale: int = 1
    ) -> TinyCapture:
        """Our layout; `shape10` where the person is our own, `tpose_joints` where it is another `person`."""
        rng = np.random.default_rng(seed)
        shape = np.zeros(10) if person else rng.standard_normal(10)
        capture = cls(motion(rng, shape))
        for rig in rigs:
            capture.add(rig, person or load_person(), person is None, scale)
        return capture

    def add(self, rig: str, person: Person, own: bool, scale: int) -> None:
        """The pictures of one rig, its cameras and parameters."""
        faces = person.body.faces.numpy()
        surfaces = [template_surface(person, signals) for signals in self.signals]
        calibration: dict[str, Any] = {}
        for name, camera in cameras(rig, scale).items():
            matrix = camera.camera_from_world
            calibration[name] = {
                "K": camera.intrinsics.ravel().tolist(),
                "R": matrix[:3, :3].tolist(),
                "T": matrix[:3, 3].tolist(),
                "distCoeff": [0, 0, 0, 0, 0],
                "imgSize": [camera.width, camera.height],
                "rectifyAlpha": 0.0,
            }
            for frame, (vertices, _) in enumerate(surfaces):
                mask = silhouette(vertices, faces, camera)
                picture = np.where(mask[..., None], [200, 120, 60], 0).astype(np.uint8)
                self.files[f"{rig}/{name}/{frame:08d}.jpg"] = jpeg(picture)
                self.files[f"{rig}/{name}/mask/pha/{frame:08d}.jpg"] = jpeg(np.uint8(255 * mask))
        self.files[f"{rig}/calibration_full.json"] = json.dumps(calibration).encode()
        self.files[f"{rig}/smpl_params.npz"] = npz(**parameters(self.signals, own))
        truth = {
            "vertices": np.stack([v for v, _ in surfaces]).astype(np.float32),
            "joints": np.stack([j for _, j in surfaces]),
            "faces": faces.astype(np.int32),
        }
        if not own:
            truth["tpose_joints"] = person.body.joint_template.double().numpy()
        self.files[f"{rig}/ground_truth.npz"] = npz(**truth)

    def change(self, rig: str = "body", **arrays: Any) -> TinyCapture:
        """Replace arrays of a rig's parameters; None removes one."""
        name = f"{rig}/smpl_params.npz"
        with np.load(io.BytesIO(self.files[name])) as old:
            merged = {**old, **arrays}
        self.files[name] = npz(**{key: value for key, value in merged.items() if value is not None})
        return self

    def calibrate(self, rig: str = "body", **values: Any) -> TinyCapture:
        """Replace values of every camera of a rig; a function gets the old value, None removes it."""
        name = f"{rig}/calibration_full.json"
        calibration = json.loads(self.files[name])
        for entry in calibration.values():
            for key, value in values.items():
                entry[key] = value(entry[key]) if callable(value) else value
                if value is None:
                    del entry[key]
        self.files[name] = json.dumps(calibration).encode()
        return self

    def manifest(self, **values: Any) -> TinyCapture:
        """Write `capture.json`."""
        self.files["capture.json"] = json.dumps({"format": 1, **values}).encode()
        return self

    def folder(self, path: Path) -> Path:
        """Write as a folder."""
        for name, data in self.files.items():
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            (path / name).write_bytes(data)
        return path

    def zip(self, path: Path, prefix: str = "") -> Path:
        """Write as a zip."""
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in self.files.items():
                archive.writestr(prefix + name, data)
        return path


def parameters(signals: list[Signals], own: bool) -> dict[str, np.ndarray]:
    """`smpl_params.npz` of some frames."""
    pose = np.stack([frame.full_pose() for frame in signals])
    count = len(pose)
    arrays = {
        "global_orient": pose[:, 0],
        "body_pose": pose[:, 1:22].reshape(count, 63),
        "jaw_pose": pose[:, 22],
        "leye_pose": pose[:, 23],
        "reye_pose": pose[:, 24],
        "left_hand_pose": pose[:, 25:40].reshape(count, 45),
        "right_hand_pose": pose[:, 40:].reshape(count, 45),
        "transl": np.stack([frame.translation for frame in signals]),
        "betas": np.zeros((1, 10)),
        "expression": np.zeros((count, 10)),
        "arkit52": np.stack([frame.expression for frame in signals]),
        "arkit_names": np.array([name[0].upper() + name[1:] for name in EXPRESSION_NAMES]),
    }
    return {**arrays, "shape10": signals[0].shape} if own else arrays


def jpeg(pixels: np.ndarray) -> bytes:
    """(h, w) or (h, w, 3) bytes as JPEG without chroma subsampling."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=97, subsampling=0)
    return stream.getvalue()


def png(pixels: np.ndarray) -> bytes:
    """(h, w, 3) or (h, w, 4) bytes as PNG."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def npz(**arrays: Any) -> bytes:
    """Arrays as `.npz`."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()
