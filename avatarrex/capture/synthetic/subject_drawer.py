"""Pictures of the clothed subject under any driving signal and camera, drawn and lit as `capture make` draws its frames.

The rasteriser, its light, the openness and its ball are the capture's own (rasteriser.py, occlusion.py, plan.py); only the
albedo's spacing differs: it is what contact sheets resolve, so that it is baked in seconds. World metres.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from avatarrex.camera import Camera
from avatarrex.capture.synthetic.albedo_lattice import bake
from avatarrex.capture.synthetic.occlusion import Occlusion
from avatarrex.capture.synthetic.plan import SIZES, RigPlan
from avatarrex.capture.synthetic.rasteriser import Rasteriser
from avatarrex.capture.synthetic.subject import Subject
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.sequence import SignalSequence

ALBEDO_SPACING = {"body": 0.003, "hand": 0.002, "face": 0.001}
"""Metres between albedo samples: under a pixel of a figure 500 pixels tall, of a hand or a head 250 pixels wide."""
DETAIL_RADIUS = 0.2
"""Metres about wrists and head that count as hand and face."""


class SubjectDrawer:
    """Draws one subject; views after one another of one pose share its mesh. Raises `NoContext` without OpenGL 4.3."""

    def __init__(self, subject: Subject, spacing: dict[str, float] | None = None, samples: int = 3) -> None:
        """`spacing` in metres as `ALBEDO_SPACING`; `samples` along each side of a pixel."""
        self._subject, self._size = subject, SIZES["small"]
        self._rasteriser = Rasteriser(
            subject.faces, bake(subject, _spacing(subject, spacing or ALBEDO_SPACING)), samples
        )
        vertices = len(subject.vertices)
        self._occlusion = Occlusion(subject.faces, vertices, self._size.directions, self._size.body.shadow_map)
        self._drawn: tuple[Signals, str] | None = None

    def draw(self, signals: Signals, camera: Camera, rig: str = "body") -> Float32[np.ndarray, "h w 4"]:
        """Premultiplied sRGB-encoded colour and coverage; `rig` "face" takes the openness about the head alone, as the
        capture's face rig does.
        """
        return self._rasteriser.draw(self._posed(signals, camera, rig)).colour

    def depth(self, signals: Signals, camera: Camera) -> Float32[np.ndarray, "h w"]:
        """Camera z in metres under each pixel's centre, 0 where nothing is hit."""
        return self._rasteriser.geometry(self._posed(signals, camera, "body")).depth

    def _posed(self, signals: Signals, camera: Camera, rig: str) -> Camera:
        """The camera as seen from the root frame of the subject, which is posed now."""
        size = self._size.face if rig == "face" else self._size.body
        frame = RigPlan(rig, self._subject, SignalSequence((signals,), 30.0), size, self._size)
        if self._drawn != (signals, rig):
            posed = frame.posed(0)
            ball = frame.occlusion_ball(posed.vertices)
            self._rasteriser.pose(posed, self._occlusion.openness(posed.vertices, posed.normals, *ball))
            self._drawn = (signals, rig)
        return camera.seen_from(frame.world_from_root(0))


def _spacing(subject: Subject, metres: dict[str, float]) -> np.ndarray:
    """(f,) metres between albedo samples."""
    joints = subject.person.body.joint_template.double().numpy()
    middle = subject.vertices[subject.faces].mean(1)

    def near(name: str) -> np.ndarray:
        return np.asarray(np.linalg.norm(middle - joints[JOINT_NAMES.index(name)], axis=1) < DETAIL_RADIUS)

    hand = near("left_wrist") | near("right_wrist")
    return np.where(near("head"), metres["face"], np.where(hand, metres["hand"], metres["body"]))
