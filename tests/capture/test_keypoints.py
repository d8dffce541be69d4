"""Keypoints: one format, checked, without the lens's bend, and sealed like pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from capture.tiny_capture import FRAMES, TinyCapture, npz

from avatarrex.camera import Camera
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.readers.splits import Sealed, sealed
from avatarrex.capture.readers.undistort import bend, distort, straighten
from avatarrex.capture.synthetic.keypoints import LOST, NOISE, SURE, WRONG, detected
from avatarrex.errors import InputError
from avatarrex.signals.joints import JOINT_NAMES

LENS = Lens("bent", Camera.orbit(width=512, height=400), np.array([-0.2, 0.05, 0.001, -0.002, 0.0]))


def keypoints(**changes: Any) -> dict[str, np.ndarray]:
    """Of two joints and two of the body's three cameras, in the other order."""
    shape = (FRAMES, 2, 2)
    points = np.arange(np.prod(shape) * 2, dtype=np.float32).reshape(*shape, 2)
    found = {
        "names": np.array(["left_wrist", "head"]),
        "cameras": np.array(["c2", "c0"]),
        "points": points,
        "confidence": np.full(shape, 0.5, np.float32),
    }
    return {key: value for key, value in {**found, **changes}.items() if value is not None}


def opened(folder: Path, **changes: Any) -> Any:
    capture = TinyCapture.make(("body",))
    capture.files["body/keypoints.npz"] = npz(**keypoints(**changes))
    return open_capture(capture.zip(folder / "a.zip"))


def test_points_come_by_view_and_frame(tmp_path: Path) -> None:
    found = opened(tmp_path).rigs["body"].keypoints
    assert found.joints == (JOINT_NAMES.index("left_wrist"), JOINT_NAMES.index("head"))
    for view, column in ((0, 1), (2, 0)):
        points, confidence = found.at(view, 1)
        np.testing.assert_array_equal(points, keypoints()["points"][1, column])
        np.testing.assert_array_equal(confidence, [0.5, 0.5])
    assert not found.at(1, 1)[1].any(), "a camera that the file does not name saw nothing"
    assert open_capture(TinyCapture.make(("body",)).zip(tmp_path / "b.zip")).rigs["body"].keypoints is None


def test_what_was_not_seen_is_not_read(tmp_path: Path) -> None:
    points, confidence = keypoints()["points"], keypoints()["confidence"]
    points[2, 1, 0], confidence[2, 1, 0] = np.nan, 0
    found = opened(tmp_path, points=points, confidence=confidence).rigs["body"].keypoints.at(0, 2)
    assert np.isfinite(found[0]).all()
    np.testing.assert_array_equal(found[1], [0, 0.5])


def test_the_lens_is_undone(tmp_path: Path) -> None:
    ideal = np.stack(np.meshgrid(np.linspace(0, 512, 9), np.linspace(0, 400, 9)), -1)
    plane = (ideal - LENS.camera.intrinsics[:2, 2]) / np.diag(LENS.camera.intrinsics)[:2]
    taken = bend(LENS, ideal)
    expected = distort(plane, LENS.distortion) * np.diag(LENS.camera.intrinsics)[:2] + LENS.camera.intrinsics[:2, 2]
    np.testing.assert_allclose(taken, expected)
    assert np.abs(taken - ideal).max() > 5
    np.testing.assert_allclose(straighten(LENS, taken), ideal, atol=1e-4)
    capture = TinyCapture.make(("body",)).calibrate(distCoeff=[-0.2, 0.05, 0.001, -0.002, 0])
    capture.files["body/keypoints.npz"] = npz(**keypoints())
    rig = open_capture(capture.zip(tmp_path / "a.zip")).rigs["body"]
    lens = Lens("c0", rig.views[0].camera, LENS.distortion)
    np.testing.assert_allclose(rig.keypoints.at(0, 1)[0], straighten(lens, keypoints()["points"][1, 1]), atol=1e-4)
    points = keypoints()["points"]
    points[1, 1, 0] = 9e4
    capture.files["body/keypoints.npz"] = npz(**keypoints(points=points))
    found = open_capture(capture.zip(tmp_path / "b.zip")).rigs["body"].keypoints.at(0, 1)
    np.testing.assert_array_equal(found[1], [0, 0.5])
    assert np.isfinite(found[0]).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"names": np.array(["left_wrist", "nose"])}, "names: expected each at most once of pelvis, .*, found nose"),
        ({"names": np.array(["head", "head"])}, "names: expected each at most once .*, found head"),
        ({"cameras": np.array(["c0", "c9"])}, "cameras: expected each at most once of c0, c1, c2, …, found c9"),
        ({"cameras": np.array([0, 1])}, "cameras: expected a row of words"),
        ({"points": None}, r"points: expected numbers of shape \(3, 2, 2, 2\), found none"),
        ({"points": np.zeros((2, 2, 2, 2))}, r"points: expected numbers of shape \(3, 2, 2, 2\)"),
        ({"points": np.full((FRAMES, 2, 2, 2), np.nan)}, "points: expected pixels within .*, found 24 others"),
        ({"confidence": None}, r"confidence: expected numbers of shape \(3, 2, 2\), found none"),
        (
            {"confidence": np.full((FRAMES, 2, 2), "1")},
            r"confidence: expected numbers of shape \(3, 2, 2\), found .* of <U1",
        ),
        ({"confidence": np.full((FRAMES, 2, 2), 1.5)}, "confidence: expected numbers from 0 to 1, found 1.5 to 1.5"),
        ({"confidence": np.full((FRAMES, 2, 2), np.nan)}, "confidence: expected numbers from 0 to 1, found nan to nan"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=rf"body/keypoints\.npz: {message}"):
        opened(tmp_path, **changes)


def test_a_sealed_rig_has_none_of_other_splits(tmp_path: Path) -> None:
    capture = opened(tmp_path)
    rig = capture.rigs["body"].holding_out([2], [2])
    capture.rigs["body"] = rig
    training = sealed(capture, "train").rigs["body"].keypoints
    np.testing.assert_array_equal(training.at(0, 1)[0], rig.keypoints.at(0, 1)[0])
    for view, frame in ((0, 2), (2, 1)):
        with pytest.raises(Sealed, match=f"keypoints of view {view}, frame {frame}"):
            training.at(view, frame)
    with pytest.raises(Sealed):
        _ = training.points


def test_a_detector_errs_as_it_says(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    joints = 0.3 * rng.standard_normal((40, 55, 3))
    found = detected(joints, [LENS, Lens("plain", LENS.camera, np.zeros(5))], [7])
    assert json.dumps(found["cameras"].tolist()) == '["bent", "plain"]'
    exact = LENS.camera.pixels(joints)[0]
    for view, taken in enumerate((bend(LENS, exact), exact)):
        seen = found["confidence"][:, view] > 0
        assert (found["confidence"][:, view][seen] >= SURE).all()
        assert abs((~seen).mean() - LOST) < 0.02
        off = (found["points"][:, view] - taken)[seen] * found["confidence"][:, view][seen][:, None]
        assert np.median(np.abs(off)) == pytest.approx(0.6745 * NOISE * 512, rel=0.08)  # of a Gaussian's σ
        assert abs((np.linalg.norm(off, axis=1) > 5 * NOISE * 512).mean() - WRONG) < 0.01
    again = detected(joints, [LENS, Lens("plain", LENS.camera, np.zeros(5))], [7])
    np.testing.assert_array_equal(found["points"], again["points"])
    away = detected(joints + np.array([9, 0, 0]), [LENS], [7])
    assert not away["confidence"].any(), "outside of the picture"
