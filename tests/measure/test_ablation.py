"""Ablations: what each variant changes, that its avatar trains, loads and draws, and that a study's tables are complete."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from capture.tiny_capture import TinyCapture
from tiny_recipe import TINY

import avatarrex.training.core.trainer as train_module
from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.fields.presets import PRESETS
from avatarrex.measure.__main__ import run
from avatarrex.measure.ablation.command import STOPPED
from avatarrex.measure.ablation.report import COSTS, MEASURES, answers, plot, rows, table, to_json
from avatarrex.measure.ablation.step_timing import StepTiming, step_timing
from avatarrex.measure.ablation.study import Study, Timed
from avatarrex.measure.ablation.variants import QUESTIONS, VARIANTS, chosen_variants, recipe_of, scaled
from avatarrex.measure.bench.contest import Times
from avatarrex.measure.volume_drawer import VolumeDrawer
from avatarrex.metrics.drawing import AvatarDrawer
from avatarrex.metrics.own_training import own_training
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.pipeline import render_frame
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import load_person, resize_person
from avatarrex.templates.person_fit import PersonFit
from avatarrex.templates.posed import pose_person
from avatarrex.training.core.stage import stages
from avatarrex.training.recipe import PAPER, QUICK, LossWeights, Recipe
from avatarrex.training.runs.begun import begun_person
from avatarrex.training.runs.control import write_json
from avatarrex.training.runs.folder import read_about

NETWORKS = tuple(name for name in PRESETS if name.startswith("compact/"))


@pytest.fixture(autouse=True)
def little_is_reported(monkeypatch):
    monkeypatch.setattr(train_module, "REPORT", 1)
    monkeypatch.setattr("avatarrex.training.core.held_out.PICTURES", 1)
    monkeypatch.setattr("avatarrex.measure.ablation.study.CAMERAS_MEASURED", 1)


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Capture:
    opened = open_capture(TinyCapture.make().folder(tmp_path_factory.mktemp("tiny") / "capture"))
    rigs = {name: rig.holding_out((2,), ()) for name, rig in opened.rigs.items()}
    return replace(opened, rigs=rigs)


def gaze(points: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.normalize(torch.tensor([[0.1, -0.2, -1.0]]), dim=-1).expand_as(points)


def test_networks_that_the_prior_does_not_know_start_as_if_there_were_none():
    """Of `compact` alone: nothing of `paper` is known."""
    for name, part in (("face-mlp", "face"), ("one-network", "body")):
        known, (one, _) = getattr(QUICK, part)[0], getattr(recipe_of(VARIANTS[name], QUICK, part), part)
        assert (one.geometry_rate, one.still, one.rate, one.warm_steps) == (1, 0, 4e-3, 5 * known.warm_steps)
        assert (known.geometry_rate, known.rate) != (one.geometry_rate, one.rate), "what it would be with a prior"
        of_paper = getattr(recipe_of(VARIANTS[name], PAPER, part), part)[0]
        assert (of_paper.rate, of_paper.warm_steps) == (5e-4, getattr(PAPER, part)[0].warm_steps)


@pytest.mark.parametrize("preset", NETWORKS)
def test_a_variant_is_stored_and_draws_the_same(preset, tmp_path):
    avatar, camera = Avatar.create(load_person(), preset, 1), Camera.orbit(10, 0, 2.5, 40, (0, -0.1, 0), 24, 32)
    save_avatar(avatar, tmp_path / "a.avatar", half=False)
    loaded = load_avatar(tmp_path / "a.avatar")
    assert loaded.meta["preset"] == preset
    settings = RenderSettings(part_voxel=0.01)
    pictures = [render_frame(one, Signals.rest(), camera, settings).image for one in (avatar, loaded)]
    assert pictures[0][..., 3].sum() > 30
    torch.testing.assert_close(pictures[0], pictures[1])


@pytest.mark.parametrize("preset", NETWORKS)
def test_gradients_reach_every_parameter(preset):
    person = load_person()
    avatar = Avatar.create(person, preset, 2)
    posed = pose_person(person, Signals.rest().replace(jaw_pose=np.array([0.2, 0, 0])), Counters(), None)
    body, face = avatar.body.requires_grad_(True), avatar.face.requires_grad_(True)
    frame = body.frame(posed.body, body.code(posed.body_rotation, torch.ones(body.widths.latent)))
    at = posed.body.vertices[:: len(posed.body.vertices) // 2000]
    loss = body.sdf(frame, at).sum() + body.colour(frame, body.patches(frame), at, gaze(at)).square().sum()
    mean, _ = body.code_network.posterior(posed.body_rotation, torch.ones(body.widths.latent))
    driven = face.driven(posed.parts["face"], posed.coefficients["face"])
    near = posed.parts["face"][person.face.blend_weight > 0.5]
    loss = loss + mean.sum() + face.sdf(face.geometry_planes(driven), near).sum()
    loss = loss + face.colour(face.colour_planes(driven), near, gaze(near)).square().sum()
    loss.backward()
    for name, parameter in [*body.named_parameters(), *face.named_parameters()]:
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name
        assert parameter.grad.abs().max() > 0, name


def test_variants_differ_where_they_say_and_nowhere_else():
    made = {preset: Avatar.create(load_person(), preset) for preset in ("compact", *NETWORKS)}
    full = made["compact"]

    def count(preset: str, part: str) -> int:
        return sum(p.numel() for p in made[preset].modules()[part].parameters())

    patches = sum(p.numel() for p in full.body.patch_network.parameters())
    nodes, _, out = full.body.colour_local.weights[0].shape
    patches += nodes * full.body.widths.patch_feature * out
    assert count("compact/no-patches", "body") == count("compact", "body") - patches
    assert count("compact/no-patches", "face") == count("compact", "face")
    plain, shared = count("compact/no-patches", "body"), count("compact/one-network", "body")
    assert abs(shared / plain - 1) < 0.02
    assert abs(count("compact/face-mlp", "face") / count("compact", "face") - 1) < 0.02
    assert count("compact/face-mlp", "body") == count("compact", "body")


def test_the_face_without_tri_planes_sees_its_coefficients_alone():
    face, person = Avatar.create(load_person(), "compact/face-mlp").face, load_person()
    posed = pose_person(person, Signals.rest().replace(expression=np.linspace(0, 1, 52)), Counters(), None)
    planes = face.geometry_planes(face.driven(posed.parts["face"], posed.coefficients["face"]))
    assert planes.tolist() == pytest.approx([*np.linspace(0, 1, 52), *np.zeros(9)])
    near = posed.parts["face"][::50]
    assert (face.sdf(planes, near) - face.sdf(torch.zeros(61), near)).abs().max() > 1e-5


def test_each_variant_changes_what_it_says():
    one, two = QUICK.body
    whole = one.steps + two.steps
    assert recipe_of(VARIANTS["full"], QUICK, "body").body == QUICK.body
    assert recipe_of(VARIANTS["pass-one"], QUICK, "body").body == (QUICK.body[0], replace(QUICK.body[1], steps=0))
    longer, nothing = recipe_of(VARIANTS["no-pass-two"], QUICK, "body").body
    assert (longer.steps, nothing.steps) == (whole, 0)
    assert longer.decay_steps / longer.steps == pytest.approx(one.decay_steps / one.steps, rel=1e-3)
    assert longer.gamma_steps / longer.steps == pytest.approx(one.gamma_steps / one.steps, rel=1e-3)
    assert recipe_of(VARIANTS["no-pass-two"], QUICK, "body").face == QUICK.face
    assert recipe_of(VARIANTS["plain"], QUICK, "body").preset == "compact/no-patches"
    assert recipe_of(VARIANTS["plain"], QUICK, "body").body == recipe_of(VARIANTS["no-pass-two"], QUICK, "body").body
    assert recipe_of(VARIANTS["no-perceptual"], QUICK, "face").face == (
        QUICK.face[0],
        replace(QUICK.face[1], weights=LossWeights(perceptual=0.0)),
    )
    assert recipe_of(VARIANTS["no-view-dropout"], QUICK, "body").body == (one, replace(two, view_dropout=0.0))
    assert two.view_dropout > 0
    uniform = recipe_of(VARIANTS["uniform-64"], QUICK, "body").body[0]
    assert uniform == replace(longer, sampling="uniform", samples=64, quadrature="point")
    assert Recipe.from_json(json.loads(json.dumps(QUICK.to_json()))) == QUICK
    half = scaled(QUICK, "body", 0.5).body
    assert (half[0].steps, half[1].steps, half[0].warm_steps) == (one.steps // 2, two.steps // 2, one.warm_steps)
    assert all(name in VARIANTS for _, first, second in QUESTIONS for name in (first, second))


def test_what_has_one_pass_is_what_that_pass_leaves():
    """Nothing is painted on it, and its surface is not registered."""
    for name in ("pass-one", "no-pass-two", "plain", "plain-one", "one-network", "uniform-64"):
        assert [stage.name for stage in stages(recipe_of(VARIANTS[name], QUICK, "body"), ("body",))] == ["I"]
    assert [stage.name for stage in stages(QUICK, ("body",))] == ["I", "II"]


def test_variants_come_with_what_they_need_and_others_are_refused():
    names = [variant.name for variant in chosen_variants(("uniform-64-time",), "body")]
    assert names == ["no-pass-two", "uniform-64", "uniform-64-time"]
    assert "face-mlp" in {variant.name for variant in chosen_variants(None, "face")}
    with pytest.raises(InputError, match="--variants: expected variants of the face: full"):
        chosen_variants(("no-patches",), "face")


@pytest.mark.slow
def test_volume_rendering_draws_the_surface_where_the_rays_meet_it():
    """Many samples and small γ: silhouette, places and colours of the deferred renderer on the packaged avatar."""
    avatar, camera = load_avatar(), Camera.orbit(10, 0, 2.6, 40, (0, -0.1, 0), 15, 20)
    dense = VolumeDrawer(avatar, "body", samples=200, gamma=5e-4).draw(Signals.rest(), camera)
    surface = AvatarDrawer(avatar, settings=RenderSettings(antialias=False)).draw(Signals.rest(), camera)
    both = dense.hit & surface.hit
    assert both.sum() > 30
    assert (dense.hit ^ surface.hit).sum() <= 2
    apart = np.linalg.norm(dense.position - surface.position, axis=-1)[both]
    assert np.median(apart) < 0.0015
    assert apart.max() < 0.02
    assert (dense.image - surface.image).abs()[torch.from_numpy(both)].mean() < 0.01


@pytest.mark.slow
def test_a_study_of_the_body_is_complete_and_not_done_twice(capture, tmp_path, monkeypatch):
    variants, seeds = chosen_variants(("no-pass-two", "volume-test-time"), "body"), [0, 1]
    monkeypatch.setattr("avatarrex.measure.ablation.study.SLOW", (1, 1))
    study = Study(tmp_path, capture, "body", TINY)
    done = [("full", 0), ("no-pass-two", 0), ("volume-test-time", 0), ("no-pass-two", 1)]
    assert all(study.finish(VARIANTS[name], seed) is not None for name, seed in done)
    found = rows(study, variants, seeds)
    assert [row.name for row in found] == [
        "naked textured mesh", "mean-colour mesh", "fitted textured mesh", "fitted mesh, own face",
        "full", "no-pass-two", "volume-test-time",
    ]  # fmt: skip
    wanted = {*MEASURES, *COSTS}
    for row in found[4:]:
        assert wanted - {"lpips_matte"} <= set(row.values), row.name
        assert all(len(values) == len(row.seeds) for values in row.values.values())
        assert set(row.values["steps"]) == {3}, "one pass takes as many steps as two"
    assert [row.seeds for row in found] == [[], [], [], [], [0], [0, 1], [0]]
    given = {answer.question: answer.differences for answer in answers(found)}
    assert set(given) == {q for q, *pair in QUESTIONS if set(pair) <= {row.name for row in found}}
    values = {row.name: row.values for row in found}
    file = max(tmp_path.glob("full/seed_0/checkpoints/*/avatar.avatar"))
    for name in ("full", "volume-test-time"):
        assert values[name]["file_mib"] == [file.stat().st_size / 2**20]
    assert all("file_mib" not in row.values for row in found[:4])
    kept = own_training(load_avatar(file), file, capture)
    assert kept is not None, "evaluate takes the study's splits"
    assert kept.applied(capture, capture.person).rigs["body"].held_out_frames == capture.rigs["body"].held_out_frames
    assert np.array_equal(kept.pelvis, capture.pelvis)
    expected = values["full"]["psnr_matte"][0] - values["no-pass-two"]["psnr_matte"][0]
    assert given["pass II against as many steps of pass I"]["psnr_matte"] == pytest.approx([expected])
    text = table(study, found)
    assert "nan" not in text
    assert all(row.name in text for row in found)
    json.dumps(to_json(study, found, seeds), allow_nan=False)
    plot(found, tmp_path / "plot.png", "tiny")
    assert (tmp_path / "plot.png").stat().st_size > 5000
    for folder in (tmp_path / "full" / "seed_0", tmp_path / "no-pass-two" / "seed_1"):
        about = read_about(folder)
        assert (about["state"], about["config"]["variant"]) == ("finished", folder.parent.name)
    monkeypatch.setattr("avatarrex.measure.ablation.study.Trainer", None)
    again = Study(tmp_path, capture, "body", TINY)
    assert all(again.finish(VARIANTS[name], seed) == study.evaluation(VARIANTS[name], seed) for name, seed in done)
    with pytest.raises(InputError, match=r"study.json: base.interval: expected 3, as requested"):
        Study(tmp_path, capture, "body", replace(TINY, interval=3))


def test_seconds_of_a_picture_are_those_of_the_wall_and_of_the_processor():
    drawer = Timed(AvatarDrawer(Avatar.create(load_person(), "compact")))
    drawer.times.add(Times(wall=[400.0, 600.0], cpu=[100.0, 300.0]))
    assert drawer.per_picture == pytest.approx({"seconds_per_picture": 0.5, "cpu_seconds_per_picture": 0.2})


def test_results_of_before_are_shown_without_what_was_not_counted_yet(capture, tmp_path):
    """Where another seed has it, that one's is shown."""
    study, names = Study(tmp_path, capture, "body", TINY), ("full", "no-view-dropout", "no-detail")
    figures = {"psnr_matte": 20.0, "seconds_per_picture": 0.25}
    before = {"subjects": {"avatar": figures}, "steps": [2, 1], "seconds": 60.0, "cpu_seconds": 90.0}
    before |= {"parameters": 2_000_000, "samples_per_ray": 5.0}
    since = {**before, "subjects": {"avatar": {**figures, "cpu_seconds_per_picture": 0.5}}, "file_bytes": 3 * 2**20}
    for name, seeds in zip(names, ((before, before), (before, since), (since, since))):
        for seed, stored in enumerate(seeds):
            folder = study.run_folder(VARIANTS[name], seed)
            folder.mkdir(parents=True)
            write_json(folder / "evaluation.json", stored)
    meshes = {"subjects": {"mesh": figures}, "frames": [2], "views": ["0"], "size": [60, 80], "missing": {}}
    write_json(tmp_path / "baselines.json", meshes)
    found = rows(study, chosen_variants(names, "body"), [0, 1])
    heads, *lines = (re.split(r"\s{2,}", line.strip()) for line in table(study, found).split("\n\n")[0].splitlines())
    shown = {name: dict(zip(heads, cells)) for name, *cells in lines}
    newer = {name: (cells["MiB"], cells["CPU s/picture"]) for name, cells in shown.items()}
    assert newer == {
        "mesh": ("n/a", "n/a"), "full": ("n/a", "n/a"), "no-view-dropout": ("3.0", "0.50"),
        "no-detail": ("3.0 ± 0.0", "0.50 ± 0.00"),
    }  # fmt: skip
    assert shown["full"]["s/picture"] == "0.25 ± 0.00"
    given = {answer.question: (answer.first, answer.second) for answer in answers(found)}
    assert given["view dropout"] == ("full", "no-view-dropout")


