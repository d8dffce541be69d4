"""What the contact sheets show: poses, cameras and their order on the page; every subject of a page in the same views.

A page is rows of groups of orders: who draws (an index into the artists) which scene. Degrees and metres, world space;
sizes in pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from avatarrex_studio.engine.framing import EVERY, Outline, framed
from avatarrex_studio.session.evaluation import motion_over
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.state import OrbitView
from avatarrex_studio.session.timeline import BODY
from avatarrex_studio.sheets.order import COLUMNS
from avatarrex_studio.sheets.paper import Tile, enlarged, over, sheet_width, tile_width
from scipy.spatial.transform import Rotation
from torch import Tensor

from avatarrex.camera import Camera
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.signals.library import named_expression, named_hand, named_pose
from avatarrex.templates.person import Person

WIDTH, NARROW = 2000, 1600
"""Pixels of a sheet: full width, and where four tiles in a row show enough."""
YAWS = {"front": 0.0, "left side": 90.0, "back": 180.0, "right side": 270.0}
EXTREME = {"arms_up": 25.0, "squat": 40.0, "run": 60.0, "crossed_arms": 20.0, "kneel": 50.0, "sit_floor": 40.0}
"""Of the library's poses, those with the largest joint rotations (squat, run, crossed arms, kneel) and those that stretch
armpits and hips the other way, each with the azimuth that shows it."""
FACES: dict[str, str | dict[str, float]] = {
    "neutral": "neutral",
    "smile": "smile",
    "jaw open": "jaw_open",
    "blink": "blink",
    "brows up": {"browInnerUp": 1.0, "browOuterUpLeft": 1.0, "browOuterUpRight": 1.0},
    "frown": {"browDownLeft": 1.0, "browDownRight": 1.0, "mouthFrownLeft": 0.9, "mouthFrownRight": 0.9},
    "pucker": "kiss",
    "wink, half a smile": "wink",
}
"""A name of the library, or coefficients."""
TURNS = {"front": 0.0, "three-quarter": 40.0}
HAND_POSES = ("relaxed", "fist", "point", "pinch", "spread", "victory")
SIDES = {"left, palm": -38.0, "right, back": 38.0}
"""Elevation of the camera before hands that are held out, palms down."""
PERSON_FOV, CLOSE_FOV = 22.0, 16.0
HEAD = ("head", "jaw", "left_eye", "right_eye")
"""Joints whose skin is framed in a face's close-up."""
HAIR = 1.14
"""How much further back the camera is than the bare head needs."""
NAILS = 1.08
"""The same for hands: a few points of each are framed."""
FEWEST = 4
"""Frames that fill the width; a sheet of fewer is narrower."""
Item = TypeVar("Item")


@dataclass(frozen=True)
class Scene:
    """One picture, whoever draws it."""

    signals: Signals
    camera: Camera
    label: str
    rig: str = "body"
    """`face` where the picture is a face's close-up."""


Group = list[tuple[int, Scene]]
"""Pictures side by side, and who draws each."""


@dataclass(frozen=True)
class Page:
    """A sheet to be drawn."""

    heading: str
    rows: list[list[Group]]
    width: int = WIDTH
    tile: int | None = None
    """Pixels to a side to which square pictures are enlarged; None where they are shown as drawn."""

    @property
    def pictures(self) -> int:
        """How many are to be drawn."""
        return sum(len(group) for row in self.rows for group in row)


@dataclass(frozen=True)
class Artist:
    """Who draws one of the subjects."""

    name: str
    draw: Callable[[Scene], np.ndarray]
    """Premultiplied RGBA (h, w, 4) in [0, 1]."""


def drawn(page: Page, artists: Sequence[Artist], done: Callable[[], object] = lambda: None) -> list[list[list[Tile]]]:
    """The tiles of `page`, one after the other; `done` after each."""

    def tile(who: int, scene: Scene) -> Tile:
        picture = over(artists[who].draw(scene))
        picture = picture if page.tile is None else enlarged(picture, page.tile)
        done()
        return Tile(picture, scene.label, artists[who].name if len(artists) > 1 else "")

    return [[[tile(*order) for order in group] for group in row] for row in page.rows]


def posed(name: str = "stand", hands: str = "relaxed") -> Signals:
    """A named pose with named hands; standing at ease by default."""
    pair = {f"{side}_hand_pose": named_hand(hands, side) for side in ("left", "right")}
    return Signals.rest().replace(body_pose=named_pose(name), **pair)


def body_page(person: Person, artists: int) -> Page:
    """Four sides of the standing person, then the extreme poses."""
    outline = Outline(person.body)

    def row(orders: Sequence[tuple[str, Signals, float]], aspect: float, across: int) -> list[Group]:
        size = _size(across, artists, WIDTH, aspect)
        groups = []
        for label, signals, azimuth in orders:
            view = framed(OrbitView(azimuth=azimuth, elevation=4, fov=PERSON_FOV), outline.points(signals), size)
            groups.append(_by_each([Scene(signals, view.camera(*size), label)], artists))
        return groups

    first = [(label, posed(), azimuth) for label, azimuth in YAWS.items()]
    rest = [(name.replace("_", " "), posed(name), azimuth) for name, azimuth in EXTREME.items()]
    if artists == 1:
        return Page("Body", [row(first + rest[:1], 1.45, 5), row(rest[1:], 1.25, 5)])
    return Page("Body", [row(first, 2.0, 4), row(rest[:3], 1.35, 3), row(rest[3:], 1.2, 3)])


