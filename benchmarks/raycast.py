"""Step II: run time against error, on the capsule man at 512² and three views, judged by the float64 cell walk.

    python benchmarks/raycast.py [--size 512] [--views 3] [--repeats 5] [--avatar NAME]

With `--avatar`, its volume in the pose `stand` takes the place of the capsule man.

Times are the least of the repeats, in one run; only their ratios travel to another machine. On Mesa llvmpipe the CPU
time of all threads is the steadier figure where other programs run.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch

from avatarrex.avatar import load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.gl.context import gl_context, renderer_name
from avatarrex.pipeline import RenderSettings
from avatarrex.pointmap.pointmap import raycast
from avatarrex.pointmap.raycast_gl import EXACT_LIST, TRACE_LIST, gl_caster
from avatarrex.pointmap.raycast_reference import first_crossing
from avatarrex.pointmap.rays import RayPlane, pixel_centres
from avatarrex.signals.library import named_pose
from avatarrex.signals.signals import Signals
from avatarrex.templates.posed import pose_person
from avatarrex.volume.build import build_volume
from avatarrex.volume.solids import capsule_man
from avatarrex.volume.volume import SdfVolume

VIEWS = ((20, 10, 2.6, 40), (75, -20, 2.2, 45), (200, 35, 3.0, 40))
NO_HIT = 1e8
SLOW = "fixed steps of h/4"
"""Run once."""


def methods(volume: SdfVolume, camera: Camera) -> dict[str, list[tuple[str, int | None, dict[str, int]]]]:
    """Name and passes of what is compared; each ends with t per pixel in the distance buffer."""
    parts = (0, 1) if volume.parts else (0,)
    trace = [("trace", None, {"PARTS": 0}), *(("trace", TRACE_LIST, {"PARTS": 1}) for _ in parts[1:])]
    exact = [("exact", EXACT_LIST, {"PARTS": k}) for k in parts]
    return {
        "two passes": [*trace, *exact],
        "first pass alone": trace,
        "sphere tracing to 1e-4": [("plain", None, {"PARTS": parts[-1], "METHOD": 1})],
        SLOW: [("plain", None, {"PARTS": parts[-1], "METHOD": 0})],
    }


def measure(volume: SdfVolume, camera: Camera, repeats: int) -> None:
    """One line per method: time, error in mm, missed and false hits."""
    caster, count = gl_caster(), camera.width * camera.height
    rays = RayPlane.of(camera, volume.middle).rays(pixel_centres(camera, torch.float64))
    truth = first_crossing(volume, rays).numpy()
    hit = np.isfinite(truth)
    for name, passes in methods(volume, camera).items():
        times, cpu = [], []
        for _ in range(repeats + 1 if name != SLOW else 1):
            run, _ = caster.prepare(volume, camera, antialias=False)
            caster.context.finish()
            start, work = time.perf_counter(), time.process_time()
            for label, over, constants in passes:
                run(label, over, **constants)
            caster.context.finish()
            times.append(time.perf_counter() - start)
            cpu.append(time.process_time() - work)
        t = np.frombuffer(caster.pixels[4].read(4 * count), "f4").astype(np.float64)
        found = t < NO_HIT
        error = 1e3 * np.abs(t - truth)[found & hit]
        print(
            f"  {name:24s} {1e3 * min(times[1:] or times):7.1f} ms, CPU {1e3 * min(cpu[1:] or cpu):7.1f}"
            f"  mean {error.mean():.5f} mm  p99 {np.quantile(error, 0.99):.5f}  max {error.max():.4f}"
            f"  missed {np.sum(hit & ~found)}  false {np.sum(found & ~hit)} of {hit.sum()} hits"
        )
    for antialias in (False, True):
        times = []
        for _ in range(repeats):
            start = time.perf_counter()
            result = raycast(volume, camera, "gl", antialias)
            times.append(time.perf_counter() - start)
        label = "point map, antialiased" if antialias else "point map"
        print(f"  {label:24s} {1e3 * min(times):8.1f} ms  {result.counters}")


def avatar_volume(name: str) -> SdfVolume:
    """The volume of an avatar that stands."""
    avatar = load_avatar(name)
    posed = pose_person(avatar.person, Signals.rest().replace(body_pose=named_pose("stand")), Counters(), None)
    return build_volume(avatar, posed, RenderSettings(), Counters(), None).sdf


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--avatar")
    options = parser.parse_args()
    print(f"{renderer_name(gl_context())}, {options.size}²")
    volume = avatar_volume(options.avatar) if options.avatar else capsule_man()
    for azimuth, elevation, distance, fov in VIEWS[: options.views]:
        camera = Camera.orbit(azimuth, elevation, distance, fov, (0, -0.05, 0), options.size, options.size)
        for label, case in (("body alone", SdfVolume(volume.body)), ("body, hands and face", volume)):
            print(f"azimuth {azimuth}°, elevation {elevation}°, {label}")
            measure(case, camera, options.repeats)


if __name__ == "__main__":
    main()
