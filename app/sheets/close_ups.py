"""Close-ups of a capture's pictures where avatars fail: eyes, mouth, hairline, armpits and the like, each in the picture that shows it best.

A place is a spot of the skin: what is met first by who looks at a joint of the template at rest from a direction, in the template's own
size. So any person's template has it. Letters: v vertices, f faces. Metres, degrees.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from avatarrex_studio.sheets.captured import ACROSS, Box, in_own_pixels, shown_pictures
from avatarrex_studio.sheets.pages import WIDTH, Artist, Group, Page, Scene
from avatarrex_studio.sheets.paper import tile_width

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import compared_frames, template_surface
from avatarrex.capture.fit.overlay import cut
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.errors import check
from avatarrex.metrics.evaluate import split_of
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.person import Person, load_person

MOST_FRAMES = 64
"""Of each rig that are searched, evenly spread."""
FACING = 0.5
"""Cosine from which a place is seen: at most 60 degrees from the front."""
NEAR = 0.25
"""Of a close-up's side: triangles as near to the spot tell where it faces."""
HIDDEN = 0.01
"""Metres that something lies before the spot where it hides it."""
SIMILAR = 0.5
"""Of the best picture's resolution, which others have among which the most open mouth is chosen."""
LATTICE = 33
"""Pixels of the side of the close-up in which the spot is looked for; odd: it is in the middle of one."""


@dataclass(frozen=True)
class Spot:
    """Where the skin is met first by who looks at joints of the template at rest."""

    joints: tuple[str, ...]
    """Their middle is looked at."""
    azimuth: float = 0.0
    """Of who looks: 0 from the front, 90 from the person's left."""
    elevation: float = 0.0
    """Degrees above the horizon from which it is looked at."""
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Added to the middle that is looked at."""

    @property
    def mirrored(self) -> Spot:
        """The same on the person's right."""
        joints = tuple(name.replace("left_", "right_") for name in self.joints)
        return Spot(joints, -self.azimuth, self.elevation, (-self.shift[0], *self.shift[1:]))


@dataclass(frozen=True)
class Place:
    """What is shown."""

    side: float
    """Metres that a close-up spans."""
    spots: tuple[Spot, ...]
    """The one that is seen best is shown."""
    most_open: bool = False
    """Whether the most open mouth is looked for."""


def _either(side: float, spot: Spot) -> Place:
    """On the left or on the right."""
    return Place(side, (spot, spot.mirrored))


EYES = ("left_eye", "right_eye")
PLACES: Mapping[str, Place] = {
    "left eye": Place(0.08, (Spot(("left_eye",)),)),
    "right eye": Place(0.08, (Spot(("right_eye",)),)),
    "mouth": Place(0.1, (Spot(EYES, shift=(0, -0.065, 0)),), most_open=True),
    "ear": _either(0.12, Spot(EYES, 90, shift=(0, -0.015, -0.085))),
    "hairline": _either(0.14, Spot(EYES, 45, shift=(0, 0.05, 0))),
    "back of the head": Place(0.3, (Spot(EYES, 180),)),
    "armpit": _either(0.25, Spot(("left_shoulder",), 45, -60, shift=(0.03, 0, 0))),
    "inner elbow": _either(0.22, Spot(("left_elbow",))),
    "back of the hand": _either(0.22, Spot(("left_middle1",), 0, 90)),
    "palm": _either(0.22, Spot(("left_middle1",), 0, -90)),
    "crotch": Place(0.3, (Spot(("pelvis",), shift=(0, -0.08, 0)),)),
    "back of the knee": _either(0.25, Spot(("left_knee",), 180)),
    "foot": _either(0.25, Spot(("left_foot",), 0, 30)),
    "heel": _either(0.25, Spot(("left_ankle",), 180)),
    "sole": _either(0.25, Spot(("left_foot",), 0, -90)),
}
LIPS = (Spot(EYES, shift=(0, -0.055, 0)), Spot(EYES, shift=(0, -0.075, 0)))
"""How far they are apart tells how open the mouth is; a chin goes down with a jaw whose lips stay shut, too."""


