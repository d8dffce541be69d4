"""Training from images: face first, then frozen; then body and hands; each in two passes (paper sec. 5.3).

A run folder (run.py) takes losses, held-out figures and pictures, and checkpoints at steps that are multiples of the
recipe's interval. Everything random in a step follows from the seed and the step, and the stored volumes are renewed at
checkpoints only: a resumed run repeats the interrupted one bit for bit on a CPU.
"""

from __future__ import annotations

import json
import math
import resource
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.errors import InputError
from avatarrex.fields.local_frame import UNSAID
from avatarrex.fields.placement import place
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.held_out import HeldOut
from avatarrex.training.core.losses import weighted
from avatarrex.training.core.mixed import in_bfloat16
from avatarrex.training.core.pass_one import BodyPass, FacePass, StepResult
from avatarrex.training.core.pass_two import PatchPass
from avatarrex.training.core.volume_rendering import Gamma
from avatarrex.training.core.warm_start import warm_start
from avatarrex.training.recipe import PassOne, PassTwo, Recipe
from avatarrex.training.runs.folder import Run

PARTS = ("face", "body")
"""In the order of training."""
REPORT = 20
"""Steps between lines of figures."""


class Diverged(ArithmeticError):
    """A loss that is not finite; the message names the saved batch."""


@dataclass
class Stage:
    """One pass of one part."""

    part: str
    name: str
    """`I` or `II`."""
    recipe: PassOne | PassTwo
    begin: int
    """Its first step in the count of its part."""

    @property
    def end(self) -> int:
        """The step after its last."""
        return self.begin + self.recipe.steps

    def rate(self, step: int) -> float:
        """Learning rate, exponential decay."""
        return self.recipe.rate * self.recipe.decay ** ((step - self.begin) / self.recipe.decay_steps)

    def rates(self, step: int) -> tuple[float, float]:
        """Learning rates of the geometry and of all else."""
        rate, one = self.rate(step), self.recipe
        if not isinstance(one, PassOne):
            return rate, rate
        return (0.0 if step - self.begin < one.still else one.geometry_rate * rate), rate

    def gamma(self, step: int) -> float:
        """γ(n) of pass I; its last value in pass II."""
        one = self.recipe
        return (
            Gamma(extra=one.gamma_extra, steps=one.gamma_steps).at(step) if isinstance(one, PassOne) else Gamma().last
        )


def stages(recipe: Recipe, parts: tuple[str, ...]) -> list[Stage]:
    """All passes in order."""
    found = []
    for part in (part for part in PARTS if part in parts):
        one, two = getattr(recipe, part)
        found += [Stage(part, "I", one, 0), Stage(part, "II", two, one.steps)]
    return found


