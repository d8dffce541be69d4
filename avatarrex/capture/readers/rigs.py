"""A multi-view capture: synchronised cameras about a person, by rig, with the person's parameters in every frame.

`open_capture` reads a folder or zip in the layouts of `layout.py`; nothing is decoded before it is needed. Images are
sRGB bytes without lens distortion, pixel centres at +0.5. Letters: h w pixels, v vertices, f faces. World metres.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from avatarrex.camera import Camera
from avatarrex.capture.fit.person_fit import check_height, fit_person
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.calibration import Lens, read_calibration
from avatarrex.capture.readers.ground_truth import RigTruth
from avatarrex.capture.readers.images_store import ByteCache, Pictures
from avatarrex.capture.readers.layout import RigFiles, find_rigs
from avatarrex.capture.readers.manifest import held_out, read_manifest
from avatarrex.capture.readers.parameters import KEYS, LARGEST_BYTES, Parameters, read_parameters
from avatarrex.capture.readers.units import metres
from avatarrex.errors import InputError, plain
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.person import Person, load_person

SMPLX_PELVIS = np.array([0.0031, -0.3514, 0.0120])
"""J_0 of the neutral SMPL-X template, metres, to 0.1 mm: where a capture's pelvis is at transl = 0 when it does not say."""


@dataclass(frozen=True, eq=False)
class View:
    """One camera of a rig."""

    name: str
    camera: Camera
    """An ideal pinhole: images come undistorted."""


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras that see the same person in the same frames."""

    name: str
    """`body` or `face`."""
    views: tuple[View, ...]
    signals: SignalSequence
    """The person in every frame."""
    missing: frozenset[tuple[int, int]]
    """(view, frame) without an image or matte."""
    held_out_frames: frozenset[int]
    held_out_views: frozenset[int]
    pictures: Pictures = field(repr=False)
    validation_frames: frozenset[int] | None = None
    """A training's own figures are of these; None: chosen by rule (splits.py)."""

    @property
    def frames(self) -> int:
        """How many."""
        return len(self.signals)

    def available(self, view: int, frame: int) -> bool:
        """Whether there is an image with its matte."""
        return (view, frame) not in self.missing and 0 <= view < len(self.views) and 0 <= frame < self.frames

    def image(self, view: int, frame: int) -> UInt8[np.ndarray, "h w 3"]:
        """sRGB bytes, read-only. Raises `InputError` for a missing or damaged one."""
        return self._picture("image", view, frame)

    def matte(self, view: int, frame: int) -> UInt8[np.ndarray, "h w"]:
        """Foreground, 0 … 255, read-only. Raises `InputError` for a missing or damaged one."""
        return self._picture("matte", view, frame)

    def holding_out(self, frames: Iterable[int] = (), views: Iterable[int] = ()) -> Rig:
        """The same rig with other frames and views kept from training. Raises `InputError` for one it does not have."""
        for what, chosen, count in (
            ("frame", frames := [*frames], self.frames),
            ("view", views := [*views], len(self.views)),
        ):
            for index in chosen:
                if not 0 <= index < count:
                    raise InputError(self.name, f"held-out {what}", f"0 to {count - 1}", index)
        return replace(self, held_out_frames=frozenset(frames), held_out_views=frozenset(views))

    def _picture(self, kind: str, view: int, frame: int) -> np.ndarray:
        if not self.available(view, frame):
            where = f"view {view} ({self.views[view].name})" if 0 <= view < len(self.views) else f"view {view}"
            raise InputError(f"{self.name} rig", f"{where}, frame {frame}", "an image with its matte", "none")
        return self.pictures.get(kind, view, frame)


@dataclass(frozen=True, eq=False)
class Capture:
    """A person before one or two rigs."""

    path: Path
    rigs: dict[str, Rig]
    person: Person
    """The default person, or one resized to the captured body."""
    ground_truth: dict[str, RigTruth]
    """Exact meshes by rig, where the capture has them."""
    notes: tuple[str, ...]
    """What the reader decided or found odd, one sentence each."""
    manifest: dict[str, Any] = field(default_factory=dict)
    """`capture.json`, where there is one."""


def open_capture(path: str | Path, memory_mb: float = 1024) -> Capture:
    """Open a capture, a folder or a zip; decoded pictures stay in memory up to `memory_mb`.

    Raises `InputError` naming file, key, what was expected and what was found.
    """
    archive = Archive(path)
    root, rig_files = find_rigs(archive)
    manifest = read_manifest(archive, root, rig_files)
    notes = ["capture.json: the capture is not complete"] if manifest.get("complete") is False else []
    parameters = {name: _parameters(files) for name, files in rig_files.items()}
    person, pelvis, scale = _person(rig_files, parameters, notes)
    cache = ByteCache(int(memory_mb * 2**20))
    rigs, truths = {}, {}
    for name, files in rig_files.items():
        rig, truth = _rig(name, files, parameters[name], pelvis, manifest, cache, notes)
        rigs[name] = rig
        if truth is not None:
            truth.scale = scale
            truths[name] = truth
    made_on = (manifest.get("provenance") or {}).get("person_hash", person.hash)
    if person.fit is None and made_on != person.hash:
        notes.append(f"capture.json: made on another version of the person ({made_on}), not this one ({person.hash})")
    return Capture(archive.path, rigs, person, truths, tuple(map(plain, notes)), manifest)


