"""Contact sheets: the person's template drawn over the pictures of a capture, one row per camera, one column per frame.

Green is the template's outline; red where only the template is, blue where only the matte is. Tiles are cut out about
the person. Letters: h w pixels.
"""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import binary_erosion

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import FOREGROUND, compared_frames, iou, silhouette, template_surface
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Splits

TILE_PIXELS = 320
"""Pixels of a tile's sides; fewer where many cameras would make the sheet longer than `TALLEST_PIXELS`."""
TALLEST_PIXELS = 4800
COMPARED_VIEWS = 4
"""Cameras of a sheet that compares."""
GAP_PIXELS = 2
"""Between tiles."""
TILE_MARGIN = 0.06
"""Of a tile's side, free about the person."""
GREEN, RED, BLUE = (40, 255, 90), (255, 60, 50), (60, 120, 255)
TINT = 0.55
"""How much of the tint covers the picture."""
LEGEND = "green: the template's outline   red: template only   blue: matte only"


def contact_sheet(capture: Capture, rig_name: str, frames: tuple[int, ...]) -> np.ndarray:
    """(h, w, 3) uint8 sheet of one rig. Raises `InputError` for a picture that cannot be decoded."""
    rig = capture.rigs[rig_name]
    side = int(np.clip(TALLEST_PIXELS // len(rig.views), 96, TILE_PIXELS))
    faces = capture.person.body.faces.numpy()
    surfaces = [template_surface(capture.person, rig.signals[frame])[0] for frame in frames]
    pitch = side + GAP_PIXELS
    strip = _labelled(np.full((side // 12 + 8, pitch * len(frames) - GAP_PIXELS, 3), 40, np.uint8), LEGEND, side)
    sheet = np.full((len(strip) + pitch * len(rig.views), strip.shape[1], 3), 255, np.uint8)
    sheet[: len(strip)] = strip
    for view in range(len(rig.views)):
        top = len(strip) + GAP_PIXELS + view * pitch
        for column, (frame, vertices) in enumerate(zip(frames, surfaces)):
            tile = _tile(rig, view, frame, vertices, faces, side)
            sheet[top : top + side, column * pitch : column * pitch + side] = tile
    return sheet


def compared_sheet(captures: tuple[Capture, ...], rig_name: str, frames: tuple[int, ...]) -> np.ndarray:
    """(h, w, 3) uint8: the training's cameras of a rig, some frames, each as the `captures` have it side by side."""
    side, views = TILE_PIXELS, Splits.of(captures[0].rigs[rig_name]).train.views
    some = [views[place] for place in compared_frames(len(views), COMPARED_VIEWS)]
    rows = []
    for view in some:
        row = []
        for frame in frames:
            for capture in captures:
                rig = capture.rigs[rig_name]
                vertices = template_surface(capture.person, rig.signals[frame])[0]
                row.append(_tile(rig, view, frame, vertices, capture.person.body.faces.numpy(), side))
        rows.append(np.concatenate([np.pad(tile, ((0, GAP_PIXELS), (0, GAP_PIXELS), (0, 0))) for tile in row], 1))
    legend = _labelled(np.full((side // 12 + 8, rows[0].shape[1], 3), 40, np.uint8), f"before | after   {LEGEND}", side)
    return np.concatenate([legend, *rows])


def _tile(rig: Rig, view: int, frame: int, vertices: np.ndarray, faces: np.ndarray, side: int) -> np.ndarray:
    label = f"{rig.views[view].name}  frame {frame}"
    if not rig.available(view, frame):
        return _labelled(np.full((side, side, 3), 60, np.uint8), f"{label}  missing", side)
    camera, matte = rig.views[view].camera, rig.matte(view, frame)
    box = box_about(matte, vertices, camera)
    seen = resized(np.full(matte.shape, 255, np.uint8), box, side) > FOREGROUND
    covered = silhouette(vertices, faces, cut(camera, box, side)) & seen
    picture = resized(rig.image(view, frame), box, side)
    inside = resized(matte, box, side) > FOREGROUND
    return _labelled(_drawn(picture, covered, inside), f"{label}  IoU {iou(covered, inside):.3f}", side)


def box_about(matte: np.ndarray, vertices: np.ndarray, camera: Camera) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of a square about matte and template, inside the picture where that is possible."""
    pixels, depth = camera.pixels(vertices)
    rows, columns = np.nonzero(matte > FOREGROUND)
    points = np.concatenate([pixels[depth > 0], np.stack([columns, rows], 1)]).clip(0, [camera.width, camera.height])
    if not len(points):
        points = np.array([[0.0, 0.0], [camera.width, camera.height]])
    low, high = points.min(0), points.max(0)
    size = np.array([camera.width, camera.height])
    half = min(max((high - low).max() * (0.5 + TILE_MARGIN), 16), size.max() / 2)
    x, y = np.where(size > 2 * half, np.clip((low + high) / 2, half, np.maximum(size - half, half)), size / 2)
    return x - half, y - half, x + half, y + half


def cut(camera: Camera, box: tuple[float, float, float, float], side: int) -> Camera:
    """The camera of the part `box` of its picture, `side` pixels square."""
    left, top, right, _ = box
    scale = side / (right - left)
    change = np.array([[scale, 0, -scale * left], [0, scale, -scale * top], [0, 0, 1]])
    return Camera(change @ camera.intrinsics, camera.camera_from_world, side, side)


def resized(pixels: np.ndarray, box: tuple[float, float, float, float], side: int) -> np.ndarray:
    """The part `box` of an image, black beyond its edge."""
    left, top, right, bottom = box
    factor = (right - left) / side
    method = Image.Resampling.BICUBIC
    image = Image.fromarray(pixels)
    if factor > 1:  # an area filter first: an affine map samples points
        small = (max(round(image.width / factor), 1), max(round(image.height / factor), 1))
        left, right = left * small[0] / image.width, right * small[0] / image.width
        top, bottom = top * small[1] / image.height, bottom * small[1] / image.height
        image = image.resize(small, Image.Resampling.BOX)
    matrix = ((right - left) / side, 0, left, 0, (bottom - top) / side, top)
    return np.array(image.transform((side, side), Image.Transform.AFFINE, matrix, method))


def _drawn(picture: np.ndarray, covered: np.ndarray, inside: np.ndarray) -> np.ndarray:
    tile = picture.astype(np.float64)
    for mask, colour in ((covered & ~inside, RED), (inside & ~covered, BLUE)):
        tile[mask] = (1 - TINT) * tile[mask] + TINT * np.array(colour)
    tile[covered & ~binary_erosion(covered)] = GREEN
    return np.rint(tile).astype(np.uint8)


def _labelled(tile: np.ndarray, text: str, side: int) -> np.ndarray:
    """The tile with a line of text in its corner, white on a dark edge."""
    image = Image.fromarray(tile)
    font = ImageFont.load_default(max(10, side // 24))
    ImageDraw.Draw(image).text((5, 4), text, (255, 255, 255), font, stroke_width=2, stroke_fill=(0, 0, 0))
    return np.array(image)
