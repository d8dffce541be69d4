"""What the sound files of a timeline sound like together. Letters: s samples."""

from __future__ import annotations

from math import gcd
from pathlib import Path

import numpy as np
from avatarrex_studio.session.timeline import Layer, Timeline
from jaxtyping import Float
from scipy.signal import resample_poly

from avatarrex.files.sound import read_sound
from avatarrex.signals.speech import FPS

ENDING = ".wav"


def soundtrack(timeline: Timeline, begin: float, seconds: float, rate: int) -> Float[np.ndarray, " s"] | None:
    """The sum of all sound layers from `begin` on, cut to −1 to 1, each as loud as its weight; `rate` samples a second.

    A layer that goes twice as fast is an octave higher. None without a sound layer. Raises `InputError` for one that cannot be read.
    """
    sounding = [layer for layer in timeline.layers if layer.clip and layer.clip.path.lower().endswith(ENDING)]
    sounding = [layer for layer in sounding if layer.weight and not layer.muted]
    if not sounding:
        return None
    times = begin + np.arange(round(seconds * rate)) / rate
    mixed: Float[np.ndarray, " s"] = np.sum([layer.weight * _sound(layer, times, rate) for layer in sounding], axis=0)
    return mixed.clip(-1.0, 1.0)


def _sound(layer: Layer, times: Float[np.ndarray, " s"], rate: int) -> Float[np.ndarray, " s"]:
    """Of one layer at times of the timeline; silence before and after it."""
    assert layer.clip is not None
    samples, own_rate = read_sound(Path(layer.clip.path))
    common = gcd(rate, own_rate)
    samples = resample_poly(samples, rate // common, own_rate // common)
    own = np.asarray(layer.local(times)) * layer.clip.fps / FPS  # at another rate the file is as long as the mouth's
    found: Float[np.ndarray, " s"] = np.interp(own, np.arange(len(samples)) / rate, samples, 0.0, 0.0)
    return found
