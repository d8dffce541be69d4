"""Where inside the matte does the squared error of pictures lie that no training saw, and how much do held-out cameras add to it?

Pictures of the body rig, of the frames that the avatar's training kept for the test, beside the fitted textured meshes. Each pixel of
a matte has one place: not covered (coverage below a half), at the rim (drawn, near the matte's outline), or inside. Squared errors
(sRGB from 0 to 1, mean of three channels) are summed over pictures and divided by all pixels of the mattes, so that those of the
places add up. Decibels do not: of two subjects whose squared error grows alike, the better one loses more decibels. Held-out cameras
look from other sides: what they add to a mesh's error is what to compare with. With `--limbs` the pixels are divided among limbs, too:
each belongs to that of the joint that lies nearest in the picture. Letters: h w pixels.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from tqdm import tqdm

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.readers.rigs import Rig, open_capture
from avatarrex.capture.readers.splits import with_validation
from avatarrex.errors import check
from avatarrex.files.json_text import write_json
from avatarrex.metrics.baselines import fitted_meshes
from avatarrex.metrics.drawing import AvatarDrawer, Drawer, Drawing, Truth
from avatarrex.metrics.evaluate import captured, observations, split_of
from avatarrex.metrics.own_training import as_trained
from avatarrex.metrics.table import printed
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person

RIM = 3
"""Pixels from the nearest one outside the matte up to which a pixel is at the rim."""
PLACES = ("not covered", "rim", "inside")
POSE, BOTH = "held-out pose", "held-out both"
LIMBS = {
    "head": ("neck", "head", "jaw", "eye"),
    "hands": ("wrist", "index", "middle", "pinky", "ring", "thumb"),
    "arms": ("shoulder", "elbow"),
    "legs": ("knee",),
    "feet": ("ankle", "foot"),
}
"""By what is in the names of their joints; the other joints are the `TORSO`'s."""
TORSO = "torso and hips"
Errors = dict[str, dict[str, dict[str, float]]]
"""By split and subject, or subject and limb: the squared error of each place per pixel of the mattes, and their `sum`."""


def places(coverage: Float[np.ndarray, "h w"], matte: Bool[np.ndarray, "h w"]) -> dict[str, Bool[np.ndarray, "h w"]]:
    """The pixels of a matte by `PLACES`; `coverage`: of the drawn subject, 0 to 1."""
    rim = distance_transform_edt(np.pad(matte, 1))[1:-1, 1:-1] <= RIM
    drawn = matte & (coverage >= 0.5)
    return dict(zip(PLACES, (matte & ~drawn, drawn & rim, drawn & ~rim)))


def limbs(person: Person, signals: Signals, camera: Camera) -> dict[str, Bool[np.ndarray, "h w"]]:
    """The pixels of each of `LIMBS` and of the `TORSO`: each is that of the joint nearest in the picture."""
    joints = template_surface(person, signals)[1]
    names = [
        next((limb for limb, parts in LIMBS.items() if any(part in name for part in parts)), TORSO)
        for name in person.body.joint_names
    ]
    row, column = np.indices((camera.height, camera.width)) + 0.5
    nearest = cKDTree(camera.pixels(joints, nearest=1e-3)[0]).query(np.stack([column, row], -1))[1]
    limb = np.array(names)[nearest]
    return {name: limb == name for name in (*LIMBS, TORSO)}


def squared_errors(
    drawing: Drawing, truth: Truth, among: Mapping[str, Bool[np.ndarray, "h w"]] = MappingProxyType({})
) -> dict[str, Float[np.ndarray, " 4"]]:
    """The summed squared error by `PLACES` and the number of the matte's pixels: of the whole picture, by the name "", and by the name of
    each mask of `among` of its pixels alone."""
    matte = truth.matte.numpy() >= 0.5
    error = np.square(drawing.image[..., :3].double().clamp(0, 1).numpy() - truth.image.double().numpy()).mean(-1)
    where = places(drawing.image[..., 3].numpy(), matte).values()
    masks = {"": matte, **among}
    return {
        name: np.array([*(error[pixels & mask].sum() for pixels in where), matte.sum()]) for name, mask in masks.items()
    }


