"""Cameras that are not ideal and parameters that are tracked: each condition alone does what it says, and nothing without it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import iou, joint_error
from avatarrex.capture.readers.calibration import Lens, read_calibration
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.readers.undistort import source_pixels, undistort
from avatarrex.capture.synthetic import identity, imaging, make, motions, rasteriser, subject, tracking
from avatarrex.capture.synthetic import plan as plans
from avatarrex.capture.synthetic.albedo_lattice import bake
from avatarrex.capture.synthetic.imaging import (
    ELECTRONS,
    GAIN,
    MATTE_SHIFT,
    READ_NOISE,
    Imaging,
    displacement,
    exposed,
    noisy,
    pushed,
)
from avatarrex.capture.synthetic.make import make_capture
from avatarrex.capture.synthetic.plan import RigPlan, RigSize, Size, plan
from avatarrex.capture.synthetic.rasteriser import Rasteriser, bent, draw_reference
from avatarrex.capture.synthetic.tracking import tracked, truth
from avatarrex.capture.synthetic.variation import CONDITIONS, Variation, conditions
from avatarrex.errors import InputError
from avatarrex.gl.context import gl_unavailable

needs_gl = pytest.mark.skipif(gl_unavailable() is not None, reason=str(gl_unavailable()))
TINY = Size(72, 96, 2, 4, RigSize(2, 2, (1,), 128), RigSize(2, 2, (1,), 128))
ALL = Variation("other", conditions=CONDITIONS, tracking_noise=1.0)


@pytest.fixture(scope="module")
def tiny_size() -> Iterator[None]:
    """A size called `tiny` beside the others: two cameras and two frames a rig."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(plans.SIZES, "tiny", TINY)
        yield


