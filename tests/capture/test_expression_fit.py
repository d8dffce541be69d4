"""Expressions from landmarks of a face: of known coefficients, with a detector's errors, on another face than the template's."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from capture import filmed
from capture.clothed import Clothed
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from avatarrex.camera import Camera
from avatarrex.capture.fit.expression_fit import ROWS, SOUGHT, Expressions, _bounded, fit_expressions
from avatarrex.capture.fit.face_marks import FACE_NAMES, NUMBERS, VERTICES, FaceMarks, face_marks
from avatarrex.capture.importers.detections import BODY_25, MESH, read_detections
from avatarrex.capture.importers.preparing import Preparing
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.synthetic.cameras import body_ring, face_arc, fitted
from avatarrex.errors import InputError
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.official.parts import COMMON
from avatarrex.templates.person import load_person

FRAMES, NOISE, WRONG = 30, 1.5, 0.05
"""Pixels, and the share of landmarks that are anywhere in the picture."""
HEAD_OFF, HEAD_TURNED = 0.01, 0.03
"""Metres and radians that the first fit's head is off in each frame."""
MOVED = ("jawOpen", "mouthSmile", "eyeBlink", "brow", "mouthPucker")
"""What the coefficients that are not zero throughout begin with."""


def rows_of(start: str) -> list[int]:
    return [row for row, name in enumerate(EXPRESSION_NAMES) if name.startswith(start)]


def track() -> np.ndarray:
    """(t, 52): jaw, smile, lids, brows and a pucker, each by itself, left before right."""
    angle = np.linspace(0, 2 * np.pi, FRAMES)
    weights = np.zeros((FRAMES, 52))
    waves = {
        "jawOpen": 0.6 * np.sin(angle), "browInnerUp": 0.7 * np.sin(2 * angle), "mouthPucker": 0.7 * np.sin(1.5 * angle + 5),
    }  # fmt: skip
    for side, late in (("Left", 0.0), ("Right", 0.3)):
        waves[f"mouthSmile{side}"] = 0.8 * np.sin(1.5 * angle + 2 + late)
        waves[f"eyeBlink{side}"] = np.sin(3 * angle + 1)
        waves[f"browOuterUp{side}"] = 0.7 * np.sin(2 * angle + late)
        waves[f"browDown{side}"] = -0.7 * np.sin(2 * angle + late)
    for name, wave in waves.items():
        weights[:, EXPRESSION_NAMES.index(name)] = wave.clip(0)
    return weights


@dataclass
class Seen:
    """What cameras see of a face, and what is true."""

    cameras: tuple[Camera, ...]
    points: np.ndarray
    confidence: np.ndarray
    heads: np.ndarray
    marks: FaceMarks
    places: np.ndarray

    def fit(self) -> Expressions:
        return fit_expressions(self.cameras, self.points, self.confidence, self.heads, self.marks)


def seen(face_off: float = 0.003, around: bool = False, wrong: float = WRONG) -> Seen:
    """Six cameras before a face whose landmarks lie `face_off` metres off the template's, in x, y and z; or sixteen around the body."""
    rng, marks, weights = np.random.default_rng(0), face_marks(load_person()), track()
    rest = marks.rest + face_off * rng.standard_normal(marks.rest.shape)
    angle = np.linspace(0, 6, FRAMES)
    turn = Rotation.from_rotvec(np.stack([0.1 * np.sin(angle), 0.3 * np.cos(angle), 0 * angle], 1))
    place = np.array([0, 1.5, 0])
    local = rest + np.einsum("lie,te->tli", marks.directions, weights)
    places = np.einsum("tij,tlj->tli", turn.as_matrix(), local) + place
    arc = face_arc(6, 384, 512, place + np.array([0, 0, 0.05]))
    cameras = body_ring(16, 1500, 2048, place - [0, 0.5, 0]) if around else fitted(arc, places, 0.6)
    found = filmed.detected(places, cameras, NOISE, wrong)
    heads = np.tile(np.eye(4), (FRAMES, 1, 1))
    heads[:, :3, :3] = (Rotation.from_rotvec(HEAD_TURNED * rng.standard_normal((FRAMES, 3))) * turn).as_matrix()
    heads[:, :3, 3] = place + HEAD_OFF * rng.standard_normal((FRAMES, 3))
    return Seen(tuple(cameras), found[..., :2], found[..., 2], heads, marks, places)


def errors(found: Expressions) -> dict[str, float]:
    """Mean error of the coefficients that move, and what the others have been given in the mean."""
    away = np.abs(found.weights - track())
    still = [row for row in ROWS if not track()[:, row].any()]
    return {name: float(away[:, rows_of(name)].mean()) for name in MOVED} | {"still": float(away[:, still].mean())}


