"""Pages of a capture: its own pictures beside the avatar's, from the same cameras in the same poses, cut out about the person."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from avatarrex_studio.sheets.pages import WIDTH, Artist, Group, Page, Scene
from avatarrex_studio.sheets.paper import tile_width

from avatarrex.capture.fit.check import compared_frames, template_surface
from avatarrex.capture.fit.overlay import box_about, cut, resized
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.metrics.baselines import fitted_meshes
from avatarrex.metrics.drawing import Drawer
from avatarrex.metrics.evaluate import observations
from avatarrex.templates.person import Person

SHOWN, ACROSS = 8, 2
"""Pictures of a page, and groups in a row."""
Box = tuple[float, float, float, float]
"""Left, top, right, bottom of a part of a picture, pixels."""


@dataclass(frozen=True)
class CapturedScene(Scene):
    """One that was photographed."""

    picture: np.ndarray = field(default_factory=lambda: np.zeros((1, 1, 4)), compare=False)
    """Premultiplied RGBA (h, w, 4) in [0, 1], as the camera has it."""
    seen: np.ndarray = field(default_factory=lambda: np.zeros((1, 1), bool), compare=False)
    """(h, w) bool: inside the photograph; a square about a person may reach beyond its edge."""


def captured_page(capture: Capture, rig: Rig, artists: int) -> Page:
    """Held-out frames where there are any, from all sides; truth is the first of `artists`."""
    side = tile_width(ACROSS, artists, WIDTH)
    chosen = shown_pictures(rig)
    pictures = [chosen[place] for place in compared_frames(len(chosen), SHOWN)]
    scenes = [captured_scene(rig, *picture, person_box(capture, rig, *picture), side) for picture in pictures]
    groups: list[Group] = [[(who, scene) for who in range(artists)] for scene in scenes]
    rows = [groups[k : k + ACROSS] for k in range(0, len(groups), ACROSS)]
    return Page(f"{rig.name.capitalize()}, as captured", rows)


def shown_pictures(rig: Rig) -> list[tuple[int, int]]:
    """(view, frame) of held-out frames by all cameras; of all frames where none is held out."""
    every = ((view, frame) for frame in range(rig.frames) for view in range(len(rig.views)))
    pairs = [pair for pair in every if rig.available(*pair)]
    return [pair for pair in pairs if pair[1] in rig.held_out_frames] or pairs


def photograph() -> Artist:
    """Who shows what the camera saw."""

    def draw(scene: Scene) -> np.ndarray:
        assert isinstance(scene, CapturedScene)
        return scene.picture

    return Artist("ground truth", draw)


def mesh_artist(capture: Capture, rig: Rig, fitted: Person) -> Artist:
    """The textured mesh with the skin of `fitted` (or one fitted here), as fine as the rig's cameras resolve. Raises `InputError`."""
    drawer = fitted_meshes(capture, fitted, list(observations(rig)))[-1]
    return drawer_artist(drawer.name, drawer)


def drawer_artist(name: str, drawer: Drawer) -> Artist:
    """Who shows what a subject of `evaluate` draws."""
    return Artist(name, lambda scene: drawer.draw(scene.signals, scene.camera).image.numpy())


def framed(artist: Artist) -> Artist:
    """The artist without what lies beyond the photograph's edge."""

    def draw(scene: Scene) -> np.ndarray:
        assert isinstance(scene, CapturedScene)
        return np.asarray(artist.draw(scene) * scene.seen[..., None])

    return Artist(artist.name, draw)


def person_box(capture: Capture, rig: Rig, view: int, frame: int) -> Box:
    """The square about the person in a picture, pixels."""
    vertices = template_surface(capture.person, rig.signals[frame])[0]
    return box_about(rig.matte(view, frame), vertices, rig.views[view].camera)


def in_own_pixels(rig: Rig, view: int, frame: int, box: Box) -> CapturedScene:
    """The part `box` of a picture, its edges rounded, a pixel for each of the photograph's."""
    left, top, right, _ = (round(edge) for edge in box)
    side = right - left
    return captured_scene(rig, view, frame, (left, top, right, top + side), side)


def captured_scene(rig: Rig, view: int, frame: int, box: Box, side: int) -> CapturedScene:
    """The part `box` of a picture, `side` pixels square."""
    camera, matte = rig.views[view].camera, rig.matte(view, frame)
    inside = np.where(matte[..., None] > 0, rig.image(view, frame), 0) * (matte[..., None] / 255.0)
    colour, alpha = resized(np.rint(inside).astype(np.uint8), box, side), resized(matte, box, side)
    label = f"{rig.views[view].name}, frame {frame}" + (" (held out)" if frame in rig.held_out_frames else "")
    picture = np.dstack([np.minimum(colour, alpha[..., None]), alpha]) / 255.0  # a cubic rings beyond an edge
    seen = resized(np.full(matte.shape, 255, np.uint8), box, side) > 127
    return CapturedScene(rig.signals[frame], cut(camera, box, side), label, rig.name, picture, seen)
