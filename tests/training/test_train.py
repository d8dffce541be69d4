"""Whole trainings on a capture of three frames: to the end, stopped, killed, with NaN, with little to see."""

from __future__ import annotations

import argparse
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tiny_recipe
import torch
from avatarrex_studio.cli.main import main, parse
from avatarrex_studio.cli.train import _config, _open_run, kept_recipe, split_as_wanted, trained_on
from capture import foreign
from capture.tiny_capture import HEIGHT, WIDTH, TinyCapture, jpeg

import avatarrex.training.core.trainer as train_module
from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.capture.importers.import_capture import import_capture
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.readers.splits import splits_of
from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import pose_person
from avatarrex.training.core import registration, work
from avatarrex.training.core.stage import Stage
from avatarrex.training.core.trainer import Trainer
from avatarrex.training.core.work import Diverged, pass_of
from avatarrex.training.recipe import Recipe, from_scratch
from avatarrex.training.runs.events import EventReader
from avatarrex.training.runs.folder import Run, read_about

TINY = replace(tiny_recipe.TINY, body=tuple(replace(one, steps=2 * one.steps) for one in tiny_recipe.TINY.body))


@pytest.fixture(autouse=True)
def every_step_is_reported(monkeypatch):
    monkeypatch.setattr(train_module, "REPORT", 1)
    monkeypatch.setattr("avatarrex.training.core.held_out.PICTURES", 1)


def start(
    capture: Path, folder: Path, parts: tuple[str, ...] = ("body",), resume: bool = False, recipe: Recipe = TINY
) -> tuple[Run, Trainer]:
    """A run and what trains in it."""
    config = {"part": ",".join(parts), "preset": "tiny", "capture": str(capture), "seed": 0, "steps": recipe.steps()}
    run = Run.open(folder) if resume else Run.create(folder, config)
    return run, Trainer(open_capture(capture), recipe, run)


def losses(folder: Path) -> dict[str, dict[int, float]]:
    """Every loss by step, the later value where a step was repeated."""
    events = EventReader(folder)
    while events.poll():
        pass
    found = {tag: events.series(tag) for tag in events.tags if "/loss/" in tag}
    return {tag: dict(zip(series.steps.tolist(), series.values.tolist())) for tag, series in found.items()}


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    return TinyCapture.make(("body",)).folder(tmp_path_factory.mktemp("tiny") / "capture")


@pytest.fixture(scope="module")
def whole(capture, tmp_path_factory) -> Path:
    """A body training that nothing interrupted."""
    before, train_module.REPORT = train_module.REPORT, 1
    folder = tmp_path_factory.mktemp("whole") / "run"
    run, trainer = start(capture, folder)
    with run:
        assert trainer.train()
    train_module.REPORT = before
    return folder


def test_a_training_ends_with_an_avatar_that_says_what_it_is(whole):
    checkpoint = sorted((whole / "checkpoints").iterdir())[-1]
    avatar = load_avatar(checkpoint / "avatar.avatar")
    assert avatar.meta["origin"].startswith("trained from images")
    assert avatar.hidden == {"face"}, "the capture has no face rig"
    assert read_about(whole)["state"] == "finished"
    found = losses(whole)
    assert set(found["body/loss/rgb"]) == set(range(6))
    assert {
        "body/loss/mask",
        "body/loss/silhouette",
        "body/loss/eikonal",
        "body/loss/kl",
        "body/loss/perceptual",
    } <= set(found)


def test_a_capture_of_another_layout_is_trained_on(tmp_path):
    """ZJU-MoCap's: +Z up, millimetres, labels for mattes. The person stands where the pictures show it from the first step on."""
    foreign.written_zju(foreign.scene(1), tmp_path / "source")
    import_capture(tmp_path / "source", tmp_path / "imported")
    run, trainer = start(tmp_path / "imported", tmp_path / "run", recipe=tiny_recipe.TINY)
    with run:
        assert trainer.train()
    found = losses(tmp_path / "run")
    assert set(found["body/loss/rgb"]) == set(range(3))
    assert max(found["body/loss/mask"].values()) < 0.25


