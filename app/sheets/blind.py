"""Blind sheets: in each view the truth, then A and B, whose names a key of its own has.

Views are of held-out frames: the whole person and close-ups of its limbs before the body's cameras, and whole pictures of the face's.
All three are drawn in the photograph's own pixels, then enlarged alike: nobody shows what the camera could not resolve.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from avatarrex_studio.sheets.captured import (
    Box,
    CapturedScene,
    drawer_artist,
    framed,
    in_own_pixels,
    mesh_artist,
    person_box,
    photograph,
)
from avatarrex_studio.sheets.pages import Artist
from avatarrex_studio.sheets.paper import Tile, enlarged, laid_out, over, sheet_width
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.readers.rigs import Capture, Rig, open_capture
from avatarrex.capture.readers.splits import with_validation
from avatarrex.errors import check
from avatarrex.files.gate import written
from avatarrex.metrics.drawing import AvatarDrawer
from avatarrex.metrics.evaluate import TEST, split_of
from avatarrex.metrics.own_training import as_trained
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.training.core.exposure import one_exposure

FORMAT = 1
TILE, ROWS = 460, 3
"""Pixels of a picture's side, and views on a page."""
LIMBS = (
    "head", "left_wrist", "right_wrist", "left_elbow", "right_elbow", "left_shoulder", "right_shoulder", "spine3",
    "pelvis", "left_knee", "right_knee", "left_ankle", "right_ankle",
)  # fmt: skip
"""Joints in the middle of close-ups."""
CLOSE = 0.5
"""Metres that a close-up's side spans at its joint."""
SAMPLES = 2
"""Samples along each side of an avatar's pixel; a mesh has as many."""
AVATAR, MESH, OTHER = "avatar", "fitted mesh", "other avatar"


@dataclass(frozen=True)
class BlindView:
    """One view of the trial."""

    rig: str
    view: int
    frame: int
    limb: str
    """The joint of a close-up; nothing where the whole person, or the face's whole picture, is shown."""
    first: bool
    """Whether the avatar is A."""


@dataclass(frozen=True)
class Trial:
    """What is compared with what, and the seed of everything random."""

    avatar: str
    capture: str
    other: str | None
    seed: int
    count: int
    swapped: bool
    exposure: str | None = None
    """The rig in whose exposure all is compared: an avatar has one, that of its body's pictures."""

    def draw(self, out: Path) -> dict[str, Any]:
        """Write `page_01.png` … into `out`; returns the key. Raises `InputError`."""
        avatar = load_avatar(self.avatar)
        capture, own = as_trained(
            avatar, self.avatar, with_validation(open_capture(self.capture, template=avatar.person.name))
        )
        if self.exposure:
            capture = one_exposure(capture, self.exposure, avatar.person if own else capture.person)
        views = chosen_views(capture, self.seed, self.count)
        rival = OTHER if self.other else MESH
        rows: list[list[list[Tile]]] = []
        pairs = {name: self._pair(capture, capture.rigs[name], avatar, own) for name in {view.rig for view in views}}
        for number, view in enumerate(tqdm(views, desc="judge", unit="view"), 1):
            rows.append([tiles(number, scene_of(capture, view), pairs[view.rig], view.first != self.swapped)])
        for start in range(0, len(rows), ROWS):
            page = start // ROWS + 1
            sheet = laid_out(f"Page {page}", "truth · A · B", rows[start : start + ROWS], sheet_width(1, 3, TILE))
            with written(out / f"page_{page:02}.png") as temporary:
                sheet.save(temporary, format="PNG")
        return {
            "format": FORMAT, "avatar": self.avatar, "capture": self.capture, "other": self.other, "seed": self.seed,
            "swapped": self.swapped, "exposed_as": self.exposure,
            "views": [self._named(k, view, capture.rigs[view.rig], rival) for k, view in enumerate(views, 1)],
        }  # fmt: skip

    def _pair(self, capture: Capture, rig: Rig, avatar: Avatar, own: bool) -> tuple[Artist, Artist]:
        """The avatar and its rival, which has the texture of this rig's pictures where it is the mesh, as fine as they resolve."""
        person = avatar.person if own else capture.person
        first = drawer_artist(AVATAR, AvatarDrawer(avatar, SAMPLES))
        if not self.other:
            return framed(first), framed(mesh_artist(capture, rig, person))
        return framed(first), framed(drawer_artist(OTHER, AvatarDrawer(load_avatar(self.other), SAMPLES)))

    def _named(self, number: int, view: BlindView, rig: Rig, rival: str) -> dict[str, Any]:
        """A line of the key."""
        names = (AVATAR, rival) if view.first != self.swapped else (rival, AVATAR)
        return {
            "number": number, "page": (number - 1) // ROWS + 1, "rig": view.rig, "camera": rig.views[view.view].name,
            "frame": view.frame, "limb": view.limb, "split": split_of(rig, view.view, view.frame), "A": names[0], "B": names[1],
        }  # fmt: skip


