"""What a synthetic capture of a given size and seed consists of, before anything is drawn.

Letters: t frames, v vertices, f faces. World metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from avatarrex.camera import Camera
from avatarrex.capture.synthetic.cameras import body_ring, face_arc, fitted
from avatarrex.capture.synthetic.imaging import Imaging
from avatarrex.capture.synthetic.motions import body_motion, face_motion, turning
from avatarrex.capture.synthetic.subject import PosedSubject, Subject, load_subject
from avatarrex.capture.synthetic.variation import DEFAULT, Variation
from avatarrex.errors import InputError
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.transform import world_from_root

GARMENTS = {"printed": "default", "loose": "loose"}
"""The packaged subject of each."""
GIRTH = {"printed": 0.0, "loose": 14.0}
"""Degrees that arms stay further out where hands touch the body: the tunic stands off it."""
HELD_OUT = {"body": ((0.45, 0.55), (0.825, 0.925)), "face": ((0.3, 0.4), (0.8, 0.9))}
"""Parts of the time that no training sees: whole stretches, so that no neighbouring frame gives them away."""
PICTURE_SHARE = {"body": 0.96, "face": 0.86}
"""Share of half the picture that the subject (the skin of the face) may reach."""
FINEST_SPACING = 0.0002
"""Metres between albedo samples at least: a quarter of the texture's finest edge."""
TURN = {"body": 50.0, "face": 15.0}
"""Degrees to either side that the person turns where the light stays: else a fixed light would look like one that turns along."""
STRIDE = 8
"""Every so many frames of the others have exact depth and normals, too."""


@dataclass(frozen=True)
class RigSize:
    """How large one rig is."""

    cameras: int
    frames: int
    held_out_cameras: tuple[int, ...]
    shadow_map: int
    """Texels a side of the depth maps of ambient occlusion."""


@dataclass(frozen=True)
class Size:
    """How large a capture is."""

    width: int
    height: int
    samples: int
    """Along each side of a pixel."""
    directions: int
    """Of ambient occlusion."""
    body: RigSize
    face: RigSize


SIZES = {
    "smoke": Size(96, 128, 3, 8, RigSize(4, 4, (1,), 256), RigSize(3, 4, (1,), 256)),
    "small": Size(384, 512, 4, 48, RigSize(16, 80, (2, 11), 768), RigSize(6, 80, (3,), 768)),
    "paper": Size(1500, 2048, 3, 96, RigSize(16, 400, (2, 11), 1536), RigSize(6, 300, (3,), 1536)),
}


