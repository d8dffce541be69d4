"""Level `live` over motion files that no surface was fitted to: depth, silhouette and colour against `quality`, beside `balanced`.

Each motion gives frames evenly spread over it, with the face of `--face` on top, seen from one side each (seeded).
"""

from __future__ import annotations

import argparse
from statistics import median

import numpy as np

from avatarrex.avatar_file import load_avatar
from avatarrex.distil.errors import compared, whole_person
from avatarrex.errors import InputError
from avatarrex.levels import level
from avatarrex.metrics.table import printed
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.signals.read import read_motion

SHOWN = ("live", "balanced")
HEADS = ("depth mm", "p99 mm", "IoU", "dB")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Avatar, motions, face, frames, pixels."""
    parser.add_argument("motions", nargs="+", help="motion files")
    parser.add_argument("--avatar", default="default")
    parser.add_argument("--face", help="a motion file whose expression, jaw and eyes are put on top")
    parser.add_argument("--frames", type=int, default=4, help="of each motion (4)")
    parser.add_argument("--size", type=int, default=512, help="pixels a side (512)")


def run(options: argparse.Namespace) -> None:
    """Print a row for each frame, the medians, and how far colours of `live` are from those of `balanced`."""
    avatar = load_avatar(options.avatar)
    if avatar.surface is None:
        raise InputError(options.avatar, "surface", "an avatar with a surface (avatarrex-studio distil)", "none")
    row = printed("frame", *(f"{name} {head}" for name in SHOWN for head in HEADS))
    rng, found = np.random.default_rng(0), []
    face = read_motion(options.face) if options.face else None
    for path in options.motions:
        motion = read_motion(path)
        for number in np.linspace(0, len(motion) - 1, options.frames + 2).astype(int)[1:-1]:
            signals = motion[int(number)]
            if face is not None:
                signals = _with_face(signals, face[int(rng.integers(len(face)))])
            view = whole_person(avatar, avatar.surface, signals, float(rng.uniform(0, 360)))
            camera = view.resized(options.size, options.size)
            exact = render_frame(avatar, signals, camera, level("quality"))
            figures = [compared(render_frame(avatar, signals, camera, level(name)), exact) for name in SHOWN]
            found.append(np.concatenate(figures))
            row(f"{motion.name} {number}", *_words(found[-1]))
    row("median", *_words([median(column) for column in np.array(found).T]))
    below = [float(figures[7] - figures[3]) for figures in found]
    print(f"live is below balanced by {median(below):.1f} dB, in the worst frame by {max(below):.1f} dB")


def _with_face(signals: Signals, face: Signals) -> Signals:
    return signals.replace(expression=face.expression, jaw_pose=face.jaw_pose, eye_pose=face.eye_pose)


def _words(figures: object) -> list[str]:
    return [f"{value:.{digits}f}" for value, digits in zip(np.asarray(figures), (2, 1, 4, 1, 2, 1, 4, 1))]