def millimetres(found: Expressions, places: np.ndarray) -> float:
    return 1000 * float(np.linalg.norm(found.places - places, axis=2).mean())


@pytest.mark.parametrize(
    ("around", "landmarks", "most"),
    [
        (False, 0.6, {"jawOpen": 0.03, "mouthSmile": 0.03, "eyeBlink": 0.04, "brow": 0.09, "mouthPucker": 0.06, "still": 0.015}),
        (True, 1.0, {"jawOpen": 0.04, "mouthSmile": 0.06, "eyeBlink": 0.08, "brow": 0.15, "mouthPucker": 0.1, "still": 0.04}),
    ],
    ids=["six before the face", "sixteen around the body"],
)  # fmt: skip
def test_known_coefficients_are_found(around: bool, landmarks: float, most: dict[str, float]) -> None:
    """With noise, outliers, a head that is off and a face that is another one; one in twenty landmarks is anywhere."""
    scene = seen(around=around)
    found = scene.fit()
    assert millimetres(found, scene.places) < landmarks
    for name, error in errors(found).items():
        assert error < most[name], name
    assert found.weights.min() >= 0
    assert found.weights.max() <= 1
    assert not np.delete(found.weights, ROWS, 1).any()


def test_an_exact_face_is_found_exactly() -> None:
    scene = seen(face_off=0)
    exact = np.stack([camera.pixels(scene.places)[0] for camera in scene.cameras], 1)
    found = replace(scene, points=exact).fit()
    assert millimetres(found, scene.places) < 0.2
    assert errors(found)["jawOpen"] < 0.01


def test_wrong_landmarks_are_not_believed() -> None:
    scene = seen()
    off = scene.points - np.stack([camera.pixels(scene.places)[0] for camera in scene.cameras], 1)
    wrong = np.linalg.norm(off, axis=-1) > 30
    believed = scene.fit().believed
    assert wrong.sum() > 300
    assert not believed[wrong].any()
    assert believed[~wrong].mean() > 0.85


def test_cameras_behind_the_head_say_nothing() -> None:
    """A detector that guesses a face from behind draws all its landmarks elsewhere, alike: no outliers by themselves."""
    scene = seen(around=True, wrong=0)
    forward = scene.heads[:, :3, 2].mean(0)
    behind = np.array([(camera.centre - scene.places.mean((0, 1))) @ forward < -2 for camera in scene.cameras])
    assert behind.sum() > 3
    points = scene.points.copy()
    points[:, behind] += [0, 8]
    found = replace(scene, points=points).fit()
    assert not found.believed[:, behind].any()
    assert millimetres(found, scene.places) < 1.0


def test_a_frame_without_landmarks_is_between_its_neighbours() -> None:
    scene = seen()
    confidence = scene.confidence.copy()
    confidence[5] = 0
    found = replace(scene, confidence=confidence).fit().weights
    np.testing.assert_allclose(found[5], (found[4] + found[6]) / 2)
    assert found[5, EXPRESSION_NAMES.index("jawOpen")] > 0.3


def test_without_landmarks_all_is_at_rest() -> None:
    scene = seen()
    found = replace(scene, confidence=np.zeros_like(scene.confidence)).fit()
    assert not found.weights.any()
    assert not found.believed.any()


def test_bounds_are_kept_as_another_solver_keeps_them() -> None:
    rng = np.random.default_rng(1)
    rows, right = rng.standard_normal((4, 20, 8)), 3 * rng.standard_normal((4, 20))
    low, high = np.tile(-0.1 * np.ones(8), (4, 1)), np.tile(0.3 * np.ones(8), (4, 1))
    found = _bounded(rows.swapaxes(1, 2) @ rows, (rows.swapaxes(1, 2) @ right[..., None])[..., 0], low, high)
    for k in range(4):
        other = lsq_linear(rows[k], right[k], (low[k], high[k]), method="bvls", tol=1e-12).x
        np.testing.assert_allclose(found[k], other, atol=1e-6)
    assert (np.abs(found - 0.3) < 1e-9).any()


