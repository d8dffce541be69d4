"""A small capture of the clothed synthetic subject, drawn without OpenGL: pictures in one colour, mattes as exact as pixels are."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from capture.tiny_capture import jpeg, npz, png
from PIL import Image

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import silhouette
from avatarrex.capture.importers.import_capture import calibration
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.synthetic.cameras import body_ring, fitted
from avatarrex.capture.synthetic.motions import body_motion
from avatarrex.capture.synthetic.subject import Subject, load_subject
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_ROWS
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.transform import world_from_root

FINER = 3
"""Pixels are averaged over so many rows and columns."""


@lru_cache(maxsize=1)
def subject() -> Subject:
    """Read once."""
    return load_subject("default")


@dataclass
class Clothed:
    """Somebody in a short motion before a ring of cameras."""

    cameras: int = 6
    frames: int = 3
    seed: int = 0
    size: tuple[int, int] = (192, 256)
    changed: dict[str, np.ndarray] = field(default_factory=dict)
    """Parameters that the file has otherwise."""

    @cached_property
    def motion(self) -> SignalSequence:
        """Far apart in time."""
        whole = body_motion(self.frames * 4, self.seed)
        return replace(whole, frames=tuple(whole[4 * frame + self.seed % 4] for frame in range(self.frames)))

    @cached_property
    def surfaces(self) -> np.ndarray:
        """(t, v, 3) world metres."""
        found = []
        for signals in self.motion:
            world = world_from_root(signals.global_orient, signals.translation, np.zeros(3))
            found.append(subject().pose(signals).vertices @ world[:3, :3].T + world[:3, 3])
        return np.array(found)

    @cached_property
    def lenses(self) -> dict[str, Camera]:
        """By name."""
        points = self.surfaces[:, ::8]
        middle = (points.min((0, 1)) + points.max((0, 1))) / 2
        return {f"c{k}": one for k, one in enumerate(fitted(body_ring(self.cameras, *self.size, middle), points, 0.94))}

    @cached_property
    def mattes(self) -> dict[tuple[str, int], np.ndarray]:
        """(h, w) bytes by camera and frame."""
        found = {}
        for name, camera in self.lenses.items():
            fine = camera.resized(FINER * camera.width, FINER * camera.height)
            for frame, vertices in enumerate(self.surfaces):
                mask = silhouette(vertices, subject().faces, fine)
                found[name, frame] = np.array(
                    Image.fromarray(np.uint8(255 * mask)).resize((camera.width, camera.height), Image.Resampling.BOX)
                )
        return found

    def parameters(self) -> dict[str, np.ndarray]:
        """`smpl_params.npz`."""
        pose = np.stack([one.full_pose() for one in self.motion])
        flat = {name: pose[:, rows].reshape(len(pose), -1) for name, rows in JOINT_ROWS.items() if name != "eye_pose"}
        return {
            **flat, "transl": np.stack([one.translation for one in self.motion]), "shape10": np.zeros(10), "flat_hand_mean": np.array(True),
            "arkit52": np.stack([one.expression for one in self.motion]), "arkit_names": np.array(EXPRESSION_NAMES), **self.changed,
        }  # fmt: skip

    def write(
        self, out: Path, pictures: dict[str, str] | None = None, flipped: bool = False, shift: float = 0.0
    ) -> Path:
        """Our layout. `pictures`: whose a camera's are, where not its own; `flipped` rows; `shift` of principal points."""
        body = out / "body"
        moved = np.array([[0, 0, shift], [0, 0, shift], [0, 0, 0]])
        lenses = [
            Lens(name, replace(one, intrinsics=one.intrinsics + moved), np.zeros(5))
            for name, one in self.lenses.items()
        ]
        body.mkdir(parents=True)
        (body / "calibration_full.json").write_text(json.dumps(calibration(tuple(lenses))))
        (body / "smpl_params.npz").write_bytes(npz(**self.parameters()))
        for name, frame in self.mattes:
            matte = self.mattes[(pictures or {}).get(name, name), frame]
            matte = matte[::-1] if flipped else matte
            folder = body / name / "mask" / "pha"
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{frame:08d}.png").write_bytes(png(np.ascontiguousarray(matte)))
            picture = np.uint8(matte[..., None] * np.array([0.8, 0.6, 0.5]))
            (body / name / f"{frame:08d}.jpg").write_bytes(jpeg(picture))
        return out
