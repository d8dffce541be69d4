"""Golden pictures of the default avatar, 96×96, one sentence each; compared on Mesa llvmpipe, whose rays are the same everywhere.

A difference in the last bits of a network moves few pixels by few levels; half a pixel of shift, a mirror or a changed
light moves the whole person. On failure `out/goldens/NAME.png` shows golden, picture and eight times their difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.files.images import composite, write_png
from avatarrex.frame import Frame
from avatarrex.gl.context import NoContext, gl_context, renderer_name
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.library import named_expression, named_hand, named_pose
from avatarrex.templates.posed import pose_person

HERE, FAILED = Path(__file__).parent, Path(__file__).parents[2] / "out" / "goldens"
SIZE = 96
BACKGROUND = (0.3, 0.45, 0.6, 1.0)
"""Blue-grey: neither skin, shirt, trousers nor shoes."""
MEAN = 0.5
"""Levels of 255, mean over the person's pixels. The torch ray caster differs by 0.06 to 0.10, light from the other side by 0.86
and more, half a pixel by 5 and more; one thread or two makes no difference."""
MANY = (24, 0.005)
"""At most this share of the person's pixels may differ by more than so many levels: silhouettes flip one at a time."""


@dataclass(frozen=True)
class Golden:
    """A picture: what is posed and from where it is seen."""

    sentence: str
    pose: str
    view: tuple[float, float, float, float]
    """Azimuth, elevation and angle of view in degrees, distance in metres."""
    target: str | tuple[float, float, float] = (0.0, -0.05, 0.0)
    """World metres, or the joint that is looked at."""
    hand: str = "relaxed"
    expression: str = "neutral"

    def signals(self) -> Signals:
        """What drives the avatar."""
        hands = {f"{side}_hand_pose": named_hand(self.hand, side) for side in ("left", "right")}
        expression = named_expression(self.expression)
        return Signals.rest().replace(body_pose=named_pose(self.pose), expression=expression, **hands)

    def camera(self, avatar: Avatar) -> Camera:
        """Through which it is seen."""
        azimuth, elevation, fov, distance = self.view
        target = self.target
        if isinstance(target, str):
            joints = pose_person(avatar.person, self.signals(), Counters(), None).body.joints
            x, y, z = joints[JOINT_NAMES.index(target)].tolist()
            target = (x, y, z)
        return Camera.orbit(azimuth, elevation, distance, fov, target, SIZE, SIZE)


GOLDENS = {
    "stand_front": Golden(
        "You should see a whole young man from the front: brown hair, white shirt with dark stripes and a round print, blue "
        "jeans, red and white shoes, arms hanging a little off his sides.",
        "stand", (0, 0, 40, 2.75)),
    "stand_back": Golden(
        "You should see the same man from behind: no face, a red 7 instead of the print, the stripes go on over his back.",
        "stand", (180, 0, 40, 2.75)),
    "smile": Golden(
        "You should see his face filling the picture: two open eyes with brows, a nose, a closed smile with raised corners.",
        "stand", (0, 0, 40, 0.45), target=(0.0, 0.72, 0.03), expression="smile"),
    "fist": Golden(
        "You should see his left fist from below, the forearm coming from the left: four fingers rolled in, the thumb across them.",
        "tpose", (0, -60, 30, 0.35), target="left_middle1", hand="fist"),
    "squat": Golden(
        "You should see him squat, turned to the right of the picture: knees bent sharply, both arms stretched forwards, shirt and "
        "trousers whole at hips and shoulders.",
        "squat", (-40, 5, 40, 2.2), target=(0.08, 0.11, 0.22)),
}  # fmt: skip


@pytest.fixture(scope="module")
def mesa() -> None:
    """Skips where the rays are not llvmpipe's."""
    try:
        name = renderer_name(gl_context())
    except NoContext as error:
        pytest.skip(f"goldens are compared on Mesa llvmpipe; here is no OpenGL: {error}")
    if "llvmpipe" not in name:
        pytest.skip(f"goldens are compared on Mesa llvmpipe; here is {name}")


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return load_avatar("default")


@pytest.fixture(scope="module")
def frames() -> dict[str, Frame]:
    """The last frame, for the stages that need not run again."""
    return {}


