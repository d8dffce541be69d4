"""Hostile files: small ones that unpack to much or nest deeply, sparse ones of many gigabytes, pipes and devices.

    python tests/files/hostile.py FOLDER      loads each; prints {name: {"error", "seconds", "mib"}} as JSON

`error` is the one line of the `InputError`, or the trace of anything else. `mib` is by how much the process's peak memory grew.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import struct
import sys
import time
import traceback
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from avatarrex_studio.cli.inspect import describe
from avatarrex_studio.jobs.runs import Runs
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import StudioState

from avatarrex.avatar_file import load_avatar
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.errors import InputError
from avatarrex.files.assets import DATA
from avatarrex.files.json_text import parse_json
from avatarrex.metrics.weights import read_weights
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.read import read_motion
from avatarrex.templates.person import load_person
from avatarrex.training.core.warm_start import read_prior
from avatarrex.training.prior import read_fitted
from avatarrex.training.runs import checkpoint
from avatarrex.training.runs.folder import read_about

HERE = Path(__file__).parent
BEFORE = HERE.parent / "compatibility"
GB = 10**9
SECONDS = 60


def header(shape: str, kind: str = "<f8") -> bytes:
    """The head of an `.npy` file."""
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (53 - len(text) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def bomb(path: Path, members: dict[str, tuple[bytes, int]]) -> Path:
    """A zip of members, each some bytes and so many GB of zeros, made without the memory."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, (start, zeros) in members.items():
            with archive.open(name, "w", force_zip64=True) as file:
                file.write(start)
                for _ in range(zeros // 2**24):
                    file.write(bytes(2**24))
    return path


def claims(path: Path, name: str, size: int, zeros: int = 0) -> Path:
    """A zip in which a member of some zeros says that it unpacks to `size` bytes of doubles."""
    bomb(path, {name: (header(f"({size // 8 - 16},)"), zeros)})
    content = bytearray(path.read_bytes())
    entry = content.rindex(b"PK\1\2")
    content[entry + 24 : entry + 28] = struct.pack("<I", size)
    path.write_bytes(content)
    return path


def directory(path: Path, size: int) -> Path:
    """A zip of a list of names of `size` bytes, of which the disk stores none."""
    sparse(path, size)
    with path.open("ab") as file:
        file.write(struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 0xFFFF, 0xFFFF, size, 0, 0))
    return path


def lzma(path: Path) -> Path:
    """Arrays packed in a way that has no bounds when it is unpacked."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("poses.npy", header("(3, 165)") + bytes(8 * 3 * 165))
    return path


def sparse(path: Path, size: int, start: bytes = b"") -> Path:
    """A file of `size` bytes that takes no room."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.write(start)
        file.truncate(size)
    return path


