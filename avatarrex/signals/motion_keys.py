"""Keys that files of motions share, whoever made them: all joints in one array, and frames a second."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import Guess
from avatarrex.signals.sequence import check_rate

POSES = ("poses", "fullpose", "pose_world", "smpl_poses", "smpl_thetas", "pose")
"""All joints in one array: AMASS and BEAT2, GRAB, WHAM in the world, AIST++, ROMP, WHAM in a camera's frame."""
RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "fps", "frame_rate", "framerate")


def rate_of(arrays: Mapping[str, np.ndarray], path: Path, options: ImportOptions) -> tuple[Guess, float]:
    """Frames a second: what was chosen, what the file says, or 30. Raises `InputError`."""
    key = next((key for key in RATE_KEYS if key in arrays), None)
    fps = check_rate(arrays[key], path, key) if key else 30.0
    why = key or "no frame rate in the file: taken as 30 a second"
    if options.fps is not None:
        fps, why = options.fps, "chosen"
    return Guess("rate", f"{fps:g} frames a second", why, "fps"), fps
