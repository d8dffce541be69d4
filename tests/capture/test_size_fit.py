"""The size and place of a captured person are found from the mattes alone, and nothing held out is looked at."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from capture.tiny_capture import TinyCapture

from avatarrex.camera import Camera
from avatarrex.capture.fit.capture_fit import fit_capture
from avatarrex.capture.fit.check import iou, posed_in_world, silhouette, template_surface
from avatarrex.capture.fit.outlines import Outline, Seen, seen_frames
from avatarrex.capture.fit.size_fit import PLACE, _SizeFit, boxes, fit_size, outline_change
from avatarrex.capture.readers.rigs import SMPLX_PELVIS, Capture, open_capture
from avatarrex.capture.readers.splits import sealed
from avatarrex.signals.limits import random_signals
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

AWAY = np.array([0.02, 0.9, -0.03])
"""J_0 of a file's model: nowhere near SMPL-X's."""
OFF = np.array([0.08, 0.05, 0.0])


@pytest.fixture(scope="module")
def small() -> Person:
    """Somebody 18 cm shorter, with long arms."""
    offsets = np.zeros((55, 3))
    offsets[[18, 20, *range(25, 40)], 0], offsets[[19, 21, *range(40, 55)], 0] = 0.03, -0.03
    return resize_person(load_person(), PersonFit(np.array([-1.1, 0.5, *np.zeros(8)]), offsets))


def unsized(person: Person, folder: Path, scale: int = 1) -> Path:
    """Their capture with nothing that says how large they are, and its pelvis elsewhere; a frame and a camera held out."""
    capture = TinyCapture.make(("body",), person=person, scale=scale)
    capture.change(transl=np.stack([signals.translation for signals in capture.signals]) - AWAY)
    del capture.files["body/ground_truth.npz"]
    capture.manifest(held_out_frames={"body": [2]}, held_out_cameras={"body": ["c2"]})
    for name in ("body/c0/mask/pha/00000002.jpg", "body/c2/mask/pha/00000001.jpg"):
        capture.files[name] = capture.files[name][:-300]  # whoever decodes it fails
    return capture.zip(folder / "a.zip")


def test_no_more_is_looked_at_than_the_training_sees(small: Person, tmp_path: Path) -> None:
    """Nor what is kept for validation; sealed to the training's split the outlines are the same ones."""
    capture = open_capture(unsized(small, tmp_path))
    rig = replace(capture.rigs["body"], validation_frames=frozenset({1}))
    capture = replace(capture, rigs={"body": rig})
    (whole,), (training,) = seen_frames(capture, 4), seen_frames(sealed(capture, "train"), 4)
    assert whole.signals is rig.signals[0] is training.signals
    assert [camera.key() for camera, _ in whole.pictures] == [rig.views[view].camera.key() for view in (0, 1)]
    assert [camera.key() for camera, _ in training.pictures] == [camera.key() for camera, _ in whole.pictures]
    assert fit_size(capture).sized


def read(path: Path) -> Capture:
    capture = open_capture(path)
    assert not capture.sized
    np.testing.assert_array_equal(capture.pelvis, SMPLX_PELVIS)
    assert any("does not say its size" in note for note in capture.notes)
    return capture


def test_size_and_place_are_found(small: Person, tmp_path: Path) -> None:
    capture = read(unsized(small, tmp_path, scale=2))
    found = fit_size(capture, count=2)
    assert found.sized
    assert found.person.fit is not None
    assert abs(np.ptp(found.person.body.v_template[:, 1].numpy()) - np.ptp(small.body.v_template[:, 1].numpy())) < 0.02
    signals = TinyCapture.make((), person=small).signals
    away = []
    for frame, exact in zip(found.rigs["body"].signals, signals):
        joints = template_surface(found.person, frame)[1]
        away.append(np.linalg.norm(joints - template_surface(small, exact)[1], axis=1))
    assert np.mean(away) < 0.03  # two cameras of 160 pixels, 19 mm each; 1.3 m before
    assert min(overlaps(found)) > 0.9


def overlaps(capture: Capture) -> list[float]:
    """IoU with mattes that are whole; the last is from a camera that nothing was fitted to."""
    rig, faces = capture.rigs["body"], capture.person.body.faces.numpy()
    found = []
    for view, frame in ((0, 0), (0, 1), (1, 0), (1, 1), (2, 0)):
        vertices = template_surface(capture.person, rig.signals[frame])[0]
        found.append(iou(silhouette(vertices, faces, rig.views[view].camera), rig.matte(view, frame) > 128))
    return found