def text(path: Path, content: str) -> Path:
    """A text file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


def pipe(path: Path) -> Path:
    """A pipe that nobody writes to."""
    path.parent.mkdir(parents=True, exist_ok=True)
    os.mkfifo(path)
    return path


def zero(path: Path) -> Path:
    """A link to a device without end."""
    path.symlink_to("/dev/zero")
    return path


def rows(seconds: float, count: int) -> str:
    """A Live Link Face recording with so many seconds between rows."""
    lines = [",".join(["Timecode", "BlendShapeCount", *EXPRESSION_NAMES])]
    for k in range(count):
        whole = int(k * seconds)
        clock = f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}:{k % 2:02d}.0"
        lines.append(",".join([clock, "52", *["0"] * 52]))
    return "\n".join(lines)


def end_sites(count: int) -> str:
    """A BVH of end sites inside one another."""
    return "HIERARCHY\nROOT Hips\n{\n" + "End Site\n{\n" * count + "}\n" * (count + 1) + "MOTION\n"


def many_joints(count: int) -> str:
    """A BVH of joints without channels."""
    joints = "".join(f"JOINT j{k}\n{{\n}}\n" for k in range(count))
    return f"HIERARCHY\nROOT Hips\n{{\n{joints}}}\nMOTION\nFrames: 1\nFrame Time: 0.03\n"


def long_bvh(frames: int) -> str:
    """A small skeleton with as many frames; each takes 400 times what its row takes in the file."""
    names = [
        "Spine",
        "Head",
        "LeftUpLeg",
        "LeftLeg",
        "RightUpLeg",
        "RightLeg",
        "LeftArm",
        "LeftForeArm",
        "RightArm",
        "RightForeArm",
    ]
    joints = "".join(f"JOINT {name}\n{{\nOFFSET 0 1 0\nCHANNELS 1 Zrotation\n}}\n" for name in names)
    head = f"HIERARCHY\nROOT Hips\n{{\nOFFSET 0 0 0\nCHANNELS 1 Zrotation\n{joints}}}\nMOTION\n"
    return f"{head}Frames: {frames}\nFrame Time: 0.01\n" + "0 0 0 0 0 0 0 0 0 0 0\n" * frames


def avatar(path: Path, weights: Callable[[Path], object] | None = None, meta: str | None = None) -> Path:
    """A folder of the packaged avatar with other weights or another `avatar.json`."""
    path.mkdir()
    with zipfile.ZipFile(DATA / "default.avatar") as archive:
        archive.extractall(path)
    if weights:
        replaced(path / "weights.safetensors", weights)
    if meta is not None:
        (path / "avatar.json").write_text(meta)
    return path


def heavy(path: Path) -> Path:
    """The packaged avatar with one weight of 3e38."""
    import safetensors.torch

    avatar(path)
    state = safetensors.torch.load_file(path / "weights.safetensors")
    name = next(name for name in state if name.endswith("bias"))
    state[name] = state[name].float().fill_(3e38)
    safetensors.torch.save_file(state, path / "weights.safetensors")
    return path


def tensors(path: Path, value: object) -> Path:
    """What `torch.save` makes of a value."""
    import torch

    torch.save(value, path)
    return path


def capture(path: Path, change: Callable[[Path], object]) -> Path:
    """The capture of tests/compatibility as a folder, changed."""
    with zipfile.ZipFile(BEFORE / "capture.zip") as archive:
        archive.extractall(path)
    change(path / "body")
    return path


def calibration(change: Callable[[str], str]) -> Callable[[Path], object]:
    """Change the text of a rig's calibration."""
    return lambda rig: text(rig / "calibration_full.json", change((rig / "calibration_full.json").read_text()))


def replaced(path: Path, write: Callable[[Path], object]) -> None:
    """Another file in place of one."""
    path.unlink()
    write(path)


def parameters(write: Callable[[Path], object]) -> Callable[[Path], object]:
    """Write other parameters for a rig."""
    return lambda rig: replaced(rig / "smpl_params.npz", write)


def npy(path: Path) -> None:
    """A single array under the name of an `.npz`."""
    with path.open("wb") as file:
        np.save(file, np.zeros((3, 63)))


def encrypted(path: Path) -> None:
    """An archive with the mark of encryption on its members."""
    np.savez(path, body_pose=np.zeros((3, 63)))
    content = bytearray(path.read_bytes())
    for mark, place in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        content[content.index(mark) + place] |= 1
    path.write_bytes(content)


def run(path: Path, change: Callable[[Path], object]) -> Path:
    """The run of tests/compatibility, changed."""
    shutil.copytree(BEFORE / "run", path)
    change(path)
    return path


def last(path: Path) -> Path:
    """The folder of a run's newest checkpoint."""
    return path / "checkpoints" / "step_00000006"


def rewritten(path: Path, state: str) -> None:
    """A checkpoint with another `state.json`, and a manifest that says so."""
    text(path / "state.json", state)
    manifest = json.loads((path / "manifest.json").read_text())
    manifest["files"]["state.json"] = [len(state), zlib.crc32(state.encode())]
    text(path / "manifest.json", json.dumps(manifest))


def checkpoint_of(path: Path, change: Callable[[Path], object]) -> Path:
    """The newest checkpoint of the run of tests/compatibility, changed."""
    return last(run(path, lambda folder: change(last(folder))))


def viewed(path: Path) -> None:
    """What `runs` shows of a folder that cannot be read, as an error."""
    runs = Runs(path)
    while runs.poll():
        pass
    (view,) = runs.views
    raise InputError(path, "", "a run", f"{view.state}: {view.note}")


def session(steps: str) -> str:
    """A session's text."""
    return f'{{"format": 1, "kind": "session", "start": {{"format": 1}}, "steps": {steps}}}'