def _parameters(files: RigFiles) -> Parameters:
    archive = files.archive
    return read_parameters(archive.arrays(files.parameters, KEYS, LARGEST_BYTES), archive.place(files.parameters))


def _person(
    files: dict[str, RigFiles], parameters: dict[str, Parameters], notes: list[str]
) -> tuple[Person, np.ndarray, float]:
    """The person, how far its J_0 is from ours as the capture places it, and the factor of its lengths to metres."""
    person = load_person("default")
    ours = person.body.joint_template[0].double().numpy()
    for name, values in parameters.items():
        source = files[name].archive.place(files[name].parameters)
        if values.shape is not None:
            return person, np.zeros(3), 1.0
        joints = values.joints
        if joints is None and files[name].ground_truth:
            truth = RigTruth(files[name])
            joints, source = truth.array("tpose_joints", (55, 3)), truth.place
        if joints is None:
            continue
        scale = 1e-3 if np.ptp(joints, axis=0).max() > 100 else 1.0
        if scale != 1:
            notes.append(f"{name}: T-pose joints and meshes in millimetres, converted to metres")
        joints = joints.astype(np.float64) * scale
        person = fit_person(person, joints, source)
        check_height(person, source)
        notes.append("person: size fitted to the capture's T-pose joints")
        return person, joints[0] - ours, scale
    notes.append("person: the default size (the capture has neither its own shape nor T-pose joints)")
    return person, SMPLX_PELVIS - ours, 1.0


def _rig(
    name: str,
    files: RigFiles,
    values: Parameters,
    shift: np.ndarray,
    manifest: dict[str, Any],
    cache: ByteCache,
    notes: list[str],
) -> tuple[Rig, RigTruth | None]:
    """One rig: cameras with pictures, units, missing pictures, what is held out."""
    archive, count = files.archive, len(values.pose)
    place = archive.place(files.calibration)
    lenses = read_calibration(archive.text(files.calibration), place)
    lenses, images, mattes = _with_pictures(name, files, lenses, count, notes)
    lenses, scale = metres(lenses, values.translation, shift, place, f"{name}: ", notes)
    listed = files.listed_missing(tuple(lens.name for lens in lenses))
    missing = _missing(name, images, mattes, listed, count, notes)
    bent = [lens.name for lens in lenses if lens.distorts]
    if bent:
        notes.append(f"{name}: images of {len(bent)} of {len(lenses)} cameras are undistorted")
    pictures = Pictures(archive, lenses, images, mattes, cache)
    for view in range(len(lenses)):
        first = next((frame for frame in range(count) if (view, frame) not in missing), None)
        if first is not None:
            pictures.check_size(view, first)
    views = tuple(View(lens.name, lens.camera) for lens in lenses)
    signals = values.signals(shift, scale, archive.path.name)
    notes.extend(f"{name}: {note}" for note in values.notes)
    rig = Rig(name, views, signals, missing, frozenset(), frozenset(), pictures)
    truth = RigTruth(files, frames=count, lenses=lenses) if files.ground_truth else None
    kept = held_out(manifest, name, count, tuple(lens.name for lens in lenses), archive.place("capture.json"))
    return rig.holding_out(*kept), truth


def _with_pictures(
    name: str, files: RigFiles, lenses: tuple[Lens, ...], count: int, notes: list[str]
) -> tuple[tuple[Lens, ...], tuple[dict[int, str], ...], tuple[dict[int, str], ...]]:
    """The cameras that have any picture, with their images and mattes by frame."""
    images = {lens.name: files.pictures(lens.name) for lens in lenses}
    mattes = {lens.name: files.mattes(lens.name) for lens in lenses}
    kept = tuple(lens for lens in lenses if set(images[lens.name]) & set(mattes[lens.name]) & set(range(count)))
    if not kept:
        raise InputError(
            files.archive.place(files.folder), "", f"images with mattes of cameras {lenses[0].name}, …", "none"
        )
    for lens in lenses:
        if lens not in kept:
            part = "no mattes" if images[lens.name] else "no images"
            notes.append(f"{name}: camera {lens.name} has {part}: left out")
    beyond = max((frame for lens in kept for frame in images[lens.name]), default=0) + 1 - count
    if beyond > 0:
        notes.append(f"{name}: images of {beyond} frames beyond the parameters' {count} are not used")
    return kept, tuple(images[lens.name] for lens in kept), tuple(mattes[lens.name] for lens in kept)


def _missing(
    name: str,
    images: tuple[dict[int, str], ...],
    mattes: tuple[dict[int, str], ...],
    listed: frozenset[tuple[int, int]],
    count: int,
    notes: list[str],
) -> frozenset[tuple[int, int]]:
    """(view, frame) that are listed as missing, or lack an image or a matte."""
    listed = frozenset((view, frame) for view, frame in listed if frame < count)
    absent = {
        (view, frame)
        for view in range(len(images))
        for frame in range(count)
        if frame not in images[view] or frame not in mattes[view]
    }
    if listed:
        notes.append(f"{name}: {len(listed)} pictures listed as missing")
    if absent - listed:
        notes.append(f"{name}: {len(absent - listed)} of {len(images) * count} pictures are not there")
    return frozenset(absent | listed)
