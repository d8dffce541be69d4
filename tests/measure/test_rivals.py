"""Learned rivals: they begin at the fitted mesh, learn from the training's split alone, and a stopped one goes on."""

from __future__ import annotations

import gc
import signal
import weakref
from dataclasses import replace

import numpy as np
import pytest
import torch
from capture.tiny_capture import TinyCapture
from tiny_recipe import TINY

from avatarrex.camera import Camera
from avatarrex.capture.readers.images_store import Pictures
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.capture.readers.splits import Sealed
from avatarrex.errors import InputError
from avatarrex.measure.ablation.report import answers, rows, table
from avatarrex.measure.ablation.study import Study
from avatarrex.measure.ablation.variants import VARIANTS, chosen_variants
from avatarrex.measure.rivals import image_translation, timed_training
from avatarrex.measure.rivals.canonical_nerf import UNIT, CanonicalNerf, PosedSkin
from avatarrex.measure.rivals.image_translation import ImageTranslation
from avatarrex.measure.rivals.kinds import make_rival
from avatarrex.metrics.baselines import FITTED, textured_mesh, with_fitted_skin
from avatarrex.metrics.evaluate import observations
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import load_person
from avatarrex.training.runs.folder import Run

HELD_OUT = 2
"""The frame that no rival may read."""
SECONDS = 60.0
"""More than a training takes that is stopped."""


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Capture:
    opened = open_capture(TinyCapture.make(("body",)).folder(tmp_path_factory.mktemp("tiny") / "capture"))
    opened = replace(opened, rigs={name: rig.holding_out((HELD_OUT,), ()) for name, rig in opened.rigs.items()})
    return replace(opened, person=with_fitted_skin(opened, opened.person))


@pytest.fixture
def translation(capture, monkeypatch) -> ImageTranslation:
    monkeypatch.setattr(image_translation, "CROP", 48)
    rig = capture.rigs["body"]
    return ImageTranslation(textured_mesh(capture.person, list(observations(rig)), FITTED), rig, "root")


class Changed(Pictures):
    """Pictures and mattes, of which those of the held-out frame are inverted."""

    def __init__(self, own: Pictures) -> None:
        self.own = own

    def get(self, kind: str, view: int, frame: int) -> np.ndarray:
        picture = self.own.get(kind, view, frame)
        return 255 - picture if frame == HELD_OUT else picture

    def check_size(self, view: int, frame: int) -> None:
        self.own.check_size(view, frame)


def learn(rival, steps: int) -> None:
    optimiser = torch.optim.Adam(rival.parameters(), rival.rate)
    for step in range(steps):
        optimiser.zero_grad()
        rival.loss(np.random.default_rng(step), step / steps).backward()
        optimiser.step()


def error(rival, rig, frame: int, view: int) -> float:
    image = rival.draw(rig.signals[frame], rig.views[view].camera).image
    truth = torch.from_numpy(rig.image(view, frame) / np.float32(255))
    matte = torch.from_numpy(rig.matte(view, frame) / np.float32(255))[..., None]
    return float((image[..., :3] - truth * matte).square().mean())


def test_an_untrained_translation_is_the_mesh(capture, translation):
    rig = capture.rigs["body"]
    drawn, mesh = (one.draw(rig.signals[0], rig.views[0].camera).image for one in (translation, translation._mesh))
    torch.testing.assert_close(drawn, mesh, atol=1e-5, rtol=0)


def test_a_translation_learns_what_the_mesh_has_wrong(capture, translation):
    """Colours that are half as bright as the pictures'."""
    rig = capture.rigs["body"]
    translation._mesh.texels = translation._mesh.texels / 2
    before = error(translation, rig, HELD_OUT, 0)
    learn(translation, 60)
    assert error(translation, rig, HELD_OUT, 0) < 0.3 * before


def test_depth_and_normals_are_those_of_the_camera(capture, translation):
    """Metres before the mean depth; what faces the camera looks along −z, and a chest forwards whichever way its owner turns."""
    rig = capture.rigs["body"]
    camera, signals = rig.views[1].camera, rig.signals[0].replace(global_orient=np.array([0, 1.3, 0]))
    drawn = translation._mesh.draw(signals, camera)
    layers, hit = translation._shown(drawn, signals, camera), torch.from_numpy(drawn.hit)
    depth = camera.pixels(drawn.position[drawn.hit].astype(np.float64), nearest=1e-3)[1]
    np.testing.assert_allclose(layers[4][hit], depth.mean() - depth, atol=1e-4)
    assert layers[7][hit].mean() < -0.5
    own = torch.from_numpy(drawn.normal @ matrix_from_rotvec(torch.tensor([0, 1.3, 0.0]).double()).numpy()).float()
    torch.testing.assert_close(layers[8:].permute(1, 2, 0), own, atol=1e-5, rtol=0)


def test_a_rival_and_its_examples_are_let_go(translation):
    """Examples are gigabytes: nothing of a rival may wait for the collector of cycles."""
    mesh, rig = translation._mesh, translation._rig
    rival = ImageTranslation(mesh, rig, "world")
    rival.loss(np.random.default_rng(0), 0.0)
    gone = weakref.ref(rival)
    gc.disable()
    try:
        del rival
        assert gone() is None
    finally:
        gc.enable()