@pytest.mark.slow
def test_a_variant_of_the_face_trains_loads_and_draws(capture, tmp_path):
    """Its network and its recipe are both another."""
    study = Study(tmp_path, capture, "face", TINY)
    found = study.finish(VARIANTS["face-mlp"], 0)
    assert found is not None
    assert found["steps"] == [2, 1]
    assert found["subjects"]["avatar"]["psnr_matte"] > 0
    assert found["subjects"]["avatar"]["pictures"] == 1


@pytest.mark.slow
def test_uniform_samples_for_as_long(capture, tmp_path):
    """64 samples a ray cost more than 4 near the surface: the time buys fewer steps."""
    study = Study(tmp_path, capture, "body", TINY)
    found = {name: study.finish(VARIANTS[name], 0) for name in ("no-pass-two", "uniform-64", "uniform-64-time")}
    assert found["uniform-64"]["samples_per_ray"] > 2 * found["no-pass-two"]["samples_per_ray"]
    assert found["uniform-64"]["steps"] == found["no-pass-two"]["steps"]
    ratio = found["no-pass-two"]["cpu_seconds"] / found["uniform-64"]["cpu_seconds"]
    assert found["uniform-64-time"]["steps"][0] == max(round(3 * ratio), 1)


@pytest.mark.slow
def test_a_stopped_variant_goes_on(capture, tmp_path, monkeypatch):
    study = Study(tmp_path, capture, "body", TINY)
    wishes = iter(["run", "stop"])
    monkeypatch.setattr("avatarrex.training.runs.folder.Run.control", lambda self: next(wishes))
    assert study.finish(VARIANTS["plain"], 0) is None
    assert read_about(tmp_path / "plain" / "seed_0")["state"] == "stopped"
    before = study.effort(VARIANTS["plain"], 0)["cpu_seconds"]
    monkeypatch.undo()
    taller = resize_person(load_person(), PersonFit(np.linspace(0.0, 0.1, 10), np.zeros((55, 3))))
    found = Study(tmp_path, replace(capture, person=taller), "body", TINY).finish(VARIANTS["plain"], 0)
    assert found is not None
    assert found["cpu_seconds"] > before > 0
    trained = begun_person(tmp_path / "plain" / "seed_0")
    assert trained is not None
    assert trained.hash == capture.person.hash, "whom the run began with, whoever is fitted by now"