@pytest.mark.parametrize("dies_at", [3, 5])
def test_a_killed_run_repeats_its_losses_bit_for_bit(capture, whole, tmp_path, monkeypatch, dies_at):
    """Steps 2 and 3 follow the first checkpoint of pass I, 4 and 5 are pass II: what was not saved is done again."""
    run, trainer = start(capture, tmp_path / "run")
    real = Run.scalars

    def die(self: Run, step: int, values) -> None:
        if step == dies_at:
            raise OSError("killed")
        real(self, step, values)

    monkeypatch.setattr(Run, "scalars", die)
    with pytest.raises(OSError, match="killed"), run:
        trainer.train()
    monkeypatch.setattr(Run, "scalars", real)
    run, trainer = start(capture, tmp_path / "run", resume=True)
    with run:
        assert trainer.train()
    assert losses(tmp_path / "run") == losses(whole)


def test_what_was_registered_is_gone_on_with(capture, tmp_path, monkeypatch):
    """Slide and relief of the beginning of pass II, from its checkpoint; one round of registration makes them."""
    monkeypatch.setattr(registration, "SLOPES", registration.SLOPES[:1])
    one, two = TINY.body
    recipe = replace(TINY, body=(one, replace(two, texel=0.05, slides=True, rises=True)))
    run, trainer = start(capture, tmp_path / "run", recipe=recipe)
    with run:
        assert trainer.train()
    wanted, last = trainer.avatar.body, sorted((tmp_path / "run/checkpoints").iterdir())[-1]
    shutil.rmtree(last)
    run, trainer = start(capture, tmp_path / "run", resume=True, recipe=recipe)
    with run:
        assert trainer.train()
    found = trainer.avatar.body
    assert found.relief.abs().max() > 1e-5
    assert found.relief.equal(wanted.relief)
    assert found.slide.share.equal(wanted.slide.share)
    assert found.detail.texel.equal(wanted.detail.texel)


def test_a_resumed_optimiser_steps_as_if_nothing_had_been():
    """Checkpoints are contiguous; weights of the U-Nets are channels-last, and the fused step reads memory in order."""
    torch.manual_seed(0)
    begun = torch.nn.Parameter(torch.randn(4, 3, 3, 3).to(memory_format=torch.channels_last))
    gradients = [torch.randn(4, 3, 3, 3).to(memory_format=torch.channels_last) for _ in range(6)]

    def steps(parameter, optimiser, chosen):
        for gradient in chosen:
            parameter.grad = gradient.clone(memory_format=torch.preserve_format)
            optimiser.step()
        return parameter.detach().clone()

    optimiser = torch.optim.Adam([begun], lr=1e-2, fused=True)
    half = torch.nn.Parameter(steps(begun, optimiser, gradients[:3]))
    kept = {name: value.clone(memory_format=torch.contiguous_format) for name, value in optimiser.state[begun].items()}
    resumed = torch.optim.Adam([half], lr=1e-2, fused=True)
    work.load(resumed, {**optimiser.state_dict(), "state": {0: kept}})
    assert steps(half, resumed, gradients[3:]).equal(steps(begun, optimiser, gradients[3:]))


def test_a_stop_is_saved_and_gone_on_with(capture, tmp_path, monkeypatch):
    run, trainer = start(capture, tmp_path / "run")
    wishes = iter(["run", "stop"])
    monkeypatch.setattr(Run, "control", lambda self: next(wishes))
    with run:
        assert not trainer.train()
        run.close("stopped")
    monkeypatch.undo()
    found = Run.open(tmp_path / "run")
    step, state = found.latest()
    found.close("stopped")
    assert step == 2
    assert state["step"] == 2


