"""FBX motion through Blender as a Python module (`bpy`, an optional extra), in a process of its own. See fbx_scene.py.

Blender's importer is native code of another project: what it does to a broken file ends its process, not ours.
"""

from __future__ import annotations

import logging
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from avatarrex.errors import InputError
from avatarrex.files.arrays import read_arrays
from avatarrex.files.gate import check_file, read_text
from avatarrex.signals import fbx_scene
from avatarrex.signals.bvh import LARGEST_NUMBER, LONGEST_NAME, MOST_JOINTS, MOST_ROTATIONS
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.imported import ImportedMotion
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.retarget import retarget
from avatarrex.signals.sequence import check_rate
from avatarrex.signals.source_motion import SourceMotion

LARGEST_FILE = 2**29
"""Bytes of an `.fbx`."""
SECONDS = 300.0
"""Until Blender is ended: a minute of motion takes some seconds."""

log = logging.getLogger(__name__)


def read_fbx(path: Path, options: ImportOptions, seconds: float = SECONDS) -> ImportedMotion:
    """Read and retarget the first skeleton of an FBX file.

    Raises `InputError`, also where `bpy` is missing or Blender takes longer than `seconds`.
    """
    check_file(path, "an FBX file", LARGEST_FILE)
    if find_spec("bpy") is None:
        remedy = "Blender as a Python module to read it (pip install 'avatarrex-studio[fbx]'), or the motion as .bvh"
        raise InputError(path, "", remedy, "no bpy")
    with tempfile.TemporaryDirectory() as folder:
        out, said = Path(folder) / "motion.npz", Path(folder) / "said"
        words = [sys.executable, fbx_scene.__file__, str(path.resolve()), str(out), str(said)]
        log.info("%s: reading through Blender, %g s at most", path.name, seconds)
        try:
            subprocess.run(words, capture_output=True, timeout=seconds, cwd=folder, check=False)
        except subprocess.TimeoutExpired:
            raise InputError(path, "", f"an FBX file that Blender reads in {seconds:g} s", "a slower one") from None
        if not out.exists():
            reason = read_text(said, "words").strip() if said.exists() else "Blender ended"
            raise InputError(path, "", "an FBX file with a moving skeleton", reason)
        return retarget(path, _source(path, out), options)


def _source(path: Path, out: Path) -> SourceMotion:
    """What fbx_scene.py wrote, checked as a file from outside is."""
    arrays = read_arrays(out)
    turned, places, rest = arrays["turned"], arrays["places"], arrays["rest"]
    names, parents = tuple(str(name)[:LONGEST_NAME] for name in arrays["names"]), arrays["parents"].astype(int)
    if len(names) > MOST_JOINTS or len(turned) * max(len(names), len(JOINT_NAMES)) > MOST_ROTATIONS:
        most = f"at most {MOST_JOINTS} bones and {MOST_ROTATIONS:,} frames times bones"
        raise InputError(path, "", most, f"{len(turned):,} frames of {len(names)}")
    for name in ("turned", "places", "rest"):
        if not np.abs(arrays[name]).max(initial=0) <= LARGEST_NUMBER:
            raise InputError(path, name, f"numbers up to {LARGEST_NUMBER:g}", "a larger one")
    offsets = rest - np.where(parents[:, None] >= 0, rest[parents], 0)
    return SourceMotion("FBX", names, parents, offsets, turned, places, check_rate(arrays["fps"], path))
