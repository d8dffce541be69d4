"""Errors of every level against the exact frame; what polish repairs and costs; the seams at wrists and neck; flicker.

`levels`: 3 poses × 2 views, every level of avatarrex.levels without and with 1 and 2 steps of polish. `density`: the
oracle against itself with four times the samples. `seams`: close-ups of a wrist and the neck, errors within 2 cm of
0 < ω < 1, with pictures of the point map's own surface. `cost`: processor milliseconds of polish and shading at 512².
`flicker`: how unevenly a pixel's colour changes while the camera goes round slowly, against the oracle's own.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import mean

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from tqdm import tqdm

from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.frame import DeferredFrame
from avatarrex.levels import DEFERRED_LEVELS
from avatarrex.measure.bench.contest import Times, interleaved, timed
from avatarrex.measure.bench.session import Bench
from avatarrex.metrics.table import printed
from avatarrex.pipeline import render_deferred
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.polish import polish
from avatarrex.reference.error_report import Accuracy, PixelErrors, depth_report, pixel_errors
from avatarrex.reference.oracle import STEP, cast, near_seam, render_oracle
from avatarrex.settings import RenderSettings
from avatarrex.shading.shade import shade
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand, named_pose
from avatarrex.volume.composed_field import composed_field

POSES = {
    "walk": Signals.rest().replace(
        body_pose=named_pose("walk"), left_hand_pose=named_hand("point", "left"), expression=named_expression("laugh")
    ),
    "squat": Signals.rest().replace(body_pose=named_pose("squat"), right_hand_pose=named_hand("fist", "right")),
    "wave": Signals.rest().replace(body_pose=named_pose("wave"), expression=named_expression("jaw_open")),
}
AZIMUTHS = (20.0, 160.0)
SEAMS = {"wrist": (20, 115.0, (0, 1)), "neck": (12, 60.0, (2,))}
"""Joint that the close-up looks at, the azimuth, and the columns of ω with bands that are the seam."""
ORBIT = tuple(20.0 + 0.5 * k for k in range(10))
"""Azimuths of the slow orbit, degrees."""
REPEATS = 3
HEADS = ("px", "depth mean", "p50", "p99", "max mm", "normal mean", "p95 °", "flips %", "PSNR dB")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which tables, of which avatar."""
    parser.add_argument("what", nargs="*", default=["levels"], choices=list(TABLES))
    parser.add_argument("--avatar", default="default")
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--pictures", type=Path)


def run(options: argparse.Namespace) -> None:
    """Print the chosen tables; `levels` unless told."""
    bench = Bench(source=options.avatar)
    for what in options.what:
        TABLES[what](bench, options)


def levels(bench: Bench, options: argparse.Namespace) -> None:
    """One line per level and number of polish steps."""
    row = printed("level", "polish", *HEADS)
    errors: dict[tuple[str, int], list[PixelErrors]] = {}
    for signals, camera in views(bench, options.size):
        oracle = render_oracle(bench.avatar, signals, camera)
        for name, settings in DEFERRED_LEVELS.items():
            frame = None
            for steps in (0, 1, 2):
                frame = render_deferred(bench.avatar, signals, camera, replace(settings, polish=steps), frame)
                errors.setdefault((name, steps), []).append(pixel_errors(frame, oracle))
    for (name, steps), found in errors.items():
        row(name, steps, *cells(Accuracy.of(found)))


def density(bench: Bench, options: argparse.Namespace) -> None:
    """Pixels that four times the samples change."""
    flips, moved, hits, times = 0, 0.0, 0, Times()
    for signals, camera in views(bench, options.size):
        oracle, took = timed(render_oracle, bench.avatar, signals, camera)
        times.add(took)
        finer = cast(oracle.field, oracle.camera, STEP / 4)
        both = finer.hit & oracle.pointmap.hit
        flips += int((finer.hit != oracle.pointmap.hit).sum())
        hits += int(both.sum())
        moved = max(moved, float((finer.depth - oracle.pointmap.depth)[both].abs().max()))
    seconds = 1e-3 * mean(times.cpu)
    print(f"{hits} hits, {flips} flips, depth moved by {1e3 * moved:.5f} mm at most; oracle {seconds:.0f} s a frame")


def seams(bench: Bench, options: argparse.Namespace) -> None:
    """Close-ups; the three settings without and with polish."""
    row = printed("seam", "part voxel", "polish", *HEADS)
    avatar, signals = bench.avatar, POSES["walk"]
    for name, (joint, azimuth, columns) in SEAMS.items():
        frame = render_deferred(avatar, signals, Camera.orbit(), RenderSettings())
        target = frame.posed.body.joints[joint].numpy()
        camera = Camera.orbit(azimuth, 10, 0.7, 20, target, options.size, options.size)
        oracle = render_oracle(avatar, signals, camera)
        among = near_seam(oracle, avatar.person.blend_weight[:, columns].amax(1))
        for part_voxel in (0.005, 0.0025):
            for steps in (0, 1, 2):
                settings = RenderSettings(part_voxel=part_voxel, antialias=False, polish=steps)
                frame = render_deferred(avatar, signals, camera, settings)
                row(name, f"{1e3 * part_voxel:.1f} mm", steps, *cells(depth_report(frame, oracle, among)))
                if options.pictures:
                    large = render_deferred(avatar, signals, camera.resized(512, 512), settings)
                    picture(relief(large.pointmap, large), options.pictures / f"{name}_{part_voxel}_{steps}.png")
        if options.pictures:
            picture(relief(oracle.pointmap, frame), options.pictures / f"{name}_oracle.png")