def test_nan_stops_with_the_batch_described(capture, tmp_path, monkeypatch):
    run, trainer = start(capture, tmp_path / "run")
    steps = []

    def spoiled(*arguments):
        work = pass_of(*arguments)
        step = work.step

        def once(number: int, gamma: float):
            steps.append(number)
            if number == 3:
                trainer.avatar.body.colour_blend[0].bias.data[0] = torch.nan
            return step(number, gamma)

        work.step = once
        return work

    monkeypatch.setattr("avatarrex.training.core.trainer.pass_of", spoiled)
    with pytest.raises(Diverged, match="step 3: rgb is not finite"), run:
        trainer.train()
    described = json.loads((tmp_path / "run" / "failed_step.json").read_text())
    assert described["step"] == 3
    assert len(described["pictures"]) == 1
    assert steps == [0, 1, 2, 3], "no step after the one that failed"
    assert read_about(tmp_path / "run")["state"] == "failed"
    opened = Run.open(tmp_path / "run")
    _, state = opened.latest()
    opened.close("stopped")
    assert all(value.isfinite().all() for value in state["modules"]["body"].values() if value.is_floating_point())


def test_pictures_without_a_person_are_learnt_from_too(tmp_path):
    """No matte shows one, in either pass."""
    tiny = TinyCapture.make(("body",))
    blank = jpeg(np.zeros((HEIGHT, WIDTH), np.uint8))
    for name in tiny.files:
        if "/mask/" in name:
            tiny.files[name] = blank
    run, trainer = start(tiny.folder(tmp_path / "capture"), tmp_path / "run", recipe=tiny_recipe.TINY)
    with run:
        assert trainer.train()
    assert set(losses(tmp_path / "run")["body/loss/rgb"]) == {0, 1, 2}


def test_one_camera_and_missing_pictures_will_do(tmp_path):
    tiny = TinyCapture.make(("body",))
    kept = {name: data for name, data in tiny.files.items() if "/c1/" not in name and "/c2/" not in name}
    del kept["body/c0/00000002.jpg"]
    tiny.files = kept
    run, trainer = start(tiny.folder(tmp_path / "capture"), tmp_path / "run", recipe=tiny_recipe.TINY)
    with run:
        assert trainer.train()


def test_nothing_left_to_train_on_is_said_at_once(capture, tmp_path):
    opened = open_capture(capture)
    rig = opened.rigs["body"].holding_out(range(3), ())
    opened.rigs["body"] = rig
    run = Run.create(tmp_path / "run", {"part": "body", "seed": 0})
    trainer = Trainer(opened, TINY, run)
    with pytest.raises(InputError, match="not held out"), run:
        trainer.train()


@pytest.mark.parametrize(
    ("option", "value", "found"),
    [("--held-out-frames", "0:9", "3 of 3 frames and"), ("--held-out-views", "c0,c1,c2", "3 of 3 cameras held out")],
)
def test_a_capture_without_pictures_to_train_on_is_refused_before_anything(
    capture, tmp_path, capsys, monkeypatch, option, value, found
):
    monkeypatch.setattr("avatarrex_studio.cli.train._fitted", lambda *_: pytest.fail("fitted"))
    assert main(["train", str(capture), "--out", str(tmp_path / "run"), "--parts", "body", option, value]) == 2
    said = capsys.readouterr().err
    assert "body rig: expected at least one picture to train on, found " in said
    assert found in said
    assert not (tmp_path / "run").exists()


def test_a_part_without_a_rig_is_refused(capture, tmp_path):
    run = Run.create(tmp_path / "run", {"part": "face", "seed": 0})
    with pytest.raises(InputError, match="rigs of the capture"), run:
        Trainer(open_capture(capture), TINY, run)


def test_geometry_is_frozen_while_colours_are_unknown(tmp_path):
    made = TinyCapture.make(("face",)).folder(tmp_path / "capture")
    run, trainer = start(made, tmp_path / "run", ("face",))
    one = replace(TINY.face[0], steps=4, still=2, geometry_rate=0.5)
    stage = Stage("face", "I", one, 0)
    assert [stage.rates(step)[::2] == (0.5 * stage.rate(step), stage.rate(step)) for step in range(4)] == [
        False,
        False,
        True,
        True,
    ]
    assert stage.rates(1) == (0.0, stage.rate(1), stage.rate(1))
    trainer.stages = [Stage("face", "I", replace(one, steps=2), 0)]
    trainer._warm_start()
    before = {name: value.clone() for name, value in trainer.avatar.face.state_dict().items()}
    trainer._warm_start = lambda: None
    with run:
        assert trainer.train()
    moved = {
        name.split(".")[0] for name, value in trainer.avatar.face.state_dict().items() if not value.equal(before[name])
    }
    assert moved
    assert "geometry" not in moved


