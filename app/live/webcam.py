"""A webcam as a live source, through mediapipe's face landmarker: 52 coefficients by Apple's names and the head's pose.

mediapipe is an extra (`pip install 'avatarrex-studio[webcam]'`), and its model, `face_landmarker.task`, a file that the user names: the
program downloads nothing. Results that were recorded as lines of JSON (`replayed`) drive without camera, model and extra (`replay.py`):

    {"time": seconds, "weights": {"jawOpen": 0.1, …}, "matrix": 4 × 4}

The matrix takes the canonical face to the camera: x to the right of the picture, y up, z towards the camera. A person who looks into the
camera has its left at the picture's right: these are our axes.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from avatarrex_studio.live.received import APPLE, Received, finite
from avatarrex_studio.live.receiver import Counts
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.files.gate import read_lines, what_is
from avatarrex.files.json_text import parse_json

EXTRA = "pip install 'avatarrex-studio[webcam]'"
MODEL = "a face landmarker of mediapipe (face_landmarker.task, published at ai.google.dev/edge/mediapipe)"


@dataclass(frozen=True)
class Landmarks:
    """What the landmarker found in one picture."""

    seconds: float
    received: Received

    @classmethod
    def of(cls, data: Any, source: str) -> Landmarks:
        """From a line's object. Raises `InputError`."""
        try:
            weights = {
                APPLE[name.lower()]: float(value) for name, value in data["weights"].items() if name.lower() in APPLE
            }
            matrix = finite(np.array(data["matrix"], dtype=np.float64).reshape(16), 1e4).reshape(4, 4)
            finite(np.array([*weights.values(), data["time"]], dtype=np.float64), 1e6)
            head = Rotation.from_matrix(matrix[:3, :3]).as_rotvec()
        except (TypeError, KeyError, ValueError, AttributeError) as error:
            raise InputError(source, "", "time, weights and a 4 × 4 matrix", error) from None
        return cls(float(data["time"]), Received(weights, head=head))


def replayed(path: str | Path) -> Iterator[tuple[float, Received]]:
    """Seconds and what was seen, of a file of recorded results. Raises `InputError`."""
    for number, line in enumerate(read_lines(path, "recorded landmarks"), 1):
        if line.strip():
            found = Landmarks.of(parse_json(line, str(path)), f"{path}: line {number}")
            yield found.seconds, found.received


class Webcam:
    """A camera, or a film in its own time, that is watched in a thread from the moment that this is made until `close`."""

    def __init__(self, model: str, camera: str = "0", arrived: Callable[[], None] = lambda: None) -> None:
        """`model`: the landmarker's file; `camera`: its number, or a film's path. Raises `InputError` for what is missing."""
        if what_is(model) != "a file":
            raise InputError(model, "", MODEL, what_is(model))
        try:
            import cv2
            import mediapipe
        except ImportError as error:
            raise InputError("webcam", "", EXTRA, error) from None
        options = mediapipe.tasks.vision.FaceLandmarkerOptions(
            mediapipe.tasks.BaseOptions(model_asset_path=str(model)),
            output_face_blendshapes=True,
            output_facial_transformation_matrixes=True,
            running_mode=mediapipe.tasks.vision.RunningMode.VIDEO,
        )
        try:
            self._landmarker = mediapipe.tasks.vision.FaceLandmarker.create_from_options(options)
        except (RuntimeError, ValueError) as error:
            raise InputError(model, "", MODEL, error) from None
        number = camera.isdigit()
        self._film = cv2.VideoCapture(int(camera) if number else camera)
        if not self._film.isOpened():
            raise InputError("webcam", camera, "a camera that opens, or a film", "none")
        self.where = f"camera {camera}" if number else Path(camera).name
        self._every = 0.0 if number else 1 / max(self._film.get(cv2.CAP_PROP_FPS), 1.0)
        self._image, self._colour = mediapipe.Image, (mediapipe.ImageFormat.SRGB, cv2.COLOR_BGR2RGB, cv2.cvtColor)
        self._arrived, self._lock, self._closed = arrived, threading.Lock(), threading.Event()
        self._latest: tuple[Received, float] = Received(), float("-inf")
        self._seen = self._empty = 0
        self._thread = threading.Thread(target=self._watch, name="webcam", daemon=True)
        self._thread.start()

    @property
    def counts(self) -> Counts:
        """Pictures, and those without a face as malformed."""
        return Counts(self._seen, self._empty)

    def latest(self) -> tuple[Received, float]:
        """What was seen last, and when."""
        with self._lock:
            return self._latest

    def close(self) -> None:
        """Watch no more."""
        self._closed.set()
        self._thread.join(2.0)
        self._film.release()
        self._landmarker.close()

    def _watch(self) -> None:
        format_, conversion, convert = self._colour
        due = time.monotonic()
        while not self._closed.wait(max(due - time.monotonic(), 0.0)):
            there, picture = self._film.read()
            if not there:
                return
            now = time.monotonic()
            due = max(due, now - self._every) + self._every
            image = self._image(image_format=format_, data=convert(picture, conversion))
            result = self._landmarker.detect_for_video(image, int(now * 1000))
            self._seen += 1
            if not result.face_blendshapes:
                self._empty += 1
                continue
            weights = {shape.category_name: shape.score for shape in result.face_blendshapes[0]}
            data = {"time": now, "weights": weights, "matrix": result.facial_transformation_matrixes[0]}
            with self._lock:
                self._latest = Landmarks.of(data, "webcam").received, now
            self._arrived()
