"""A capture of another layout written in ours: pictures linked, mattes white where the person is, metres, +Y up (docs/import.md).

What of the files cannot be used is a list in the end, `import.json`, and ends nothing: a damaged picture, a frame without parameters.
The same command goes on after a stop. Letters: t frames.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from tqdm import tqdm

from avatarrex.capture.importers.axes import upright, upright_cameras
from avatarrex.capture.importers.corrections import GUESSED, Corrections, few
from avatarrex.capture.importers.difference import difference_matte
from avatarrex.capture.importers.layouts import read_source
from avatarrex.capture.importers.pictures import (
    RULES,
    as_matte,
    check_picture,
    matte_rule,
    matte_values,
    open_picture,
)
from avatarrex.capture.importers.source import Reading, Source, SourceView
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.linked import link
from avatarrex.capture.readers.manifest import FORMAT
from avatarrex.capture.readers.rigs import SMPLX_PELVIS, joint_unit
from avatarrex.capture.readers.units import SURELY_NOT_METRES, metres
from avatarrex.errors import InputError, check
from avatarrex.files.gate import is_begun, remove_unfinished, write_text, written
from avatarrex.files.images import write_arrays
from avatarrex.files.json_text import SMALL, read_json, write_json

SHOWN_PROBLEMS = 12
"""Lines of problems that are printed."""
PREVIEW = ("body", "face", "look")
"""Folders of a preview: its rig, and what was drawn of it."""
RULE_MATTES = 8
"""Mattes of a camera that are looked at for what they mean."""


@dataclass(frozen=True)
class Imported:
    """What an import found."""

    layout: str
    rig: str
    cameras: tuple[str, ...]
    frames: int
    pictures: int
    """Pictures with a matte that are in the new capture."""
    posed: bool
    """Whether the layout had parameters."""
    problems: tuple[str, ...]
    notes: tuple[str, ...]

    def lines(self) -> list[str]:
        """To be read: what was found, what was decided, and the first of the problems."""
        shown = [f"  {problem}" for problem in self.problems[:SHOWN_PROBLEMS]]
        if len(self.problems) > SHOWN_PROBLEMS:
            shown.append(f"  … and {len(self.problems) - SHOWN_PROBLEMS} more, all in import.json")
        what = f"{self.layout}: {self.rig}, {len(self.cameras)} cameras, {self.frames} frames, {self.pictures} pictures with mattes"
        said = [f"  {note}" for note in self.notes]
        return [what, *(["notes", *said] if said else []), *(["problems", *shown] if shown else [])]


def import_capture(path: Path, out: Path, corrections: Corrections = GUESSED, frames: int | None = None) -> Imported:
    """Write `path` into the folder `out` in our layout, or go on there; `frames` of it alone, to be looked at.

    Raises `InputError` for what cannot be imported at all.
    """
    archive = Archive(path)
    source, reading = read_source(archive, corrections.metres)
    source = in_our_world(source if frames is None else few(source, frames), reading, corrections)
    manifest = _begun(path, out, source.layout, frames)
    folder = out / source.rig
    write_text(
        folder / "calibration_full.json", json.dumps(calibration(view.lens for view in source.views), indent=1) + "\n"
    )
    with tqdm(source.views, desc="import", unit="camera") as views:
        pictures = sum(_write_view(source, view, reading, folder) for view in views)
    if source.parameters:
        write_arrays(folder / "smpl_params.npz", {"flat_hand_mean": np.array(True), **source.parameters})
    else:
        reading.notes.append("no parameters: `capture prepare` finds poses from keypoints")
    write_json(out / "capture.json", manifest)
    cameras = tuple(view.lens.name for view in source.views)
    found = Imported(
        source.layout, source.rig, cameras, source.frames, pictures, bool(source.parameters),
        (*source.problems, *reading.problems), (*source.notes, *reading.notes),
    )  # fmt: skip
    write_json(out / "import.json", vars(found))
    remove_unfinished(out)
    return found


def _begun(path: Path, out: Path, layout: str, frames: int | None = None) -> dict[str, Any]:
    """`capture.json` of an import that is complete, or of a preview of `frames`; in `out` it says until then that it is not.

    A preview that is there is removed. Raises `InputError` where `out` has files that are not of an import of `path`, and for a preview
    over an import of the whole.
    """
    key = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:16]
    provenance: dict[str, Any] = {
        "maker": "avatarrex-studio capture import",
        "layout": layout,
        "source": path.name,
        "source_key": key,
    }
    if is_begun(out):
        made = _provenance(out)
        found = made.get("source") or "something else"
        check(
            made.get("source_key") == key, out, "", f"a new or empty folder, or one that {path} is imported into", found
        )
        preview = "preview" in made
        check(preview or frames is None, out, "", "a new or empty folder for --preview", f"an import of all of {found}")
        if preview:
            _remove_preview(out)
    if frames is not None:
        provenance["preview"] = frames
    manifest = {"format": FORMAT, "provenance": provenance}
    write_json(out / "capture.json", {**manifest, "complete": False})
    return manifest


def _provenance(out: Path) -> dict[str, Any]:
    """As the folder's `capture.json` says it; empty where there is none."""
    manifest = read_json(out / "capture.json", largest=SMALL) if (out / "capture.json").exists() else None
    made = manifest.get("provenance") if isinstance(manifest, dict) else None
    return made if isinstance(made, dict) else {}


