"""The synthetic capture: the clothed subject before two rigs, in the AvatarReX layout with exact ground truth.

    OUT/capture.json, OUT/{body,face}/{calibration_full.json, smpl_params.npz, keypoints.npz, ground_truth.npz},
    OUT/{body,face}/<serial>/{%08d.jpg, mask/pha/%08d.jpg, truth/%08d.npz}        (assets_spec/capture.json)

Every file is written whole or not at all, and everything in it follows from size, seed, garment and variation: a run that was stopped
goes on where it was, and what is missing or cut short is made again, byte for byte the same on the same OpenGL renderer.

Letters: t frames, h w pixels, v vertices, f faces. World metres.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from tqdm import tqdm

from avatarrex.camera import Camera
from avatarrex.capture.readers.drawn import MAKER
from avatarrex.capture.readers.manifest import FORMAT
from avatarrex.capture.synthetic.albedo_lattice import bake
from avatarrex.capture.synthetic.cameras import calibration
from avatarrex.capture.synthetic.imaging import JPEG_QUALITY, Imaging
from avatarrex.capture.synthetic.keypoints import keypoints
from avatarrex.capture.synthetic.occlusion import Occlusion
from avatarrex.capture.synthetic.plan import Plan, RigPlan, plan
from avatarrex.capture.synthetic.rasteriser import Picture, Rasteriser
from avatarrex.capture.synthetic.tracking import tracked, truth
from avatarrex.capture.synthetic.variation import DEFAULT, Variation
from avatarrex.errors import InputError
from avatarrex.files.background import background_writer
from avatarrex.files.gate import is_begun
from avatarrex.files.json_text import SMALL, read_json
from avatarrex.gl.context import NoContext, gl_context, renderer_name

CAPTURE_JSON = "the capture.json of a synthetic capture"
BYTES_PER_PIXEL = 0.9
"""Picture, matte and truth together, a generous mean; it only serves to refuse a disk that is too small."""


def make_capture(
    out: str | Path,
    size: str,
    seed: int = 0,
    garment: str = "printed",
    archive: bool = False,
    variation: Variation = DEFAULT,
) -> Path:
    """Make or go on with a capture in the folder `out`, or in the zip `out` (built in `out` + `.parts`); returns its path.

    Raises `InputError`: unknown size or garment, a folder that holds something else, one that cannot be written, a disk that
    is full, no OpenGL.
    """
    made = plan(size, seed, garment, variation)
    out = Path(out)
    folder = out.with_name(out.name + ".parts") if archive else out
    if archive and out.exists():
        raise InputError(out, "", "a new zip", "a file of that name")
    with _one_line(folder):
        _open_folder(folder, made)
        _write_heads(folder, made)
        for rig in made.rigs:
            _draw_rig(folder / rig.name, rig)
        _write(folder / "capture.json", _json(_manifest(made, complete=True)), whole=False)
        if archive:
            _pack(folder, out)
    return out


def _open_folder(folder: Path, made: Plan) -> None:
    """Make the folder, or check that it holds this very capture; check that the disk has room."""
    manifest = folder / "capture.json"
    if manifest.is_file():
        found, wanted = (
            read_json(manifest, CAPTURE_JSON, SMALL),
            {"size": made.size, "seed": made.seed, "garment": made.garment},
        )
        if not isinstance(found, dict) or not wanted.keys() <= found.keys():
            raise InputError(manifest, "", CAPTURE_JSON, "something else")
        wanted |= _varied(made)
        found = {key: found[key] for key in (*wanted, "variation") if key in found}
        if found != wanted:
            raise InputError(folder, "", f"a new folder, or one begun with {wanted}", found)
    elif folder.exists() and (not folder.is_dir() or is_begun(folder)):
        raise InputError(folder, "", "a new or empty folder, or a capture to go on with", "something else")
    folder.mkdir(parents=True, exist_ok=True)
    pictures = sum(len(rig.motion) * rig.size.cameras for rig in made.rigs)
    meshes = sum(len(rig.motion) * 12 * len(rig.subject.vertices) for rig in made.rigs)
    need = pictures * made.rigs[0].picture.width * made.rigs[0].picture.height * BYTES_PER_PIXEL + meshes
    need -= sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    free = shutil.disk_usage(folder).free
    if free < need:
        raise InputError(folder, "", f"{need / 2**30:.2f} GiB of free disk space", f"{free / 2**30:.2f} GiB")


def _write_heads(folder: Path, made: Plan) -> None:
    """All but the pictures."""
    if not _is_whole(folder / "capture.json"):
        _write(folder / "capture.json", _json(_manifest(made, complete=False)))
    for rig in made.rigs:
        _write(folder / rig.name / "calibration_full.json", _json(calibration(rig.cameras, rig.imaging.distortion)))
        _write(folder / rig.name / "smpl_params.npz", _npz(tracked(rig)))
        _write(folder / rig.name / "keypoints.npz", _npz(keypoints(rig, made.seed)))
        if not _is_whole(folder / rig.name / "ground_truth.npz"):
            _write(folder / rig.name / "ground_truth.npz", _npz(truth(rig)))


def _manifest(made: Plan, complete: bool) -> dict[str, Any]:
    subject = made.rigs[0].subject
    return {
        "format": FORMAT, "size": made.size, "seed": made.seed, "garment": made.garment, **_varied(made), "complete": complete,
        "background": [0, 0, 0],
        "held_out_frames": {rig.name: rig.held_out_frames for rig in made.rigs},
        "held_out_cameras": {rig.name: rig.held_out_cameras for rig in made.rigs},
        "depth_frames": {rig.name: rig.depth_frames for rig in made.rigs},
        "provenance": {
            "maker": MAKER, "subject": "the synthetic clothed subject; no person was recorded",
            "person": subject.person.name, "person_hash": subject.person.hash, "renderer": renderer_name(gl_context()),
            "licence": "CC0 1.0",
        },
    }  # fmt: skip


def _varied(made: Plan) -> dict[str, Any]:
    """The manifest's word on the variation; nothing of the default."""
    varied = made.variation.to_json()
    return {"variation": varied} if varied else {}


