"""Pictures with rows missing, which Pillow reads without a word."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from partial_png import partial_png
from PIL import Image

from avatarrex.errors import InputError
from avatarrex.files.images import read_pixels

PIXELS = np.random.default_rng(0).integers(1, 255, (64, 48, 3), dtype=np.uint8)


def refusal(path: Path, content: bytes) -> str:
    """Empty where the picture is read."""
    path.write_bytes(content)
    try:
        read_pixels(path)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("pieces", [1, 7])
def test_a_half_empty_png_is_noticed(tmp_path: Path, pieces: int) -> None:
    assert refusal(tmp_path / "a.png", partial_png(PIXELS, 32, pieces)).endswith(
        "a.png: expected a whole picture, found 50% of its pixels"
    )
    assert refusal(tmp_path / "a.png", partial_png(PIXELS, 63, pieces))
    assert not refusal(tmp_path / "a.png", partial_png(PIXELS, 64, pieces))


def test_a_black_end_is_a_picture(tmp_path: Path) -> None:
    dark = PIXELS.copy()
    dark[20:] = 0
    assert not refusal(tmp_path / "a.png", partial_png(dark, 64))
    for mode in ("1", "L", "P", "LA", "RGB", "RGBA"):
        for shape in ((64, 48), (3, 5), (1, 1)):
            stream = io.BytesIO()
            Image.new(mode, shape).save(stream, "PNG")
            assert not refusal(tmp_path / "a.png", stream.getvalue()), (mode, shape)


def test_a_half_grey_jpeg_is_noticed(tmp_path: Path) -> None:
    stream = io.BytesIO()
    Image.fromarray(np.kron(PIXELS, np.ones((4, 4, 1), np.uint8))).save(stream, "JPEG")
    whole = stream.getvalue()
    said = refusal(tmp_path / "a.jpg", whole[: len(whole) // 2] + b"\xff\xd9")
    assert "a.jpg: expected a whole picture, found nothing below row " in said
    assert said.endswith("of 256: all is middle grey")
    assert not refusal(tmp_path / "a.jpg", whole)


def test_a_grey_studio_is_a_picture(tmp_path: Path) -> None:
    """Grey from top to bottom about a person."""
    grey = np.full((128, 64, 3), 128, np.uint8)
    grey[40:80, 20:40] = 200
    stream = io.BytesIO()
    Image.fromarray(grey).save(stream, "JPEG")
    assert not refusal(tmp_path / "a.jpg", stream.getvalue())
