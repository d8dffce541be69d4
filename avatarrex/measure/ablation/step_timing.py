"""How long a recipe takes here: a pilot of a few steps, for variants that are to take a given time.

The real warm start, then `PILOT` steps spread over each pass, twice: the second time every frame is posed already, the
difference is what posing a frame and making its volume costs. Processor seconds, or wall seconds where networks run on a GPU.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import Capture
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.stage import stages
from avatarrex.training.core.warm_start import warm_start
from avatarrex.training.core.work import Work, pass_of
from avatarrex.training.recipe import Recipe

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


def step_timing(capture: Capture, recipe: Recipe, part: str, seed: int, device: str = "cpu") -> StepTiming:
    """Train a throw-away avatar for a few steps, with its networks on `device`."""
    clock = time.process_time if device == "cpu" else time.monotonic
    avatar, rig = Avatar.create(capture.person, recipe.preset, seed), capture.rigs[part]
    avatar.place(device)
    hidden = frozenset() if part == "face" else frozenset({"face"})
    begun = clock()
    for other in (name for name in ("body", "face") if name not in hidden):
        one = getattr(recipe, other)[0]
        if one.warm_steps:
            poses = (capture.rigs.get(other) or rig).signals.frames
            warm_start(avatar, poses, other, one.warm_steps, seed, one.prior)
    fixed = clock() - begun
    passes, perceptual = 0.0, Perceptual.load()
    perceptual.place(device)
    for stage in (stage for stage in stages(recipe, (part,)) if stage.recipe.steps):
        store = FrameStore(avatar, rig, part, hidden, stage.name == "II")
        store.renew(0)
        still = replace(stage, recipe=replace(stage.recipe, rate=0.0))
        work = Work(still, pass_of(still, avatar, store, perceptual, seed), None)
        passes += _seconds(work, store, recipe.interval, clock)
    return StepTiming(fixed, passes)


def _seconds(work: Work, store: FrameStore, interval: int, clock: Callable[[], float]) -> float:
    """Of one pass."""
    stage, frames = work.stage, store.rig.frames
    one, steps = stage.name == "I", stage.recipe.steps
    times, seen, pictures = [], set(), 0
    for _ in range(2):
        begun = clock()
        for step in np.linspace(stage.begin, stage.end - 1, PILOT).astype(int).tolist():
            work.step = step
            result, total = work.evaluate()
            work.descend(total)
            seen |= {frame for frame, _ in result.pictures}
            pictures = len(result.pictures)
        times.append(clock() - begun)
    work.close()
    posing = max(times[0] - times[1], 0.0) / max(len(seen), 1)
    draws = pictures * (min(interval, steps) if one else steps)
    posed = frames * (1 - (1 - 1 / frames) ** draws) * (math.ceil(steps / interval) if one else 1)
    return steps * times[1] / PILOT + posed * posing