def test_crops_reach_the_rim_as_often_as_the_middle(translation):
    """Crops reach beyond the example, where nothing is: no row of a crop shows the person more often than others."""
    rows = []
    for seed in range(300):
        crop = translation._crop(np.random.default_rng(seed))
        assert crop.shown.shape[1:] == crop.truth.shape[1:] == (48, 48)
        rows.append((crop.truth[3] > 0.5).any(1))
    example = translation._example(*translation._pairs[0])
    assert torch.stack(rows).float().mean(0).std() < 0.1
    assert torch.stack(rows).float().mean() > 0.2
    assert len(example.truth[0]) > 48


def test_a_posed_skin_leads_back_to_rest():
    person = load_person()
    bent = Signals.rest()
    pose = np.zeros((21, 3))
    pose[17, 1], pose[3, 0] = -1.2, 0.9
    skin = PosedSkin.of(person, bent.replace(body_pose=pose, global_orient=np.array([0.3, 1.0, 0.1])))
    assert (skin.vertices - person.body.v_template).norm(dim=1).max() > 0.2
    rest, distance = skin.at_rest(skin.vertices)
    assert (rest - person.body.v_template).norm(dim=1).quantile(0.95) < 0.002
    assert distance.abs().max() < 1e-4
    beyond, outside = skin.at_rest(skin.vertices + 0.01 * torch.from_numpy(skin.distance.normals).float())
    assert outside.median() == pytest.approx(0.01, abs=0.001)
    moved = (skin.vertices - person.body.v_template).norm(dim=1) > 0.2
    off = beyond - person.body.v_template - 0.01 * person.body.normals
    assert off[moved].norm(dim=1).median() < 0.002


def test_an_untrained_nerf_has_the_skin_as_its_surface(capture):
    rig = capture.rigs["body"]
    nerf = CanonicalNerf(capture.person, rig)
    for view in range(3):
        drawn, matte = nerf.draw(rig.signals[1], rig.views[view].camera), rig.matte(view, 1) > 127
        assert (drawn.hit & matte).sum() > 0.9 * (drawn.hit | matte).sum()


def test_samples_follow_the_learnt_surface(capture):
    """Four centimetres outside the skin: light ends there along rays that meet it at a slant, too, not at the skin."""
    rig = capture.rigs["body"]
    nerf, camera = CanonicalNerf(capture.person, rig), rig.views[0].camera
    depths = []
    for off in (-0.04, 0.0):
        torch.nn.init.constant_(nerf.offset.bias, off / UNIT)
        drawn = nerf.draw(rig.signals[0], camera)
        away = np.linalg.norm(drawn.position - camera.centre, axis=-1)
        depths.append(np.where(drawn.hit, away, np.nan))
        assert drawn.image[..., 3][torch.from_numpy(drawn.hit)].median() > 0.99
    assert np.nanmedian(depths[1] - depths[0]) == pytest.approx(0.05, abs=0.012)


def test_rays_that_see_nothing_teach_nothing(capture, tmp_path):
    """A camera that looks away: the training goes on, its networks as they were."""
    rig = capture.rigs["body"]
    aside = replace(rig.views[0], camera=Camera.orbit(0, 0, 3.0, 50, (0.2, 60.0, -0.1), 60, 80))
    nerf = CanonicalNerf(capture.person, replace(rig, views=(aside, aside, aside)))
    before = [values.clone() for values in nerf.parameters()]
    loss = nerf.loss(np.random.default_rng(0), 0.9)
    assert loss.isfinite()
    if loss.requires_grad:
        loss.backward()
        assert all(values.grad is None or not values.grad.any() for values in nerf.parameters())
    with Run.create(tmp_path / "run", {"part": "body"}) as run:
        assert timed_training.train(nerf, run, 0.2, 0)
    assert all(torch.equal(a, b) for a, b in zip(before, nerf.parameters()))


def test_a_nerf_learns_colours_and_a_frame_it_was_not_shown(capture, tmp_path):
    rig = capture.rigs["body"]
    nerf = make_rival("canonical-nerf", capture, "body", 0)
    before = error(nerf, rig, HELD_OUT, 0)
    with Run.create(tmp_path / "run", {"part": "body"}) as run:
        assert timed_training.train(nerf, run, 12.0, 0)
    assert error(nerf, rig, HELD_OUT, 0) < 0.6 * before


@pytest.mark.parametrize("name", ["image-translation", "canonical-nerf"])
def test_rivals_see_the_training_alone(capture, name, monkeypatch):
    """Other pictures and mattes of both rigs in the held-out frame change nothing of what is learnt about the fitted person."""
    monkeypatch.setattr(image_translation, "CROP", 48)
    losses, rig = [], capture.rigs["body"]
    for pictures in (rig.pictures, Changed(rig.pictures)):
        rigs = {key: replace(rig, name=key, pictures=pictures) for key in ("body", "face")}
        rival = make_rival(name, replace(capture, rigs=rigs), "body", 0)
        learn(rival, 2)
        losses.append([rival.loss(np.random.default_rng(seed), 0.5).item() for seed in range(4)])
    assert losses[0] == losses[1]
    read = [rival._rig] if name == "image-translation" else [rig for rig, _ in rival._rigs]
    assert [rig.name for rig in read] == (["body"] if name == "image-translation" else ["body", "face"])
    for rig in read:
        with pytest.raises(InputError, match="an image with its matte"):
            rig.image(0, HELD_OUT)
        with pytest.raises(Sealed):
            assert rig.signals[HELD_OUT].body_pose is not None


