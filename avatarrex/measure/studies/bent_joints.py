"""Do sharply bent joints have holes? An avatar of the packaged subject beside the subject's own mesh.

Close views of elbows and hips, bent farther than in the training's poses too: depth error where both are seen, and of 1000
pixels of the subject how many are a hole (nothing, or more than 1 cm too deep) and how many a fringe (what the
subject does not have, or more than 1 cm before it).
"""

from __future__ import annotations

import argparse

import numpy as np
from PIL import Image

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.synthetic.subject import load_subject
from avatarrex.capture.synthetic.subject_drawer import SubjectDrawer
from avatarrex.counters import Counters
from avatarrex.metrics.table import printed
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.library import named_pose
from avatarrex.templates.posed import pose_person

DEPTH_OFF = 0.01
"""Metres from which a pixel is wrong."""
VIEW_ANGLES = ((0, 0), (60, 10), (-60, 10), (180, 0), (0, -35))
"""Azimuth and elevation, degrees."""
NAMED = {
    "left_elbow": ("crossed_arms",),
    "right_elbow": ("wave", "think", "salute", "hands_on_hips"),
    "pelvis": ("squat", "run", "star", "sit"),
}
"""Poses by the joint that is looked at."""
RIM_PIXELS = 2
"""Of the picture's own rim, which are not judged."""


def cases() -> dict[str, tuple[Signals, str]]:
    """Signals and joint by name."""
    found = {}
    for degrees in (99, 120, 140):
        pose = np.array(named_pose("stand"))
        pose[17:19, 1] = np.radians([-degrees, degrees])
        found[f"elbows {degrees}"] = pose, "left_elbow"
    for spread in (0.3, 0.6):
        pose = np.array(named_pose("stand"))
        pose[:2, 2] += spread, -spread
        found[f"hips {spread} apart"] = pose, "pelvis"
    found |= {name: (np.array(named_pose(name)), joint) for joint, names in NAMED.items() for name in names}
    return {name: (Signals.rest().replace(body_pose=pose), joint) for name, (pose, joint) in found.items()}


def measure(
    avatar: Avatar, truth: SubjectDrawer, signals: Signals, joint: str, side: int
) -> tuple[np.ndarray, list[np.ndarray]]:
    """(depth error in mm, holes, fringes), the latter of 1000 pixels of the subject; and pictures, truth over avatar."""
    posed = pose_person(avatar.person, signals, Counters(), None)
    x, y, z = map(float, posed.body.joints[JOINT_NAMES.index(joint)])
    at = x, y - (0.08 if joint == "pelvis" else 0.0), z
    inner = np.s_[RIM_PIXELS:-RIM_PIXELS, RIM_PIXELS:-RIM_PIXELS]
    pictures, error, holes, fringes, met, both = [], 0.0, 0, 0, 0, 0
    for azimuth, elevation in VIEW_ANGLES:
        camera = Camera.orbit(azimuth, elevation, 0.9, 28, at, side, side)
        frame = render_frame(avatar, signals, camera)
        there = truth.depth(signals, camera)[inner]
        here = (frame.pointmap.depth * frame.pointmap.hit).numpy()[inner]
        seen, drawn = there > 0, here > 0
        holes += (seen & (~drawn | (here > there + DEPTH_OFF))).sum()
        fringes += (drawn & (~seen | (here < there - DEPTH_OFF))).sum()
        close = seen & drawn & (np.abs(here - there) < 3 * DEPTH_OFF)
        error, both, met = error + np.abs(here - there)[close].sum(), both + close.sum(), met + seen.sum()
        pictures.append(np.concatenate([truth.draw(signals, camera)[..., :3], frame.image.numpy()[..., :3]]))
    return np.array([1000 * error / both, 1000 * holes / met, 1000 * fringes / met]), pictures


def add_options(parser: argparse.ArgumentParser) -> None:
    """Whom, and how large."""
    parser.add_argument("avatar", nargs="?", default="default", help="name or file (the packaged avatar)")
    parser.add_argument("--size", type=int, default=180, help="pixels a side")
    parser.add_argument("--sheet", help="PNG with all views, the subject over the avatar")


def run(options: argparse.Namespace) -> None:
    """Print the table, draw the sheet."""
    avatar, truth = load_avatar(options.avatar), SubjectDrawer(load_subject())
    row = printed("of 1000 pixels", "depth mm", "holes", "fringes")
    figures, sheet = [], []
    for name, (signals, joint) in cases().items():
        found, pictures = measure(avatar, truth, signals, joint, options.size)
        row(name, f"{found[0]:.2f}", f"{found[1]:.1f}", f"{found[2]:.1f}")
        figures.append(found)
        sheet.append(np.concatenate(pictures, 1))
    mean = np.mean(figures, 0)
    row("mean", f"{mean[0]:.2f}", f"{mean[1]:.1f}", f"{mean[2]:.1f}")
    if options.sheet:
        Image.fromarray((255 * np.concatenate(sheet).clip(0, 1)).astype(np.uint8)).save(options.sheet)