def test_a_capture_without_held_out_poses_is_refused(capture, tmp_path):
    rigs = {name: rig.holding_out() for name, rig in capture.rigs.items()}
    with pytest.raises(InputError, match="held-out frames"):
        Study(tmp_path / "none", replace(capture, rigs=rigs), "body", TINY)
    assert not (tmp_path / "none").exists()


def test_minutes_scale_the_steps(capture, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "avatarrex.measure.ablation.study.step_timing", lambda *given: StepTiming(fixed=30.0, passes=15.0)
    )
    study = Study(tmp_path, capture, "body", QUICK, minutes=1.0)
    one, two = study.recipe(VARIANTS["full"], 0).body
    assert (one.steps, two.steps) == (2 * QUICK.body[0].steps, 2 * QUICK.body[1].steps)
    assert Study(Path(tmp_path), capture, "body", QUICK, minutes=1.0).recipe(VARIANTS["full"], 7).body == (one, two)


def test_steps_are_timed_where_networks_are_trained(capture, monkeypatch):
    """On a GPU by the wall's clock: the processor only waits."""
    placed: list[str] = []
    for module in (Avatar, Perceptual):
        monkeypatch.setattr(module, "place", lambda self, device: placed.append(f"{type(self).__name__} on {device}"))
    monkeypatch.setattr("time.process_time", lambda: 0.0)
    timing = step_timing(capture, TINY, "body", 0, "meta")
    assert min(timing.fixed, timing.passes) > 0
    assert placed == ["Avatar on meta", "Perceptual on meta"]


