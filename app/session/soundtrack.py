"""What the sound files of timelines sound like together. Letters: s samples."""

from __future__ import annotations

from collections.abc import Iterable
from math import gcd
from pathlib import Path

import numpy as np
from avatarrex_studio.session.timeline import Layer, Timeline
from jaxtyping import Float

from avatarrex.files.sound import read_sound
from avatarrex.signals.speech import FPS

ENDING = ".wav"


def soundtrack(
    timeline: Timeline, begin: float, seconds: float, rate: int, others: Iterable[Timeline] = ()
) -> Float[np.ndarray, " s"] | None:
    """The sum of all sound layers from `begin` on, cut to −1 to 1, each as loud as its weight; `rate` samples a second.

    `others`: of the figures beside, which sound as they move: again where they repeat. A layer that goes twice as fast is an octave
    higher. None without a sound layer. Raises `InputError` for one that cannot be read.
    """
    times = begin + np.arange(round(seconds * rate)) / rate
    shown = [(timeline, timeline.local(times)), *((other, other.repeated(times)) for other in others)]
    sounding = [(_sounding(each), _own_times(each, times, own)) for each, own in shown]
    sounds = [layer.weight * _sound(layer, own, rate) for layers, own in sounding for layer in layers]
    return np.sum(sounds, axis=0).clip(-1.0, 1.0) if sounds else None


def _sounding(timeline: Timeline) -> list[Layer]:
    """The layers that sound."""
    files = [layer for layer in timeline.layers if layer.clip and layer.clip.path.lower().endswith(ENDING)]
    return [layer for layer in files if layer.weight and not layer.muted]


def _own_times(
    timeline: Timeline, times: Float[np.ndarray, " s"], shown: Float[np.ndarray, " s"]
) -> Float[np.ndarray, " s"]:
    """A timeline's own times at which it sounds while it is `shown` at some; NaN, silence, where it waits in its first or last frame."""
    first, last = timeline.played
    repeats = timeline.loop and last > first
    late, frame = times - shown, 1 / timeline.fps  # the last frame sounds for as long as a frame lasts
    waits = (late <= -1e-9) | (not repeats and late >= frame)
    return np.where(waits, np.nan, shown if repeats else times)


def _sound(layer: Layer, times: Float[np.ndarray, " s"], rate: int) -> Float[np.ndarray, " s"]:
    """Of one layer at times of the timeline; silence before and after it, and at those that are NaN."""
    from scipy.signal import resample_poly  # takes 0.4 s: not before there is a sound

    assert layer.clip is not None
    samples, own_rate = read_sound(Path(layer.clip.path))
    common = gcd(rate, own_rate)
    samples = resample_poly(samples, rate // common, own_rate // common)
    own = np.asarray(layer.local(times)) * layer.clip.fps / FPS  # at another rate the file is as long as the mouth's
    found: Float[np.ndarray, " s"] = np.interp(own, np.arange(len(samples)) / rate, samples, 0.0, 0.0)
    return np.where(np.isnan(found), 0.0, found)