@pytest.fixture(scope="module")
def made(tiny_size: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The other person under all conditions, tracked with noise; no test changes it."""
    return make_capture(tmp_path_factory.mktemp("varied") / "tiny", "tiny", seed=3, variation=ALL)


@pytest.fixture(scope="module")
def exact(tiny_size: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, tracked exactly."""
    variation = Variation("other", conditions=CONDITIONS)
    return make_capture(tmp_path_factory.mktemp("exact") / "tiny", "tiny", seed=3, variation=variation)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def light(encoded: np.ndarray) -> np.ndarray:
    """sRGB-encoded to linear, of values above the straight piece."""
    return np.asarray(((encoded + 0.055) / 1.055) ** 2.4)


@needs_gl
def test_without_a_variation_nothing_of_it_happens(
    tiny_size: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every step that a variation adds raises; the manifest and files have the keys that they always had."""

    def never(*_: object, **__: object) -> None:
        raise AssertionError("a variation's step in the default capture")

    steps = [(imaging, ("exposed", "noisy", "pushed")), (rasteriser, ("bent",)), (subject, ("detailed",)),
             (plans, ("turning",)), (tracking, ("_noisy",))]  # fmt: skip
    for module, names in steps:
        for name in names:
            monkeypatch.setattr(module, name, never)
    for name in ("other_person", "own_expressions"):
        monkeypatch.setattr(f"avatarrex.capture.synthetic.variation.{name}", never)
    out = make_capture(tmp_path / "plain", "tiny", seed=3)
    manifest = json.loads((out / "capture.json").read_text())
    assert list(manifest) == [
        "format", "size", "seed", "garment", "complete", "background", "held_out_frames", "held_out_cameras", "depth_frames",
        "provenance",
    ]  # fmt: skip
    with np.load(out / "body" / "ground_truth.npz") as arrays:
        assert set(arrays) == {
            "vertices", "faces", "tpose_vertices", "tpose_joints", "joint_names", "part_of_face", "parts",
        }  # fmt: skip
    with np.load(out / "body" / "smpl_params.npz") as arrays:
        assert "shape10" in arrays
    for lens in read_calibration((out / "body" / "calibration_full.json").read_text(), ""):
        assert not lens.distortion.any()
    colour = np.random.default_rng(0).random((4, 5, 4))
    assert Imaging("body", Variation(), 0).developed(colour, "24070100", 0) is colour


@needs_gl
def test_the_reader_takes_all_of_it(made: Path) -> None:
    """The person is fitted to its joints, lenses are undone, and the manifest says what differs."""
    capture = open_capture(made)
    assert capture.person.fit is not None
    assert capture.manifest["variation"] == {
        "subject": "other", "expressions": "own", "conditions": list(CONDITIONS), "tracking_noise": 1.0,
    }  # fmt: skip
    notes = " ".join(capture.notes)
    assert "size fitted" in notes
    assert "images of 2 of 2 cameras are undistorted" in notes
    for rig in capture.rigs.values():
        assert rig.image(0, 0).shape == (96, 72, 3)


@needs_gl
def test_joints_of_the_truth_are_the_subjects_own(made: Path, exact: Path) -> None:
    """Exact parameters put the fitted person's joints on the subject's to 10 µm, noisy ones a centimetre and more beside."""
    for folder in (exact, made):
        capture = open_capture(folder)
        for rig in capture.rigs.values():
            error = joint_error(capture, rig)
            assert error is not None
            assert error[1] < 0.01 if folder == exact else 10 < error[0] < 60, folder


@needs_gl
def test_pictures_and_truth_do_not_know_the_tracking(made: Path, exact: Path) -> None:
    """Of the same capture tracked exactly only the parameters and the manifest differ."""
    one, two = contents(made), contents(exact)
    assert set(one) == set(two)
    assert {name for name in one if one[name] != two[name]} == {
        "capture.json", "body/smpl_params.npz", "face/smpl_params.npz",
    }  # fmt: skip


def rig_of(variation: Variation, name: str = "body", frames: int = 2) -> RigPlan:
    """One rig of a tiny capture with more frames."""
    found = next(rig for rig in plan("tiny", 3, "printed", variation).rigs if rig.name == name)
    if frames == 2:
        return found
    motion = {"body": motions.body_motion, "face": motions.face_motion}[name](frames, 3)
    if variation.has("light"):
        motion = motions.turning(motion, plans.TURN[name])
    return RigPlan(name, found.subject, motion, found.size, found.picture, 3, variation)


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_tracking_noise_has_its_size(tiny_size: None, factor: float) -> None:
    """Root mean square: 2° a joint, 1 cm of the root, 0.1 of coefficients away from the ends; the truth is exact."""
    rig = rig_of(Variation(tracking_noise=factor), frames=60)
    found, exact = tracked(rig), truth(rig)
    for key in ("global_orient", "body_pose", "left_hand_pose", "jaw_pose"):
        a, b = (Rotation.from_rotvec(arrays[key].reshape(-1, 3)) for arrays in (found, exact))
        turn = np.degrees((a.inv() * b).magnitude())
        assert np.sqrt((turn**2).mean()) == pytest.approx(2.0 * factor, rel=0.15)
    shift = np.linalg.norm(found["transl"] - exact["transl"], axis=1)
    assert np.sqrt((shift**2).mean()) == pytest.approx(0.01 * factor, rel=0.2)
    middle = np.abs(exact["arkit52"] - 0.5) < 0.15
    if factor == 1:
        assert np.std((found["arkit52"] - exact["arkit52"])[middle]) == pytest.approx(0.1, rel=0.15)
    assert found["arkit52"].min() >= 0
    assert found["arkit52"].max() <= 1
    for key, value in tracked(rig_of(Variation(), frames=60)).items():
        if key in exact:
            np.testing.assert_array_equal(exact[key], value)
    again = tracked(rig_of(Variation(tracking_noise=factor), frames=60))
    np.testing.assert_array_equal(again["body_pose"], found["body_pose"])
    steps = np.linalg.norm(np.diff(found["transl"] - exact["transl"], axis=0), axis=1)
    assert steps.min() > 0


def test_exposure_is_a_gain_of_linear_light() -> None:
    """Of the straight colour, whatever the coverage; either rig its own; white stays white."""
    straight = np.linspace(0.15, 0.8, 60).reshape(4, 5, 3)
    alpha = np.linspace(0.2, 1, 20).reshape(4, 5, 1)
    for rig, other in (("body", "face"), ("face", "body")):
        picture = np.concatenate([straight * alpha, alpha], 2)
        seen = Imaging(rig, Variation(conditions=("exposure",)), 0).developed(picture, "24070100", 0)
        ratio = light(seen[..., :3] / seen[..., 3:]) / light(straight)
        np.testing.assert_allclose(ratio, np.broadcast_to(GAIN[rig], ratio.shape), rtol=1e-6)
        assert np.abs(ratio / GAIN[other] - 1).min() > 0.03
        np.testing.assert_array_equal(seen[..., 3], alpha[..., 0])
    assert np.log2(GAIN["face"].mean() / GAIN["body"].mean()) > 0.2
    cast = GAIN["face"] / GAIN["body"]
    assert cast[0] / cast[2] > 1.3
    assert exposed(np.ones((1, 1, 4)), np.array([1.5, 0.5, 1.0]))[0, 0, 0] == pytest.approx(1)


def test_noise_is_shot_and_read_noise(rng: np.random.Generator) -> None:
    """In linear light: unbiased, σ² = read² + L / electrons; nothing where there is nobody."""
    for level in (0.25, 0.5, 0.8):
        picture = np.concatenate([np.full((120, 120, 3), level), np.ones((120, 120, 1))], 2)
        seen = light(noisy(picture, rng)[..., :3])
        wanted = np.sqrt(READ_NOISE**2 + light(np.array(level)) / ELECTRONS)
        assert seen.std() == pytest.approx(wanted, rel=0.03)
        assert seen.mean() == pytest.approx(float(light(np.array(level))), abs=4 * wanted / 200)
        assert abs(np.corrcoef(seen[..., 0].ravel(), seen[..., 1].ravel())[0, 1]) < 0.04
    assert not noisy(np.zeros((5, 5, 4)), rng).any()


@pytest.mark.parametrize("condition", ["noise", "mattes"])
def test_noise_comes_back_and_differs_from_frame_to_frame(condition: str) -> None:
    """By seed, rig, camera and frame."""
    picture = np.full((9, 9, 4), 0.5)
    picture[..., 3] = np.linspace(0.2, 1, 9)

    def seen(rig: str = "body", seed: int = 1, serial: str = "24070100", frame: int = 2) -> bytes:
        developed = Imaging(rig, Variation(conditions=(condition,)), seed).developed(picture, serial, frame)
        return bytes(developed.tobytes())

    others = [seen("face"), seen(seed=2), seen(serial="24070101"), seen(frame=3)]
    assert seen() == seen()
    assert len({seen(), *others}) == 5


def test_mattes_are_one_to_two_pixels_off(rng: np.random.Generator) -> None:
    """Everywhere by 1 to 2 pixels, in directions that turn; deep inside and far outside nothing changes."""
    shift = displacement((96, 128), rng)
    length = np.linalg.norm(shift, axis=0)
    assert length.min() >= MATTE_SHIFT[0]
    assert length.max() <= MATTE_SHIFT[1]
    assert length.std() > 0.1
    angle = np.arctan2(*shift)
    assert np.abs(np.exp(1j * angle).mean()) < 0.7
    assert np.median(np.abs(np.diff(np.unwrap(angle, axis=1), axis=1))) < 0.2
    row, column = np.indices((96, 128)) + 0.5
    away = np.hypot(row - 48, column - 64) - 30
    off = pushed(np.clip(0.5 - away, 0, 1), rng)
    assert (off[away < -2.6] > 0.999999).all()
    assert (off[away > 2.6] < 1e-6).all()
    assert 0.90 < iou(off > 0.5, away < 0) < 0.975
    assert pushed(np.ones((40, 40)), rng).min() > 0.999999


def test_pictures_do_not_move_with_their_mattes() -> None:
    picture = np.random.default_rng(2).random((30, 30, 4))
    seen = Imaging("face", Variation(conditions=("mattes",)), 0).developed(picture, "24070200", 0)
    np.testing.assert_array_equal(seen[..., :3], picture[..., :3])
    assert np.abs(seen[..., 3] - picture[..., 3]).mean() > 0.1


def test_lenses_bend_as_the_calibration_says() -> None:
    """By OpenCV's formula, typed here: a point of an ideal picture, and where the lens puts it."""
    camera = Camera.orbit(20, 5, 3.0, 36, (0, 0, 0), 384, 512)
    k1, k2, p1, p2, k3 = distortion = np.array([-0.2, 0.1, 0.01, -0.02, 0.05])
    points = np.random.default_rng(1).uniform(-0.8, 0.8, (50, 3))
    ideal, depth = camera.pixels(points)
    k = camera.intrinsics
    x, y = (ideal[:, 0] - k[0, 2]) / k[0, 0], (ideal[:, 1] - k[1, 2]) / k[1, 1]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    found, kept = camera.pixels(bent(points, camera, distortion))
    np.testing.assert_allclose(found, np.stack([k[0, 0] * u + k[0, 2], k[1, 1] * v + k[1, 2]], 1), atol=1e-6)
    np.testing.assert_allclose(kept, depth, atol=1e-9)
    assert np.abs(found - ideal).max() > 2


@needs_gl
@pytest.mark.parametrize("name", ["body", "face"])
def test_undone_a_lens_gives_the_ideal_picture(tiny_size: None, name: str) -> None:
    """The reader undoes what was drawn: what is left is the softness of resampling; a second picture is unharmed."""
    rig = rig_of(Variation(conditions=("lens",)), name)
    serial = next(iter(rig.cameras))
    camera, lens = rig.cameras[serial].resized(384, 512), 3 * rig.imaging.distortion(serial)
    posed, placed = rig.posed(0), rig.world_from_root(0)
    drawer = Rasteriser(rig.subject.faces, bake(rig.subject, np.full(len(rig.subject.faces), 1.0)), 2)
    drawer.pose(posed, np.ones(len(posed.vertices)))
    seen = camera.seen_from(placed)
    ideal, taken = drawer.draw(seen).colour, drawer.draw(seen, lens).colour
    np.testing.assert_array_equal(drawer.draw(seen).colour, ideal)
    calibrated = Lens(serial, camera, lens)
    assert calibrated.distorts
    back = undistort(np.rint(255 * taken[..., 3]).astype(np.uint8), source_pixels(calibrated)) / 255
    left, bend = (np.abs(picture - ideal[..., 3])[8:-8, 8:-8].mean() for picture in (back, taken[..., 3]))
    assert bend > 1e-3
    assert left < 0.4 * bend


def test_every_camera_has_its_own_lens(tiny_size: None) -> None:
    rig = rig_of(Variation(conditions=("lens",)))
    lenses = np.stack([rig.imaging.distortion(serial) for serial in rig.cameras])
    assert np.abs(lenses[0, :4] / lenses[1, :4] - 1).min() > 1e-3
    assert (np.abs(lenses).sum(1) > 0.05).all()
    assert not rig_of(Variation()).imaging.distortion("24070100").any()


@needs_gl
def test_a_light_of_the_world_stays_when_the_person_turns(tiny_size: None) -> None:
    """Pictures agree with the NumPy reference that lights world normals; with the root's light they do not."""
    rig = rig_of(Variation(conditions=("light",)), frames=8)
    assert np.ptp([signals.global_orient[1] for signals in rig_of(Variation(), frames=8).motion]) < np.radians(20)
    turned = [np.degrees(rig.motion[frame].global_orient[1]) for frame in range(8)]
    assert np.ptp(turned) > 70
    frame = int(np.argmax(turned))
    light_from_root = rig.light_from_root(frame)
    np.testing.assert_allclose(light_from_root, rig.world_from_root(frame)[:3, :3])
    np.testing.assert_array_equal(rig_of(Variation()).light_from_root(1), np.eye(3))
    posed, ones = rig.posed(frame), np.ones(len(rig.subject.vertices))
    camera = Camera.orbit(20, 5, 3.0, 36, (0, 0, 0), 72, 96)
    drawer = Rasteriser(rig.subject.faces, bake(rig.subject, np.full(len(rig.subject.faces), 0.004)), 3)
    drawer.pose(posed, ones, light_from_root)
    drawn = drawer.draw(camera).colour
    expected, unlike = (draw_reference(posed, ones, camera, 3, r).colour for r in (light_from_root, light_from_root.T))
    inside = drawn[..., 3] > 0
    assert np.abs(drawn - expected)[inside].mean() < 0.01
    assert np.abs(drawn - unlike)[inside].mean() > 0.03


@needs_gl
def test_conditions_reach_the_files(made: Path) -> None:
    """Lens in the calibration, a matte that leaves the mesh, pictures darker in the body's rig; each by the file alone."""
    lenses = read_calibration((made / "body" / "calibration_full.json").read_text(), "")
    rig = rig_of(ALL)
    for lens in lenses:
        np.testing.assert_allclose(lens.distortion, rig.imaging.distortion(lens.name))
    coarseness = []
    for name in ("00000000.jpg", "mask/pha/00000000.jpg"):
        with Image.open(made / "body" / lenses[0].name / name) as picture:
            coarseness.append(sum(picture.quantization[0]))  # type: ignore[attr-defined]
    assert coarseness[1] > 3 * coarseness[0]


def test_conditions_are_named_in_one_order() -> None:
    assert conditions("all") == CONDITIONS
    assert conditions("none") == ()
    assert Variation(conditions=conditions("mattes, light")).conditions == ("light", "mattes")
    assert Variation("other").expressions == "own"
    assert Variation("other", "template").to_json() == {"subject": "other"}
    assert Variation().to_json() == {}
    assert Variation(expressions="own").to_json() == {"expressions": "own"}


def test_what_is_applied_is_what_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Geometry, expression shapes and detail one by one."""
    default = subject.load_subject()
    for variation, moved, expressive, rich in (
        (Variation(), False, False, False),
        (Variation("other", "template"), True, False, False),
        (Variation(expressions="own"), False, True, False),
        (Variation(conditions=("texture",)), False, False, True),
    ):
        found = variation.applied(default)
        assert (np.abs(found.vertices - default.vertices).max() > 0.01) == moved
        bent_shapes = identity.other_person(default) if moved else default
        same = bool((found.model.expression_dirs == bent_shapes.model.expression_dirs).all())
        assert same != expressive
        assert found.detailed == rich


BAD: list[tuple[Callable[[], Variation], str]] = [
    (lambda: Variation("nobody"), "--subject: expected one of default, other, found nobody"),
    (lambda: Variation(expressions="mine"), "--expressions: expected one of template, own, found mine"),
    (lambda: Variation(conditions=conditions("light,fog")), "--conditions: expected one of light, .*found fog"),
    (lambda: Variation(conditions=conditions("")), "--conditions: expected one of light"),
    (lambda: Variation(conditions=conditions("light,all")), "--conditions: expected one of light.*found all"),
    (lambda: Variation(tracking_noise=-0.1), "--tracking-noise: expected a factor from 0 to 10"),
    (lambda: Variation(tracking_noise=11), "--tracking-noise: expected a factor from 0 to 10"),
    (lambda: Variation(tracking_noise=float("nan")), "--tracking-noise: expected a factor from 0 to 10"),
]


@pytest.mark.parametrize(("bad", "expected"), BAD)
def test_unknown_names_are_refused(bad: Callable[[], Variation], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        bad()


@needs_gl
def test_another_variation_in_the_same_folder_is_refused(made: Path) -> None:
    """Exact where it was noisy, the default where it was varied; nothing is touched."""
    before = contents(made)
    for variation in (Variation(), Variation("other", conditions=CONDITIONS)):
        with pytest.raises(InputError, match="a new folder, or one begun with"):
            make_capture(made, "tiny", seed=3, variation=variation)
    assert contents(made) == before
    make.make_capture(made, "tiny", seed=3, variation=ALL)
    assert contents(made) == before