class Trainer:
    """A training at work."""

    def __init__(
        self,
        capture: Capture,
        recipe: Recipe,
        parts: tuple[str, ...],
        run: Run,
        seed: int,
        start: Avatar | None = None,
        device: str = "cpu",
    ) -> None:
        """`start`: an avatar to go on from, in place of the warm start; of the recipe's networks and the capture's body.

        The networks run on `device`.
        """
        self.capture, self.recipe, self.run, self.seed, self.device = capture, recipe, run, seed, device
        for part in parts:
            if part not in capture.rigs:
                raise InputError(capture.path, "parts", "rigs of the capture: " + ", ".join(capture.rigs), part)
        self.parts = parts
        self.stages = stages(recipe, parts)
        self.start = start
        self.avatar = self._untrained() if start is None else self._untrained(start.body.local_frame)
        known = "face" in parts or (start is not None and "face" not in start.hidden)
        self.hidden = frozenset() if known else frozenset({"face"})
        if start is not None and (found := start.meta["preset"]) != recipe.preset:
            raise InputError("--start", "preset", recipe.preset, found)
        self.perceptual = Perceptual.load()
        place(self.perceptual, device)
        self.interrupted = False

    def train(self) -> bool:
        """Go on from the run's last checkpoint to the end; False where it was stopped before."""
        place, state = self._restore()
        with _on_interrupt(self):
            for number, stage in enumerate(self.stages):
                if number < place:
                    continue
                if not self._train_stage(number, stage, state if number == place else None):
                    return False
        return True

    def _untrained(self, local_frame: str = "turned") -> Avatar:
        """An avatar of the recipe's networks; in one that goes on, rest positions are found as they were."""
        avatar = Avatar.create(self.capture.person, self.recipe.preset, self.seed, local_frame)
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
        if (found := set(state["modules"])) != set(self.avatar.modules()):
            raise InputError(
                self.run.path, "checkpoint: modules", ", ".join(self.avatar.modules()), ", ".join(sorted(found))
            )
        self.avatar = self._untrained(state.get("local_frame", UNSAID))
        for name, module in self.avatar.modules().items():
            module.load_state_dict(state["modules"][name])
        return int(state["stage"]), state if "optimiser" in state else None

    def _train_stage(self, number: int, stage: Stage, state: dict[str, Any] | None) -> bool:
        rig = self.capture.rigs[stage.part]
        fine = stage.name == "II"
        step = stage.begin if state is None else int(state["step"])
        if state is None and number == 0:
            self._warm_start()
        if state is None and stage.part == "body":
            self._hold_codes(rig, fine)
        unseen = self.hidden | {"left_hand", "right_hand"} if stage.part == "face" else self.hidden
        store = FrameStore(self.avatar, rig, stage.part, unseen, fine)
        store.renew(step)
        work = self._pass(stage, store)
        parameters = work.parameters()
        for parameter in parameters:
            parameter.requires_grad_(True)
        optimiser = torch.optim.Adam(self._groups(stage.part, parameters), lr=stage.rate(step), fused=True)
        if state is not None:
            _load(optimiser, state["optimiser"])
            if isinstance(work, BodyPass):
                work.frame_codes.data.copy_(state["frame_codes"])
        self.run.stage(stage.part, stage.name, stage.end)
        if state is None:
            self._save(number, step, work, optimiser)
        held_out = HeldOut(self.avatar, rig, self.hidden, self.run, stage.part)
        done = self._loop(number, stage, step, store, work, optimiser, held_out)
        for parameter in parameters:
            parameter.requires_grad_(False)
        return done

    def _warm_start(self) -> None:
        """Fit the geometry of every part to the template: a part that is trained first is seen beside the others."""
        if self.start is not None:
            for name, module in self.start.modules().items():
                self.avatar.modules()[name].load_state_dict(module.state_dict())
            return
        for part in (part for part in ("body", "face") if part not in self.hidden):
            steps = getattr(self.recipe, part)[0].warm_steps
            rig = self.capture.rigs.get(part) or self.capture.rigs[self.parts[0]]
            if steps:
                error = warm_start(self.avatar, rig.signals, part, steps, self.seed)
                self.run.scalars(0, {f"{part}/warm_start/error_mm": 1e3 * error})

    def _hold_codes(self, rig: Rig, hold: bool) -> None:
        """Free while the geometry is trained; then held to what the training's poses have."""
        code = self.avatar.body.code_network
        if not hold:
            return code.release()
        seen = [signals.body_pose for index, signals in enumerate(rig.signals) if index not in rig.held_out_frames]
        code.hold(matrix_from_rotvec(torch.tensor(np.stack(seen), dtype=torch.float32)))

    def _pass(self, stage: Stage, store: FrameStore) -> BodyPass | FacePass | PatchPass:
        if isinstance(stage.recipe, PassTwo):
            return PatchPass(self.avatar, store, stage.part, stage.recipe, self.perceptual, self.seed)
        kind = FacePass if stage.part == "face" else BodyPass
        return kind(self.avatar, store, stage.recipe, self.seed)

    def _groups(self, part: str, parameters: list[nn.Parameter]) -> list[dict[str, Any]]:
        """Geometry and all else."""
        field = self.avatar.body.geometry_parameters() if part == "body" else self.avatar.face.geometry.parameters()
        geometry = {id(parameter) for parameter in field}
        return [{"params": [p for p in parameters if (id(p) in geometry) is wanted]} for wanted in (True, False)]

    def _loop(
        self,
        number: int,
        stage: Stage,
        step: int,
        store: FrameStore,
        work: BodyPass | FacePass | PatchPass,
        optimiser: torch.optim.Optimizer,
        held_out: HeldOut,
    ) -> bool:
        label = f"{stage.part}: pass {stage.name}"
        began, begun_at = time.monotonic(), step
        with tqdm(total=stage.recipe.steps, initial=step - stage.begin, desc=label) as bar:
            while step < stage.end:
                gamma = stage.gamma(step)
                for group, rate in zip(optimiser.param_groups, stage.rates(step)):
                    group["lr"] = rate
                result = work.step(step, gamma)
                total = weighted(result.terms)
                if not torch.isfinite(total):
                    raise self._diverged(stage, step, result)
                optimiser.zero_grad(set_to_none=True)
                if total.requires_grad:  # else nothing of the part is seen in the patch: nothing to learn
                    total.backward()
                    optimiser.step()
                if step % REPORT == 0:
                    seconds = max(time.monotonic() - began, 1e-6)
                    self._report(stage, step, result, float(total.detach()), gamma, (step + 1 - begun_at) / seconds)
                step += 1
                bar.update()
                asked = self._asked()
                at_interval = step % self.recipe.interval == 0 or step == stage.end
                if at_interval:
                    if isinstance(stage.recipe, PassOne):
                        store.renew(step)
                    last = step == stage.end
                    score = held_out.measure(step) if last or step % self.recipe.evaluate == 0 else None
                    follows = number + 1 if last else number
                    self._save(follows, step, None if last else work, None if last else optimiser, score)
                if asked == "stop":
                    if not at_interval:
                        self._save(number, step, work, optimiser)
                    return number + 1 == len(self.stages) and step == stage.end
        return True

    def _asked(self) -> str:
        asked = "stop" if self.interrupted else self.run.control()
        while asked == "pause":
            time.sleep(0.2)
            asked = "stop" if self.interrupted else self.run.control()
        return asked

    def _save(
        self,
        stage: int,
        step: int,
        work: BodyPass | FacePass | PatchPass | None,
        optimiser: torch.optim.Optimizer | None,
        score: float | None = None,
    ) -> None:
        self.avatar.meta |= self._provenance(step)
        state: dict[str, Any] = {
            "stage": stage,
            "step": step,
            "local_frame": self.avatar.body.local_frame,
            "modules": {name: dict(module.state_dict()) for name, module in self.avatar.modules().items()},
        }
        if optimiser is not None:
            state["optimiser"] = optimiser.state_dict()
        if isinstance(work, BodyPass):
            state["frame_codes"] = work.frame_codes.data
        before = sum(self.recipe.steps()[part] for part in PARTS[: PARTS.index(self.run.part)] if part in self.parts)
        self.run.save(before + step, state, avatar=self.avatar, score=score)

    def _provenance(self, step: int) -> dict[str, Any]:
        """What avatar.json says of where the avatar comes from."""
        return {
            "name": Path(self.capture.path).stem,
            "origin": "trained from images in two passes",
            "untrained": sorted(self.hidden),
            "training": {
                "capture": Path(self.capture.path).name,
                "recipe": self.recipe.name,
                "parts": list(self.parts),
                "at": f"{self.run.part} step {step}",
                "perceptual": self.perceptual.name,
                "seed": self.seed,
                **(
                    {}
                    if self.start is None
                    else {"start": self.start.meta.get("training", self.start.meta.get("origin"))}
                ),
            },
        }

    def _report(self, stage: Stage, step: int, result: StepResult, total: float, gamma: float, rate: float) -> None:
        values = {f"loss/{name}": float(value.detach()) for name, value in result.terms.items()}
        values |= {
            "loss/total": total,
            "schedule/gamma": gamma,
            "schedule/lr": stage.rate(step),
            "rate/steps_per_s": rate,
            "rate/samples_per_ray": result.samples_per_ray,
            "rate/silhouette_rays": result.silhouette_rays,
            "memory/mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        }
        self.run.scalars(step, {f"{stage.part}/{name}": value for name, value in values.items()})

    def _diverged(self, stage: Stage, step: int, result: StepResult) -> Diverged:
        """Save what the step was made of, and the error to raise."""
        path = self.run.path / "failed_step.json"
        terms = {name: float(value.detach()) for name, value in result.terms.items()}
        content = {"part": stage.part, "pass": stage.name, "step": step, "seed": self.seed, "terms": terms}
        content["pictures"] = [list(pair) for pair in result.pictures]
        path.write_text(json.dumps(content, indent=2) + "\n")
        bad = ", ".join(name for name, value in terms.items() if not math.isfinite(value))
        return Diverged(
            f"{stage.part}, pass {stage.name}, step {step}: {bad or 'the total'} is not finite; the batch is described in"
            f" {path}; --resume goes on from the last checkpoint"
        )


def _load(optimiser: torch.optim.Optimizer, saved: dict[str, Any]) -> None:
    """The saved state in its parameters' own layout: checkpoints are contiguous, the U-Nets' weights channels-last, and
    the fused step reads memory in order."""
    optimiser.load_state_dict(saved)
    for parameter, state in optimiser.state.items():
        for name, value in state.items():
            if torch.is_tensor(value) and value.shape == parameter.shape:
                state[name] = torch.empty_like(parameter).copy_(value)


@contextmanager
def _on_interrupt(trainer: Trainer) -> Iterator[None]:
    """Ctrl+C asks for a stop after the step; a second one stops at once."""

    def ask(number: int, frame: object) -> None:
        if trainer.interrupted:
            raise KeyboardInterrupt
        trainer.interrupted = True
        tqdm.write("stopping after this step (Ctrl+C again: at once)")

    try:
        before = signal.signal(signal.SIGINT, ask)
    except ValueError:  # not in the main thread: whoever runs it there stops it by control.json
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
