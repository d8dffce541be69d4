"""A sheet of labelled pictures on paper: rows of groups of tiles, a heading above, small text under each tile. Pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from avatarrex.files.gate import written

QUALITY = 90
SHEET_BYTES = 700_000
"""Bytes of a sheet at most: one that is larger is made smaller."""
EDGE, GROUPS, TILES, LINE, HEADING = 24, 18, 4, 30, 78
"""Margin, space between groups and between a group's tiles, height of a label and of the heading."""
INK, FAINT, PAPER, GROUND = (40, 42, 46), (120, 124, 130), (252, 252, 251), (233, 234, 236)
"""Text, lesser text, paper, and the background of the figures."""


@dataclass(frozen=True, eq=False)
class Tile:
    """A picture with the words under it."""

    picture: UInt8[np.ndarray, "h w 3"]
    label: str
    note: str = ""
    """Fainter words after the label."""


Group = list[Tile]


def tile_width(groups: int, tiles: int, width: int) -> int:
    """Width of a tile where `groups` of `tiles` each fill a row of a sheet `width` wide."""
    free = width - 2 * EDGE - (groups - 1) * GROUPS - groups * (tiles - 1) * TILES
    return free // (groups * tiles)


def sheet_width(groups: int, tiles: int, tile: int) -> int:
    """Width of a sheet that a row of `groups` of `tiles`, each `tile` wide, fills: the inverse of `tile_width`."""
    return 2 * EDGE + (groups - 1) * GROUPS + groups * ((tiles - 1) * TILES + tiles * tile)


def over(image: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    """Premultiplied RGBA (h, w, 4) in [0, 1] over the sheet's ground."""
    pixels = 255 * image[..., :3] + (1 - image[..., 3:]) * np.array(GROUND)
    return np.asarray(np.rint(np.clip(pixels, 0, 255)).astype(np.uint8))


def enlarged(picture: UInt8[np.ndarray, "h w 3"], side: int) -> UInt8[np.ndarray, "side side 3"]:
    """A square picture with `side` pixels to a side, cubic between those that it has."""
    return np.asarray(Image.fromarray(picture).resize((side, side), Image.Resampling.BICUBIC))


def laid_out(heading: str, note: str, rows: list[list[Group]], width: int) -> Image.Image:
    """The sheet, `width` wide; a row is as high as its tallest tile."""
    heights = [max(len(tile.picture) for group in row for tile in group) for row in rows]
    sheet = Image.new("RGB", (width, HEADING + sum(heights) + LINE * len(rows) + EDGE // 2), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((EDGE, 30), heading, INK, ImageFont.load_default(26), anchor="lm")
    draw.text((EDGE + 1, 57), _shortened(note, width - 2 * EDGE, 16), FAINT, ImageFont.load_default(16), anchor="lm")
    top = HEADING
    for row, height in zip(rows, heights):
        left = EDGE
        for group in row:
            for tile in group:
                sheet.paste(Image.fromarray(tile.picture), (left, top))
                _label(draw, tile, left + tile.picture.shape[1] / 2, top + height + LINE / 2 - 2)
                left += tile.picture.shape[1] + TILES
            left += GROUPS - TILES
        top += height + LINE
    return sheet


def write_jpeg(path: str | Path, sheet: Image.Image) -> None:
    """`sheet` as JPEG of at most `SHEET_BYTES` bytes: reduced by a tenth until it fits."""
    picture = sheet
    while True:
        with written(path) as temporary:
            picture.save(temporary, format="JPEG", quality=QUALITY, optimize=True)
        if Path(path).stat().st_size <= SHEET_BYTES:
            return
        picture = sheet.resize((picture.width * 9 // 10, picture.height * 9 // 10), Image.Resampling.LANCZOS)


def _label(draw: ImageDraw.ImageDraw, tile: Tile, middle: float, height: float) -> None:
    """The label and what of the note has room beside it, centred under the tile."""
    font = ImageFont.load_default(15)
    room = tile.picture.shape[1] - font.getlength(tile.label)
    words = [(tile.label, INK)] + ([(_shortened(f"  {tile.note}", room, 15), FAINT)] if tile.note else [])
    left = middle - sum(font.getlength(text) for text, _ in words) / 2
    for text, colour in words:
        draw.text((left, height), text, colour, font, anchor="lm")
        left += font.getlength(text)


def _shortened(text: str, room: float, size: int) -> str:
    """`text`, or its beginning where it is wider than `room` in letters of `size`."""
    font = ImageFont.load_default(size)
    if font.getlength(text) <= room:
        return text
    while text and font.getlength(text + "…") > room:
        text = text[:-1]
    return text + "…" if text else ""
