"""A picture of how a motion was read: frames of the file's own skeleton, and of the avatar in the same view.

A file without a skeleton of its own (SMPL-X, our JSON) shows ours. Metres, world space; sizes in pixels.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from avatarrex_studio.engine.framing import Outline, framed
from avatarrex_studio.session.state import OrbitView
from avatarrex_studio.sheets.pages import PERSON_FOV
from avatarrex_studio.sheets.paper import GROUND, Tile, laid_out, over, sheet_width
from PIL import Image, ImageDraw

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers import choice
from avatarrex.errors import InputError
from avatarrex.files.gate import written
from avatarrex.levels import LEVELS
from avatarrex.metrics.drawing import AvatarDrawer
from avatarrex.signals.driving import Signals
from avatarrex.signals.ground import floor_height
from avatarrex.signals.imported import ImportedMotion
from avatarrex.signals.rest_skeleton import rest_skeleton

FRAMES, MOST = 6, 12
"""How many are drawn, and may be."""
BESIDE = 3
"""Frames up to which file and avatar stand side by side, else one above the other."""
SIZE = (260, 400)
AZIMUTH = 25.0
"""Degrees: a view in which a foot, a hand and a face show where they point."""
LEFT, RIGHT, MIDDLE, FLOOR = (38, 110, 190), (200, 80, 40), (70, 72, 76), (200, 202, 206)
"""Colours of the person's left and right, of the rest, and of the floor's grid."""
FINE = 4
"""Samples along each side of a drawn pixel."""
TILE = 0.5
"""Metres between lines of the floor."""


def draw(imported: ImportedMotion, avatar: str, frames: str | None, out: Path) -> None:
    """Write the picture. Raises `InputError`."""
    count = len(imported.sequence)
    shown = (
        choice.frames(frames, count)
        if frames
        else tuple(k * count // min(FRAMES, count) for k in range(min(FRAMES, count)))
    )
    if len(shown) > MOST:
        raise InputError("--frames", "", f"at most {MOST} frames in a picture", f"{len(shown)}")
    person = load_avatar(avatar)
    outline, drawer = Outline(person.person.body), AvatarDrawer(person, 2, LEVELS["fast"])
    signals = [imported.sequence[k] for k in shown]
    step = [np.array([s.translation[0], 0.0, s.translation[2]]) for s in signals]
    points = np.concatenate([outline.points(s) - along for s, along in zip(signals, step)])
    view = replace(framed(OrbitView(azimuth=AZIMUTH, elevation=6, fov=PERSON_FOV), points, SIZE), azimuth=AZIMUTH)
    pairs = []
    for k, frame, along in zip(shown, signals, step):
        camera = view.moved(along).camera(*SIZE)
        whose = "the file" if imported.skeleton else "joints"
        bones = Tile(_skeleton(imported, k, frame, camera, along), f"frame {k}: {whose}")
        pairs.append([bones, Tile(over(drawer.draw(frame, camera).image.numpy()), f"frame {k}: the avatar")])
    note = "; ".join(imported.warnings) or "nothing looks wrong"
    if len(pairs) > BESIDE:
        rows, width = [[[pair[row]] for pair in pairs] for row in (0, 1)], sheet_width(len(pairs), 1, SIZE[0])
    else:
        rows, width = [pairs], sheet_width(len(pairs), 2, SIZE[0])
    sheet = laid_out(imported.sequence.name, note, rows, width)
    with written(out) as temporary:
        sheet.save(temporary, "PNG")


def _skeleton(imported: ImportedMotion, k: int, signals: Signals, camera: Camera, along: np.ndarray) -> np.ndarray:
    """(h, w, 3) bones in one frame, over the floor."""
    if imported.skeleton:
        places, parents = imported.skeleton.places[k], imported.skeleton.parents
        sides = [_side(name) for name in _ours(imported)]
    else:
        places = rest_skeleton().posed(signals.full_pose()[None])[1][0] + signals.translation
        parents = np.array(rest_skeleton().parents)
        sides = [_side_of(x) for x in rest_skeleton().joints[:, 0]]
    image = Image.new("RGB", (SIZE[0] * FINE, SIZE[1] * FINE), GROUND)
    pencil = ImageDraw.Draw(image)
    for start, end in _grid(along):
        pencil.line([_pixel(camera, start), _pixel(camera, end)], FLOOR, FINE)
    for child, parent in enumerate(parents):
        if parent >= 0:
            ends = [_pixel(camera, places[parent]), _pixel(camera, places[child])]
            pencil.line(ends, sides[child], 2 * FINE)
    for place, colour in zip(places, sides):
        x, y = _pixel(camera, place)
        pencil.ellipse((x - 2 * FINE, y - 2 * FINE, x + 2 * FINE, y + 2 * FINE), colour)
    return np.asarray(image.resize(SIZE, Image.Resampling.BOX))


def _ours(imported: ImportedMotion) -> list[str]:
    """For each joint of the file the one of ours that it is, or that the nearest above it is."""
    assert imported.skeleton is not None
    by_name = {theirs: ours for ours, theirs in imported.skeleton.mapped.items()}
    names: list[str] = []
    for name, parent in zip(imported.skeleton.names, imported.skeleton.parents):
        names.append(by_name.get(name, names[parent] if parent >= 0 else ""))
    return names


def _side(name: str) -> tuple[int, int, int]:
    return LEFT if name.startswith("left") else RIGHT if name.startswith("right") else MIDDLE


def _side_of(x: float) -> tuple[int, int, int]:
    return LEFT if x > 0.02 else RIGHT if x < -0.02 else MIDDLE


def _grid(along: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Lines of the floor about the person, world metres."""
    height, reach = floor_height(), 2 * TILE
    middle = np.round(along / TILE) * TILE
    lines = []
    for offset in np.arange(-reach, reach + TILE / 2, TILE):
        for axis in (0, 2):
            start, end = middle.copy(), middle.copy()
            start[axis] += offset
            end[axis] += offset
            start[2 - axis] -= reach
            end[2 - axis] += reach
            start[1] = end[1] = height
            lines.append((start, end))
    return lines


def _pixel(camera: Camera, point: np.ndarray) -> tuple[float, float]:
    """Of the fine picture."""
    seen = camera.intrinsics @ (camera.camera_from_world[:3, :3] @ point + camera.camera_from_world[:3, 3])
    x, y = seen[:2] / max(seen[2], 1e-3) * FINE
    return float(x), float(y)
