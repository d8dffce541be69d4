"""What stands between the drawn subject and a file of a real stage: exposure, lens, sensor and matting.

    linear' = gain · linear        σ² = read² + linear' / electrons        matte'(x) = matte(x + d(x)),  1 ≤ |d| ≤ 2 pixels

Exposure and white balance are one gain per channel of linear light, other ones for either rig. Lenses bend by OpenCV's five
coefficients, a little differently in every camera; the calibration says them. Noise is shot and read noise in linear
light. A matte is pushed about by 1 to 2 pixels, in a direction that turns slowly over the picture, and compressed harder.
Everything random follows from (seed, rig, camera, frame).

Letters: h w pixels. Colours sRGB-encoded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import expit

from avatarrex.capture.synthetic.variation import Variation

GAIN = {"body": np.array([0.74, 0.80, 0.90]), "face": np.array([1.08, 1.00, 0.86])}
"""The body rig a third of a stop darker than the face rig and cool, the face rig warm."""
DISTORTION = {"body": (-0.14, 0.06, 0.0015, -0.001, 0.0), "face": (-0.35, 0.20, 0.003, 0.002, 0.0)}
"""k1, k2, p1, p2, k3 of a rig's lenses; barrel-shaped, up to 6 pixels at the corners of 384×512."""
LENS_SPREAD = 0.15
"""From lens to lens, relative."""
ELECTRONS, READ_NOISE = 1500.0, 0.002
"""At full scale of one pixel; linear light."""
MATTE_SHIFT = (1.0, 2.0)
"""Pixels."""
MATTE_SCALE = 12.0
"""Pixels over which a matte's error turns."""
JPEG_QUALITY, MATTE_QUALITY = 96, 75
"""JPEG, colour not subsampled: sharp prints keep their edges; of mattes that are off."""
_RIGS = ("body", "face")


@dataclass(frozen=True)
class Imaging:
    """The cameras of one rig."""

    rig: str
    variation: Variation
    seed: int

    def distortion(self, serial: str) -> np.ndarray:
        """(5,) k1, k2, p1, p2, k3 of a camera; zero for an ideal pinhole."""
        if not self.variation.has("lens"):
            return np.zeros(5)
        spread = 1 + LENS_SPREAD * self._random(serial, 0, 0).uniform(-1, 1, 5)
        return np.asarray(np.round(np.array(DISTORTION[self.rig]) * spread, 6))

    def developed(self, colour: np.ndarray, serial: str, frame: int) -> np.ndarray:
        """(h, w, 4) what camera and matting make of premultiplied `colour` (h, w, 4)."""
        picture = colour.astype(np.float64) if self.variation.conditions else colour
        if self.variation.has("exposure"):
            picture = exposed(picture, GAIN[self.rig])
        if self.variation.has("noise"):
            picture = noisy(picture, self._random(serial, frame, 1))
        if self.variation.has("mattes"):
            picture[..., 3] = pushed(picture[..., 3], self._random(serial, frame, 2))
        return picture

    @property
    def matte_quality(self) -> int:
        """JPEG quality of mattes."""
        return MATTE_QUALITY if self.variation.has("mattes") else JPEG_QUALITY

    def _random(self, serial: str, frame: int, what: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, 3, _RIGS.index(self.rig), int(serial), frame, what])


def exposed(picture: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Premultiplied `picture` (h, w, 4) with its linear light times `gain` (3,), clipped at white."""
    return _in_linear_light(picture, lambda linear: linear * gain)


def noisy(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Premultiplied `picture` (h, w, 4) with shot and read noise on the subject; the backdrop stays black."""

    def sensed(linear: np.ndarray) -> np.ndarray:
        return linear + np.sqrt(READ_NOISE**2 + linear / ELECTRONS) * rng.standard_normal(linear.shape)

    return _in_linear_light(picture, sensed)


def pushed(matte: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """`matte` (h, w) read 1 to 2 pixels beside each pixel."""
    places = np.indices(matte.shape) + displacement(matte.shape, rng)
    return np.asarray(map_coordinates(matte, places, order=1, mode="nearest"))


def displacement(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """(2, h, w) pixels, rows first: lengths within `MATTE_SHIFT`, turning over `MATTE_SCALE` pixels."""
    noise = np.stack([gaussian_filter(rng.standard_normal(shape), MATTE_SCALE) for _ in range(3)])
    noise /= noise.std((1, 2), keepdims=True)
    direction = noise[:2] / np.maximum(np.linalg.norm(noise[:2], axis=0), 1e-9)
    low, high = MATTE_SHIFT
    return np.asarray(direction * (low + (high - low) * expit(2 * noise[2])))


def _in_linear_light(picture: np.ndarray, change: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    alpha = picture[..., 3:]
    straight = picture[..., :3] / np.maximum(alpha, 1e-6)
    return np.concatenate([_encoded(change(_linear(straight))) * alpha, alpha], 2)


def _linear(encoded: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _encoded(linear: np.ndarray) -> np.ndarray:
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