@pytest.mark.slow
def test_face_then_body(tmp_path):
    made, (one, two) = TinyCapture.make().folder(tmp_path / "capture"), tiny_recipe.TINY.body
    recipe = replace(tiny_recipe.TINY, body=(replace(one, steps=one.steps + 1), two))
    run, trainer = start(made, tmp_path / "run", ("face", "body"), recipe=recipe)
    with run:
        assert trainer.train()
    found = losses(tmp_path / "run")
    assert set(found["face/loss/rgb"]) == set(range(3))
    assert set(found["body/loss/rgb"]) == set(range(4))
    avatar = load_avatar(sorted((tmp_path / "run" / "checkpoints").iterdir())[-1] / "avatar.avatar")
    assert not avatar.hidden


def test_codes_are_free_while_geometry_is_trained_and_then_clamped(capture, whole, tmp_path, monkeypatch):
    """To what the poses of the training have, not those held out; a run that goes on with pass I frees them."""

    def bounds(checkpoint: Path) -> torch.Tensor:
        code = load_avatar(checkpoint / "avatar.avatar").body.code_network
        return code.most - code.least

    *_, last = sorted((whole / "checkpoints").iterdir())
    rig = open_capture(capture).rigs["body"]
    seen = [rig.signals[frame].body_pose for frame in range(rig.frames) if frame not in rig.held_out_frames]
    width = bounds(last)
    assert 0 < float(width.mean()) < 0.5
    code = load_avatar(last / "avatar.avatar").body.code_network
    with torch.no_grad():
        code.clamp_to(matrix_from_rotvec(torch.tensor(np.stack(seen), dtype=torch.float32)))
    torch.testing.assert_close(code.most - code.least, width, atol=1e-3, rtol=0.05)
    run, _ = start(capture, tmp_path / "run")
    monkeypatch.setattr(Run, "control", lambda self: "stop")
    trainer = Trainer(open_capture(capture), TINY, run, load_avatar(last / "avatar.avatar"))
    with run:
        assert not trainer.train()
    assert float(trainer.avatar.body.code_network.most.min()) == 1.0


def test_it_goes_on_from_an_avatar(capture, whole, tmp_path, monkeypatch):
    """One step of Adam away from the start, and the file says where it came from."""
    known = load_avatar(sorted((whole / "checkpoints").iterdir())[-1] / "avatar.avatar")
    run, _ = start(capture, tmp_path / "run")
    monkeypatch.setattr(Run, "control", lambda self: "stop")
    trainer = Trainer(open_capture(capture), TINY, run, known)
    with run:
        assert not trainer.train()
    after, before = trainer.avatar.state(), known.state()
    moved = max(float((after[name] - before[name]).abs().max()) for name in before if "geometry_local" in name)
    assert 0 < moved < 1.5 * TINY.body[0].rate
    assert trainer.avatar.meta["training"]["start"]["recipe"] == "tiny"
    assert trainer.hidden == {"face"}, "nobody has trained it"
    with pytest.raises(InputError, match="--start: preset: expected compact, found paper"):
        Trainer(open_capture(capture), TINY, run, Avatar.create(known.person, "paper"))


def test_a_part_that_is_not_trained_keeps_the_splits_it_was_trained_with(tmp_path):
    """Its held-out frames are the test's; another split of its rig would call some of those held out that it has read."""
    made = open_capture(TinyCapture.make().folder(tmp_path / "capture"))
    known, said = Avatar.create(made.person, "compact", 0), splits_of(made)
    run, _ = start(tmp_path / "capture", tmp_path / "run")
    known.meta["training"] = {"capture_key": made.key, "splits": said}
    with run:
        assert Trainer(made, tiny_recipe.TINY, run, known)._provenance(0)["training"]["splits"] == said
        kept = replace(made, rigs={name: rig.holding_out((2,), ()) for name, rig in made.rigs.items()})
        with pytest.raises(
            InputError, match=r"--start: splits: face: expected the face rig split as it was .* found test frames 2:3"
        ):
            Trainer(kept, tiny_recipe.TINY, run, known)
        known.meta["training"]["capture_key"] = "another capture"
        Trainer(kept, tiny_recipe.TINY, run, known)