def test_marks_are_where_their_names_say() -> None:
    """Both sides alike; the order of the face from the brows to the chin; lids close over eyes, the lower lip goes down with the jaw."""
    person, at = load_person(), NUMBERS.index
    marks = face_marks(person)
    rest = person.body.v_template.numpy()[list(VERTICES.values())]
    assert (VERTICES[8], VERTICES[30]) == (5225, 297)
    mirrored = {**{k: 43 - k for k in range(17, 22)}, 31: 35, 32: 34, 36: 45, 37: 44, 38: 43, 39: 42, 40: 47, 41: 46,
                48: 54, 49: 53, 50: 52, 58: 56, 59: 55, 60: 64, 61: 63, 67: 65}  # fmt: skip
    for right, left in mirrored.items():
        np.testing.assert_allclose(rest[at(right)] * [-1, 1, 1], rest[at(left)], atol=1e-6)
        assert rest[at(right), 0] < 0
    for number in set(NUMBERS) - set(mirrored) - set(mirrored.values()):
        assert rest[at(number), 0] == pytest.approx(0, abs=1e-6)
    heights = [rest[at(number), 1] for number in (19, 37, 41, 28, 30, 33, 51, 62, 66, 57, 8)]
    assert heights == sorted(heights, reverse=True)
    blink, jaw = (marks.directions[:, 1, EXPRESSION_NAMES.index(name)] for name in ("eyeBlinkRight", "jawOpen"))
    assert blink[[at(37), at(38)]].max() < -0.008
    assert abs(blink[[at(40), at(41)]]).max() < 0.001
    assert jaw[[at(66), at(57), at(8)]].max() < -0.02 < jaw[at(62)]
    np.testing.assert_array_equal(face_marks(replace(person, name="another")).rest, marks.rest)


def test_the_coefficients_that_are_sought_are_told_apart() -> None:
    """What is left of each beside all others and a rigid motion is 0.5 mm or more at one landmark."""
    marks = face_marks(load_person())
    rigid = [np.tile(axis, (len(marks.rest), 1)) for axis in np.eye(3)] + [
        np.cross(axis, marks.rest) for axis in np.eye(3)
    ]
    whole = np.concatenate([marks.directions[..., ROWS].reshape(-1, len(ROWS)), np.reshape(rigid, (6, -1)).T], 1)
    for column, name in enumerate(SOUGHT):
        others = np.delete(whole, column, 1)
        left = whole[:, column] - others @ np.linalg.lstsq(others, whole[:, column], rcond=None)[0]
        assert np.linalg.norm(left.reshape(-1, 3), axis=1).max() > 0.0005, name


def test_both_detectors_say_the_same_of_a_face(tmp_path: Path) -> None:
    lens = Lens("c0", face_arc(1, 384, 512, np.zeros(3))[0], np.zeros(5))
    exact = np.random.default_rng(0).uniform(10, 300, (len(FACE_NAMES), 3))
    exact[:, 2] = 1
    (tmp_path / "open" / "c0").mkdir(parents=True)
    (tmp_path / "media").mkdir()
    said = filmed.openpose(exact, FACE_NAMES)
    assert len(said["people"][0]["face_keypoints_2d"]) == 210
    (tmp_path / "open" / "c0" / "v_000000000000_keypoints.json").write_text(json.dumps(said))
    (tmp_path / "media" / "c0.json").write_text(json.dumps([filmed.mediapipe(exact, (384, 512), FACE_NAMES), None]))
    for folder in ("open", "media"):
        points, confidence, problems = read_detections(tmp_path / folder, (lens,), names=FACE_NAMES)
        np.testing.assert_allclose(points[0, 0], exact[:, :2], atol=2e-3)
        assert (confidence[0] > 0.7).all()
        assert not problems
    assert not read_detections(tmp_path / "open", (lens,))[1].any()  # nothing of the body
    numbers = {MESH[row]: row for row in MESH}
    for number, row in zip(*(COMMON[kind] for kind in (False, True))):
        assert numbers[f"face_{number}"] == row
    said["people"][0]["face_keypoints_2d"] = said["people"][0]["face_keypoints_2d"][:30]
    (tmp_path / "open" / "c0" / "v_000000000000_keypoints.json").write_text(json.dumps(said))
    assert not read_detections(tmp_path / "open", (lens,), names=FACE_NAMES)[1].any()


def test_a_face_that_cannot_be_read_costs_no_body(tmp_path: Path) -> None:
    lens = Lens("c0", face_arc(1, 384, 512, np.zeros(3))[0], np.zeros(5))
    body = tuple(name for name in BODY_25[:8] if name)
    names = (*body, *FACE_NAMES)
    said = filmed.openpose(np.tile([100.0, 100.0, 1.0], (len(names), 1)), names)
    (tmp_path / "c0").mkdir()
    for broken in ([1.0] * 136, [None] * 210, [float("nan")] * 210):
        said["people"][0]["face_keypoints_2d"] = broken
        (tmp_path / "c0" / "v_000000000000_keypoints.json").write_text(json.dumps(said))
        _, confidence, problems = read_detections(tmp_path, (lens,), names=body)
        assert confidence.all()
        assert not problems
        with pytest.raises(InputError, match="face_keypoints_2d"):
            read_detections(tmp_path, (lens,), names=FACE_NAMES)


