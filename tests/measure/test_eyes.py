"""`python -m avatarrex.measure eyes`: where eyes are, and that an error there, and only there, is seen."""

from __future__ import annotations

import numpy as np
import torch
from capture.tiny_capture import TinyCapture

from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.measure.studies.eyes import REACH, Eyes, measure
from avatarrex.metrics.drawing import Drawing
from avatarrex.metrics.evaluate import captured
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.person import load_person


def test_eyes_are_two_spots_about_their_centres():
    person = load_person()
    joints = person.body.joint_template.double().numpy()
    centres = joints[[JOINT_NAMES.index("left_eye"), JOINT_NAMES.index("right_eye")]]
    camera = Camera.orbit(0, 0, 0.6, 20, tuple(centres.mean(0)), 200, 200)
    seen = Eyes(person).seen(Signals.rest(), camera)
    pixels, depth = camera.pixels(centres)
    rows, columns = np.nonzero(seen)
    distance = np.linalg.norm(np.stack([columns, rows], 1)[:, None] + 0.5 - pixels[None], axis=-1).min(1)
    reach = REACH * camera.intrinsics[0, 0] / (depth.min() - REACH)
    assert distance.max() <= reach
    assert seen[tuple(pixels.astype(int).T[::-1])].all(), "the pupils"
    assert 0.02 < seen.mean() < 0.12
    assert not Eyes(person).seen(Signals.rest(), Camera.orbit(180, 0, 0.6, 20, tuple(centres.mean(0)), 200, 200)).any()


class Photograph:
    """Draws what was captured, darker in a part of the picture."""

    def __init__(self, name, rig, dark):
        self.name, self.rig, self.dark = name, rig, dark

    def draw(self, signals, camera):
        frame = next(k for k, own in enumerate(self.rig.signals) if own is signals)
        image = captured(self.rig, 0, frame, camera).layers()
        image[self.dark(signals, camera)] *= 0.5
        empty = np.zeros((*image.shape[:2], 3), np.float32)
        return Drawing(torch.from_numpy(image), empty, empty, image[..., 3] > 0)


def test_only_the_eyes_count(tmp_path):
    capture = open_capture(TinyCapture.make(scale=2).zip(tmp_path / "tiny.zip"))
    rig, eyes = capture.rigs["face"], Eyes(capture.person)

    def around(signals, camera):
        far = np.ones((camera.height, camera.width), bool)
        rows, columns = np.nonzero(eyes.seen(signals, camera))
        far[max(rows.min() - 6, 0) : rows.max() + 7, max(columns.min() - 6, 0) : columns.max() + 7] = False
        return far

    drawers = [Photograph("elsewhere", rig, around), Photograph("eyes", rig, eyes.seen)]
    pairs = [(0, frame) for frame in range(rig.frames)]
    shown = [eyes.seen(rig.signals[frame], rig.views[0].camera).any() for _, frame in pairs]
    assert 0 < sum(shown) < len(pairs), "in some pictures the face is turned away"
    found = measure(capture.person, rig, drawers, pairs)
    assert found["elsewhere"]["ssim"] > 0.9999
    assert found["elsewhere"]["psnr"] > 60
    assert found["eyes"]["psnr"] < 15
    assert found["eyes"]["pictures"] == sum(shown)
