"""A sound file as a mouth that speaks: visemes by energy and spectrum. It is simple, and says so: it knows no words and no language.

Of each window of 40 ms, 60 a second: the loudness L in dB over the file's quiet tenth, as a share of the range to its loud tenth, and how
its energy is spread over bands of speech. Loudness opens the mouth; the balance of bands chooses among four shapes, blended softly:

    low (200–800 Hz) leads            oh, oo   rounded
    low and middle (800–1800 Hz)      ah       open
    middle and high (1800–3500 Hz)    ee       spread
    hiss (4–8 kHz) leads              s sh     teeth

Times in seconds, frequencies in hertz. Letters: s samples, t frames, b bands.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import gaussian_filter1d

from avatarrex.files.sound import read_sound
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import Guess, ImportedMotion
from avatarrex.signals.macros import face_direction
from avatarrex.signals.sequence import SignalSequence, check_frames, stack

FPS, WINDOW = 60.0, 0.04
BANDS = ((200.0, 800.0), (800.0, 1800.0), (1800.0, 3500.0), (4000.0, 8000.0))
SHAPES = {
    "oh": (1.0, 0.25, 0.05, 0.0),
    "ah": (0.6, 1.0, 0.3, 0.05),
    "ee": (0.55, 0.15, 1.0, 0.25),
    "s sh": (0.1, 0.1, 0.4, 1.0),
}
"""Each shape's share of the loudest band in the four bands: rough averages of vowels and of s."""
QUIETEST = 12.0
"""dB between quiet and loud under which a file is no speech: its mouth stays shut."""
SMOOTHING = 0.03
"""Seconds: lips do not jump."""
EMPHASIS = 6.0
"""dB an octave by which speech falls off over its bands, made up for."""


def read_speech(path: Path, options: ImportOptions) -> ImportedMotion:
    """Read a `.wav` of 8 to 32 bits; the mouth alone moves. Raises `InputError`."""
    samples, rate = read_sound(path)
    count = int(len(samples) / rate * FPS) + 1
    check_frames(count, path, "length")
    weights = _weights(samples, rate, count)
    fps = options.fps or FPS
    note = "simple: visemes by energy and spectrum, no words"
    frames = stack(np.zeros((count, 55, 3)), np.zeros((count, 3)), weights)
    guesses = (
        Guess("file", "sound", f"{len(samples) / rate:.2f} s at {rate} Hz; {note}"),
        Guess("rate", f"{fps:g} frames a second", "chosen" if options.fps else "", "fps"),
    )
    return ImportedMotion(SignalSequence(frames, fps, path.name, (note,)), guesses, options=options)


def _weights(samples: Float64[np.ndarray, " s"], rate: int, count: int) -> Float64[np.ndarray, "t 52"]:
    """The 52 coefficients of every frame."""
    length = max(int(WINDOW * rate), 16)
    padded = np.concatenate([samples, np.zeros(length)])
    from scipy.signal import stft  # takes 0.25 s: not before there is a sound

    frequencies, times, spectrum = stft(padded, rate, "hann", length, length * 3 // 4, padded=True)
    power = np.abs(spectrum) ** 2
    energy = np.stack([power[(frequencies >= low) & (frequencies < high)].sum(0) for low, high in BANDS])
    frames = np.arange(count) / FPS
    energy = np.stack([np.interp(frames, times, band) for band in energy], 1)
    loudness = 10 * np.log10(energy.sum(1) + 1e-12)
    quiet, loud = max(np.quantile(loudness, 0.1), -80.0), np.quantile(loudness, 0.95)
    if loud - max(quiet, -90.0) < QUIETEST and loud < -50:
        return np.zeros((count, 52))
    floor = max(quiet, loud - 45.0)
    opened = np.clip((loudness - floor) / max(loud - floor, QUIETEST), 0.0, 1.0)
    middles = np.array([np.sqrt(low * high) for low, high in BANDS])
    levelled = energy * 10 ** (EMPHASIS / 10 * np.log2(middles / middles[0]))
    levelled /= levelled.max(1, keepdims=True) + 1e-12
    targets = np.array(list(SHAPES.values()))
    distance = ((levelled[:, None] - targets) ** 2).sum(2)
    share = np.exp(-4 * distance)
    share /= share.sum(1, keepdims=True)
    shapes = np.stack([face_direction(name) for name in SHAPES])
    weights = opened[:, None] * (share @ shapes)
    found: Float64[np.ndarray, "t 52"] = np.clip(
        gaussian_filter1d(weights, SMOOTHING * FPS, axis=0, mode="nearest"), 0, 1
    )
    return found