def test_mediapipes_landmarks_lie_on_its_own_rings(tmp_path: Path) -> None:
    """Its published connections of eyes, lips and brows, in the order that iBUG has; tasks of it write a list of faces."""
    order = {number: row for row, name in MESH.items() for number in [int(name.removeprefix("face_"))]}
    right_eye = (33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7)
    left_eye = (362, 398, 384, 385, 386, 387, 388, 466, 263, 249, 390, 373, 374, 380, 381, 382)
    outer = (61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291, 375, 321, 405, 314, 17, 84, 181, 91, 146)
    inner = (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308, 324, 318, 402, 317, 14, 87, 178, 88, 95)
    for ring, numbers in (
        (right_eye, range(36, 42)),
        (left_eye, range(42, 48)),
        (outer, range(48, 60)),
        (inner, range(60, 68)),
    ):
        places = [ring.index(order[number]) for number in numbers]
        assert places == sorted(places), numbers
    brows = (70, 63, 105, 66, 107, 336, 296, 334, 293, 300)
    assert [order[number] for number in range(17, 27)] == list(brows)
    lens = Lens("c0", face_arc(1, 384, 512, np.zeros(3))[0], np.zeros(5))
    face = [{"x": 0.5, "y": row / 1000} for row in range(478)]
    (tmp_path / "c0.json").write_text(json.dumps([{"face_landmarks": [face]}]))
    points, confidence, _ = read_detections(tmp_path, (lens,), names=FACE_NAMES)
    assert confidence.all()
    assert points[0, 0, FACE_NAMES.index("face_36"), 1] == pytest.approx(0.033 * 512)


class Gaping(Clothed):
    """Whose mouth is open in the second of two frames."""

    @property
    def motion(self):  # type: ignore[no-untyped-def, override]
        whole, jaw = super().motion, np.eye(52)[EXPRESSION_NAMES.index("jawOpen")]
        return replace(whole, frames=tuple(one.replace(expression=k * jaw) for k, one in enumerate(whole)))


def test_a_prepared_capture_has_the_expressions(tmp_path: Path) -> None:
    """Found, kept when nothing has changed, the same when it is done again, at rest again once the landmarks are gone."""
    one = Gaping(cameras=4, frames=2, size=(96, 128))
    source, out = filmed.film(one, tmp_path / "film", faces=True), tmp_path / "out"

    def prepared(redo: str = "") -> tuple[str, np.ndarray, str]:
        work = Preparing(source, out)
        if redo:
            work.forget(redo)
        said = "\n".join(work.run())
        signals = open_capture(out / "capture").rigs["body"].signals
        return said, np.stack([frame.expression for frame in signals]), work.made()

    said, expressions, made = prepared()
    assert "expressions of 2 of 2 frames" in said
    assert "px from the fitted face" in said
    jaw = expressions[:, EXPRESSION_NAMES.index("jawOpen")]
    assert jaw[0] < 0.2
    assert jaw[1] > 0.6
    with np.load(out / "steps" / "face.npz") as kept:
        assert kept["points"].shape == (2, 4, 52, 2)
        assert np.linalg.norm(kept["places"] - filmed.exact_faces(one.motion), axis=2).mean() < 0.02
    assert (out / "steps" / "6_face.png").stat().st_size > 5000
    said, again, key = prepared()
    assert said.count("(done before)") == 6
    assert key == made
    said, again, key = prepared("face")
    assert said.count("(done before)") == 5
    assert key != made  # a refinement follows
    np.testing.assert_array_equal(again, expressions)
    for path in (source / "keypoints").rglob("*000000000001_keypoints.json"):
        data = json.loads(path.read_text())
        data["people"][0]["face_keypoints_2d"] = [None] * 210
        path.write_text(json.dumps(data))
    said, again, key = prepared()
    assert "face_keypoints_2d: expected" in said, "the last frame's faces cannot be read"
    assert "expressions of 1 of 2 frames" in said
    assert len(again) == 2
    for path in (source / "keypoints").rglob("*.json"):
        data = json.loads(path.read_text())
        data["people"][0]["face_keypoints_2d"] = []
        path.write_text(json.dumps(data))
    said, again, key = prepared()
    assert "no landmarks of a face in the keypoints: expressions and jaw stay at rest" in said
    assert not again.any()
    assert not (out / "steps" / "face.npz").exists()
