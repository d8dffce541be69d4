"""Where does the squared error of pictures lie that no training saw, and how much more of it is there from cameras that were held out?

Inside the matte, of the avatar beside the textured meshes that are fitted to the same mattes: where nothing is drawn (missing), at
the rim of the matte, and farther inside. Mean squared errors add up over these places, decibels do not: of two subjects that gain the
same error, the better one loses more decibels. Letters: h w pixels.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt
from tqdm import tqdm

from avatarrex.avatar_file import load_avatar
from avatarrex.capture.readers.choice import held_out
from avatarrex.capture.readers.rigs import Rig, open_capture
from avatarrex.capture.readers.splits import with_validation
from avatarrex.errors import check
from avatarrex.files.json_text import write_json
from avatarrex.metrics.baselines import fitted_meshes
from avatarrex.metrics.drawing import AvatarDrawer, Drawer, Drawing, Truth
from avatarrex.metrics.evaluate import captured, observations, split_of
from avatarrex.metrics.own_training import as_trained
from avatarrex.metrics.table import printed

RIM = 3
"""Pixels from the nearest one outside the matte up to which a pixel is at the rim."""
PLACES = ("missing", "rim", "inside")
SPLITS = ("held-out pose", "held-out both")
Errors = dict[str, dict[str, dict[str, float]]]
"""By split and subject: the mean squared error of each place per pixel of the matte, their `sum`, and how many pictures."""


def places(covered: Bool[np.ndarray, "h w"], matte: Bool[np.ndarray, "h w"]) -> dict[str, Bool[np.ndarray, "h w"]]:
    """The pixels of a matte by `PLACES`; `covered`: where the subject is drawn."""
    rim = distance_transform_edt(np.pad(matte, 1))[1:-1, 1:-1] <= RIM
    drawn = matte & covered
    return {"missing": matte & ~covered, "rim": drawn & rim, "inside": drawn & ~rim}


def squared_errors(drawing: Drawing, truth: Truth) -> Float[np.ndarray, " 4"]:
    """Sums over the three channels' mean of a picture, by `PLACES`; the last is the number of the matte's pixels."""
    matte, covered = truth.matte.numpy() >= 0.5, drawing.image[..., 3].numpy() >= 0.5
    error = np.square(drawing.image[..., :3].double().clamp(0, 1).numpy() - truth.image.double().numpy()).mean(-1)
    return np.array([*(error[where].sum() for where in places(covered, matte).values()), matte.sum()])


def errors(rig: Rig, drawers: Sequence[Drawer]) -> Errors:
    """Of every picture of held-out frames. Raises `InputError` where there is none."""
    pairs = [(f, v) for f in sorted(rig.held_out_frames) for v in range(len(rig.views)) if rig.available(v, f)]
    check(pairs, rig.name, "", "pictures of held-out frames", "none")
    found: dict[str, dict[str, list[np.ndarray]]] = {}
    for frame, view in tqdm(pairs, unit="picture"):
        camera, signals = rig.views[view].camera, rig.signals[frame]
        truth = captured(rig, view, frame, camera)
        of_split = found.setdefault(split_of(rig, view, frame), {})
        for drawer in drawers:
            of_split.setdefault(drawer.name, []).append(squared_errors(drawer.draw(signals, camera), truth))
    return {split: {name: _means(rows) for name, rows in named.items()} for split, named in found.items()}


def _means(rows: list[np.ndarray]) -> dict[str, float]:
    *summed, pixels = np.sum(rows, 0).tolist()
    by_place = {place: value / max(pixels, 1) for place, value in zip(PLACES, summed)}
    return {**by_place, "sum": sum(by_place.values()), "pictures": len(rows)}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of whom, against what."""
    parser.add_argument("avatar", help="name, folder or .avatar file")
    parser.add_argument("capture", help="a folder or .zip")
    parser.add_argument("--rig", choices=("body", "face"), default="body")
    whole = "instead of those of the avatar's training"
    parser.add_argument("--held-out-frames", metavar="A:B:S", help=f"frames that were not trained on, {whole}")
    parser.add_argument("--held-out-views", metavar="NAMES", help=f"cameras that were not trained on, {whole}")
    parser.add_argument("--json", metavar="FILE.json")


def run(options: argparse.Namespace) -> None:
    """Measure and print. Raises `InputError` for a capture without the rig or without held-out frames."""
    avatar = load_avatar(options.avatar)
    whole = with_validation(open_capture(options.capture, template=avatar.person.name))
    capture, own = as_trained(avatar, options.avatar, whole)
    check(options.rig in capture.rigs, options.capture, "", f"a {options.rig} rig", ", ".join(capture.rigs))
    rig = held_out(capture.rigs[options.rig], options.held_out_frames, options.held_out_views)
    capture = replace(capture, rigs={**capture.rigs, options.rig: rig})
    person = avatar.person if own else capture.person
    found = errors(rig, [AvatarDrawer(avatar), *fitted_meshes(capture, person, list(observations(rig)))])
    _print(found)
    if options.json:
        told = {"avatar": options.avatar, "capture": options.capture, "rig": options.rig, "rim_pixels": RIM}
        write_json(options.json, {**told, "mean_squared_error": found})


def _print(found: Errors) -> None:
    row = printed("mean squared error × 10⁴".ljust(42), "pictures", *PLACES, "sum")
    for split, by_subject in found.items():
        for name, values in by_subject.items():
            shown = (f"{1e4 * values[key]:.1f}" for key in (*PLACES, "sum"))
            row(f"{split}: {name}", int(values["pictures"]), *shown)
    if len(found) < 2:
        return
    for name, values in found[SPLITS[0]].items():
        more = (f"{1e4 * (found[SPLITS[1]][name][key] - values[key]):+.1f}" for key in (*PLACES, "sum"))
        row(f"more from held-out cameras: {name}", "", *more)
