"""How well are eyes, mouth and face drawn, and how far is the learnt surface off the face's mesh there?

Pictures of the face's rig, of frames that were held out: PSNR, SSIM and sharpness where a camera sees a region, of the avatar
beside the textured meshes that are fitted to the same mattes. Pictures are not cut: windows of SSIM reach into the skin around.
Closed eyes and mouths count, too. An avatar is drawn in the exposure of its body's pictures: where rigs differ, `--exposed-as`
makes them one; one of a face trained alone has the tone of its rig's own: `--gain` multiplies every drawn picture by what fits its
face best to the true one, channel by channel.
The surface: distances |s| of the avatar's face at points of the driven face mesh, where its front view shows them.
Letters: h w pixels, f faces, v vertices, p points.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Capture, Rig, open_capture
from avatarrex.capture.readers.splits import Splits, with_validation
from avatarrex.counters import Counters
from avatarrex.errors import check
from avatarrex.fields.orthographic import front_points
from avatarrex.files.json_text import write_json
from avatarrex.metrics.baselines import PosedMesh, fitted_meshes
from avatarrex.metrics.drawing import AvatarDrawer, Drawer
from avatarrex.metrics.evaluate import captured, observations
from avatarrex.metrics.image import Similarity, gradient_energy, psnr
from avatarrex.metrics.own_training import as_trained
from avatarrex.metrics.table import printed
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.mesh import within_reach
from avatarrex.templates.model import EYES, TEETH
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.posed import pose_person
from avatarrex.training.core.exposure import factors, one_exposure

REACH = 0.022
"""Metres about an eye's centre: the ball, both lids to their creases, and the corners."""
LIPS, LIDS = 0.008, 0.005
"""Metres at rest within which skin is a lip of what lips enclose, a lid of an eyeball."""
FACE = 0.99
"""ω from which a vertex is the face's."""
MEASURES = ("psnr", "ssim", "sharpness")
Masks = dict[str, Bool[np.ndarray, "h w"]]


class Regions:
    """Where cameras see the eyes, the mouth and the face of a person."""

    def __init__(self, person: Person) -> None:
        self._mesh = PosedMesh(person)
        self.faces = {name: chosen[self._mesh.faces].all(1) for name, chosen in _vertices(person).items()}

    def seen(self, signals: Signals, camera: Camera) -> Masks:
        """Of each region pixels whose centre's ray first meets it."""
        face = self._mesh.visible(signals, camera)[0]
        return {name: np.asarray((face >= 0) & chosen[face]) for name, chosen in self.faces.items()}


def _labelled(person: Person) -> Person:
    """With the template's lips and mouth, so that regions are the same for avatars of fits of before."""
    if person.fit is None or person.fit.labels_stay:
        return person
    return resize_person(load_person(person.name), replace(person.fit, labels_stay=True))


def _vertices(person: Person) -> dict[str, Bool[np.ndarray, " v"]]:
    """Vertices of the body by region."""
    person = _labelled(person)
    joints = person.body.joint_template.double().numpy()
    eyes = joints[[JOINT_NAMES.index(name) for name in EYES]]
    rest, face = person.body.v_template.double().numpy(), person.face
    near = np.linalg.norm(rest[:, None] - eyes[None], axis=-1).min(1) < REACH
    found = {"eyes": near}
    for name, chosen in (
        ("mouth", within_reach(face.v_template, face.mouth, LIPS)),
        ("face", face.blend_weight > FACE),
    ):
        found[name] = np.zeros(len(rest), bool)
        found[name][face.body_vertex_ids[chosen].numpy()] = True
    return found


@dataclass(frozen=True)
class Study:
    """Pictures (view, frame) of a rig to be measured."""

    rig: Rig
    pairs: list[tuple[int, int]]
    gain: bool = False
    """Whether drawn pictures are multiplied by what fits their face best."""

    def measure(self, person: Person, drawers: list[Drawer]) -> dict[str, dict[str, dict[str, float]]]:
        """By region and drawer means of `MEASURES` over the pictures in which the region is seen, and how many. Raises `InputError`
        where none is."""
        regions = Regions(person)
        found: dict[str, dict[str, list[list[float]]]] = {}
        for view, frame in tqdm(self.pairs, unit="picture"):
            camera, signals = self.rig.views[view].camera, self.rig.signals[frame]
            seen = {
                name: torch.from_numpy(mask)[None] for name, mask in regions.seen(signals, camera).items() if mask.any()
            }
            if not seen:
                continue
            truth = _batch(captured(self.rig, view, frame, camera).image)
            for drawer in drawers:
                drawn = _batch(drawer.draw(signals, camera).image[..., :3])
                if self.gain and "face" in seen:
                    drawn = (drawn * _gain(drawn, truth, seen["face"])).clamp(0, 1)
                for name, inside in seen.items():
                    found.setdefault(name, {}).setdefault(drawer.name, []).append(measured(drawn, truth, inside))
        check(found, self.rig.name, "", "pictures in which the face is seen", "none")
        return {
            region: {
                name: {**dict(zip(MEASURES, np.mean(rows, 0).tolist())), "pictures": len(rows)}
                for name, rows in by_drawer.items()
            }
            for region, by_drawer in found.items()
        }


def measured(render: Tensor, truth: Tensor, inside: Tensor) -> list[float]:
    """`MEASURES` of (1, 3, h, w) in the mask (1, h, w)."""
    similarity = Similarity.of(render, truth, levels=1).ssim(inside)
    sharpness = gradient_energy(render, inside) / gradient_energy(truth, inside)
    return [value.item() for value in (psnr(render, truth, inside), similarity, sharpness)]