@dataclass(frozen=True)
class Patch:
    """A spot of one person's skin."""

    corners: np.ndarray
    """(3,) vertices of its triangle,"""
    weights: np.ndarray
    """(3,) and its barycentrics there."""
    about: np.ndarray
    """(n, 3) vertices of triangles about it that face the same way at rest."""

    @staticmethod
    def of(person: Person, spot: Spot, near: float) -> Patch | None:
        """With what is `near` it; None where the template has no skin there."""
        body = load_person(person.name).body  # the shifts are of its size; a fitted person has the same mesh
        rest, faces = body.v_template.double().numpy(), body.faces.numpy()
        target = body.joint_template[[JOINT_NAMES.index(name) for name in spot.joints]].double().numpy().mean(0)
        camera = Camera.orbit(spot.azimuth, spot.elevation, 3.0, 0.1, target + spot.shift, 1, 1)
        face, weights, _ = (values[0, 0] for values in visible_faces(rest, faces, camera))
        if face < 0:
            return None
        corners = faces[face]
        far = np.linalg.norm(rest[faces].mean(1) - weights @ rest[corners], axis=1)
        along = _areas(rest, faces) @ camera.camera_from_world[2, :3]
        same = (far < near) & (along < 0)
        same[face] = True
        return Patch(corners, weights, faces[same])

    def point(self, vertices: np.ndarray) -> np.ndarray:
        """(3,) where it is on posed `vertices` (v, 3)."""
        return np.asarray(self.weights @ vertices[self.corners])

    def normal(self, vertices: np.ndarray) -> np.ndarray:
        """(3,) unit: where the skin about it faces."""
        mean = _areas(vertices, self.about).sum(0)
        return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-12))


@dataclass(frozen=True)
class CloseUp:
    """A place in a picture."""

    place: str
    rig: str
    view: int
    frame: int
    box: Box
    """Pixels of the picture; the spot is in its middle."""
    depth: float
    """Camera z of the spot, metres."""
    facing: float
    """Cosine between the skin's normal and the direction to the camera."""
    resolution: float
    """Pixels that a metre of the skin spans, foreshortened, times the part of the box that is in the picture."""

    def to_json(self, capture: Capture) -> dict[str, object]:
        """For `sheet.json`."""
        rig = capture.rigs[self.rig]
        degrees = round(float(np.degrees(np.arccos(min(self.facing, 1.0)))))
        where = {"rig": self.rig, "camera": rig.views[self.view].name, "frame": self.frame}
        return {"place": self.place, **where, "split": split_of(rig, self.view, self.frame), "degrees": degrees}


