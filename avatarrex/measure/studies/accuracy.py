"""How near is an avatar to the subject it was fitted to? Silhouettes and surface, with the ceiling that its grid allows.

Per pose: the subject's mesh gives the true silhouette (pixel centres, no antialiasing). `ceiling` is the subject's own exact
signed distance in the avatar's lattices, seen by the same camera: what a perfect field would reach. Surface: distance from
every visible surface point of the avatar to the subject's outer surface; points that a hand's or the face's own field
makes (ω > ½) are counted apart.
"""

from __future__ import annotations

import argparse
import json
import platform
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.synthetic.subject import PosedSubject, Subject, load_subject
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.fields.local_frame import LOCAL_FRAMES
from avatarrex.files.gate import write_text
from avatarrex.metrics.mesh import silhouette_iou
from avatarrex.metrics.table import printed
from avatarrex.pipeline import render_deferred
from avatarrex.pointmap.raycast import raycast
from avatarrex.settings import RenderSettings
from avatarrex.signals.driving import Signals
from avatarrex.signals.limits import random_signals
from avatarrex.signals.read import read_motion
from avatarrex.volume.lattice import Lattice
from avatarrex.volume.prefilter import prefiltered
from avatarrex.volume.sdf_volume import PartBox, SdfVolume

SEED, SIZE = 7, 512
CAMERA = Camera.orbit(25, 8, 3.4, 40, (0, -0.05, 0), SIZE, SIZE)
BACK = Camera.orbit(205, 8, 3.4, 40, (0, -0.05, 0), SIZE, SIZE)
SETTINGS = RenderSettings(antialias=False)
REGIONS = ("body", "fingers", "face")
EXACT_VOXELS = 3.0
"""Around the avatar's surface, in which the ceiling's lattices have the subject's distance."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of which avatar, and in which poses."""
    add = parser.add_argument
    add("--avatar", default="default")
    add("--poses", type=int, default=50)
    add("--motion", action="append", default=[], type=Path)
    add("--frames", type=int, default=10, help="of each motion, evenly spaced")
    add("--local-frame", choices=LOCAL_FRAMES, help="read the same networks through another one")
    add("--json")


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    avatar, subject = load_avatar(options.avatar), load_subject()
    if options.local_frame:
        avatar.body.local_frame = options.local_frame
        avatar.body.place()
    print(f"{platform.machine()}, torch {torch.__version__}; {SIZE}², seed {SEED}; surface: median / p95 in mm")
    row = printed("median / worst", "ceiling IoU", "avatar IoU", "drop", *REGIONS, width=15)
    results = {}
    for name, poses in sets(options):
        measured = [measure(avatar, subject, signals) for signals in tqdm(poses, desc=name, leave=False)]
        results[name] = figures = summary(measured)
        ceiling, reached = (np.array(figures[key]) for key in ("ceiling", "avatar"))
        pairs = ((np.median(iou), iou.min()) for iou in (ceiling, reached))
        drop = ceiling - reached
        surface = (f"{one['median']:.2f} / {one['p95']:.2f}" for one in figures["surface_mm"].values())
        row(name, *(f"{a:.4f} / {b:.4f}" for a, b in (*pairs, (np.median(drop), drop.max()))), *surface)
    if options.json:
        write_text(options.json, json.dumps(results, indent=1) + "\n")


def sets(options: argparse.Namespace) -> Iterator[tuple[str, list[Signals]]]:
    """Half limits, full limits, then every motion; root at rest."""
    for name, scale in (("half limits", 0.5), ("full limits", 1.0)):
        rng = np.random.default_rng(SEED)
        if options.poses:
            yield name, [random_signals(rng, scale) for _ in range(options.poses)]
    for path in options.motion:
        motion = read_motion(path)
        chosen = np.linspace(0, len(motion) - 1, options.frames).round().astype(int)
        still = {"global_orient": np.zeros(3), "translation": np.zeros(3)}
        yield path.stem, [motion[int(k)].replace(**still) for k in chosen]


def measure(avatar: Avatar, subject: Subject, signals: Signals) -> dict[str, Any]:
    """Both IoU and the surface distances (metres) of one pose."""
    target = subject.pose(signals)
    frame = render_deferred(avatar, signals, CAMERA, SETTINGS)
    truth = visible_faces(target.vertices, target.faces, CAMERA)[0] >= 0
    perfect = raycast(exact_volume(frame.volume.sdf, target), CAMERA, antialias=False)
    back = render_deferred(avatar, signals, BACK, SETTINGS, frame)
    distances: dict[str, list[np.ndarray]] = {region: [] for region in REGIONS}
    for view in (frame, back):
        hit, weight = view.pointmap.hit, view.pointmap.part_weight
        distance = np.abs(target.signed_distance(view.pointmap.position[hit].double().numpy()))
        fingers, face = (weight[hit][:, :2].amax(1) > 0.5).numpy(), (weight[hit][:, 2] > 0.5).numpy()
        for region, mask in zip(REGIONS, (~fingers & ~face, fingers, face)):
            distances[region].append(distance[mask])
    return {
        "ceiling": silhouette_iou(perfect.hit.numpy(), truth),
        "avatar": silhouette_iou(frame.pointmap.hit.numpy(), truth),
        **{region: np.concatenate(values) for region, values in distances.items()},
    }


def exact_volume(volume: SdfVolume, target: PosedSubject) -> SdfVolume:
    """The same lattices with the subject's signed distance around the surface."""
    grid = volume.body
    z, y, x = grid.sdf.shape
    body = exact(grid.sdf, Lattice(grid.origin, grid.voxel, (z, y, x)), np.eye(4), target)
    stored = prefiltered(replace(grid, sdf=body, bricks=None, known=None))
    return SdfVolume(stored, tuple(exact_part(part, target) for part in volume.parts))


def exact_part(part: PartBox, target: PosedSubject) -> PartBox:
    """A box of the subject's distance, all its own where the part's surface is."""
    field = part.field.clone()
    z, y, x = field.shape[:3]
    lattice = Lattice(np.zeros(3), part.voxel, (z, y, x))
    field[..., 0] = exact(part.field[..., 0], lattice, np.linalg.inv(part.box_from_root), target)
    return replace(part, field=field, contact=None)


def exact(sdf: torch.Tensor, lattice: Lattice, root_from_lattice: np.ndarray, target: PosedSubject) -> torch.Tensor:
    """`sdf` with the target's distance where it is small."""
    flat = sdf.reshape(-1).clone()
    near = np.flatnonzero(flat.abs().numpy() < EXACT_VOXELS * lattice.voxel)
    position = lattice.position(near) @ root_from_lattice[:3, :3].T + root_from_lattice[:3, 3]
    flat[torch.from_numpy(near)] = torch.as_tensor(target.signed_distance(position), dtype=sdf.dtype)
    return flat.reshape(sdf.shape)


def summary(measured: list[dict[str, Any]]) -> dict[str, Any]:
    """IoU of every pose; surface distances of all of them together, millimetres."""
    pooled = {region: 1e3 * np.concatenate([one[region] for one in measured]) for region in REGIONS}
    surface = {
        region: {"median": float(np.median(values)), "p95": float(np.quantile(values, 0.95))}
        for region, values in pooled.items()
    }
    return {**{key: [one[key] for one in measured] for key in ("ceiling", "avatar")}, "surface_mm": surface}