@dataclass(frozen=True)
class RigPlan:
    """One rig of a capture."""

    name: str
    subject: Subject
    motion: SignalSequence
    size: RigSize
    picture: Size
    seed: int = 0
    variation: Variation = DEFAULT

    @cached_property
    def imaging(self) -> Imaging:
        """What its cameras make of what they see."""
        return Imaging(self.name, self.variation, self.seed)

    def light_from_root(self, frame: int) -> np.ndarray:
        """(3, 3): the light is fixed in the root frame, or in the world."""
        return self.world_from_root(frame)[:3, :3] if self.variation.has("light") else np.eye(3)

    def posed(self, frame: int) -> PosedSubject:
        """The subject in the root frame."""
        return self.subject.pose(self.motion[frame])

    def world_from_root(self, frame: int) -> np.ndarray:
        """(4, 4) rigid."""
        signals = self.motion[frame]
        pelvis = self.subject.person.body.joint_template[0].double().numpy()
        return world_from_root(signals.global_orient, signals.translation, pelvis)

    @cached_property
    def world_vertices(self) -> np.ndarray:
        """(t, v, 3) float32 world metres."""
        moved = np.empty((len(self.motion), *self.subject.vertices.shape), np.float32)
        for frame in range(len(moved)):
            placed = self.world_from_root(frame)
            moved[frame] = self.posed(frame).vertices @ placed[:3, :3].T + placed[:3, 3]
        return moved

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        """By serial number, which AvatarReX's are: eight digits."""
        keep = np.flatnonzero(self._framed)[::4]  # a few millimetres apart
        points = self.world_vertices[:, keep].astype(np.float64)
        low, high = points.min((0, 1)), points.max((0, 1))
        make, first = (body_ring, 24070100) if self.name == "body" else (face_arc, 24070200)
        cameras = make(self.size.cameras, self.picture.width, self.picture.height, (low + high) / 2)
        return {str(first + k): camera for k, camera in enumerate(fitted(cameras, points, PICTURE_SHARE[self.name]))}

    @property
    def held_out_frames(self) -> list[int]:
        """Frames that no training sees."""
        count = len(self.motion)
        stretches = HELD_OUT[self.name]
        inside = [t for t in range(count) if any(a <= (t + 0.5) / count < b for a, b in stretches)]
        return inside or [int(sum(stretches[0]) / 2 * count)]

    @property
    def held_out_cameras(self) -> list[str]:
        """Cameras that no training sees."""
        serials = list(self.cameras)
        return [serials[k] for k in self.size.held_out_cameras]

    @property
    def depth_frames(self) -> list[int]:
        """Frames with exact depth and normals: the held-out ones, and some of the others."""
        return sorted({*self.held_out_frames, *range(0, len(self.motion), STRIDE)})

    @cached_property
    def _framed(self) -> np.ndarray:
        """(v,) what must be in every picture: all of the body; the skin of the face."""
        if self.name == "body":
            return np.ones(len(self.subject.vertices), dtype=bool)
        framed = np.zeros(len(self.subject.vertices), dtype=bool)
        framed[np.unique(self.subject.faces[self.subject.faces_of("face")])] = True
        return framed

    def spacing(self) -> np.ndarray:
        """(f,) metres between albedo samples: two to a pixel or more, a third of the finest edge of the texture on the face."""
        camera = next(iter(self.cameras.values()))
        distance = np.linalg.norm(camera.centre - self.world_vertices[0, self._framed].mean(0))
        finest = max(1.8 * distance / (camera.intrinsics[0, 0] * self.picture.samples), FINEST_SPACING)
        if self.name == "body":
            return np.full(len(self.subject.faces), finest)
        head = self.subject.person.body.joint_template[JOINT_NAMES.index("head")].double().numpy()
        away = np.linalg.norm(self.subject.vertices[self.subject.faces].mean(1) - head, axis=1)
        return np.where(away < 0.20, finest, np.where(away < 0.5, 6 * finest, 0.05))

    def occlusion_ball(self, vertices: np.ndarray) -> tuple[np.ndarray, float]:
        """Centre (3,) and radius of what openness is needed for, given posed `vertices` (v, 3) of the root frame."""
        if self.name == "face":
            return vertices[self._framed].mean(0), 0.30
        centre = (vertices.min(0) + vertices.max(0)) / 2
        return centre, float(np.linalg.norm(vertices - centre, axis=1).max())


@dataclass(frozen=True)
class Plan:
    """A capture."""

    size: str
    seed: int
    garment: str
    variation: Variation
    rigs: tuple[RigPlan, ...]


def plan(size: str, seed: int, garment: str, variation: Variation = DEFAULT) -> Plan:
    """The capture of that name. Raises `InputError` for an unknown size or garment, or a negative seed."""
    for option, value, known in (("--size", size, SIZES), ("--garment", garment, GARMENTS)):
        if value not in known:
            raise InputError(option, "", "one of " + ", ".join(known), value)
    if not 0 <= seed < 2**32:
        raise InputError("--seed", "", "an integer from 0 to 4294967295", seed)
    subject, chosen = variation.applied(load_subject(GARMENTS[garment])), SIZES[size]
    motions = {
        "body": body_motion(chosen.body.frames, seed, GIRTH[garment]),
        "face": face_motion(chosen.face.frames, seed),
    }
    if variation.has("light"):
        motions = {rig: turning(motion, TURN[rig]) for rig, motion in motions.items()}
    body, face = (RigPlan(rig, subject, motions[rig], getattr(chosen, rig), chosen, seed, variation) for rig in motions)
    return Plan(size, seed, garment, variation, (body, face))