def _gain(drawn: Tensor, truth: Tensor, inside: Tensor) -> Float[Tensor, "1 3 1 1"]:
    """Of (1, 3, h, w) by least squares in the mask (1, h, w)."""
    a, b = drawn[0][:, inside[0]], truth[0][:, inside[0]]
    return ((a * b).sum(1) / (a * a).sum(1).clamp_min(1e-12))[None, :, None, None]


def _batch(image: Tensor) -> Tensor:
    return image.permute(2, 0, 1)[None].clamp(0, 1).contiguous()


@torch.no_grad()
def surface_distances(avatar: Avatar, signals: list[Signals]) -> dict[str, dict[str, float]]:
    """By what the front view shows of the driven face mesh: mean |s| and median s in millimetres of the avatar's face there (s < 0: its
    surface lies before the mesh), and the number of points."""
    face, marked = avatar.face, _features(avatar.person)
    found: dict[str, list[Tensor]] = {}
    for one in tqdm(signals, unit="frame"):
        posed = pose_person(avatar.person, one, Counters(), None)
        mesh = posed.parts["face"].to(face.box_centre)
        planes = face.geometry_planes(face.driven(mesh, posed.coefficients["face"].float()))
        for name, chosen in marked.items():
            points = front_points(mesh, face.faces, chosen, face.box)
            found.setdefault(name, []).append(1e3 * face.sdf(planes, points))
    joined = {name: torch.cat(rows) for name, rows in found.items()}
    return {
        name: {"mean_abs_mm": sdf.abs().mean().item(), "median_mm": sdf.median().item(), "points": len(sdf)}
        for name, sdf in joined.items()
        if len(sdf)
    }


def _features(person: Person) -> dict[str, Bool[Tensor, " v"]]:
    """Vertices of the face mesh by feature; skin is what is the face's alone besides."""
    face = _labelled(person).face
    eyes, teeth, tongue = (face.model.of_groups(names) for names in (EYES, TEETH, ("tongue",)))
    outer = ~(eyes | face.mouth)
    lids, lips = (
        within_reach(face.v_template, inner, reach) & outer for inner, reach in ((eyes, LIDS), (face.mouth, LIPS))
    )
    skin = outer & ~lids & ~lips & (face.blend_weight > FACE)
    return {"eyeballs": eyes, "lids": lids, "lips": lips, "teeth": teeth, "tongue": tongue, "other skin": skin}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of whom, against what."""
    parser.add_argument("avatar", help="name, folder or .avatar file")
    parser.add_argument("capture", help="a folder or .zip with a face rig")
    parser.add_argument("--split", choices=("test", "validation"), default="test", help="frames that are measured")
    exposed = "pictures as the cameras of another rig would have taken them"
    parser.add_argument("--exposed-as", metavar="RIG", help=exposed)
    parser.add_argument(
        "--gain", action="store_true", help="a gain for each drawn picture and channel, fitted to its face"
    )
    parser.add_argument("--json", metavar="FILE.json")


def run(options: argparse.Namespace) -> None:
    """Measure and print. Raises `InputError` for a capture without a face rig or such frames, and what `one_exposure` raises."""
    avatar = load_avatar(options.avatar)
    capture, own = as_trained(
        avatar, options.avatar, with_validation(open_capture(options.capture, template=avatar.person.name))
    )
    check("face" in capture.rigs, options.capture, "", "a face rig", ", ".join(capture.rigs))
    person = avatar.person if own else capture.person
    if options.exposed_as:
        capture = one_exposure(capture, options.exposed_as, person)
    study = _study(capture, options)
    drawers: list[Drawer] = [AvatarDrawer(avatar), *fitted_meshes(capture, person, list(observations(study.rig)))]
    pictures = study.measure(person, drawers)
    frames = sorted({frame for _, frame in study.pairs})
    surface = surface_distances(avatar, [study.rig.signals[frame] for frame in frames])
    _print(pictures, surface)
    if options.json:
        exposed = {"rig": options.exposed_as, "gain": factors(study.rig)} if options.exposed_as else None
        told = {"avatar": options.avatar, "capture": options.capture, "exposed_as": exposed, "gain": options.gain}
        write_json(
            options.json, {**told, "split": options.split, "frames": frames, "pictures": pictures, "surface": surface}
        )


def _study(capture: Capture, options: argparse.Namespace) -> Study:
    rig = capture.rigs["face"]
    test = options.split == "test"
    frames = rig.held_out_frames if test else Splits.of(rig).validation.frames
    views = [view for view in range(len(rig.views)) if test or view not in rig.held_out_views]
    pairs = [(view, frame) for frame in sorted(frames) for view in views if rig.available(view, frame)]
    check(pairs, options.capture, "face rig", f"pictures of {options.split} frames", "none")
    return Study(rig, pairs, options.gain)


def _print(pictures: dict[str, dict[str, dict[str, float]]], surface: dict[str, dict[str, float]]) -> None:
    for region, by_drawer in pictures.items():
        row = printed(region.ljust(26), "pictures", *MEASURES)
        for name, values in by_drawer.items():
            row(name, int(values["pictures"]), *(_shown(values[key]) for key in MEASURES))
    row = printed("surface".ljust(26), "points", "mean |s| mm", "median s mm")
    for name, values in surface.items():
        row(name, int(values["points"]), f"{values['mean_abs_mm']:.2f}", f"{values['median_mm']:+.2f}")


def _shown(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "n/a"