@pytest.mark.parametrize("learnt", [True, False])
def test_a_body_that_goes_on_leaves_the_faces_tone_alone(tmp_path, learnt):
    """Its tone mapping was learnt beside a face that is not trained now; one that never was is learnt with the body, in either pass."""
    made = open_capture(TinyCapture.make().folder(tmp_path / "capture"))
    known = Avatar.create(made.person, "compact", 0)
    last = list(known.tone.network[-1].parameters())
    with torch.no_grad():
        last[-1].add_(0.05 * learnt)
    run, _ = start(tmp_path / "capture", tmp_path / "run")
    trainer = Trainer(made, tiny_recipe.TINY, run, known)
    with run:
        assert trainer.train()
    after, before = trainer.avatar.state(), known.state()
    moved = {name.split(".")[0] for name, value in before.items() if not value.equal(after[name])}
    assert "body" in moved
    assert ("tone" in moved) is not learnt


def test_what_goes_on_keeps_the_frames_it_began_with(capture, tmp_path, monkeypatch):
    """Rest positions of another kind would move the surface that was learned, another light's frame its colours: started from, and
    resumed."""
    monkeypatch.setattr(Run, "control", lambda self: "stop")
    opened = open_capture(capture)
    before = Avatar.create(opened.person, "compact", 0, "anchors")
    run, _ = start(capture, tmp_path / "run")
    with run:
        assert not Trainer(opened, TINY, run, before).train()
    saved = sorted((tmp_path / "run" / "checkpoints").iterdir())[-1]
    found = load_avatar(saved / "avatar.avatar")
    assert (found.body.local_frame, found.light.frame) == ("anchors", before.light.frame) == ("anchors", "root")
    run, trainer = start(capture, tmp_path / "run", resume=True)
    assert (trainer.avatar.body.local_frame, trainer.avatar.light.frame) == ("turned", "world")
    _, state = run.latest()
    for kept, lit in (("anchors", "root"), ("turned", "world")):
        changed = {**state, "local_frame": kept, "light_frame": lit}
        monkeypatch.setattr(run, "latest", lambda changed=changed: (changed["step"], changed))
        trainer._restore()
        assert (trainer.avatar.body.local_frame, trainer.avatar.light.frame) == (kept, lit)
    run.close()


def options(*words: str) -> argparse.Namespace:
    """Options of `train`."""
    return parse(["train", "capture", "--out", "run", *words])


def test_cameras_to_train_on_alone(capture):
    """By name or number, in place of what is held out; of the named rig only."""
    rig = open_capture(capture).rigs["body"]
    assert trained_on(rig, options("--body-views", "c0,2")).held_out_views == {1}
    assert trained_on(rig, options("--face-views", "0")).held_out_views == rig.held_out_views
    with pytest.raises(InputError, match="--body-views: expected cameras 0 to 2"):
        trained_on(rig, options("--body-views", "c7"))


def test_frames_for_validation_are_chosen_and_kept(capture, tmp_path):
    """By option; a run that began before there were any goes on without."""
    opened = open_capture(capture)
    chosen = split_as_wanted(opened, options("--validation-frames", "1:2", "--held-out-frames", "2:3")).rigs["body"]
    assert (chosen.held_out_frames, chosen.validation_frames) == ({2}, {1})
    assert split_as_wanted(opened, options()).rigs["body"].validation_frames is None
    run = tmp_path / "run"
    for config, frames in (({"part": "body"}, frozenset()), ({"part": "body", "splits": {}}, None)):
        Run.create(run, config).close("stopped")
        resumed = parse(["train", str(capture), "--out", str(run), "--resume"])
        assert split_as_wanted(opened, resumed).rigs["body"].validation_frames == frames
        shutil.rmtree(run)


