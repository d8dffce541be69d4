"""What moves in the sequences of the stage `frame`: signals and view of frame k, and the frames one after another."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median

import numpy as np

from avatarrex.frame import Frame
from avatarrex.measure.bench.session import Bench
from avatarrex.pipeline import render_frame
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand

WARM = 2
"""Frames that are not counted: shaders are compiled, caches filled."""
LEFT_SHOULDER = 15
"""Row of the body pose."""
Change = Callable[[Bench, int], tuple[Signals, float]]
"""Signals and the camera's azimuth of frame k."""


def posing(bench: Bench, k: int) -> tuple[Signals, float]:
    """A new body pose in every frame."""
    return bench.signals(2 * k + 1), 20.0


def turning(bench: Bench, k: int) -> tuple[Signals, float]:
    """The camera goes around somebody who stands."""
    return bench.signals(), 20.0 + 5 * k


def everything(bench: Bench, k: int) -> tuple[Signals, float]:
    """Body, both hands, face and camera are new in every frame."""
    amount, body = _amount(k), bench.signals(2 * k + 1)
    hands = {f"{side}_hand_pose": amount * named_hand("fist", side) for side in ("left", "right")}
    return body.replace(expression=amount * named_expression("laugh"), **hands), 20.0 + 5 * k


def expressing(bench: Bench, k: int) -> tuple[Signals, float]:
    """A new expression of somebody who stands."""
    return bench.signals().replace(expression=_amount(k) * named_expression("laugh")), 20.0


def dragging(bench: Bench, k: int) -> tuple[Signals, float]:
    """One arm is lifted."""
    pose = np.array(bench.signals().body_pose)
    pose[LEFT_SHOULDER] += [0, 0, 0.05 * k]
    return bench.signals().replace(body_pose=pose), 20.0


def sequence(bench: Bench, settings: RenderSettings, size: int, count: int, change: Change) -> list[Frame]:
    """`count` frames after `WARM` others."""
    frames: list[Frame] = []
    for k in range(count + WARM):
        signals, azimuth = change(bench, k)
        previous = frames[-1] if frames else None
        frames.append(render_frame(bench.placed, signals, bench.camera(size, azimuth), settings, previous))
    return frames[WARM:]


def by_stage(frames: list[Frame]) -> dict[str, float]:
    """Medians, milliseconds."""
    return {f"{name}_ms": median(frame.ms[name] for frame in frames) for name in frames[0].ms if name != "total"}


def total(frames: list[Frame]) -> float:
    """Median of whole frames, milliseconds."""
    return median(frame.ms["total"] for frame in frames)


def _amount(k: int) -> float:
    """From 0 to 1 and back, never the same twice."""
    return float(1 - np.cos(2 * k + 1)) / 2