def cost(bench: Bench, options: argparse.Namespace) -> None:
    """Processor milliseconds at 512², the least of three, body and parts apart."""
    avatar, signals, camera = bench.avatar, POSES["walk"], bench.camera(512)
    frame = render_deferred(avatar, signals, camera, RenderSettings(antialias=False))
    view, volume = camera.seen_from(frame.world_from_root), frame.volume
    weight = frame.pointmap.part_weight.sum(-1)
    some = {"all": weight >= 0, "body": weight == 0, "parts": weight > 0}
    for name, mask in some.items():
        pointmap = replace(frame.pointmap, coverage=frame.pointmap.coverage * mask)
        for steps in (1, 2):
            counters = Counters()
            field = composed_field(avatar, frame.posed, volume.body, volume.states, counters)
            spent = least(partial(polish, pointmap, field, volume.sdf, view, steps, counters))
            pairs, hits = (counters[key] // REPEATS for key in ("local_mlp_evaluations", "hits_polished"))
            print(f"polish {steps}, {name}: {spent:.0f} ms, {hits} hits, {pairs} local MLPs", flush=True)
        shown, before = replace(frame.surface, pointmap=pointmap), frame.shading
        spent = least(partial(shade, avatar, shown, before.light, Counters(), before, frame.settings))
        print(f"shading, {name}: {spent:.0f} ms")


def flicker(bench: Bench, options: argparse.Namespace) -> None:
    """Mean |I(t−1) − 2 I(t) + I(t+1)| of pixels that all sequences cover, in 1/255, and its ratio to the oracle's."""
    sequences: dict[str, list[Tensor]] = {"oracle": [], **{name: [] for name in DEFERRED_LEVELS}}
    covered, last = [], dict.fromkeys(DEFERRED_LEVELS)
    for azimuth in tqdm(ORBIT, leave=False):
        camera = bench.camera(options.size, azimuth)
        oracle = render_oracle(bench.avatar, POSES["walk"], camera)
        sequences["oracle"].append(oracle.image[..., :3].float())
        hits = [oracle.pointmap.hit]
        for name, settings in DEFERRED_LEVELS.items():
            plain = replace(settings, antialias=False)
            last[name] = frame = render_deferred(bench.avatar, POSES["walk"], camera, plain, last[name])
            sequences[name].append(frame.image[..., :3])
            hits.append(frame.pointmap.hit)
        covered.append(torch.stack(hits).all(0))
    mask = torch.stack(covered)
    mask = mask[:-2] & mask[1:-1] & mask[2:]
    print(f"{len(ORBIT)} views of {options.size}², {int(mask.sum())} pixels")
    base = 0.0
    for name, images in sequences.items():
        image = torch.stack(images)
        uneven = 255 * (image[:-2] - 2 * image[1:-1] + image[2:]).abs().mean(-1)[mask]
        base = base or float(uneven.mean())
        ratio = float(uneven.mean()) / base
        print(f"{name:<12}mean {uneven.mean():.3f}  p95 {uneven.quantile(0.95):.2f}  {ratio:.3f} of the oracle's")


def views(bench: Bench, size: int) -> Iterator[tuple[Signals, Camera]]:
    """The 3 poses × 2 views, with a bar that shows how far they are."""
    pairs = [(signals, bench.camera(size, azimuth)) for signals in POSES.values() for azimuth in AZIMUTHS]
    yield from tqdm(pairs, leave=False)


def cells(a: Accuracy) -> list[str]:
    """The figures under `HEADS`."""
    depth = (a.depth_mean_mm, a.depth_median_mm, a.depth_p99_mm, a.depth_max_mm)
    rest = (a.normal_mean_deg, a.normal_p95_deg, 100 * a.flips, a.colour_psnr_db)
    return [str(a.pixels), *(f"{value:.4f}" for value in depth), *(f"{value:.2f}" for value in rest)]


def relief(pointmap: PointMap, frame: DeferredFrame) -> np.ndarray:
    """The surface that the positions themselves make, lit from the camera's upper left; (h, w, 3) bytes."""
    row = torch.as_tensor(frame.camera.seen_from(frame.world_from_root).camera_from_world[:3, :3])
    across, down = (slope(pointmap.position.double(), axis) for axis in (1, 0))
    normal = torch.nn.functional.normalize(torch.cross(down, across, dim=-1), dim=-1) @ row.T
    light = torch.nn.functional.normalize(torch.tensor([-0.3, -0.4, -1.0], dtype=torch.float64), dim=0)
    grey = torch.where(pointmap.hit, 40 + 215 * (normal @ light).clamp(0, 1), 255.0)
    return grey[..., None].expand(-1, -1, 3).byte().numpy()


def slope(values: Tensor, axis: int) -> Tensor:
    """Differences of neighbours on both sides."""
    return torch.roll(values, -1, axis) - torch.roll(values, 1, axis)


def picture(pixels: np.ndarray, path: Path) -> None:
    """Write a PNG, at 512² whatever the size."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).resize((512, 512), Image.Resampling.NEAREST).save(path)


def least(work: Callable[[], object]) -> float:
    """Least processor milliseconds of `REPEATS` calls."""
    return min(interleaved({"work": work}, REPEATS, warm=False)["work"].cpu)


TABLES = {"levels": levels, "density": density, "seams": seams, "cost": cost, "flicker": flicker}
