"""An invisible mark in a picture that says it was made by this program, and the search for it.

Spread spectrum in the discrete cosine transform: the mark is a fixed pseudo-random picture of `SIDE`² pixels whose frequencies lie
in `BAND` half periods over the whole picture, stretched over whatever raster the picture has and added to its brightness, more
where the picture is rough. As its frequencies are counted over the picture, another size leaves them where they are; those of `BAND`
are low enough for JPEG and too high for a slow gradient to reach.

The search stretches the picture to `SIDE`², divides each coefficient of the band by what its neighbours have in size, so that edges
of the picture count no more than flat places, and correlates with the mark: the score of a picture without it has mean 0 and
standard deviation 1. Cut out or turned pictures are not found. Letters: h w image rows and columns, c channels.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float64, UInt8
from PIL import Image
from scipy.fft import dctn, idctn
from scipy.ndimage import uniform_filter

SIDE = 512
"""Of the mark's own raster, pixels."""
BAND = (40, 160)
"""Half periods over the picture: from 13 pixels of `SIDE` a half period to 3."""
SEED = 20231
SMALLEST = 192
"""Pixels of the shorter side that a picture needs: less than this and half of the band has no place in it."""
STRENGTH = (0.8, 3.5)
"""Steps of 8 bits that a flat place and the roughest one change by, as a standard deviation."""
ROUGH = 24.0
"""Steps of 8 bits: a local standard deviation of the brightness at which the change is halfway to its greatest."""
FOUND = 6.0
"""Score from which a picture counts as marked: of unmarked ones, one in 10⁹ reaches it if the score is normal."""
NEIGHBOURS, MOST = 13, 3.0
"""Coefficients along each side whose mean size is the usual one of the middle; multiples of it beyond which one counts no more."""
BRIGHTNESS = np.array([0.299, 0.587, 0.114])
"""Of red, green and blue, as JPEG has it."""


def mark(pixels: UInt8[np.ndarray, "h w c"]) -> UInt8[np.ndarray, "h w c"]:
    """The picture with the mark; a fourth channel is left alone. The sides must be `SMALLEST` or more."""
    height, width = pixels.shape[:2]
    colour = pixels[..., :3].astype(np.float64)
    brightness = colour @ BRIGHTNESS
    mean = uniform_filter(brightness, 9)
    rough = np.sqrt(np.maximum(uniform_filter(brightness**2, 9) - mean**2, 0))
    low, high = STRENGTH
    amount = low + (high - low) * rough / (rough + ROUGH)
    change = amount * _stretched(_pattern(), (width, height))
    marked = np.rint(np.clip(colour + change[..., None], 0, 255)).astype(np.uint8)
    return np.concatenate([marked, pixels[..., 3:]], -1)


def score(pixels: UInt8[np.ndarray, "h w c"]) -> float:
    """How clearly the mark is seen: about a normal number of mean 0 and standard deviation 1 without it, `FOUND` or more with it."""
    brightness = pixels[..., :3].astype(np.float64) @ BRIGHTNESS
    found = _band(dctn(_stretched(brightness, (SIDE, SIDE)), norm="ortho"))
    inside = _inside()
    usual = uniform_filter(np.abs(found), NEIGHBOURS) / np.maximum(_share(), 1e-9)
    even = np.clip(found / np.maximum(usual, 1e-6), -MOST, MOST)[inside]
    spread = float(np.sqrt((even**2).sum()))
    return float((even * _signs()[inside]).sum() / spread) if spread else 0.0


def _stretched(values: Float64[np.ndarray, "h w"], size: tuple[int, int]) -> Float64[np.ndarray, "a b"]:
    """Another raster, (width, height), of the same picture."""
    image = Image.fromarray(values.astype(np.float32))
    return np.asarray(image.resize(size, Image.Resampling.BICUBIC), np.float64)


@lru_cache(maxsize=1)
def _inside() -> np.ndarray:
    """(SIDE, SIDE) bool: which coefficients of the transform are in the band."""
    rows, columns = np.mgrid[:SIDE, :SIDE]
    radius = np.hypot(rows, columns)
    return np.asarray((radius >= BAND[0]) & (radius < BAND[1]))


@lru_cache(maxsize=1)
def _share() -> np.ndarray:
    """(SIDE, SIDE): share of each coefficient's neighbours that are in the band."""
    return np.asarray(uniform_filter(_inside().astype(np.float64), NEIGHBOURS))


@lru_cache(maxsize=1)
def _signs() -> np.ndarray:
    """(SIDE, SIDE) of ±1: what the mark does to each coefficient."""
    return np.random.default_rng(SEED).choice([-1.0, 1.0], (SIDE, SIDE))


def _band(values: np.ndarray) -> np.ndarray:
    return np.where(_inside(), values, 0.0)


@lru_cache(maxsize=1)
def _pattern() -> np.ndarray:
    """(SIDE, SIDE): the mark, standard deviation 1."""
    picture = idctn(_band(_signs()), norm="ortho")
    return np.asarray(picture / picture.std())