BONES = ":bonedata\nbegin\nname a\ndirection 0 1 0\nlength 1\ndof rx\nend\n:hierarchy\nbegin\nroot a\nend\n"


def skeleton(folder: Path, bones: str, frames: str, size: int = 0) -> Path:
    """A motion `.amc` with its `.asf`: of `size` bytes, or a pipe where that is negative."""
    if size < 0:
        pipe(folder / "m.asf")
    elif size:
        sparse(folder / "m.asf", size)
    else:
        text(folder / "m.asf", bones)
    return text(folder / "m.amc", frames)


MANY, LONG = "1" + "0" * 400, "a/" * 32000 + "a"
BVH = "HIERARCHY\n"
CASES: dict[str, tuple[Callable[[Path], object], Callable[[Path], Path], str]] = {
    # what reads it, what makes it, what the error says
    "bvh: nested end sites": (
        read_motion,
        lambda d: text(d / "m.bvh", end_sites(60000)),
        r"line 6: expected an OFFSET alone in an End Site",
    ),
    "bvh: 200 000 joints": (
        read_motion,
        lambda d: text(d / "m.bvh", many_joints(200000)),
        "expected at most 1000 joints, found another",
    ),
    "bvh: a long name": (
        read_motion,
        lambda d: text(d / "m.bvh", f"{BVH}ROOT {'x' * 10**5}\n"),
        "name of at most 200 letters, found 1000",
    ),
    "bvh: 30 MB of frames": (
        read_motion,
        lambda d: text(d / "m.bvh", long_bvh(1300000)),
        "at most 72,727 frames of 11 joints, found 1,300,000",
    ),
    "bvh: a line without end": (
        read_motion,
        lambda d: sparse(d / "m.bvh", 5 * 10**8, BVH.encode()),
        "lines of less than 1,048,576 letters",
    ),
    "npz: 100 kB to 600 MB": (
        read_motion,
        lambda d: bomb(d / "m.npz", {"poses.npy": (header("(484848, 165)"), 640 * 10**6)}),
        "poses: expected arrays of at most 271 MiB, found",
    ),
    "npz: many small frames": (
        read_motion,
        lambda d: bomb(d / "m.npz", {"poses.npy": (header("(200000, 165)", "|i1"), 50 * 10**6)}),
        "poses: expected at most 108,000 frames, found 200,000",
    ),
    "npz: a member that lies": (
        read_motion,
        lambda d: claims(d / "m.npz", "poses.npy", 8000, 4 * 10**8),
        "poses: expected",
    ),
    "npz: no zip of pipes": (read_motion, lambda d: pipe(d / "m.npz"), "a motion file, found no plain file"),
    "npz: LZMA": (
        read_motion,
        lambda d: lzma(d / "m.npz"),
        "poses: expected a member that is stored or deflated, found method 14",
    ),
    "zip: a list of names of 400 MB": (
        read_motion,
        lambda d: directory(d / "m.npz", 4 * 10**8),
        "list of names of at most 64 MiB, found 381 MiB",
    ),
    "npy: 8 bytes of 100 GB": (
        read_motion,
        lambda d: sparse(d / "m.npy", 200, header("(50000000, 265)")),
        r"a plain array \(no pickled objects\) of shape \(50000000, 265\), found",
    ),
    "npy: 20 GB": (
        read_motion,
        lambda d: sparse(d / "m.npy", 20 * GB),
        "an array file of at most 271 MiB, found 19073 MiB",
    ),
    "asf: 30 000 bones": (
        read_motion,
        lambda d: skeleton(d, ":bonedata\n" + "begin\nname x\nend\n" * 30000 + ":hierarchy\n", "1\n"),
        "at most 1000 bones, found another",
    ),
    "asf: an empty hierarchy": (
        read_motion,
        lambda d: skeleton(d, BONES.replace("root a\n", ""), "1\n"),
        r"m\.asf: :hierarchy: expected bones below the root, found none",
    ),
    "asf: no channel": (
        read_motion,
        lambda d: skeleton(d, ":root\norder\n" + BONES.replace("dof rx\n", ""), "1\n"),
        r"m\.asf: expected channels: an order of the root or a dof of a bone, found none",
    ),
    "asf: 20 GB": (
        read_motion,
        lambda d: skeleton(d, "", "1\n", 20 * GB),
        "an ASF file of at most 1 MiB, found 19073 MiB",
    ),
    "amc: a pipe beside it": (read_motion, lambda d: skeleton(d, "", "1\n", -1), "an ASF file, found no plain file"),
    "amc: 10 million frames": (
        read_motion,
        lambda d: skeleton(d, BONES, "1\n" * 10**7),
        "at most 72,727 frames of 2 bones",
    ),
    "fbx: 20 GB": (
        read_motion,
        lambda d: sparse(d / "m.fbx", 20 * GB),
        "an FBX file of at most 512 MiB, found 19073 MiB",
    ),
    "csv: rows 9 s apart": (
        read_motion,
        lambda d: text(d / "m.csv", rows(9, 3000)),
        "Timecode: expected rows at most 0.25 s apart on average, found 9",
    ),
    "csv: /dev/zero": (read_motion, lambda d: zero(d / "m.csv"), "a motion file, found no plain file"),
    "json: 700 000 frames": (
        read_motion,
        lambda d: text(d / "m.json", f'{{"frames": [{"{}," * 700000}{{}}]}}'),
        "frames: expected at most 108,000 frames, found 700,001",
    ),
    "json: 12 million values": (
        read_motion,
        lambda d: text(d / "m.json", f"[{'1,' * 12000000}1]"),
        "at most 10,000,000 values, found 12,000,001",
    ),
    "json: 900 deep": (
        read_motion,
        lambda d: text(d / "m.json", "[" * 900 + "]" * 900),
        "a JSON file nested at most 64 deep",
    ),
    "json: 10 GB": (
        read_motion,
        lambda d: sparse(d / "m.json", 10 * GB),
        "a JSON file of at most 256 MiB, found 9536 MiB",
    ),
    "session: an endless integer": (
        Journal.load,
        lambda d: text(d / "s.json", session(f'[[{{"command": "OrbitBy", "azimuth": {MANY}, "elevation": 0}}]]')),
        r"s\.json: steps\[0\]: camera: azimuth: expected a number, found nan",
    ),
    "session: an endless side": (
        Journal.load,
        lambda d: text(
            d / "s.json", session("[]").replace('"format": 1}', f'"format": 1, "view": {{"fov": {MANY}}}}}')
        ),
        r"s\.json: start: camera: fov: expected a number from 1 to 170, found inf",
    ),
    "session: a million commands": (
        Journal.load,
        lambda d: text(d / "s.json", session(f"[[{'{},' * 1000000}{{}}]]")),
        "steps: expected at most 100,000 commands",
    ),
    "session: /dev/zero": (Journal.load, lambda d: zero(d / "s.json"), "a session file, found no plain file"),
    "avatar: sparse weights": (
        load_avatar,
        lambda d: avatar(d / "a", lambda path: sparse(path, 20 * GB)),
        "a file of at most 1024 MiB, found 19073 MiB",
    ),
    "avatar: a pipe for weights": (
        load_avatar,
        lambda d: avatar(d / "a", pipe),
        "weights.safetensors: expected a file, found no plain file",
    ),
    "avatar: a pipe": (
        load_avatar,
        lambda d: pipe(d / "a.avatar"),
        "an avatar folder or an .avatar file, found no plain file",
    ),
    "avatar: weights of 3e38": (load_avatar, lambda d: heavy(d / "a"), "bias: expected numbers up to 65504, found 3e"),
    "avatar: endless seed": (
        load_avatar,
        lambda d: avatar(d / "a", meta=f'{{"format": 3, "preset": "compact", "seed": {MANY}}}'),
        "seed: expected an integer, found inf",
    ),
    "avatar: a bomb": (
        load_avatar,
        lambda d: bomb(d / "a.avatar", {"avatar.json": (b"{", 10**9)}),
        "avatar.json: expected a file of at most 4 MiB, found 9",
    ),
    "person: a bomb": (
        load_person,
        lambda d: claims(d / "p.npz", "v_template.npy", 2**32 - 2),
        "v_template: expected arrays of at most 2048 MiB, found 4095 MiB",
    ),
    "person: a pipe": (load_person, lambda d: pipe(d / "p.npz"), "a complete .npz file, found no plain file"),
    "capture: a pipe": (
        open_capture,
        lambda d: pipe(d / "c.zip"),
        "a capture: a folder or a .zip file, found no plain file",
    ),
    "capture: /dev/zero": (
        open_capture,
        lambda d: zero(d / "c.zip"),
        "a capture: a folder or a .zip file, found no plain file",
    ),
    "capture: 32 000 folders": (
        open_capture,
        lambda d: bomb(d / "c.zip", {LONG: (b"", 0)}),
        "names of at most 1000 letters and 32 folders, found 64001",
    ),
    "capture: parameters of 4 GB": (
        open_capture,
        lambda d: capture(d / "c", parameters(lambda path: claims(path, "body_pose.npy", 2**32 - 2))),
        "body_pose: expected arrays of at most 357 MiB, found 4095 MiB",
    ),
    "capture: parameters are one array": (
        open_capture,
        lambda d: capture(d / "c", parameters(npy)),
        "smpl_params.npz: expected a complete .npz file",
    ),
    "capture: parameters of no dimension": (
        open_capture,
        lambda d: capture(d / "c", parameters(lambda path: np.savez(path, body_pose=np.float64(1)))),
        "smpl_params.npz: body_pose: expected",
    ),
    "capture: parameters encrypted": (
        open_capture,
        lambda d: capture(d / "c", parameters(encrypted)),
        "smpl_params.npz: body_pose: expected a member without a password, found an encrypted one",
    ),
    "capture: parameters too large": (
        open_capture,
        lambda d: capture(d / "c", parameters(lambda path: np.savez(path, body_pose=np.full((3, 63), 1e300)))),
        "body_pose: expected radians up to 1000, found 1e",
    ),
    "capture: a pipe for a calibration": (
        open_capture,
        lambda d: capture(d / "c", lambda rig: replaced(rig / "calibration_full.json", pipe)),
        "calibration_full.json: expected the file to be there",
    ),
    "capture: endless integers": (
        open_capture,
        lambda d: capture(d / "c", calibration(lambda t: re.sub(r'"T": \[[^,]*,', f'"T": [{MANY},', t))),
        r"c0\.T: expected finite numbers, found NaN or Inf",
    ),
    "capture: an endless size": (
        open_capture,
        lambda d: capture(d / "c", calibration(lambda t: t.replace('"imgSize": [60', f'"imgSize": [{MANY}', 1))),
        r"c0\.imgSize: expected finite numbers",
    ),
    "capture: a name with NUL": (
        open_capture,
        lambda d: capture(d / "c", calibration(lambda t: t.replace('"c0"', '"c\\u0000"', 1))),
        "a camera's name that can name a folder",
    ),
    "capture: deep calibration": (
        open_capture,
        lambda d: capture(d / "c", calibration(lambda t: "[" * 500)),
        "JSON nested at most 64 deep",
    ),
    "weights: four bytes": (read_weights, lambda d: sparse(d / "w.pth", 4), "a file of tensors"),
    "weights: 20 GB": (
        read_weights,
        lambda d: sparse(d / "w.pth", 20 * GB),
        "a weights file of at most 2048 MiB, found 19073 MiB",
    ),
    "weights: a pipe": (read_weights, lambda d: pipe(d / "w.safetensors"), "a weights file, found no plain file"),
    "prior: four bytes": (read_fitted, lambda d: sparse(d / "body.pt", 4), "body.pt: expected a file of tensors"),
    "prior: 20 GB": (
        read_fitted,
        lambda d: sparse(d / "body.pt", 20 * GB),
        "a fitted part of at most 2048 MiB, found 19073 MiB",
    ),
    "prior: a bomb": (
        read_fitted,
        lambda d: bomb(d / "body.pt", {"archive/data.pkl": (b"", 3 * GB)}),
        "tensors of at most 2048 MiB, found 2",
    ),
    "prior: wrong kinds": (
        read_fitted,
        lambda d: tensors(d / "body.pt", {"state": {}, "steps": 3}),
        "a checkpoint of the prior, found dict",
    ),
    "prior: a pipe": (read_fitted, lambda d: pipe(d / "body.pt"), "a fitted part, found no plain file"),
    "packaged prior: four bytes": (
        read_prior,
        lambda d: sparse(d / "p.safetensors", 4),
        "a complete .safetensors file",
    ),
    "packaged prior: 20 GB": (
        read_prior,
        lambda d: sparse(d / "p.safetensors", 20 * GB),
        "a prior's tensors of at most 2048 MiB, found 19073 MiB",
    ),
    "state: 900 deep": (
        lambda path: StudioState.from_json(parse_json(path.read_text(), str(path)), str(path)),
        lambda d: text(d / "s.json", "[" * 900),
        r"s\.json: expected JSON nested at most 64 deep",
    ),
    "state: an endless integer": (
        lambda path: StudioState.from_json(parse_json(path.read_text(), str(path)), str(path)),
        lambda d: text(d / "s.json", f'{{"format": 1, "view": {{"fov": {MANY}}}}}'),
        "camera: fov: expected a number from 1 to 170, found inf",
    ),
    "run: 20 GB": (
        read_about,
        lambda d: run(d / "r", lambda r: sparse(r / "run.json", 20 * GB)),
        "a run folder with run.json, found none that can be read",
    ),
    "run: shown, 20 GB": (
        viewed,
        lambda d: run(d / "r", lambda r: sparse(r / "run.json", 20 * GB)),
        "found dead: run.json cannot be read",
    ),
    "run: shown, deep": (
        viewed,
        lambda d: run(d / "r", lambda r: text(r / "run.json", '{"config":' + "[" * 900 + "]" * 900 + "}")),
        "dead: run.json cannot be read",
    ),
    "run: wrong kinds": (
        viewed,
        lambda d: run(d / "r", lambda r: text(r / "run.json", '{"config": 5, "started": "x"}')),
        "dead: run.json cannot be read",
    ),
    "checkpoint: deep": (
        checkpoint.read,
        lambda d: checkpoint_of(d / "r", lambda c: rewritten(c, "[" * 900)),
        "a state nested at most 64 deep",
    ),
    "checkpoint: a number": (
        checkpoint.read,
        lambda d: checkpoint_of(d / "r", lambda c: rewritten(c, "5")),
        "state.json: expected an object, found int",
    ),
    "checkpoint: wrong names": (
        checkpoint.read,
        lambda d: checkpoint_of(d / "r", lambda c: rewritten(c, '{"$tensor": {}}')),
        "a checkpoint of this program",
    ),
    "checkpoint: 20 GB": (
        checkpoint.read,
        lambda d: checkpoint_of(d / "r", lambda c: sparse(c / "state.safetensors", 20 * GB)),
        "a file that can be read of at most 8192 MiB, found 19073 MiB",
    ),
    "checkpoint: a pipe": (
        checkpoint.read,
        lambda d: checkpoint_of(d / "r", lambda c: replaced(c / "state.json", pipe)),
        "a file that can be read, found no plain file",
    ),
    "inspect: a pipe": (
        lambda path: describe(str(path)),
        lambda d: pipe(d / "m.bvh"),
        "an avatar, a motion, a capture, a run or a session, or a picture, found no plain file",
    ),
}


