"""A multi-view capture: synchronised cameras about a person, by rig, with the person's parameters in every frame.

`open_capture` reads a folder or zip in the layouts of `layout.py`; nothing is decoded before it is needed. Images are
sRGB bytes without lens distortion, pixel centres at +0.5. Letters: h w pixels, v vertices, f faces. World metres.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from avatarrex.camera import Camera
from avatarrex.capture.fit.person_fit import check_height, fit_person
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.calibration import read_calibration
from avatarrex.capture.readers.framing import bare, shows_a_face
from avatarrex.capture.readers.ground_truth import RigTruth
from avatarrex.capture.readers.images_store import ByteCache, Pictures
from avatarrex.capture.readers.keypoints import Keypoints, read_keypoints
from avatarrex.capture.readers.layout import RigFiles, find_rigs
from avatarrex.capture.readers.listing import missing_pictures, with_pictures
from avatarrex.capture.readers.manifest import held_out, read_manifest, warnings
from avatarrex.capture.readers.parameters import KEYS, LARGEST_BYTES, Parameters, read_parameters
from avatarrex.capture.readers.units import metres
from avatarrex.errors import InputError, plain
from avatarrex.signals.driving import LARGEST
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.person import OWN_SHAPE, SMPLX_SHAPE, Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

SMPLX_PELVIS = np.array([0.0031, -0.3514, 0.0120])
"""J_0 of the neutral SMPL-X template, metres, to 0.1 mm: where a capture's pelvis is at transl = 0 when it does not say."""
SAME_SHAPE = 1e-4
"""Of β: coefficients that differ by no more are one body's."""


@dataclass(frozen=True, eq=False)
class View:
    """One camera of a rig."""

    name: str
    camera: Camera
    """An ideal pinhole: images come undistorted."""
    gain: tuple[float, ...] = (1.0, 1.0, 1.0)
    """What red, green and blue of its images were multiplied by, as the calibration says."""


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
    keypoints: Keypoints | None = field(default=None, repr=False)
    """Joints that were detected in the pictures, where the capture has them."""
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
    """Of the template that was named, resized where the files say the captured body's joints, or `betas` that are its shape."""
    ground_truth: dict[str, RigTruth]
    """Exact meshes by rig, where the capture has them."""
    notes: tuple[str, ...]
    """What the reader decided or found odd, one sentence each."""
    manifest: dict[str, Any] = field(default_factory=dict)
    """`capture.json`, where there is one."""
    pelvis: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """J_0, metres: where the capture's pelvis is at `transl` 0."""
    key: str = ""
    """SHA-256 of calibration and parameters, first 16 hex digits: the same for folder and zip, whatever it is called."""
    sized: bool = True
    """Whether the file says how large the person is; if not, `person` is the template until `fit_size`."""

    def moved(self, offset: np.ndarray) -> Capture:
        """The same with its pelvis, in every frame, `offset` (3,) metres from there."""
        rigs = {}
        for name, rig in self.rigs.items():
            frames = tuple(frame.replace(translation=frame.translation + offset) for frame in rig.signals)
            rigs[name] = replace(rig, signals=replace(rig.signals, frames=frames))
        return replace(self, rigs=rigs, pelvis=self.pelvis + offset)


def open_capture(path: str | Path, memory_mb: float = 1024, template: str = "default") -> Capture:
    """Open a capture, a folder or a zip; decoded pictures stay in memory up to `memory_mb`.

    `template` is the person it is of (`load_person`). Raises `InputError` naming file, key, what was expected and what was found.
    """
    archive = Archive(path)
    root, rig_files = find_rigs(archive)
    parameters = {name: _parameters(files) for name, files in rig_files.items()}
    if bare(rig_files, root) and shows_a_face(rig_files["body"], parameters["body"].translation + SMPLX_PELVIS):
        rig_files, parameters = {"face": rig_files["body"]}, {"face": parameters["body"]}
    manifest = read_manifest(archive, root, rig_files)
    notes = warnings(manifest)
    if "face" not in rig_files:
        notes.append("face: no rig of its own: the head is learned from the body's cameras")
    person, place = _person(load_person(template), rig_files, parameters, notes)
    cache = ByteCache(int(memory_mb * 2**20))
    rigs, truths = {}, {}
    for name, files in rig_files.items():
        rig, truth = _rig(name, files, parameters[name], place, manifest, cache, notes)
        rigs[name] = rig
        if truth is not None:
            truth.scale = place.scale
            truths[name] = truth
    made_on = (manifest.get("provenance") or {}).get("person_hash", person.hash)
    if place.sized and person.packaged and made_on != person.hash:
        notes.append(f"capture.json: made on another version of the person ({made_on}), not this one ({person.hash})")
    said = tuple(map(plain, notes))
    return Capture(archive.path, rigs, person, truths, said, manifest, place.pelvis, _key(rig_files), place.sized)


def _key(rigs: dict[str, RigFiles]) -> str:
    digest = hashlib.sha256()
    for name, files in rigs.items():
        for part in (name.encode(), *map(files.archive.read, (files.calibration, files.parameters))):
            digest.update(f"{len(part)};".encode() + part)
    return digest.hexdigest()[:16]


def _parameters(files: RigFiles) -> Parameters:
    archive = files.archive
    return read_parameters(archive.arrays(files.parameters, KEYS, LARGEST_BYTES), archive.place(files.parameters))


