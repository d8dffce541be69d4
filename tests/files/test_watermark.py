"""The invisible mark: found after JPEG and another size, not seen, and never found where it is not."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from avatarrex.files.watermark import FOUND, SMALLEST, mark, score

IMAGES = sorted((Path(__file__).parents[2] / "docs" / "images").glob("*"))
"""Renderings, sheets and curves."""
PHOTOS = [
    path for path in IMAGES if path.stem in ("default", "surface_close", "default_hands", "capture_other", "levels")
]
UNMARKED = 200


def opened(path, longest=1024):
    with Image.open(path) as image:
        image.thumbnail((longest, longest))
        return np.asarray(image.convert("RGB"))


def through_jpeg(pixels, quality=80):
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file))


def smaller(pixels, factor=0.75):
    height, width = pixels.shape[:2]
    return np.asarray(
        Image.fromarray(pixels).resize((round(factor * width), round(factor * height)), Image.Resampling.BICUBIC)
    )


@pytest.mark.parametrize("path", PHOTOS, ids=lambda path: path.stem)
def test_it_survives_jpeg_and_another_size(path):
    pixels = opened(path)
    marked = mark(pixels)
    assert score(pixels) < FOUND / 2
    for copy in (marked, through_jpeg(marked), smaller(through_jpeg(marked)), through_jpeg(smaller(marked))):
        assert score(copy) >= FOUND
    error = ((marked.astype(float) - pixels) ** 2).mean()
    assert 10 * np.log10(255**2 / error) > 40


def unmarked(number):
    """A picture of its own: a crop of a document's picture, mirrored or not, or noise whose power falls with frequency."""
    random = np.random.default_rng(number)
    height, width = random.integers(SMALLEST, 400, 2)
    if number % 2:
        spectrum = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)) + 1 / max(height, width)
        waves = np.fft.fft2(random.standard_normal((height, width))) / spectrum ** random.uniform(0, 2)
        values = np.fft.ifft2(waves).real
        values = 128 + random.uniform(2, 60) * (values - values.mean()) / values.std()
        return np.repeat(np.clip(values, 0, 255).astype(np.uint8)[..., None], 3, -1)
    pixels = SOURCES[number // 2 % len(SOURCES)]
    height, width = min(height, pixels.shape[0]), min(width, pixels.shape[1])
    top, left = random.integers(pixels.shape[0] - height + 1), random.integers(pixels.shape[1] - width + 1)
    return pixels[top : top + height, left : left + width][:, :: random.choice([-1, 1])]


SOURCES = [opened(path) for path in PHOTOS]


def test_there_is_no_false_alarm():
    scores = np.array([score(unmarked(number)) for number in range(UNMARKED)])
    assert np.abs(scores).max() < FOUND - 1.5
    assert abs(scores.mean()) < 0.3
    assert 0.8 < scores.std() < 1.3, "the score is in standard deviations"


def test_alpha_stays_and_another_picture_is_marked_by_the_same_change():
    random = np.random.default_rng(0)
    pixels = random.integers(0, 256, (SMALLEST, 300, 4), np.uint8)
    marked = mark(pixels)
    assert (marked[..., 3] == pixels[..., 3]).all()
    assert score(marked) >= FOUND > score(pixels)
    assert score(marked[::-1]) < FOUND, "turned pictures are not found, as is said"