def chosen_views(capture: Capture, seed: int, count: int) -> list[BlindView]:
    """Of each kind as many as of the others, by turns; no picture twice while there are others. Raises `InputError` without a test."""
    random = np.random.default_rng(seed)
    pictures = {name: _shuffled(_test_pictures(rig), random) for name, rig in capture.rigs.items()}
    kinds = [(name, close) for name in pictures for close in ((False, True) if name == "body" else (False,))]
    for name, found in pictures.items():
        check(found, capture.path, f"{name} rig", "pictures that were held out", "none")
    avatar_first = random.permutation(count) % 2 == 0
    views = []
    for number in range(count):
        name, close = kinds[number % len(kinds)]
        view, frame = pictures[name][number % len(pictures[name])]
        limb = str(random.choice(LIMBS)) if close else ""
        views.append(BlindView(name, view, frame, limb, bool(avatar_first[number])))
    return views


def scene_of(capture: Capture, view: BlindView) -> CapturedScene:
    """The view in the photograph's own pixels. Raises `InputError` where its picture cannot be decoded."""
    rig = capture.rigs[view.rig]
    box = person_box(capture, rig, view.view, view.frame)
    if view.limb:
        box = _limb_box(capture, rig, view) or box
    return in_own_pixels(rig, view.view, view.frame, box)


def tiles(number: int, scene: CapturedScene, pair: Sequence[Artist], avatar_first: bool) -> list[Tile]:
    """Truth, A and B, enlarged alike; their labels say no more than that."""
    drawn: Mapping[str, Artist] = dict(
        zip(("truth", "A", "B"), (photograph(), *(pair if avatar_first else pair[::-1])))
    )
    return [Tile(enlarged(over(artist.draw(scene)), TILE), f"{number}: {name}") for name, artist in drawn.items()]


def _limb_box(capture: Capture, rig: Rig, view: BlindView) -> Box | None:
    """The square of `CLOSE` metres about the joint; None where it is not in the picture."""
    camera = rig.views[view.view].camera
    joint = template_surface(capture.person, rig.signals[view.frame])[1][JOINT_NAMES.index(view.limb)]
    (pixel,), (depth,) = camera.pixels(joint[None])
    half = 0.5 * CLOSE * camera.intrinsics[0, 0] / max(float(depth), 1e-6)
    inside = depth > 0 and (pixel > 0).all() and (pixel < [camera.width, camera.height]).all()
    return (pixel[0] - half, pixel[1] - half, pixel[0] + half, pixel[1] + half) if inside else None


def _test_pictures(rig: Rig) -> list[tuple[int, int]]:
    """(view, frame) of held-out frames that are there, by all cameras; of held-out cameras where no frame is."""
    every = ((view, frame) for frame in range(rig.frames) for view in range(len(rig.views)))
    test = [pair for pair in every if rig.available(*pair) and split_of(rig, *pair) in TEST]
    return [pair for pair in test if pair[1] in rig.held_out_frames] or test


def _shuffled(pictures: list[tuple[int, int]], random: np.random.Generator) -> list[tuple[int, int]]:
    return [pictures[place] for place in random.permutation(len(pictures))]