@dataclass(frozen=True)
class _Place:
    """How a capture's files place and size the person."""

    pelvis: np.ndarray
    """J_0 (3,), metres."""
    shape: np.ndarray
    """β (10,) of every frame."""
    scale: float = 1.0
    """Metres of the unit of T-pose joints and meshes."""
    sized: bool = True


def _person(
    person: Person, files: dict[str, RigFiles], parameters: dict[str, Parameters], notes: list[str]
) -> tuple[Person, _Place]:
    """`person` as the capture has it, and where. A shape in another person's directions does not say the size of this one."""
    flat = np.zeros(10)
    for name, values in parameters.items():
        source = files[name].archive.place(files[name].parameters)
        if person.shape_key in values.shapes:
            return _by_shape(person, name, source, parameters, notes)
        joints = values.joints
        if joints is None and files[name].ground_truth:
            truth = RigTruth(files[name])
            joints, source = truth.array("tpose_joints", (55, 3)), truth.place
        if joints is None:
            continue
        scale = joint_unit(joints)
        if scale != 1:
            notes.append(f"{name}: T-pose joints and meshes in millimetres, converted to metres")
        joints = joints.astype(np.float64) * scale
        person = fit_person(person, joints, source)
        check_height(person, source)
        notes.append("person: size fitted to the capture's T-pose joints")
        return person, _Place(joints[0], flat, scale)
    others = {key for values in parameters.values() for key in values.shapes}
    if SMPLX_SHAPE in others:
        notes.append("betas belong to the SMPL-X model (--person models): not applied")
    notes.append(
        f"person: the capture does not say its size (no {person.shape_key}, no tpose_joints): it has to be fitted to the mattes"
    )
    return person, _Place(np.zeros(3) if OWN_SHAPE in others else SMPLX_PELVIS, flat, sized=False)


def _by_shape(
    person: Person, rig: str, source: str, parameters: dict[str, Parameters], notes: list[str]
) -> tuple[Person, _Place]:
    """`person` in the shape that `rig` says. The default one follows its signals' shape; another is made in that size once and for all."""
    key, values = person.shape_key, parameters[rig]
    shape = values.shapes[key]
    if (largest := float(np.abs(shape).max())) > LARGEST["shape"]:
        raise InputError(source, key, f"numbers up to ±{LARGEST['shape']:g}", f"{largest:g}")
    for name, other in parameters.items():
        if not np.allclose(other.shapes.get(key, shape), shape, rtol=0, atol=SAME_SHAPE):
            notes.append(f"{name}: {key} of another body than the {rig} rig's, which are taken for both")
    pelvis = person.pelvis(shape)
    if key == OWN_SHAPE:
        return person, _Place(pelvis, shape)
    if person.sex and person.sex != (values.sex or "neutral"):
        said = f"the {values.sex} model's" if values.sex else "the neutral model's, as the file says no other"
        notes.append(f"{rig}: {key} are {said}, but the person is the {person.sex} one: another size")
    person = resize_person(person, PersonFit(shape, np.zeros((55, 3))))
    check_height(person, source)
    return person, _Place(SMPLX_PELVIS + values.turn @ (pelvis - SMPLX_PELVIS), np.zeros(10))


def joint_unit(joints: np.ndarray) -> float:
    """Metres of the unit that T-pose joints (55, 3) are in: metres or millimetres."""
    return 1e-3 if np.ptp(joints, axis=0).max() > 100 else 1.0


def _rig(
    name: str,
    files: RigFiles,
    values: Parameters,
    where: _Place,
    manifest: dict[str, Any],
    cache: ByteCache,
    notes: list[str],
) -> tuple[Rig, RigTruth | None]:
    """One rig: cameras with pictures, units, missing pictures, what is held out."""
    archive, count = files.archive, len(values.pose)
    place = archive.place(files.calibration)
    lenses = read_calibration(archive.text(files.calibration), place)
    calibrated = tuple(lens.name for lens in lenses)
    lenses, images, mattes = with_pictures(name, files, lenses, count, notes)
    converted: list[str] = []
    lenses, scale = metres(lenses, values.translation, where.pelvis, place, converted)
    notes.extend(f"{name}: {note}" for note in converted)
    listed = files.listed_missing(tuple(lens.name for lens in lenses))
    missing = missing_pictures(name, images, mattes, listed, count, notes)
    bent = [lens.name for lens in lenses if lens.distorts]
    if bent:
        notes.append(f"{name}: images of {len(bent)} of {len(lenses)} cameras are undistorted")
    pictures = Pictures(archive, lenses, images, mattes, cache)
    for view in range(len(lenses)):
        first = next((frame for frame in range(count) if (view, frame) not in missing), None)
        if first is not None:
            pictures.check_size(view, first)
    views = tuple(View(lens.name, lens.camera, lens.gain) for lens in lenses)
    signals = values.signals(where.shape, where.pelvis, scale, archive.path.name)
    notes.extend(f"{name}: {note}" for note in values.notes)
    keypoints = read_keypoints(files, lenses, calibrated, count)
    rig = Rig(name, views, signals, missing, frozenset(), frozenset(), pictures, keypoints)
    truth = RigTruth(files, frames=count, lenses=lenses) if files.ground_truth else None
    kept = held_out(manifest, name, count, tuple(lens.name for lens in lenses), archive.place("capture.json"))
    return rig.holding_out(*kept), truth