def test_nothing_goes_on_from_scratch(capture, tmp_path, capsys):
    """An avatar to start from and a start from nothing are not wanted together."""
    assert main(["train", str(capture), "--out", str(tmp_path / "run"), "--from-scratch", "--start", "default"]) == 2
    assert "--from-scratch: expected no avatar to go on from" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_from_scratch_no_template_is_looked_at(capture, tmp_path, monkeypatch):
    """Neither prior nor fit; the body begins away from where a face would be seen."""
    monkeypatch.setattr(train_module, "warm_start", lambda *arguments: pytest.fail("a warm start"))
    monkeypatch.setattr(Run, "control", lambda self: "stop")
    run = Run.create(tmp_path / "run", {"part": "body", "seed": 1})
    trainer = Trainer(open_capture(capture), from_scratch(TINY), run)
    begun = {name: value.clone() for name, value in trainer.avatar.modules()["body"].state_dict().items()}
    with run:
        assert not trainer.train()
    saved = load_avatar(sorted((tmp_path / "run" / "checkpoints").iterdir())[0] / "avatar.avatar")
    assert saved.meta["training"]["from_scratch"]
    changed = {
        name for name, value in trainer.avatar.modules()["body"].state_dict().items() if not value.equal(begun[name])
    }
    assert changed
    frame = trainer.avatar.body.frame(*rest_of(trainer.avatar))
    with torch.no_grad():
        away = trainer.avatar.body.sdf(frame, trainer.avatar.body.template.v_template)
    assert away.min() > 0.01
    assert away.mean() > 0.05


def rest_of(avatar: Avatar):
    """The posed template and code of the rest pose."""
    posed = pose_person(avatar.person, Signals.rest(), Counters(), None)
    return posed.body, avatar.body.code(posed.body_rotation)


def test_a_run_that_goes_on_keeps_its_recipe(tmp_path):
    """Not that of the same name today; what is damaged, or wanted too late, is named."""
    config = {"recipe": TINY.to_json()}
    assert kept_recipe(tmp_path, config, mixed=False) == TINY
    with pytest.raises(InputError, match="--mixed: expected as the run began, without"):
        kept_recipe(tmp_path, config, mixed=True)
    config["recipe"]["mixed"] = True
    assert kept_recipe(tmp_path, config, mixed=False).mixed
    assert kept_recipe(tmp_path, {"recipe": from_scratch(TINY).to_json()}, False, True) == from_scratch(TINY)
    with pytest.raises(InputError, match="--from-scratch: expected as the run began, without"):
        kept_recipe(tmp_path, config, mixed=True, scratch=True)
    del config["recipe"]["body"]
    with pytest.raises(InputError, match="recipe: expected a recipe of this version, found KeyError"):
        kept_recipe(tmp_path, config, mixed=False)


def test_a_run_with_other_options_than_it_began_with_is_left_as_it_is(capture, whole, capsys):
    before = (whole / "run.json").read_bytes()
    assert main(["train", str(capture), "--recipe", "quick", "--out", str(whole), "--resume"]) == 2
    assert "run.json: preset: expected quick, as requested, found tiny" in capsys.readouterr().err
    assert (whole / "run.json").read_bytes() == before


def test_a_run_goes_on_with_the_person_it_began_with(capture, tmp_path):
    """Not with other files under the same name; one that began before this was written down goes on."""
    path = tmp_path / "run"
    arguments = parse(["train", str(capture), "--out", str(path), "--resume"])
    arguments.person = "default"
    config = _config(arguments, open_capture(capture), TINY, ("body",))
    assert config["person_hash"] == load_person().hash
    Run.create(path, config).close("stopped")
    _open_run(arguments, config).close("stopped")
    other = {**config, "person_hash": "0123"}
    with pytest.raises(
        InputError, match=f"run.json: person_hash: expected 0123, as requested, found {load_person().hash}"
    ):
        _open_run(arguments, other)
    about = json.loads((path / "run.json").read_text())
    del about["config"]["person_hash"]
    (path / "run.json").write_text(json.dumps(about))
    _open_run(arguments, other).close("stopped")