def test_an_unknown_rival_is_refused(capture):
    with pytest.raises(ValueError, match="no rival is called gan"):
        make_rival("gan", capture, "body", 0)


def test_a_stopped_training_goes_on(capture, tmp_path, monkeypatch):
    wishes = iter(["run"] * 3 + ["stop"])
    monkeypatch.setattr("avatarrex.training.runs.folder.Run.control", lambda self: next(wishes))
    nerf = make_rival("canonical-nerf", capture, "body", 0)
    with Run.create(tmp_path / "run", {"part": "body"}) as run:
        assert not timed_training.train(nerf, run, SECONDS, 0)
        run.close("stopped")
    monkeypatch.undo()
    kept = make_rival("canonical-nerf", capture, "body", 1)
    assert timed_training.read(kept, tmp_path / "run")[1] == 3
    assert all(torch.equal(a, b) for a, b in zip(kept.parameters(), nerf.parameters()))
    with Run.open(tmp_path / "run") as run:
        found = run.latest()
        assert found is not None
        before = found[1]["seconds"]
        whole = make_rival("canonical-nerf", capture, "body", 2)
        assert timed_training.train(whole, run, before, 0), "nothing is left to do"
        assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), nerf.parameters()))
        assert timed_training.train(make_rival("canonical-nerf", capture, "body", 2), run, before + 1.0, 0)
    again = Run.open(tmp_path / "run")
    step, state = again.latest()
    again.close()
    assert step > 3
    assert state["seconds"] >= before + 1.0
    with pytest.raises(InputError, match="checkpoints: expected one that is whole"):
        timed_training.read(kept, tmp_path)


def test_ctrl_c_ends_a_rival_with_its_checkpoint(capture, tmp_path, monkeypatch):
    nerf = CanonicalNerf(capture.person, capture.rigs["body"])
    steps = []

    def loss(rng, progress):
        steps.append(progress)
        if len(steps) == 3:
            signal.raise_signal(signal.SIGINT)
        return CanonicalNerf.loss(nerf, rng, progress)

    monkeypatch.setattr(nerf, "loss", loss)
    with Run.create(tmp_path / "run", {"part": "body"}) as run:
        assert not timed_training.train(nerf, run, SECONDS, 0)
        found = run.latest()
    assert found is not None
    assert found[0] == len(steps) == 3


def test_no_time_and_no_number_are_refused(capture, tmp_path, monkeypatch):
    nerf = CanonicalNerf(capture.person, capture.rigs["body"])
    with Run.create(tmp_path / "none", {"part": "body"}) as run, pytest.raises(InputError, match="more than 0"):
        timed_training.train(nerf, run, 0.0, 0)
    monkeypatch.setattr(nerf, "loss", lambda rng, progress: nerf.offset.weight.sum() * np.nan)
    with Run.create(tmp_path / "nan", {"part": "body"}) as run, pytest.raises(InputError, match="loss of step 1"):
        timed_training.train(nerf, run, 1.0, 0)


@pytest.mark.slow
def test_a_rival_stands_beside_the_avatar_in_a_study(capture, tmp_path, monkeypatch):
    monkeypatch.setattr("avatarrex.measure.ablation.study.CAMERAS_MEASURED", 1)
    monkeypatch.setattr("avatarrex.training.core.held_out.PICTURES", 1)
    study, nerf = Study(tmp_path, capture, "body", TINY), VARIANTS["canonical-nerf"]
    found = study.finish(nerf, 0)
    assert found is not None
    used, steps = timed_training.read(make_rival(nerf.name, capture, "body", 0), study.run_folder(nerf, 0))
    assert used >= study.effort(VARIANTS["full"], 0)["cpu_seconds"] > 0
    assert found["steps"] == [steps]
    assert found["parameters"] > 100_000
    variants = chosen_variants((nerf.name,), "body")
    assert [variant.name for variant in variants] == ["full", nerf.name]
    made = rows(study, variants, [0])
    assert [row.name for row in made[-2:]] == ["full", nerf.name]
    full, rival = (row.values for row in made[-2:])
    assert full.keys() - rival.keys() == {"file_mib", "samples_per_ray"}, "what is no avatar has no file"
    assert rival["cpu_seconds_per_picture"][0] > 0
    assert "avatar against a canonical NeRF" in {answer.question for answer in answers(made)}
    assert "nan" not in table(study, made)
    monkeypatch.setattr("avatarrex.measure.ablation.study.timed_training.train", None)
    assert Study(tmp_path, capture, "body", TINY).finish(nerf, 0) == found