class Search:
    """Looks for the best close-ups of a person in a capture's pictures, held-out ones where there are any."""

    def __init__(self, capture: Capture, person: Person) -> None:
        self.capture, self.person = capture, person
        self.pictures = [(rig, *picture) for rig in capture.rigs.values() for picture in _some_pictures(rig)]
        self.surface = cache(self._surface)
        lips = [Patch.of(person, spot, 0.0) for spot in LIPS]
        self.lips = [patch for patch in lips if patch is not None]

    def best(self, name: str) -> CloseUp | None:
        """One of `PLACES` where it is seen at the highest resolution; None where no picture shows it."""
        place = PLACES[name]
        patches = [Patch.of(self.person, spot, NEAR * place.side) for spot in place.spots]
        found = [one for patch in patches if patch is not None for one in self._candidates(name, patch)]
        best = self._first_seen(sorted(found, key=lambda one: -one.resolution))
        if best is None or not place.most_open:
            return best
        similar = [one for one in found if one.resolution >= SIMILAR * best.resolution]
        return self._first_seen(sorted(similar, key=lambda one: (-self._opening(one), -one.resolution)))

    def _candidates(self, name: str, patch: Patch) -> Iterator[CloseUp]:
        """The close-ups in which the place faces the camera, hidden or not."""
        for rig, view, frame in self.pictures:
            vertices, camera = self.surface(rig.name, frame), rig.views[view].camera
            point, size = patch.point(vertices), np.array([camera.width, camera.height])
            to = camera.centre - point
            facing = float(patch.normal(vertices) @ to / np.linalg.norm(to))
            pixel, depth = camera.pixels(point)
            if facing < FACING or depth <= 0 or (pixel < 0).any() or (pixel > size).any():
                continue
            scale = float(camera.intrinsics[0, 0] / depth)
            low, high = (pixel + sign * 0.5 * PLACES[name].side * scale for sign in (-1, 1))
            inside = (np.minimum(high, size) - np.maximum(low, 0)).prod() / (high - low).prod()
            box = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
            yield CloseUp(name, rig.name, view, frame, box, float(depth), facing, float(facing * scale * inside))

    def _first_seen(self, found: Iterable[CloseUp]) -> CloseUp | None:
        """The first of which nothing hides the spot."""
        return next((one for one in found if self._depth(one) > one.depth - HIDDEN), None)

    def _depth(self, one: CloseUp) -> float:
        """Camera z of what is seen in the middle of the box, metres."""
        camera = cut(self.capture.rigs[one.rig].views[one.view].camera, one.box, LATTICE)
        faces = self.person.body.faces.numpy()
        depth = visible_faces(self.surface(one.rig, one.frame), faces, camera)[2]
        return float(depth[LATTICE // 2, LATTICE // 2])

    def _opening(self, one: CloseUp) -> float:
        """Metres between the lips; 0 where the template has none."""
        points = [patch.point(self.surface(one.rig, one.frame)) for patch in self.lips]
        return float(np.linalg.norm(points[0] - points[-1])) if points else 0.0

    def _surface(self, rig: str, frame: int) -> np.ndarray:
        """(v, 3) world metres."""
        return template_surface(self.person, self.capture.rigs[rig].signals[frame])[0]


def close_ups(capture: Capture, person: Person, wanted: bool = True) -> list[CloseUp]:
    """Of every one of `PLACES` that a picture shows, `person` being the capture's. Raises `InputError` where none is and one was `wanted`."""
    search = Search(capture, person)
    found = [one for one in map(search.best, PLACES) if one is not None]
    check(found or not wanted, capture.path, "close-ups", "a picture that shows one of " + ", ".join(PLACES), "none")
    return found


def close_page(capture: Capture, found: Sequence[CloseUp], artists: int) -> Page:
    """Each close-up by every artist, all drawn in the photograph's own pixels, then enlarged alike."""
    scenes: list[Scene] = []
    for one in found:
        scene = in_own_pixels(capture.rigs[one.rig], one.view, one.frame, one.box)
        scenes.append(replace(scene, label=one.place))
    groups: list[Group] = [[(who, scene) for who in range(artists)] for scene in scenes]
    rows = [groups[k : k + ACROSS] for k in range(0, len(groups), ACROSS)]
    return Page("Close-ups", rows, tile=tile_width(ACROSS, artists, WIDTH))


def by_rig(artists: Mapping[str, Artist]) -> Artist:
    """Who draws the pictures of each rig as that rig's artist does."""
    name = " / ".join(dict.fromkeys(artist.name for artist in artists.values()))
    return Artist(name, lambda scene: artists[scene.rig].draw(scene))


def _some_pictures(rig: Rig) -> list[tuple[int, int]]:
    """(view, frame) of the pictures that are shown, of at most `MOST_FRAMES` frames."""
    pictures = shown_pictures(rig)
    frames = sorted({frame for _, frame in pictures})
    some = {frames[place] for place in compared_frames(len(frames), MOST_FRAMES)}
    return [picture for picture in pictures if picture[1] in some]


def _areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(f, 3) normals of triangles, twice as long as they are large."""
    a, b, c = vertices[faces].swapaxes(0, 1)
    return np.cross(b - a, c - a)