def too_long(*_: object) -> None:
    """What ends a load that hangs."""
    raise TimeoutError(f"more than {SECONDS} s")


def peak() -> float:
    """MiB of this process's memory at its most."""
    status = Path("/proc/self/status").read_text()
    return int(re.findall(r"VmHWM:\s*(\d+)", status)[0]) / 1024


def load(read: Callable[[Path], object], path: Path) -> dict[str, object]:
    """Load a file: the error, the seconds of work, and by how many MiB the peak of memory grew."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    before, started = peak(), time.process_time()
    signal.alarm(SECONDS)
    try:
        read(path)
        error = "none"
    except InputError as refusal:
        error = str(refusal)
    except BaseException:
        error = traceback.format_exc()
    signal.alarm(0)
    seconds = time.process_time() - started
    return {
        "error": error,
        "seconds": seconds,
        "mib": peak() - before,
    }


def main(folder: Path) -> None:
    """Make each file in a process of its own, so that making it costs this one nothing, and load it."""
    signal.signal(signal.SIGALRM, too_long)
    load_avatar("default")  # what it takes to load anything at all
    found = {}
    for number, (name, (read, make, _)) in enumerate(CASES.items()):
        place = folder / str(number)
        place.mkdir()
        if (child := os.fork()) == 0:
            (place / "path").write_text(str(make(place)))
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0, name
        found[name] = load(read, Path((place / "path").read_text()))
        shutil.rmtree(place)
    print(json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