def _remove_preview(out: Path) -> None:
    """What a preview has written: its numbers are of other frames than the whole's, or than another preview's."""
    for name in PREVIEW:
        if (out / name).exists():
            shutil.rmtree(out / name)
    (out / "import.json").unlink(missing_ok=True)


def in_our_world(source: Source, reading: Reading, corrections: Corrections = GUESSED) -> Source:
    """The source in metres with +Y up; what was changed is noted. Raises `InputError` where no unit fits."""
    lenses = corrections.lenses(tuple(view.lens for view in source.views), reading.notes)
    values = corrections.hand_mean(source, reading)
    if "global_orient" not in values or "transl" not in values:
        lenses = lenses if corrections.unit else _camera_metres(lenses, reading.notes)
        return _viewed(source, upright_cameras(lenses, corrections.up, reading.notes))
    rest = rest_pelvis(values)
    known = corrections.metres is not None
    lenses, scale = metres(lenses, values["transl"], rest, reading.place(), reading.notes, known)
    pelvis = values["transl"] * scale + rest
    lenses, orient, pelvis, turn = upright(lenses, values["global_orient"], pelvis, reading.notes, corrections.up)
    changed = {**values, "global_orient": orient, "transl": pelvis - rest}
    if turn.magnitude():  # for a person whose pelvis at rest is not at `rest`
        changed["world_turn"] = turn.as_rotvec()
    return replace(_viewed(source, lenses), parameters=changed)


def rest_pelvis(values: Mapping[str, np.ndarray]) -> np.ndarray:
    """J_0 (3,), metres: where `open_capture` has the pelvis at `transl` 0, with these parameters."""
    if "shape10" in values:
        return np.zeros(3)
    joints = values.get("tpose_joints")
    return SMPLX_PELVIS if joints is None else joints[0].astype(np.float64) * joint_unit(joints)


def calibration(lenses: Iterator[Lens] | tuple[Lens, ...]) -> dict[str, Any]:
    """`calibration_full.json` of cameras."""
    return {
        lens.name: {
            "K": lens.taken.ravel().tolist(),
            "R": lens.camera.camera_from_world[:3, :3].ravel().tolist(),
            "T": lens.camera.camera_from_world[:3, 3].tolist(),
            "distCoeff": lens.distortion.tolist(),
            "imgSize": [lens.camera.width, lens.camera.height],
            "rectifyAlpha": 0.0,
            **({} if lens.fisheye is None else {"fisheye": True}),
            **({} if set(lens.gain) == {1.0} else {"gain": list(lens.gain)}),
        }
        for lens in lenses
    }


