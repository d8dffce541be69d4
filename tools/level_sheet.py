"""Four poses of the packaged avatar, the subject's truth beside levels `live`, `balanced` and `quality`, drawn at 1024² a tile.

    python tools/level_sheet.py OUT.jpg

A row a pose, in columns of the order above; what is empty in all four of a row is cut off, a column is as wide as the widest pose.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from avatarrex.avatar_file import load_avatar
from avatarrex.capture.synthetic.subject import load_subject
from avatarrex.capture.synthetic.subject_drawer import SubjectDrawer
from avatarrex.distil.errors import whole_person
from avatarrex.files.images import composite
from avatarrex.levels import level
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand, named_pose

SIDE, MARGIN = 1024, 12
"""Pixels."""
GREY = (0.8, 0.8, 0.8, 1.0)
QUALITY = 85
"""Of the JPEG."""
SCENES = (
    ("stand", "relaxed", "neutral", 20.0),
    ("arms_up", "spread", "laugh", -15.0),
    ("hands_on_hips", "relaxed", "smile", 30.0),
    ("run", "fist", "neutral", 55.0),
)
"""Pose, hands, expression, azimuth."""


def main() -> None:
    """Draw them and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    out: Path = parser.parse_args().out
    avatar, truth = load_avatar("default"), SubjectDrawer(load_subject("default"))
    assert avatar.surface is not None
    rows = []
    for pose, hands, expression, azimuth in SCENES:
        both = {f"{side}_hand_pose": named_hand(hands, side) for side in ("left", "right")}
        face = named_expression(expression)
        signals = Signals.rest().replace(body_pose=named_pose(pose), expression=face, **both)
        camera = whole_person(avatar, avatar.surface, signals, azimuth).resized(SIDE, SIDE)
        levels = (render_frame(avatar, signals, camera, level(name)) for name in ("live", "balanced", "quality"))
        pictures = [torch.as_tensor(truth.draw(signals, camera, "body")), *(frame.image for frame in levels)]
        person = torch.stack(pictures)[..., 3].amax(0).numpy() > 0
        down, across = (np.flatnonzero(person.any(axis)) for axis in (1, 0))
        box = np.s_[max(down[0] - MARGIN, 0) : down[-1] + MARGIN, max(across[0] - MARGIN, 0) : across[-1] + MARGIN]
        rows.append([composite(picture, GREY)[box][..., :3] for picture in pictures])
    wide = max(row[0].shape[1] for row in rows)
    sheet = np.concatenate([np.concatenate([_amid(tile, wide) for tile in row], 1) for row in rows])
    Image.fromarray(sheet).save(out, "JPEG", quality=QUALITY)


def _amid(tile: np.ndarray, wide: int) -> np.ndarray:
    """The tile (h, w, 3) with grey on both sides of it."""
    left = (wide - tile.shape[1]) // 2
    spare = ((0, 0), (left, wide - tile.shape[1] - left), (0, 0))
    return np.pad(tile, spare, constant_values=round(255 * GREY[0]))


if __name__ == "__main__":
    main()
