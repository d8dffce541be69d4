"""Random driving signals through whole frames: nothing may be NaN or Inf, nothing may raise.

    python benchmarks/random_signals.py [--signals 1000] [--size 48] [--seed 0]

Every joint, the root's too, turns about a random axis; a third of the signals by angles up to π, a third by exactly ±π
about one axis, a third within the joint limits. Expressions, shapes of ±5 σ, far roots and random cameras come along.
"""

from __future__ import annotations

import argparse

import numpy as np
import torch
from tqdm import tqdm

from avatarrex.avatar import load_avatar
from avatarrex.camera import Camera
from avatarrex.pipeline import Frame, RenderSettings, render_frame
from avatarrex.signals.limits import random_signals
from avatarrex.signals.signals import Signals


def draw(rng: np.random.Generator, k: int) -> Signals:
    """Signal `k` of the three kinds in turn."""
    pose = rng.normal(size=(55, 3))
    pose /= np.linalg.norm(pose, axis=1, keepdims=True)
    if k % 3 == 0:
        pose *= rng.uniform(0, np.pi, (55, 1))
    elif k % 3 == 1:
        axis = rng.integers(3, size=55)
        pose = np.zeros((55, 3))
        pose[np.arange(55), axis] = rng.choice([-np.pi, np.pi], 55)
    else:
        pose = random_signals(rng, 1.0).full_pose()
        pose[0] = rng.uniform(-3, 3, 3)
    return Signals.from_full_pose(
        pose,
        expression=rng.random(52) * (rng.random(52) < 0.3),
        shape=rng.uniform(-5, 5, 10) * (rng.random() < 0.3),
        translation=rng.normal(size=3) * rng.choice([0, 1, 1000]),
    )


def unsound(frame: Frame) -> list[str]:
    """Names of the frame's tensors that hold NaN or Inf."""
    tensors = {
        "body": frame.posed.body.vertices,
        **frame.posed.parts,
        "body grid": frame.volume.sdf.body.sdf,
        **{f"{box.name} box": box.field for box in frame.volume.sdf.parts},
        "node": frame.volume.body_frame.node_position,
        "embedding": frame.volume.body_frame.code.embedding,
        "position": frame.pointmap.position,
        "normal": frame.pointmap.normal,
        "depth": frame.pointmap.depth,
        "image": frame.image,
    }
    return [name for name, value in tensors.items() if not torch.isfinite(value).all()]


def main() -> None:
    """Run them all; exit status 1 names the first that failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--signals", type=int, default=1000)
    parser.add_argument("--size", type=int, default=48)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    avatar, rng, hits = load_avatar(), np.random.default_rng(options.seed), 0
    for k in tqdm(range(options.signals)):
        signals = draw(rng, k)
        target = tuple(signals.translation + rng.normal(size=3) * 0.2)
        camera = Camera.orbit(rng.uniform(-180, 180), rng.uniform(-60, 60), 2.8, 45, target, options.size, options.size)
        frame = render_frame(avatar, signals, camera, RenderSettings(voxel=0.03, part_voxel=0.01))
        bad = unsound(frame)
        if bad:
            raise SystemExit(f"signal {k} of seed {options.seed}: NaN or Inf in {', '.join(bad)}")
        hits += bool(frame.pointmap.hit.any())
    print(f"{options.signals} signals, whole frames at {options.size}²: all finite; the avatar is in view in {hits}")


if __name__ == "__main__":
    main()
