"""Stage `training`: how many samples a step of pass I evaluates per ray that meets the person, once γ has settled.

Real steps (losses, gradients, Adam) on a capture, from the packaged avatar on, with the `quick` recipe; no study of quality:
that is `bench ablation`. Without a capture, three frames of the clothed subject are drawn into a temporary folder.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from statistics import mean, median
from tempfile import TemporaryDirectory

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.synthetic.make import make_capture
from avatarrex.errors import InputError
from avatarrex.gl.context import gl_unavailable
from avatarrex.measure.bench.clock import Times, timed
from avatarrex.measure.bench.metric import Metric
from avatarrex.measure.bench.session import SEED, Bench
from avatarrex.measure.stepper import Stepper
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.pass_one import BodyPass
from avatarrex.training.core.volume_rendering import Gamma
from avatarrex.training.core.warm_start import warm_start
from avatarrex.training.recipe import QUICK

SETTLED_STEP = 10**9
"""A step at which γ has its last value."""


def measure(bench: Bench) -> list[Metric]:
    """See the module."""
    if bench.capture is not None:
        return _steps(bench, bench.capture)
    if gl_unavailable() is not None:
        bench.absent["training.samples_per_ray"] = f"no capture, and none can be drawn: {gl_unavailable()}"
        return []
    with TemporaryDirectory() as folder:
        return _steps(bench, make_capture(Path(folder) / "capture", "smoke"))


def _steps(bench: Bench, path: Path) -> list[Metric]:
    capture = open_capture(path)
    if "body" not in capture.rigs:
        raise InputError(path, "rigs", "a body rig", ", ".join(capture.rigs) or "none")
    rig, known = capture.rigs["body"], bench.avatar
    avatar = Avatar.create(capture.person, QUICK.preset, SEED)
    if known.meta["preset"] == QUICK.preset and known.person.hash == capture.person.hash:
        for name, module in known.modules().items():
            avatar.modules()[name].load_state_dict(module.state_dict())
    else:  # another person: its template is near enough to place the samples
        avatar.meta["untrained"] = ["face"]
        warm_start(avatar, rig.signals, "body", QUICK.body[0].warm_steps, SEED)
    full = QUICK.body[0]
    recipe = replace(full, rays=bench.count(full.rays, 200), outline=bench.count(full.outline, 1000))
    store = FrameStore(avatar, rig, "body", avatar.hidden)
    store.renew(0)
    stepper = Stepper(BodyPass(avatar, store, recipe, SEED), recipe.rate * recipe.geometry_rate)
    gamma = Gamma(extra=recipe.gamma_extra, steps=recipe.gamma_steps).at(SETTLED_STEP)
    times, results, losses = Times(), [], []
    for number in range(bench.count(30, 8)):
        (result, loss), took = timed(stepper.step, number, gamma)
        times.add(took)
        results.append(result)
        losses.append(loss)
    samples = [result.samples_per_ray for result in results]
    spread = {"least": min(samples), "most": max(samples), "steps": len(samples), "loss": median(losses)}
    spread["silhouette_rays"] = mean(result.silhouette_rays for result in results)
    return [
        Metric("training.samples_per_ray", mean(samples), "samples", error=spread, target=6.0),
        Metric("training.step_ms", times.ms, "ms", error={"rays": recipe.rays, "loss": median(losses)}),
    ]