def face_page(person: Person, artists: int) -> Page:
    """Two expressions to a row, each from the front and from three quarters."""
    width = NARROW if artists == 1 else WIDTH
    size = _size(2, 2 * artists, width, 1.16)
    points = _head(person, posed())
    cameras = {}
    for turn, azimuth in TURNS.items():
        view = framed(OrbitView(azimuth=azimuth, elevation=2, fov=CLOSE_FOV), points, size)
        cameras[turn] = replace(view, distance=HAIR * view.distance).camera(*size)
    groups = []
    for label, what in FACES.items():
        signals = posed().replace(expression=_expression(what))
        labels = [label, *list(TURNS)[1:]]
        scenes = [Scene(signals, camera, words, "face") for words, camera in zip(labels, cameras.values())]
        groups.append(_by_each(scenes, artists))
    return Page("Face", _rows(groups, 2), width)


def hands_page(person: Person, artists: int) -> Page:
    """Both hands of each pose, held out: the left from the palm's side, the right from the back; all at one scale."""
    across = 2 if artists == 1 else 1
    size = _size(across, 2 * artists, NARROW, 0.74)
    poses = [posed("tpose", name) for name in HAND_POSES]
    cameras: list[list[Camera]] = []
    for column, elevation in enumerate(SIDES.values()):
        view = OrbitView(elevation=elevation, fov=CLOSE_FOV)
        views = [framed(view, _hand(person, signals, column), size) for signals in poses]
        distance = NAILS * max(view.distance for view in views)
        cameras.append([replace(view, distance=distance).camera(*size) for view in views])
    groups = []
    for name, signals, *pair in zip(HAND_POSES, poses, *cameras):
        scenes = [Scene(signals, camera, f"{name}: {words}") for words, camera in zip(SIDES, pair)]
        groups.append(_by_each(scenes, artists))
    return Page("Hands", _rows(groups, across), NARROW)


def motion_page(person: Person, artists: int, motion: Motion, frames: Sequence[int]) -> Page:
    """A row for each artist, a column for each frame, in bands of `COLUMNS`; one scale, going along over the ground."""
    frame_signals = [motion_over(posed(), motion, frame) for frame in frames]
    face = _is_face(motion)
    across = min(COLUMNS, len(frames))
    size = _size(max(across, FEWEST), 1, WIDTH, 1.2 if face else 1.8)
    steps = [np.array([s.translation[0], 0, s.translation[2]]) for s in frame_signals]
    outline = Outline(person.body)
    shown = [_head(person, s) if face else outline.points(s) for s in frame_signals]
    azimuth = 15.0 + _heading(frame_signals)
    view = OrbitView(azimuth=azimuth, elevation=4, fov=CLOSE_FOV if face else PERSON_FOV)
    view = framed(view, np.concatenate([points - step for points, step in zip(shown, steps)]), size)
    view = replace(view, distance=HAIR * view.distance) if face else view
    scenes = []
    for frame, signals, step in zip(frames, frame_signals, steps):
        camera = view.moved(step).camera(*size)
        scenes.append(Scene(signals, camera, f"frame {frame}", "face" if face else "body"))
    width = sheet_width(across, 1, size[0])
    bands = _rows(scenes, across)
    return Page("Motion", [[[(who, scene)] for scene in band] for band in bands for who in range(artists)], width)


def _by_each(scenes: Sequence[Scene], artists: int) -> Group:
    """Each scene by every artist, side by side."""
    return [(who, scene) for scene in scenes for who in range(artists)]


def _rows(items: list[Item], across: int) -> list[list[Item]]:
    return [items[k : k + across] for k in range(0, len(items), across)]


def _size(groups: int, tiles: int, width: int, aspect: float) -> tuple[int, int]:
    across = tile_width(groups, tiles, width)
    return across, round(aspect * across)


def _expression(what: str | dict[str, float]) -> np.ndarray:
    if isinstance(what, str):
        return named_expression(what)
    return np.array([what.get(name, 0.0) for name in EXPRESSION_NAMES])


def _hand(person: Person, signals: Signals, column: int) -> np.ndarray:
    """(p, 3) world metres: points of the left hand (0) or the right (1)."""
    return _points(person, signals, person.blend_weight[:, column])


def _head(person: Person, signals: Signals) -> np.ndarray:
    """(p, 3) world metres: points of the head."""
    return _points(person, signals, person.body.weights[:, [JOINT_NAMES.index(name) for name in HEAD]].sum(1))


def _points(person: Person, signals: Signals, weight: Tensor) -> np.ndarray:
    """(p, 3) world metres: of the outline's points those of a `weight` (v,) above a half."""
    own: np.ndarray = (weight[::EVERY] > 0.5).numpy()
    return np.asarray(Outline(person.body).points(signals)[own])


def _heading(frames: Sequence[Signals]) -> float:
    """Degrees by which the person faces away from +Z on average, about +Y."""
    forward = Rotation.from_rotvec(np.array([s.global_orient for s in frames])).apply([0, 0, 1]).mean(0)
    return float(np.degrees(np.arctan2(forward[0], forward[2])))


def _is_face(motion: Motion) -> bool:
    """Whether a motion drives the face and no limb, as face recordings do."""
    return bool({"lids", "upper face", "mouth"} & set(motion.parts)) and not set(BODY) & set(motion.parts)
