"""Training from images: face first, then frozen; then body and hands; each in two passes (paper sec. 5.3).

A run folder (runs/folder.py) takes losses, held-out figures and pictures, and checkpoints at steps that are multiples of the
recipe's interval. Everything random in a step follows from the seed and the step, and the stored volumes are renewed at
checkpoints only: a resumed run repeats the interrupted one bit for bit on a CPU.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.drawn import light_frame
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import sealed, splits_of
from avatarrex.errors import InputError
from avatarrex.fields.light import UNSAID
from avatarrex.fields.texel_mesh import flattened
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.signals.driving import Signals
from avatarrex.training.core import provenance
from avatarrex.training.core.carving import carve
from avatarrex.training.core.even import even_folds
from avatarrex.training.core.exposure import exposed_as
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.held_out import HeldOut
from avatarrex.training.core.mixed import in_bfloat16
from avatarrex.training.core.process_group import ALONE, ProcessGroup
from avatarrex.training.core.projection import start_from_pictures
from avatarrex.training.core.stage import Stage, stages
from avatarrex.training.core.warm_start import clear_space, warm_start
from avatarrex.training.core.work import Work, pass_of
from avatarrex.training.recipe import TRAINED, PassOne, PassTwo, Recipe
from avatarrex.training.runs.folder import Run
from avatarrex.training.runs.interruption import Interruption

REPORT = 20
"""Steps between lines of figures."""
OUTGROWTH_WARM = 3
"""Times the warm start of a body with an outgrowth, which the prior does not know."""


class Trainer:
    """A training at work."""

    def __init__(
        self,
        capture: Capture,
        recipe: Recipe,
        run: Run,
        start: Avatar | None = None,
        device: str = "cpu",
        group: ProcessGroup = ALONE,
    ) -> None:
        """The run's configuration has the seed, and the parts to train; the networks run on `device`.

        Each process of `group` has a trainer of its own; that of one that does not lead has a run that only follows.

        Of the capture only what is not held out is kept (capture/readers/splits.py): nothing here can read the test's.
        `start`: an avatar to go on from, in place of the warm start; of the recipe's networks and the capture's body.
        """
        self.capture, self.validation = sealed(capture, "train"), sealed(capture, "validation")
        self.splits = splits_of(capture)
        self.recipe, self.run, self.device, self.group = recipe, run, device, group
        self.seed, self.parts = int(run.config["seed"]), tuple(run.config["part"].split(","))
        for part in self.parts:
            if part not in capture.rigs:
                raise InputError(capture.path, "parts", "rigs of the capture: " + ", ".join(capture.rigs), part)
        self.stages = stages(recipe, self.parts)
        self.start = start
        self.avatar = self._untrained(light_frame(capture))
        if start is not None:
            self._check_splits(start)
            self.avatar = self._untrained(start.light.frame, start.body.local_frame)
        known = "face" in self.parts or (start is not None and "face" not in start.hidden)
        self.hidden = frozenset() if known else frozenset({"face"})
        if start is not None and (found := start.meta["preset"]) != recipe.preset:
            raise InputError("--start", "preset", recipe.preset, found)
        self.perceptual = Perceptual.load()
        self.perceptual.place(device)
        self.interruption = Interruption()
        self.known = provenance.prior(self.avatar, recipe, self.parts, start)
        self.seconds, self.began = 0.0, time.monotonic()

    @property
    def keeps_tone(self) -> bool:
        """Whether the face's tone mapping stays that of the start: it was learnt beside that face, which is not trained here.

        Learnt once more beside the body alone it turned a face pink from where no camera was.
        """
        return self.start is not None and "face" not in self.parts and self.start.tone.learnt

    def _check_splits(self, start: Avatar) -> None:
        """Raise `InputError` where a rig that is not trained here was split otherwise when `start` was trained on this capture: what its
        part has read would count as held out."""
        before = start.meta.get("training")
        if not isinstance(before, dict) or before.get("capture_key") != self.capture.key:
            return
        said = before.get("splits")
        for rig, found in said.items() if isinstance(said, dict) else ():
            if rig in self.splits and rig not in self.parts and found != self.splits[rig]:
                test = self.splits[rig]["test"]["frames"] or "none"
                expected = f"the {rig} rig split as it was when {start.meta.get('name', 'it')} was trained"
                raise InputError("--start", f"splits: {rig}", expected, f"test frames {test}")

    def train(self) -> bool:
        """Go on from the run's last checkpoint to the end; False where it was stopped before."""
        first, state = self._restore()
        with self.interruption.handled():
            for number, stage in enumerate(self.stages[first:], first):
                if not self._train_stage(number, stage, state if number == first else None):
                    return False
        return True

    def _untrained(self, light_frame: str, local_frame: str = "turned") -> Avatar:
        """An avatar of the recipe's networks; one that goes on keeps its kind of local frames and its light's."""
        avatar = Avatar.create(self.capture.person, self.recipe.preset, self.seed, local_frame)
        avatar.light.frame = light_frame
        avatar.place(self.device)
        if self.recipe.mixed:
            in_bfloat16(avatar)
        return avatar

    def _restore(self) -> tuple[int, dict[str, Any] | None]:
        """The stage to go on with, and its state where it has begun."""
        latest = self.run.latest()
        if latest is None:
            return 0, None
        _, state = latest
        self.seconds = float(state.get("seconds", 0.0))
        own, found = self.avatar.modules(), state["modules"]
        if set(own) != set(found):
            raise InputError(self.run.path, "checkpoint: modules", ", ".join(own), ", ".join(sorted(found)))
        self.avatar = self._untrained(state.get("light_frame", UNSAID), state["local_frame"])
        self._take(found)
        return int(state["stage"]), state if "optimiser" in state else None

    def _take(self, states: Mapping[str, Any]) -> None:
        """Weights by module."""
        for name, module in self.avatar.modules().items():
            module.load_state_dict(states[name])

    def _train_stage(self, number: int, stage: Stage, state: dict[str, Any] | None) -> bool:
        """From the stage's beginning or from a checkpoint's `state`; False where it was stopped before the end."""
        rig = self.capture.rigs[stage.part]
        if state is None and number == 0:
            self._warm_start()
            self.group.agree(self.avatar.modules().values())
        if state is None and stage.part == "face" and stage.name == "I":
            self.avatar.light.add_face()
        if state is None and stage.part == "body":
            self._clamp_codes(rig, stage.recipe)
        unseen = self.hidden | {"left_hand", "right_hand"} if stage.part == "face" else self.hidden
        store = FrameStore(self.avatar, rig, stage.part, unseen, stage.name == "II")
        if stage.part == "body" and stage.recipe.close and "face" in self.capture.rigs:
            close = exposed_as(self.capture.rigs["face"], rig, self.capture.person)
            store.close = FrameStore(self.avatar, close, "body", unseen, stage.name == "II")
        store.renew(stage.begin if state is None else int(state["step"]))
        if state is None and stage.recipe.texel:
            two = stage.recipe if isinstance(stage.recipe, PassTwo) else None
            moves = (False, False) if two is None else (two.slides, two.rises)
            self.group.agree([self.avatar.body])  # on what its clothes are, where texels are laid
            start_from_pictures(self.avatar, stage.part, store, stage.recipe.texel, *moves)
        self.group.agree(self.avatar.modules().values())
        if self.group.size > 1:  # on what all agreed on
            store.renew(store.age + 1)
        kept = self.avatar.tone.parameters() if self.keeps_tone else ()
        losses = pass_of(stage, self.avatar, store, self.perceptual, self.seed)
        losses.group = self.group
        work = Work(stage, losses, state, kept)
        self.run.stage(stage.part, stage.name, stage.end)
        if state is None:
            self._save(number, work.step, work)
        own = self.validation.rigs[stage.part]
        seen = own if len(own.held_out_frames) < own.frames else rig
        done = self._loop(number, work, HeldOut(self.avatar, seen, self.hidden, self.run, stage.part))
        work.close()
        return done

    def _warm_start(self) -> None:
        """Fit the geometry of every part to the template: a part that is trained first is seen beside the others."""
        if self.start is not None:
            return self._take({name: module.state_dict() for name, module in self.start.modules().items()})
        if not self.recipe.body[0].warm_steps:
            clear_space(self.avatar)
        elif self.recipe.body[0].carved and "body" in self.parts:
            self.avatar.body.set_outgrowth(carve(self.avatar, self.capture.rigs["body"]))
        for part in ("body", "face"):
            one = getattr(self.recipe, part)[0]
            steps = one.warm_steps
            steps *= OUTGROWTH_WARM if part == "body" and self.avatar.body.outgrowth is not None else 1
            if steps and part not in self.hidden:
                rig = self.capture.rigs.get(part) or self.capture.rigs[self.parts[0]]
                error = warm_start(self.avatar, training_signals(rig), part, steps, self.seed, one.prior)
                self.run.scalars(0, {f"{part}/warm_start/error_mm": 1e3 * error})

    def _clamp_codes(self, rig: Rig, stage: PassOne | PassTwo) -> None:
        """The whole range while the geometry is trained, then that of the training poses' codes."""
        code = self.avatar.body.code_network
        if isinstance(stage, PassOne) or not stage.clamped:
            return code.unclamp()
        seen = [signals.body_pose for signals in training_signals(rig)]
        code.clamp_to(matrix_from_rotvec(torch.tensor(np.stack(seen), dtype=torch.float32)))

    def _loop(self, number: int, work: Work, held_out: HeldOut) -> bool:
        """To the stage's end; False where it was stopped before the training's end."""
        stage, begun_at, began = work.stage, work.step, time.monotonic()
        label = f"{stage.part}: pass {stage.name}"
        with tqdm(total=stage.recipe.steps, initial=work.step - stage.begin, desc=label) as bar:
            while work.step < stage.end:
                result, own = work.evaluate()
                total = work.total(result)
                if not torch.isfinite(total):
                    raise work.diverged(result, self.run.path, self.seed)
                work.descend(own)
                if work.step % REPORT == 0:
                    speed = (work.step + 1 - begun_at) / max(time.monotonic() - began, 1e-6)
                    self.run.scalars(work.step, work.figures(result, float(total), speed))
                work.step += 1
                bar.update()
                stopping = self._stopping()
                last = work.step == stage.end
                due = last or work.step % self.recipe.interval == 0
                if last and stage.part == "body" and stage.name == "II" and self.avatar.body.detail is not None:
                    even_folds(self.avatar.body.detail, flattened(self.avatar.body.template))
                if due:
                    if isinstance(stage.recipe, PassOne):
                        work.losses.store.renew(work.step)
                    measured = last or work.step % self.recipe.evaluate == 0
                    score = held_out.measure(work.step) if measured and self.group.leads else None
                    self._save(number + last, work.step, None if last else work, score)
                if stopping:
                    if not due:
                        self._save(number, work.step, work)
                    return last and number + 1 == len(self.stages)
        return True

    def _stopping(self) -> bool:
        """Whether a viewer or Ctrl+C requested a stop, of any process; a pause is waited for."""
        wish = self.run.control()
        while wish == "pause" and not self.interruption.requested:
            time.sleep(0.2)
            wish = self.run.control()
        return self.group.any(self.interruption.requested or wish == "stop")

    def _save(self, stage: int, step: int, work: Work | None, score: float | None = None) -> None:
        """A checkpoint to go on from with the stage of that number, in the midst of `work` or at its beginning."""
        self.avatar.meta |= self._provenance(step)
        state: dict[str, Any] = {
            "stage": stage,
            "step": step,
            "seconds": self._spent(),
            "local_frame": self.avatar.body.local_frame,
            "light_frame": self.avatar.light.frame,
            "modules": {name: dict(module.state_dict()) for name, module in self.avatar.modules().items()},
            **({} if work is None else work.state()),
        }
        before = sum(
            self.recipe.steps()[part] for part in TRAINED[: TRAINED.index(self.run.part)] if part in self.parts
        )
        self.run.save(before + step, state, avatar=self.avatar, score=score)

    def _spent(self) -> float:
        """Seconds of training so far, of every process that worked at it."""
        return self.seconds + time.monotonic() - self.began

    def _provenance(self, step: int) -> dict[str, Any]:
        """What avatar.json says of where the avatar comes from."""
        shown = training_signals(self.capture.rigs["face"]) if "face" in self.parts else None
        training: dict[str, Any] = {
            "capture": Path(self.capture.path).name,
            "recipe": self.recipe.name,
            "parts": list(self.parts),
            "at": f"{self.run.part} step {step}",
            "perceptual": self.perceptual.name,
            "seed": self.seed,
            "from_scratch": self.recipe.scratch,
            "splits": self.splits,
            "prior": self.known,
            "tracking": provenance.tracking(self.capture),
            "light": provenance.light(self.capture),
            "template": provenance.of_the_template(self.capture),
            "expressions": provenance.expressions(shown, self.start),
            "seconds": round(self._spent(), 1),
            **{key: self.run.config[key] for key in ("command", "capture_key", "pelvis") if key in self.run.config},
        }
        if self.start is not None:
            training["start"] = self.start.meta.get("training", self.start.meta.get("origin"))
        return {
            "name": Path(self.capture.path).stem,
            "origin": "trained from images in two passes",
            "untrained": sorted(self.hidden),
            "training": training,
        }


def training_signals(rig: Rig) -> list[Signals]:
    """Of every frame that is not held out. Raises `InputError` where there is none."""
    found = [rig.signals[frame] for frame in range(rig.frames) if frame not in rig.held_out_frames]
    if not found:
        raise InputError(f"{rig.name} rig", "frames", "at least one that is not held out", "none")
    return found