def test_a_study_trains_and_times_on_its_device(capture, tmp_path, monkeypatch):
    devices: list[str] = []

    class Stopped:
        def __init__(self, capture, recipe, run, device):
            devices.append(device)

        def train(self):
            return False

    def timed(capture, recipe, part, seed, device):
        devices.append(device)
        return StepTiming(fixed=0.0, passes=60.0)

    monkeypatch.setattr("avatarrex.measure.ablation.study.Trainer", Stopped)
    monkeypatch.setattr("avatarrex.measure.ablation.study.step_timing", timed)
    study = Study(tmp_path, capture, "body", TINY, minutes=1.0, device="meta")
    assert study.finish(VARIANTS["plain"], 0) is None
    assert devices == ["meta", "meta"]
    with pytest.raises(InputError, match="device: expected cpu, as requested"):
        Study(tmp_path, capture, "body", TINY, minutes=1.0)


def test_what_takes_processor_time_is_refused_on_a_gpu(capture, tmp_path):
    words = ["ablation", str(capture.path), "--out", str(tmp_path / "study"), "--device", "cuda"]
    for variant in ("image-translation", "uniform-64-time"):
        with pytest.raises(InputError, match=f"--device: {variant}: expected cpu: "):
            run([*words, "--variants", variant, "--held-out-frames", "2:3"])
    assert not (tmp_path / "study").exists()


def test_the_device_goes_from_the_command_to_the_study(capture, tmp_path, monkeypatch):
    found: list[str] = []
    monkeypatch.setattr("avatarrex.measure.ablation.command.device_named", lambda name: name)
    monkeypatch.setattr(Study, "finish", lambda self, variant, seed: found.append(self.device))
    monkeypatch.setattr("avatarrex.measure.ablation.command.rows", lambda *given: [])
    monkeypatch.setattr("avatarrex.measure.ablation.command.table", lambda *given: "")
    words = [
        "ablation",
        str(capture.path),
        "--out",
        str(tmp_path / "study"),
        "--held-out-frames",
        "2:3",
        "--seeds",
        "0",
    ]
    assert run([*words, "--variants", "plain", "--device", "meta"]) == STOPPED
    assert found == ["meta"]
