"""How near is an avatar to the subject it was fitted to? Silhouettes and surface, with the ceiling that its grid allows.

    python avatarrex/measure/studies/accuracy.py [--avatar default] [--poses 50] [--motion FILE]... [--local-frame F] [--json FILE]

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

import numpy as np
import torch
from tqdm import tqdm

from avatarrex.avatar import Avatar, load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.synthetic.subject import PosedSubject, Subject, load_subject
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.fields.local_frame import LOCAL_FRAMES
from avatarrex.pipeline import RenderSettings, render_frame
from avatarrex.pointmap.raycast import raycast
from avatarrex.signals.driving import Signals
from avatarrex.signals.limits import random_signals
from avatarrex.signals.read import read_motion
from avatarrex.volume.sdf_volume import PartBox, SdfVolume

SEED, SIZE = 7, 512
CAMERA = Camera.orbit(25, 8, 3.4, 40, (0, -0.05, 0), SIZE, SIZE)
BACK = Camera.orbit(205, 8, 3.4, 40, (0, -0.05, 0), SIZE, SIZE)
SETTINGS = RenderSettings(antialias=False)
REGIONS = ("body", "fingers", "face")
NEAR = 3.0
"""Voxels around the avatar's surface in which the ceiling's lattices hold the subject's distance."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--avatar", default="default")
    parser.add_argument("--poses", type=int, default=50)
    parser.add_argument("--motion", action="append", default=[], type=Path)
    parser.add_argument("--frames", type=int, default=10, help="of each motion, evenly spaced")
    parser.add_argument("--local-frame", choices=LOCAL_FRAMES, help="read the same networks through another one")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    avatar, subject = load_avatar(options.avatar), load_subject()
    if options.local_frame:
        avatar.body.local_frame = options.local_frame
        avatar.body.place()
    print(f"{platform.machine()}, torch {torch.__version__}; {SIZE}², {len(REGIONS)} regions, seed {SEED}")
    head = ("", "ceiling IoU med / worst", "avatar IoU med / worst", "drop med / worst")
    print(
        f"{head[0]:<22}"
        + "".join(f"{title:>26}" for title in head[1:])
        + "   surface mm median / p95: body, fingers, face"
    )
    results = {}
    for name, poses in sets(options):
        rows = [measure(avatar, subject, signals) for signals in tqdm(poses, desc=name, leave=False)]
        results[name] = report(name, rows)
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


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


def measure(avatar: Avatar, subject: Subject, signals: Signals) -> dict[str, object]:
    """Both IoU and the surface distances (metres) of one pose."""
    target = subject.pose(signals)
    frame = render_frame(avatar, signals, CAMERA, SETTINGS)
    truth = visible_faces(target.vertices, target.faces, CAMERA)[0] >= 0
    perfect = raycast(exact_volume(frame.volume.sdf, target), CAMERA, antialias=False)
    back = render_frame(avatar, signals, BACK, SETTINGS, frame)
    distances: dict[str, list[np.ndarray]] = {region: [] for region in REGIONS}
    for view in (frame, back):
        hit, weight = view.pointmap.hit, view.pointmap.part_weight
        distance = np.abs(target.signed_distance(view.pointmap.position[hit].double().numpy()))
        fingers, face = (weight[hit][:, :2].amax(1) > 0.5).numpy(), (weight[hit][:, 2] > 0.5).numpy()
        for region, mask in zip(REGIONS, (~fingers & ~face, fingers, face)):
            distances[region].append(distance[mask])
    return {
        "ceiling": iou(perfect.hit.numpy(), truth),
        "avatar": iou(frame.pointmap.hit.numpy(), truth),
        **{region: np.concatenate(values) for region, values in distances.items()},
    }


def exact_volume(volume: SdfVolume, target: PosedSubject) -> SdfVolume:
    """The same lattices with the subject's signed distance around the surface."""
    z, y, x = volume.body.sdf.shape
    place = np.stack(np.meshgrid(np.arange(z), np.arange(y), np.arange(x), indexing="ij")[::-1], -1).reshape(-1, 3)
    body = exact(volume.body.sdf, volume.body.origin + volume.body.voxel * place, volume.body.voxel, target)
    parts = [exact_part(part, target) for part in volume.parts]
    return SdfVolume(replace(volume.body, sdf=body), tuple(parts))


def exact_part(part: PartBox, target: PosedSubject) -> PartBox:
    """A box of the subject's distance, all its own where the part's surface is."""
    z, y, x = part.field.shape[:3]
    place = np.stack(np.meshgrid(np.arange(z), np.arange(y), np.arange(x), indexing="ij")[::-1], -1).reshape(-1, 3)
    root_from_box = np.linalg.inv(part.box_from_root)
    position = part.voxel * place @ root_from_box[:3, :3].T + root_from_box[:3, 3]
    field = part.field.clone()
    field[..., 0] = exact(part.field[..., 0], position, part.voxel, target)
    return replace(part, field=field, contact=None)


def exact(sdf: torch.Tensor, position: np.ndarray, voxel: float, target: PosedSubject) -> torch.Tensor:
    """`sdf` with the target's distance where it is small."""
    flat = sdf.reshape(-1).clone()
    near = np.flatnonzero(flat.abs().numpy() < NEAR * voxel)
    flat[torch.from_numpy(near)] = torch.as_tensor(target.signed_distance(position[near]), dtype=sdf.dtype)
    return flat.reshape(sdf.shape)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks."""
    return float((a & b).sum() / max((a | b).sum(), 1))


def report(name: str, rows: list[dict[str, object]]) -> dict[str, object]:
    """Print one line; returns its figures."""
    ceiling, avatar = (np.array([row[key] for row in rows]) for key in ("ceiling", "avatar"))
    drop = ceiling - avatar
    pairs = [(np.median(ceiling), ceiling.min()), (np.median(avatar), avatar.min()), (np.median(drop), drop.max())]
    surface = {}
    for region in REGIONS:
        values = 1e3 * np.concatenate([np.asarray(row[region]) for row in rows])
        surface[region] = {"median": float(np.median(values)), "p95": float(np.quantile(values, 0.95))}
    line = f"{name:<22}" + "".join(f"{f'{a:.4f} / {b:.4f}':>26}" for a, b in pairs)
    print(line + "   " + ", ".join(f"{s['median']:.2f} / {s['p95']:.2f}" for s in surface.values()), flush=True)
    return {"ceiling": ceiling.tolist(), "avatar": avatar.tolist(), "surface_mm": surface}


if __name__ == "__main__":
    main()
