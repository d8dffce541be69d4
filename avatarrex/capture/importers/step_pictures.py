"""What a person looks at after each step of a preparation: cameras from above and from the side, tiles of pictures with what was found in
them.

Letters: h w pixels. World metres.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import binary_erosion

from avatarrex.capture.readers.calibration import Lens

SIDE, GAP, PLAN = 240, 4, 560
"""Pixels of a tile, between tiles, and of each half of the plan."""
PAPER, INK, CAMERA, PERSON, MATTE = (24, 27, 33), (210, 214, 220), (90, 170, 255), (255, 170, 60), (60, 255, 110)
WRONG = (255, 70, 60)
FACE_MARGIN = 0.75
"""Half a side of a face's picture, in extents of its landmarks."""
LENGTH = 0.12
"""Of a camera's sign, as a share of the stage."""


def tiles(pictures: Iterable[tuple[str, np.ndarray]], columns: int = 5) -> np.ndarray:
    """(h, w, 3) bytes: pictures (h, w, 3), each with a line of text, side by side."""
    made = [_tile(text, pixels) for text, pixels in pictures] or [_tile("nothing", np.zeros((4, 3, 3), np.uint8))]
    columns = min(columns, len(made))
    rows = -(-len(made) // columns)
    height, width = max(tile.shape[0] for tile in made), max(tile.shape[1] for tile in made)
    sheet = np.full((rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3), PAPER, np.uint8)
    for place, tile in enumerate(made):
        top, left = place // columns * (height + GAP), place % columns * (width + GAP)
        sheet[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
    return sheet


def outlined(image: np.ndarray, matte: np.ndarray) -> np.ndarray:
    """The picture darker beyond its matte, with the matte's edge in green."""
    inside = matte > 127
    thick = max(1, round(max(matte.shape) / 250))
    edge = inside & ~binary_erosion(inside, iterations=thick)
    pixels = np.where(inside[..., None], image[..., :3], image[..., :3] // 3)
    pixels[edge] = MATTE
    return np.asarray(pixels, np.uint8)


def dotted(image: np.ndarray, points: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """The picture with points (k, 2), the surer the greener."""
    picture = Image.fromarray(np.ascontiguousarray(image[..., :3]))
    draw, radius = ImageDraw.Draw(picture), max(1.5, max(image.shape) / 160)
    for (x, y), sure in zip(points, confidence):
        if sure > 0:
            colour = (int(255 * (1 - sure)), int(255 * sure), 60)
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour, outline=(0, 0, 0))
    return np.array(picture)


def fitted_face(image: np.ndarray, fitted: np.ndarray, found: np.ndarray, believed: np.ndarray) -> np.ndarray:
    """The part of a picture about the fitted landmarks (l, 2), orange; those found (k, 2) green where they are believed (k,), else red."""
    low, high = fitted.min(0), fitted.max(0)
    half = max(float((high - low).max()) * FACE_MARGIN, 4.0)
    corner, scale = (low + high) / 2 - half, 2 * SIDE / (2 * half)
    box = (*corner, *(corner + 2 * half))
    picture = Image.fromarray(np.ascontiguousarray(image[..., :3])).crop(tuple(map(round, box)))
    corner = np.round(corner)
    picture = picture.resize((2 * SIDE, 2 * SIDE), Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(picture)
    for places, radius, colours in (
        (found, 5, [MATTE if one else WRONG for one in believed]),
        (fitted, 3, [PERSON] * len(fitted)),
    ):
        for (x, y), colour in zip((places - corner) * scale, colours):
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour, outline=(0, 0, 0))
    return np.array(picture)


def plan(lenses: tuple[Lens, ...], person: np.ndarray | None = None, up: int = 1) -> np.ndarray:
    """(h, w, 3) bytes: cameras from above and from the side with where they look, and the places (n, 3) of a person."""
    centres = np.stack([lens.camera.centre for lens in lenses])
    ahead = np.stack([lens.camera.camera_from_world[2, :3] for lens in lenses])
    places = centres if person is None else np.concatenate([centres, person])
    middle = (places.min(0) + places.max(0)) / 2
    reach = max(float(np.abs(places - middle).max()) * 1.25, 1e-6)
    flat = [axis for axis in range(3) if axis != up]
    halves = [((flat[0], flat[1]), 1.0, "from above"), ((flat[0], up), -1.0, "from the side")]
    sheet = Image.new("RGB", (2 * PLAN + GAP, PLAN), PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    for half, ((across, along), sign, text) in enumerate(halves):

        def pixel(
            place: np.ndarray, across: int = across, along: int = along, sign: float = sign, half: int = half
        ) -> tuple[float, float]:
            away = (place - middle) / reach * PLAN / 2
            return half * (PLAN + GAP) + PLAN / 2 + away[across], PLAN / 2 + sign * away[along]

        draw.text((half * (PLAN + GAP) + 10, 8), f"{text}; {2 * reach:.3g} units wide", INK, font)
        for place in () if person is None else person[:: max(1, len(person) // 200)]:
            x, y = pixel(place)
            draw.ellipse((x - 3, y - 3, x + 3, y + 3), fill=PERSON)
        for lens, centre, way in zip(lenses, centres, ahead):
            x, y = pixel(centre)
            draw.line((x, y, *pixel(centre + way * reach * LENGTH * 2)), CAMERA, 2)
            draw.ellipse((x - 5, y - 5, x + 5, y + 5), fill=CAMERA)
            long, edge = draw.textlength(lens.name, font), half * (PLAN + GAP) + PLAN
            draw.text((x + 7 if x + 7 + long <= edge else x - 7 - long, y - 8), lens.name, INK, font)
    return np.array(sheet)


def _tile(text: str, pixels: np.ndarray) -> np.ndarray:
    scale = SIDE / max(pixels.shape[:2])
    size = (max(round(pixels.shape[1] * scale), 1), max(round(pixels.shape[0] * scale), 1))
    picture = Image.fromarray(np.ascontiguousarray(pixels[..., :3])).resize(
        size, Image.Resampling.BOX if scale < 1 else Image.Resampling.BICUBIC
    )
    ImageDraw.Draw(picture).text(
        (4, 3), text, (255, 255, 255), ImageFont.load_default(12), stroke_width=2, stroke_fill=(0, 0, 0)
    )
    return np.array(picture)
