"""A capture with other parameters: the same files, linked where that is possible, and `smpl_params.npz` written anew.

Poses are full axis-angle with flat hands at zero, in metres. The person's size is the shape in its own directions where it was that
(`shape10`; `betas` of a person of SMPL-X), else `tpose_joints`, so that captures whose files did not say it do now. Letters: t frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.capture.fit.refine import Body
from avatarrex.capture.fit.refining import FILE as WORK
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.layout import RigFiles, find_rigs
from avatarrex.capture.readers.linked import link
from avatarrex.capture.readers.manifest import FORMAT
from avatarrex.capture.readers.parameters import KEYS, LARGEST_BYTES
from avatarrex.capture.readers.rigs import Capture
from avatarrex.errors import InputError
from avatarrex.files.images import write_arrays
from avatarrex.files.json_text import write_json
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_ROWS

REPLACED = ("flat_hand_mean", "hands_meanl", "hands_meanr", "betas", "shape10", "tpose_joints", "expression")
"""Arrays of the old file that the new one has otherwise, or that mean nothing beside its size."""


def write_refined(
    capture: Capture, body: Body, signals: dict[str, tuple[Signals, ...]], said: dict[str, Any], out: Path
) -> None:
    """Into the folder `out`: `signals` by rig, `said` as `refined` of capture.json. Raises `InputError` for a file that is damaged."""

    def write(rig: str, files: RigFiles, target: Path) -> None:
        write_arrays(target, _parameters(capture, files, body, signals[rig]))

    write_anew(capture, out, lambda files: files.parameters, write, {"refined": said})


def write_anew(
    capture: Capture,
    out: Path,
    file: Callable[[RigFiles], str],
    write: Callable[[str, RigFiles, Path], None],
    said: dict[str, Any],
) -> None:
    """The capture's files linked into the folder `out`, but for one of each rig, its `file`, which `write` makes of the rig's name and
    files; `said` goes into capture.json. Raises `InputError` for a file that is damaged."""
    archive = Archive(capture.path)
    root, found = find_rigs(archive)
    rigs = {name: found.get(name) or next(iter(found.values())) for name in capture.rigs}
    new = {file(files): name for name, files in rigs.items()}
    for name in all_files(archive, root):
        target = out / name.removeprefix(f"{root}/" if root else "")
        if name in new:
            write(new[name], rigs[new[name]], target)
        elif target not in (out / WORK, out / "capture.json"):  # the former of the capture's own refinement
            link(archive, name, target)
    manifest = archive.place(f"{root}/capture.json".lstrip("/"))
    rewrite_json(out / "capture.json", {"format": FORMAT, **capture.manifest, **said}, manifest)


def rewrite_json(path: Path, data: object, source: str) -> None:
    """JSON of what was read from `source`. Raises `InputError` for what JSON cannot say, NaN among it."""
    try:
        write_json(path, data)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(source, "", "finite numbers, and texts that are UTF-8", error) from None


def all_files(archive: Archive, folder: str) -> Iterator[str]:
    """Files in a folder and below, by name."""
    for entry in sorted(archive.entries(folder)):
        name = f"{folder}/{entry}".lstrip("/")
        if archive.exists(name):
            yield name
        else:
            yield from all_files(archive, name)


def _parameters(capture: Capture, files: RigFiles, body: Body, signals: tuple[Signals, ...]) -> dict[str, np.ndarray]:
    old = files.archive.arrays(files.parameters, KEYS, LARGEST_BYTES)
    pose = np.stack([one.full_pose() for one in signals])
    flat = {name: pose[:, rows].reshape(len(pose), -1) for name, rows in JOINT_ROWS.items() if name != "eye_pose"}
    key, pelvis = capture.person.shape_key, capture.pelvis
    if key in old and body.person.fit is not None and not body.person.fit.joint_offsets.any():
        size, pelvis = {key: body.shape}, _pelvis(capture, body, old)
    else:
        unit = next((truth.scale for truth in capture.ground_truth.values()), 1.0)  # exact meshes keep theirs
        size = {"tpose_joints": (body.person.body.joint_template.double().numpy() + capture.pelvis) / unit}
    return {
        **{name: value for name, value in old.items() if name not in REPLACED},
        **flat,
        **size,
        "transl": np.stack([one.translation for one in signals]) - pelvis,
        "arkit52": np.stack([one.expression for one in signals]),
        "arkit_names": np.array(EXPRESSION_NAMES),
        "flat_hand_mean": np.array(True),
    }


def _pelvis(capture: Capture, body: Body, old: dict[str, np.ndarray]) -> np.ndarray:
    """J_0 (3,), metres, where `open_capture` has the pelvis of the refined shape at `transl` 0: SMPL-X's follows β."""
    first = capture.person.fit
    if first is None:
        return capture.pelvis
    turn = Rotation.from_rotvec(old.get("world_turn", np.zeros(3)))
    return np.asarray(capture.pelvis + turn.apply(body.person.pelvis(body.shape) - body.person.pelvis(first.shape)))