def picture(avatar: Avatar, golden: Golden, frames: dict[str, Frame]) -> np.ndarray:
    """(h, w, 3) bytes of a golden as it is rendered now."""
    frames["last"] = render_frame(avatar, golden.signals(), golden.camera(avatar), None, frames.get("last"))
    return composite(frames["last"].image, BACKGROUND)[..., :3]


def opaque(image: np.ndarray) -> np.ndarray:
    """(h, w, 4) bytes of (h, w, 3)."""
    return np.concatenate([image, np.full_like(image[..., :1], 255)], -1)


def compare(golden: np.ndarray, now: np.ndarray) -> tuple[float, float]:
    """Mean difference over the person's pixels, in levels, and the share of them that differs by more than `MANY[0]`."""
    difference = np.abs(golden.astype(float) - now.astype(float)).max(-1)
    person = ((golden != golden[0, 0]) | (now != golden[0, 0])).any(-1)
    return float(difference[person].mean()), float((difference[person] > MANY[0]).mean())


def same(golden: np.ndarray, now: np.ndarray) -> bool:
    """Whether two pictures are the same within the tolerances."""
    mean, many = compare(golden, now)
    return mean <= MEAN and many <= MANY[1]


def stored(name: str) -> np.ndarray:
    """The golden as it lies beside this file; there must be one."""
    path = HERE / f"{name}.png"
    assert path.is_file(), (
        f"{path.name} is missing: `make goldens` writes it, then look at it. {GOLDENS[name].sentence}"
    )
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


@pytest.mark.slow
@pytest.mark.usefixtures("mesa")
@pytest.mark.parametrize("name", GOLDENS)
def test_golden(name, avatar, frames, request):
    now = picture(avatar, GOLDENS[name], frames)
    if request.config.getoption("--regenerate-goldens", default=False):
        write_png(HERE / f"{name}.png", opaque(now), {"Description": GOLDENS[name].sentence})
        return
    golden = stored(name)
    if not same(golden, now):
        difference = np.clip(8 * np.abs(golden.astype(int) - now), 0, 255).astype(np.uint8)
        write_png(FAILED / f"{name}.png", opaque(np.concatenate([golden, now, difference], 1)))
        mean, many = compare(golden, now)
        pytest.fail(f"{name}: {mean:.2f} levels, {100 * many:.1f} % of the person; see {FAILED}/{name}.png. "
                    f"{GOLDENS[name].sentence}")  # fmt: skip


def test_no_golden_without_its_sentence():
    """A file that no test compares is not a golden."""
    assert {path.stem for path in HERE.glob("*.png")} == set(GOLDENS)
    assert all(golden.sentence.startswith("You should see") for golden in GOLDENS.values())


def half_a_pixel(image: np.ndarray, axis: int) -> np.ndarray:
    """The picture shifted by half a pixel, as antialiasing would draw it."""
    moved = np.roll(image, 1, axis).astype(float)
    return np.rint((image + moved) / 2).astype(np.uint8)


def lit_from_the_other_side(image: np.ndarray) -> np.ndarray:
    """5 % brighter on one side and darker on the other, the silhouette as it is."""
    ramp = np.linspace(0.95, 1.05, image.shape[1])[None, :, None]
    person = (image != image[0, 0]).any(-1, keepdims=True)
    return np.where(person, np.clip(image * ramp, 0, 255), image).astype(np.uint8)


MUTANTS = {
    "half a pixel right": lambda image: half_a_pixel(image, 1),
    "half a pixel down": lambda image: half_a_pixel(image, 0),
    "mirrored": lambda image: image[:, ::-1],
    "red and blue exchanged": lambda image: image[..., ::-1],
    "lit from the other side": lit_from_the_other_side,
    "3 % darker": lambda image: np.where((image != image[0, 0]).any(-1, keepdims=True), 0.97 * image, image).astype(np.uint8),
}  # fmt: skip


@pytest.mark.parametrize("mutant", MUTANTS)
@pytest.mark.parametrize("name", GOLDENS)
def test_the_comparison_rejects(name, mutant):
    golden = stored(name)
    assert same(golden, golden)
    assert not same(golden, MUTANTS[mutant](golden)), compare(golden, MUTANTS[mutant](golden))