def _camera_metres(lenses: tuple[Lens, ...], notes: list[str]) -> tuple[Lens, ...]:
    """Cameras without a person: in millimetres where they are farther from each other than any stage is wide."""
    centres = np.stack([lens.camera.centre for lens in lenses])
    if np.ptp(centres, axis=0).max() <= SURELY_NOT_METRES:
        return lenses
    notes.append("camera positions in millimetres, converted to metres")
    return tuple(lens.scaled(1e-3) for lens in lenses)


def _viewed(source: Source, lenses: tuple[Lens, ...]) -> Source:
    return replace(source, views=tuple(replace(view, lens=lens) for view, lens in zip(source.views, lenses)))


def _write_view(source: Source, view: SourceView, reading: Reading, folder: Path) -> int:
    """A camera's pictures and mattes; how many there are."""
    name, size = view.lens.name, (view.lens.camera.width, view.lens.camera.height)
    rule = _rule(view, reading, size)
    if rule != "grey":
        reading.notes.append(f"{name}: mattes are {RULES[rule]}")
    written_frames = set[int]()
    for frame in sorted(view.images):
        if frame in source.without_parameters or frame >= source.frames:
            continue
        what, image = f"{name} frame {frame}", view.images[frame]
        target = folder / name / f"{frame:08d}{_suffix(image)}"

        def write(image: str = image, target: Path = target, frame: int = frame) -> bool:
            check_picture(reading.archive, reading.name(image), size)
            _write_matte(source, view, reading, frame, rule, folder / name / "mask" / "pha" / f"{frame:08d}")
            link(reading.archive, reading.name(image), target)
            return True

        if reading.attempt(what, write):
            written_frames.add(frame)
    _remove_others(folder / name, written_frames)
    return len(written_frames)


def _remove_others(folder: Path, frames: set[int]) -> None:
    """Pictures and mattes of a camera that an earlier import has written, and the source has no more."""
    for place in (folder, folder / "mask" / "pha"):
        for path in place.glob("*.*g"):
            if not path.stem.isdecimal() or int(path.stem) not in frames:
                path.unlink()


def _rule(view: SourceView, reading: Reading, size: tuple[int, int]) -> str:
    """What the camera's mattes mean."""

    def some() -> Iterator[np.ndarray]:
        for name in list(view.mattes.values())[:RULE_MATTES]:
            try:
                yield matte_values(reading.archive, reading.name(name), size)
            except InputError:  # said when it is its turn
                continue

    return matte_rule(some())


def _write_matte(source: Source, view: SourceView, reading: Reading, frame: int, rule: str, target: Path) -> None:
    """The frame's matte under `target`, which lacks its suffix. Raises `InputError` where there is none."""
    size = (view.lens.camera.width, view.lens.camera.height)
    if frame in view.mattes:
        name = reading.name(view.mattes[frame])
        values = matte_values(reading.archive, name, size)
        if rule == "grey" and open_picture(reading.archive, name).mode in ("L", "RGB"):
            link(reading.archive, name, target.with_suffix(_suffix(name)))
            return
        pixels = as_matte(values, rule)
    elif source.backdrop is not None:
        image, empty = (
            np.array(open_picture(reading.archive, reading.name(name)).convert("RGB"))
            for name in (view.images[frame], source.backdrop)
        )
        if image.shape != empty.shape:
            raise InputError(
                reading.place(source.backdrop), "", f"a picture of {size[0]}x{size[1]} pixels", empty.shape[1::-1]
            )
        pixels = difference_matte(image, empty)
    elif open_picture(reading.archive, reading.name(view.images[frame])).has_transparency_data:
        return  # the reader takes it from there
    else:
        raise InputError(reading.place(view.images[frame]), "", "a matte", "none")
    with written(target.with_suffix(".png")) as part:
        Image.fromarray(pixels).save(part, format="PNG")


def _suffix(name: str) -> str:
    return ".png" if name.lower().endswith(".png") else ".jpg"