def held_out_pictures(rig: Rig) -> list[tuple[int, int]]:
    """View and frame of each picture of held-out frames. Raises `InputError` where none was held out, or no camera was trained on."""
    pairs = [(v, f) for f in sorted(rig.held_out_frames) for v in range(len(rig.views)) if rig.available(v, f)]
    check(pairs, rig.name, "", "pictures of held-out frames", "none")
    check(len(rig.held_out_views) < len(rig.views), rig.name, "", "cameras that were trained on", "none")
    return pairs


def errors(rig: Rig, drawers: Sequence[Drawer], person: Person | None = None) -> Errors:
    """Of every picture of held-out frames; by `limbs` of a `person`, too. Raises `InputError` where there is none, or all their mattes
    are empty."""
    found: dict[str, dict[str, list[np.ndarray]]] = {}
    for view, frame in tqdm(held_out_pictures(rig), unit="picture"):
        camera, signals = rig.views[view].camera, rig.signals[frame]
        truth = captured(rig, view, frame, camera)
        of_split = found.setdefault(split_of(rig, view, frame), {})
        among = {} if person is None else {f", {limb}": mask for limb, mask in limbs(person, signals, camera).items()}
        for drawer in drawers:
            for limb, row in squared_errors(drawer.draw(signals, camera), truth, among).items():
                of_split.setdefault(drawer.name + limb, []).append(row)
    return {
        split: {name: _per_pixel(rig, np.sum(rows, 0).tolist()) for name, rows in found[split].items()}
        for split in (POSE, BOTH)
        if split in found
    }


def _per_pixel(rig: Rig, summed: list[float]) -> dict[str, float]:
    *of_places, pixels = summed
    check(pixels, rig.name, "", "mattes that are not empty", "none")
    by_place = {place: value / pixels for place, value in zip(PLACES, of_places)}
    return {**by_place, "sum": sum(by_place.values())}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of whom, against what."""
    parser.add_argument("avatar", help="name, folder or .avatar file")
    parser.add_argument("capture", help="a folder or .zip, which the avatar was trained on")
    parser.add_argument("--limbs", action="store_true", help="divide the error among limbs, too")
    parser.add_argument("--json", metavar="FILE.json")


def run(options: argparse.Namespace) -> None:
    """Measure and print. Raises `InputError` for a capture that the avatar was not trained on, or without such pictures."""
    avatar = load_avatar(options.avatar)
    whole = with_validation(open_capture(options.capture, template=avatar.person.name))
    capture, own = as_trained(avatar, options.avatar, whole)
    check(own, options.capture, "", f"the capture that {options.avatar} was trained on", "another one")
    check("body" in capture.rigs, options.capture, "", "a body rig", ", ".join(capture.rigs))
    rig = capture.rigs["body"]
    held_out_pictures(rig)  # refuses before minutes of fitting
    drawers: list[Drawer] = [AvatarDrawer(avatar), *fitted_meshes(capture, avatar.person, list(observations(rig)))]
    found = errors(rig, drawers, avatar.person if options.limbs else None)
    _print(found)
    if options.json:
        told = {"avatar": options.avatar, "capture": options.capture, "rim_pixels": RIM}
        write_json(options.json, {**told, "squared_error_per_pixel": found})


def _print(found: Errors) -> None:
    row = printed("squared error × 10⁴".ljust(60), *PLACES, "sum")
    for split, by_subject in found.items():
        for name, values in by_subject.items():
            row(f"{split}: {name}", *(f"{1e4 * value:.1f}" for value in values.values()))
    if BOTH not in found:
        return
    for name, values in found[POSE].items():
        more = (f"{1e4 * (found[BOTH][name][key] - value):+.1f}" for key, value in values.items())
        row(f"added by held-out cameras: {name}", *more)