def _draw_rig(folder: Path, rig: RigPlan) -> None:
    """Draw the frames that are not there yet, with a progress bar."""
    serials = list(rig.cameras)
    for serial in serials:
        for part in ("mask/pha", "truth"):
            (folder / serial / part).mkdir(parents=True, exist_ok=True)
    to_do = {frame: missing for frame in range(len(rig.motion)) if (missing := _missing(folder, rig, frame))}
    bar = tqdm(total=len(rig.motion) * len(serials), desc=rig.name, unit="picture", mininterval=1.0)
    bar.update(bar.total - sum(map(len, to_do.values())))
    if not to_do:
        bar.close()
        return
    with bar, background_writer(threads=2) as write:
        for frame, rasteriser in posed_stage(rig, to_do):
            placed = rig.world_from_root(frame)
            for serial in to_do[frame]:
                camera = rig.cameras[serial].seen_from(placed)
                drawn = rasteriser.draw(camera, rig.imaging.distortion(serial))
                write(_write_picture, folder / serial, frame, drawn, rig.imaging)
                if frame in rig.depth_frames:
                    write(_write, folder / serial / "truth" / f"{frame:08d}.npz", _truth(rasteriser, camera, placed))
                bar.update()


def posed_stage(rig: RigPlan, frames: Iterable[int]) -> Iterator[tuple[int, Rasteriser]]:
    """Each frame with its subject posed and lit, ready for cameras in the root frame; one rasteriser for all, so draw before the next. Raises
    `NoContext` without OpenGL 4.3."""
    subject, picture = rig.subject, rig.picture
    rasteriser = Rasteriser(subject.faces, bake(subject, rig.spacing()), picture.samples)
    occlusion = Occlusion(subject.faces, len(subject.vertices), picture.directions, rig.size.shadow_map)
    for frame in frames:
        posed = rig.posed(frame)
        openness = occlusion.openness(posed.vertices, posed.normals, *rig.occlusion_ball(posed.vertices))
        rasteriser.pose(posed, openness, rig.light_from_root(frame))
        yield frame, rasteriser