def test_fit_capture_leaves_what_is_known(tmp_path: Path) -> None:
    """The studio's own person in a capture that says so."""
    capture = open_capture(TinyCapture.make(("body",)).zip(tmp_path / "a.zip"))
    assert fit_capture(capture) is capture


def test_how_outlines_follow_the_unknowns(rng: np.random.Generator) -> None:
    """Against differences of whole posed templates; in bones and place the change is linear, so they are exact."""
    fit = _SizeFit(load_person(), [])
    count = 13 + 3 * len(fit.bones)
    unknown = np.concatenate([np.zeros(3), 0.3 * rng.standard_normal(10), 0.02 * rng.standard_normal(count - 13)])
    person, signals = fit.person(unknown), random_signals(rng, 0.4)
    ends = rng.integers(0, len(person.body.v_template), (40, 2))
    outward = rng.standard_normal((40, 3))
    rows = outline_change(person, signals, Outline(ends, outward, np.zeros(40)), *fit._rest_change(person))

    def places(row: np.ndarray) -> np.ndarray:
        one = signals.replace(translation=signals.translation + row[PLACE])
        posed, world = posed_in_world(fit.person(row), one)
        vertices = posed.vertices.double().numpy() @ world[:3, :3].T + world[:3, 3]
        return np.einsum("kc,kc->k", outward, vertices[ends].mean(1))

    for column in (0, 1, 2, 3, 4, 13, 14, 20, 30, count - 1):
        step = np.zeros(count)
        step[column] = 0.05
        difference = (places(unknown + step) - places(unknown - step)) / 0.1
        np.testing.assert_allclose(rows[:, column], difference, atol=5e-3 if 3 <= column < 13 else 2e-4)


def test_the_right_side_mirrors_the_left() -> None:
    fit = _SizeFit(load_person(), [])
    unknown = np.zeros(13 + 3 * len(fit.bones))
    elbow = 13 + 3 * fit.bones.index("left_elbow")
    unknown[elbow : elbow + 3] = 0.01, 0.02, 0.03
    moved = fit.person(unknown).body.joint_template - load_person().body.joint_template
    names = load_person().body.joint_names
    np.testing.assert_allclose(moved[names.index("left_thumb3")], [0.01, 0.02, 0.03], atol=1e-6)
    np.testing.assert_allclose(moved[names.index("right_thumb3")], [-0.01, 0.02, 0.03], atol=1e-6)
    assert not moved[names.index("left_shoulder")].any()


def test_boxes_say_how_far_a_person_is_off(rng: np.random.Generator) -> None:
    """Somebody 8 cm to the right and 5 cm up in a picture; a side at the picture's edge says nothing."""
    person, signals = load_person(), random_signals(rng, 0.2)
    camera = Camera.orbit(0, 0, 3.0, 50, (0, -0.1, 0), 480, 640)
    vertices, _ = template_surface(person, signals)
    matte = 255 * silhouette(vertices + OFF, person.body.faces.numpy(), camera).astype(np.uint8)
    found = boxes(person, Seen(signals, ((camera, lambda: matte),)))
    assert len(found.distance) == 4
    for outward, distance in zip(found.outward, found.distance):
        assert abs(outward @ OFF - distance) < 0.01  # two pixels
    cut = camera.cropped(0, 0, 480, 400)
    found = boxes(person, Seen(signals, ((cut, lambda: matte[:400]),)))
    assert [tuple(np.rint(outward)) for outward in found.outward] == [(-1, 0, 0), (1, 0, 0), (0, 1, 0)]
    assert not len(boxes(person, Seen(signals, ((camera, lambda: np.zeros_like(matte)),))).distance)


def test_a_capture_moves_as_a_whole(small: Person, tmp_path: Path) -> None:
    capture = read(unsized(small, tmp_path))
    moved = capture.moved(OFF)
    np.testing.assert_allclose(moved.pelvis, SMPLX_PELVIS + OFF)
    for before, after in zip(capture.rigs["body"].signals, moved.rigs["body"].signals):
        np.testing.assert_allclose(after.translation - before.translation, OFF)
