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
from avatarrex.errors import check
from avatarrex.gl.context import gl_unavailable
from avatarrex.measure.bench.contest import Times, timed
from avatarrex.measure.bench.report import Metric
from avatarrex.measure.bench.session import SEED, Bench
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.pass_one import BodyPass, StepResult
from avatarrex.training.core.stage import Stage
from avatarrex.training.core.warm_start import warm_start
from avatarrex.training.core.work import Work
from avatarrex.training.recipe import QUICK


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
    check("body" in capture.rigs, path, "rigs", "a body rig", ", ".join(capture.rigs) or "none")
    rig, known = capture.rigs["body"], bench.avatar
    avatar = Avatar.create(capture.person, QUICK.preset, SEED)
    if known.meta["preset"] == QUICK.preset and known.person.hash == capture.person.hash:
        for name, module in known.modules().items():
            avatar.modules()[name].load_state_dict(module.state_dict())
    else:  # another person: its template is near enough to place the samples
        avatar.meta["untrained"] = ["face"]
        warm_start(avatar, rig.signals.frames, "body", QUICK.body[0].warm_steps, SEED)
    full = QUICK.body[0]
    recipe = replace(
        full, rays=bench.count(full.rays, 200), outline=bench.count(full.outline, 1000), gamma_extra=0.0,
        rate=full.rate * full.geometry_rate, geometry_rate=1.0, still=0, decay=1.0,
    )  # fmt: skip
    store = FrameStore(avatar, rig, "body", avatar.hidden)
    store.renew(0)
    work = Work(Stage("body", "I", recipe, 0), BodyPass(avatar, store, recipe, SEED), None)
    times, results, losses = Times(), [], []
    for _ in range(bench.count(30, 8)):
        (result, loss), took = timed(_step, work)
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


def _step(work: Work) -> tuple[StepResult, float]:
    """The next step, and its loss."""
    result, total = work.evaluate()
    work.descend(total)
    work.step += 1
    return result, float(total.detach())