def _missing(folder: Path, rig: RigPlan, frame: int) -> list[str]:
    """Serials of the cameras of which a file of `frame` is not there or not whole."""

    def whole(serial: str) -> bool:
        files = [folder / serial / f"{frame:08d}.jpg", folder / serial / "mask" / "pha" / f"{frame:08d}.jpg"]
        if frame in rig.depth_frames:
            files.append(folder / serial / "truth" / f"{frame:08d}.npz")
        return all(map(_is_whole, files))

    return [serial for serial in rig.cameras if not whole(serial)]


def _truth(rasteriser: Rasteriser, camera: Camera, placed: np.ndarray) -> bytes:
    """Exact depth (h, w) float32 and world normals (h, w, 3) float16 as compressed `.npz`."""
    geometry = rasteriser.geometry(camera)
    normal = geometry.normal @ placed[:3, :3].T.astype(np.float32)
    return _npz({"depth": geometry.depth, "normal": normal.astype(np.float16)}, compressed=True)


def _write_picture(folder: Path, frame: int, picture: Picture, imaging: Imaging) -> None:
    colour = imaging.developed(picture.colour, folder.name, frame)
    levels = np.rint(255 * np.clip(colour, 0, 1)).astype(np.uint8)
    _write(folder / "mask" / "pha" / f"{frame:08d}.jpg", _jpeg(levels[..., 3], imaging.matte_quality))
    _write(folder / f"{frame:08d}.jpg", _jpeg(levels[..., :3]))


def _jpeg(levels: np.ndarray, quality: int = JPEG_QUALITY) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, format="JPEG", quality=quality, subsampling=0)
    return buffer.getvalue()


def _npz(arrays: dict[str, np.ndarray], compressed: bool = False) -> bytes:
    buffer = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _json(value: object) -> bytes:
    return (json.dumps(value, indent=1) + "\n").encode()


def _write(path: Path, content: bytes, whole: bool = True) -> None:
    """Under a temporary name, then renamed; a file that is already `whole` and the same is left alone."""
    if whole and path.is_file() and path.stat().st_size == len(content) and path.read_bytes() == content:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.part")
    temporary.write_bytes(content)
    os.replace(temporary, path)


def _is_whole(path: Path) -> bool:
    """Whether a file of ours ends as its kind does: one that was cut short, or is all zeros, does not."""
    try:
        with open(path, "rb") as file:
            if path.suffix == ".jpg":
                head = file.read(2)
                file.seek(-2, os.SEEK_END)
                return head == b"\xff\xd8" and file.read() == b"\xff\xd9"
            return path.suffix != ".npz" or zipfile.is_zipfile(file)
    except OSError:
        return False


@contextmanager
def _one_line(folder: Path) -> Iterator[None]:
    try:
        yield
    except NoContext as error:
        raise InputError("capture make", "", "OpenGL 4.3 (Mesa's llvmpipe will do)", error) from None
    except OSError as error:
        raise InputError(error.filename or folder, "", "a place that can be written", error.strerror or error) from None


def _pack(folder: Path, out: Path) -> None:
    """The finished folder as one zip, stored; the folder is then removed."""
    temporary = out.with_name(out.name + ".part")
    with zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for file in sorted(path for path in folder.rglob("*") if path.is_file()):
            entry = zipfile.ZipInfo(file.relative_to(folder).as_posix())
            entry.external_attr = 0o644 << 16
            with file.open("rb") as source, archive.open(entry, "w", force_zip64=True) as target:
                shutil.copyfileobj(source, target)
    os.replace(temporary, out)
    shutil.rmtree(folder)
