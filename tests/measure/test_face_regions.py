"""`python -m avatarrex.measure face-regions`: where eyes and mouth are, that an error there alone is seen, how far a surface is off."""

from __future__ import annotations

import numpy as np
import torch
from capture.tiny_capture import TinyCapture
from templates.test_face_labels import lowered

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.measure.studies.face_regions import REACH, Regions, Study, surface_distances
from avatarrex.metrics.drawing import Drawing
from avatarrex.metrics.evaluate import captured
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.templates.person import load_person


def test_eyes_are_two_spots_about_their_centres():
    person = load_person()
    joints = person.body.joint_template.double().numpy()
    centres = joints[[JOINT_NAMES.index("left_eye"), JOINT_NAMES.index("right_eye")]]
    camera = Camera.orbit(0, 0, 0.6, 20, tuple(centres.mean(0)), 200, 200)
    seen = Regions(person).seen(Signals.rest(), camera)["eyes"]
    pixels, depth = camera.pixels(centres)
    rows, columns = np.nonzero(seen)
    distance = np.linalg.norm(np.stack([columns, rows], 1)[:, None] + 0.5 - pixels[None], axis=-1).min(1)
    reach = REACH * camera.intrinsics[0, 0] / (depth.min() - REACH)
    assert distance.max() <= reach
    assert seen[tuple(pixels.astype(int).T[::-1])].all(), "the pupils"
    assert 0.02 < seen.mean() < 0.12
    behind = Camera.orbit(180, 0, 0.6, 20, tuple(centres.mean(0)), 200, 200)
    assert not Regions(person).seen(Signals.rest(), behind)["eyes"].any()


def test_the_mouth_is_beneath_the_eyes_and_grows_with_the_jaw():
    person = load_person()
    head = person.body.joint_template[JOINT_NAMES.index("head")].double().numpy()
    camera = Camera.orbit(0, 0, 0.9, 20, tuple(head + np.array([0, 0.03, 0])), 200, 200)
    opened = np.zeros(52)
    opened[EXPRESSION_NAMES.index("jawOpen")] = 0.7
    rest = Regions(person).seen(Signals.rest(), camera)
    wide = Regions(person).seen(Signals.rest().replace(expression=opened), camera)
    assert np.nonzero(rest["mouth"])[0].min() > np.nonzero(rest["eyes"])[0].max()
    assert (rest["mouth"] & ~rest["face"]).sum() < 0.1 * rest["mouth"].sum()
    assert wide["mouth"].sum() > 1.3 * rest["mouth"].sum()
    assert rest["face"].sum() > 10 * rest["mouth"].sum()


def test_regions_are_the_same_for_a_fit_of_before():
    now, before = (Regions(lowered(stay)).faces for stay in (True, False))
    assert all(np.array_equal(now[name], before[name]) for name in now)


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
    rig, regions = capture.rigs["face"], Regions(capture.person)

    def eyes(signals, camera):
        return regions.seen(signals, camera)["eyes"]

    def around(signals, camera):
        far = np.ones((camera.height, camera.width), bool)
        rows, columns = np.nonzero(eyes(signals, camera))
        far[max(rows.min() - 6, 0) : rows.max() + 7, max(columns.min() - 6, 0) : columns.max() + 7] = False
        return far

    drawers = [Photograph("elsewhere", rig, around), Photograph("eyes", rig, eyes)]
    pairs = [(0, frame) for frame in range(rig.frames)]
    shown = [eyes(rig.signals[frame], rig.views[0].camera).any() for _, frame in pairs]
    assert 0 < sum(shown) < len(pairs), "in some pictures the face is turned away"
    found = Study(rig, pairs).measure(capture.person, drawers)["eyes"]
    assert found["elsewhere"]["ssim"] > 0.9999
    assert found["elsewhere"]["psnr"] > 60
    assert found["eyes"]["psnr"] < 15
    assert found["eyes"]["pictures"] == sum(shown)


def test_a_gain_forgives_a_tone_and_nothing_else(tmp_path):
    capture = open_capture(TinyCapture.make(scale=2).zip(tmp_path / "tiny.zip"))
    rig, regions = capture.rigs["face"], Regions(capture.person)
    drawers = [
        Photograph("tone", rig, lambda signals, camera: np.ones((camera.height, camera.width), bool)),
        Photograph("eyes", rig, lambda signals, camera: regions.seen(signals, camera)["eyes"]),
    ]
    pairs = [(0, frame) for frame in range(rig.frames)]
    plain, gained = (Study(rig, pairs, gain).measure(capture.person, drawers) for gain in (False, True))
    assert plain["face"]["tone"]["psnr"] < 15
    assert gained["face"]["tone"]["psnr"] > 60
    assert gained["eyes"]["eyes"]["psnr"] < 25


def test_distances_of_a_surface_are_those_of_the_mesh_it_is_compared_with(monkeypatch):
    """With a field that has the mesh 2 mm inside, points of it are 2 mm inside; a closed mouth shows no tongue."""
    avatar, opened = load_avatar(), np.zeros(52)
    opened[EXPRESSION_NAMES.index("jawOpen")] = 0.7
    monkeypatch.setattr(type(avatar.face), "sdf", lambda self, planes, points: torch.full((len(points),), -0.002))
    closed, wide = (
        surface_distances(avatar, [signals]) for signals in (Signals.rest(), Signals.rest().replace(expression=opened))
    )
    assert {"eyeballs", "lids", "lips", "other skin"} <= set(closed)
    assert set(wide) - set(closed) == {"tongue"}
    for values in closed.values():
        assert abs(values["mean_abs_mm"] - 2) < 1e-4
        assert abs(values["median_mm"] + 2) < 1e-4
    assert wide["tongue"]["points"] > 50
    assert closed["other skin"]["points"] > 5000
    monkeypatch.undo()
    assert 0 < surface_distances(avatar, [Signals.rest()])["lids"]["mean_abs_mm"] < 2, "the default avatar's own"
