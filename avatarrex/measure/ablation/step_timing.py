"""How long a recipe takes here: a pilot of a few steps, for variants that are to take a given time.

The real warm start, then `PILOT` steps spread over each pass, twice: the second time every frame is posed already, the
difference is what posing a frame and making its volume costs. Processor seconds.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import Capture
from avatarrex.measure.stepper import Stepper
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.pass_one import BodyPass, FacePass
from avatarrex.training.core.pass_two import PatchPass
from avatarrex.training.core.trainer import Stage, stages
from avatarrex.training.core.warm_start import warm_start
from avatarrex.training.recipe import PassOne, Recipe

PILOT = 8


@dataclass(frozen=True)
class StepTiming:
    """Estimated seconds of a recipe."""

    fixed: float
    """The warm start."""
    passes: float
    """What grows with the steps."""

    def factor(self, seconds: float) -> float:
        """By how much to scale the steps to take `seconds` in all."""
        return max((seconds - self.fixed) / self.passes, 0.0)


def step_timing(capture: Capture, recipe: Recipe, part: str, seed: int) -> StepTiming:
    """Train a throw-away avatar for a few steps."""
    avatar, rig = Avatar.create(capture.person, recipe.preset, seed), capture.rigs[part]
    hidden = frozenset() if part == "face" else frozenset({"face"})
    begun = time.process_time()
    for other in (name for name in ("body", "face") if name not in hidden):
        steps = getattr(recipe, other)[0].warm_steps
        if steps:
            warm_start(avatar, (capture.rigs.get(other) or rig).signals, other, steps, seed)
    fixed = time.process_time() - begun
    passes = 0.0
    for stage in (stage for stage in stages(recipe, (part,)) if stage.recipe.steps):
        store = FrameStore(avatar, rig, part, hidden, stage.name == "II")
        store.renew(0)
        passes += _seconds(avatar, store, stage, recipe.interval, seed)
    return StepTiming(fixed, passes)


def _seconds(avatar: Avatar, store: FrameStore, stage: Stage, interval: int, seed: int) -> float:
    """Of one pass."""
    work: BodyPass | FacePass | PatchPass
    one = isinstance(stage.recipe, PassOne)
    if isinstance(stage.recipe, PassOne):
        work = (FacePass if stage.part == "face" else BodyPass)(avatar, store, stage.recipe, seed)
    else:
        work = PatchPass(avatar, store, stage.part, stage.recipe, Perceptual.load(), seed)
    stepper = Stepper(work, 0.0)
    chosen = np.linspace(stage.begin, stage.end - 1, PILOT).astype(int).tolist()
    times, seen, pictures = [], set(), 0
    for _ in range(2):
        begun = time.process_time()
        for step in chosen:
            result, _ = stepper.step(step, stage.gamma(step))
            seen |= {frame for frame, _ in result.pictures}
            pictures = len(result.pictures)
        times.append(time.process_time() - begun)
    for parameter in stepper.parameters:
        parameter.requires_grad_(False)
    posing = max(times[0] - times[1], 0.0) / max(len(seen), 1)
    frames, steps = store.rig.frames, stage.recipe.steps
    draws = pictures * (min(interval, steps) if one else steps)
    posed = frames * (1 - (1 - 1 / frames) ** draws) * (math.ceil(steps / interval) if one else 1)
    return steps * times[1] / PILOT + posed * posing
