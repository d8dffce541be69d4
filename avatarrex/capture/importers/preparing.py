"""From videos, a calibration and keypoint files to a capture: steps that are done once, each with a picture to look at (docs/import.md).

`OUT/prepare.json` has what each step said and a key of what it was made from; a step whose key is the same is not done again, and one
that is done again lets all after it be done, too. `OUT/steps/` has the pictures, `OUT/capture/` the capture. Letters: t frames, c
cameras, l landmarks.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from avatarrex.capture.fit.face_marks import FACE_NAMES
from avatarrex.capture.fit.initial import fit_initial
from avatarrex.capture.fit.landmarks import landmarks
from avatarrex.capture.fit.overlay import contact_sheet
from avatarrex.capture.importers.calibrations import SUFFIXES, Cameras, find_cameras
from avatarrex.capture.importers.detections import read_detections
from avatarrex.capture.importers.difference import difference_matte, quality
from avatarrex.capture.importers.expressions import find_expressions
from avatarrex.capture.importers.footage import Footage, find_footage, read_image, save_jpeg, save_matte
from avatarrex.capture.importers.import_capture import RULE_MATTES, calibration
from avatarrex.capture.importers.pictures import as_matte, matte_rule
from avatarrex.capture.importers.step_pictures import dotted, outlined, plan, tiles
from avatarrex.capture.readers import choice
from avatarrex.capture.readers.calibration import Lens, read_calibration
from avatarrex.capture.readers.keypoints import FILE as KEYPOINTS
from avatarrex.capture.readers.manifest import FORMAT
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.errors import InputError, check
from avatarrex.files.arrays import read_arrays
from avatarrex.files.gate import remove_unfinished
from avatarrex.files.images import write_arrays, write_png
from avatarrex.files.json_text import SMALL, read_json, write_json
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.person import load_person, other_files

STATE = "prepare.json"
PICTURES, MATTES, BACKDROPS = ("videos", "images", "video"), ("mattes", "masks", "matte"), ("background", "backgrounds")
"""Folders of the source."""
SHOWN_FRAMES, SHOWN_FAULTS = 3, 8
"""Frames of a sheet, and faults that are printed."""
IMPORTED, DIFFERENT, OWN = "imported", "what differs from the empty scene", "alpha channels"
"""Where mattes come from."""
FIT, FACE = "fit", "steps/face.npz"
"""The step that poses the person; landmarks of faces and what was fitted to them, where there are any."""
LARGEST_BYTES = 2**31


@dataclass(frozen=True)
class Options:
    """What a person may choose."""

    stride: int = 1
    """Every so many frames are used."""
    fps: float | None = None
    """Frames a second of the pictures, where no video says it."""
    height: float | None = None
    """Metres of the person, for calibrations without a unit."""
    held_out: str | None = None
    """Frames of the capture, `A:B:S`, that no training sees."""
    person: str = "default"
    """The template (`load_person`)."""


@dataclass(eq=False)
class Preparing:
    """A preparation in a folder, that goes on where it stopped."""

    source: Path
    out: Path
    options: Options = Options()
    state: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.source.is_dir():
            raise InputError(self.source, "", "a folder with videos, a calibration and keypoints", "no folder")
        if (self.out / STATE).exists():
            self.state = read_json(self.out / STATE, largest=SMALL)
            check(isinstance(self.state, dict), self.out / STATE, "", "an object", type(self.state).__name__)
        elif (self.out / "capture").exists():
            raise InputError(self.out / "capture", "", f"a name that is free, or {STATE} beside it", "something else")

    @property
    def body(self) -> Path:
        """The folder of the capture's rig."""
        return self.out / "capture" / "body"

    def forget(self, step: str) -> None:
        """Let a step and all after it be done again. Raises `InputError` for an unknown one."""
        check(step in STEPS, "--redo", "", f"one of {', '.join(STEPS)}", step)
        for name in list(STEPS)[list(STEPS).index(step) :]:
            self.state.pop(name, None)

    def run(self) -> Iterator[str]:
        """Do what is not done; lines to be read. Raises `InputError` where a step cannot be done: the same command goes on there."""
        before, files = "", other_files(self.options.person)
        self._check_person()
        for number, (name, step) in enumerate(STEPS.items(), 1):
            chosen = f"{[getattr(self.options, option) for option in step.options]}{files if step.fits else ''}"
            key = hashlib.sha256(f"{before} {name} {chosen} {self._inputs(step)}".encode()).hexdigest()[:16]
            done = self.state.get(name)
            again = not (isinstance(done, dict) and done.get("key") == key)
            picture = self.out / "steps" / f"{number}_{name}.png"
            if again:
                self.forget(name)
                write_json(self.out / STATE, self.state)  # stopped within the step, it is not done
                said, sheet = step.do(self)
                write_png(picture, np.dstack([sheet, np.full(sheet.shape[:2], 255, np.uint8)]))
                whose = {"person": self.options.person} if step.fits else {}
                self.state[name] = {"key": key, "said": said, "at": datetime.now(UTC).isoformat(), **whose}
                write_json(self.out / STATE, self.state)
            before = key
            yield f"{number} {name}{'' if again else ' (done before)'}: {picture}"
            yield from (f"    {line}" for line in self.state[name]["said"])
        remove_unfinished(self.out, below=False)  # a training may be at work in one of its folders
        for folder in ("steps", "capture"):
            remove_unfinished(self.out / folder)

    def _check_person(self) -> None:
        """Refuse another person than the one that was fitted: what was refined and trained is of that one."""
        done = self.state.get(FIT)
        begun = done.get("person", "default") if isinstance(done, dict) else self.options.person
        expected = f"{begun}, which {self.out / STATE} was begun with (or --redo {FIT}, with all that follows)"
        check(begun == self.options.person, "--person", "", expected, self.options.person)

    def made(self) -> str:
        """Which fit the capture has: another one after any step was done again."""
        steps = [FIT, "face"] if (self.out / FACE).exists() else [FIT]
        return " ".join(f"{self.state[name]['key']} {self.state[name].get('at')}" for name in steps)

    def _inputs(self, step: Step) -> str:
        """Names, sizes and times of the files that a step is made from; of the source's own those that a calibration may be."""
        found = []
        for folder in step.inputs:
            place = self.source / folder
            for path in sorted(place.rglob("*") if folder else place.iterdir()):
                if path.is_file() and (folder or path.suffix.lower() in SUFFIXES):
                    status = path.stat()
                    found.append((str(path.relative_to(self.source)), status.st_size, status.st_mtime_ns))
        return hashlib.sha256(json.dumps(found).encode()).hexdigest()

    def footage(self) -> dict[str, Footage]:
        """The cameras' pictures. Raises `InputError` without any."""
        found = find_footage(self.source, PICTURES)
        check(found, self.source, "", "videos/CAMERA.mp4 or images/CAMERA/…", "neither")
        return found

    @property
    def first(self) -> int | None:
        """The number in the names of pictures that frame 0 has; None beside videos."""
        return next((one.first for one in self.footage().values() if one.video is None), None)

    def beside(self, folders: tuple[str, ...]) -> dict[str, Footage]:
        """What there is for each frame beside the pictures, numbered as they are. Beside videos files may count from 1."""
        found = find_footage(self.source, folders, self.first)
        if self.first is None and not any(one.first == 1 for one in found.values()):
            return find_footage(self.source, folders, 0)
        return found

    def cameras(self) -> Cameras:
        """As the first step has read them."""
        place = self.out / "steps" / "cameras.json"
        data = read_json(place, largest=SMALL)
        return Cameras(read_calibration(json.dumps(data["cameras"]), str(place)), data["kind"], data["scaled"], ())

    def detections(self, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, list[str]]:
        """Landmarks (t, c, l, 2) in the pictures, their confidence (t, c, l), and what could not be read."""
        lenses, stride = self.cameras().lenses, self.options.stride
        count = 1 + max(max(self.pictures(lens), default=0) for lens in lenses)
        points, confidence, problems = read_detections(
            self.source / "keypoints", lenses, count * stride, self.first, names
        )
        return points[::stride], confidence[::stride], problems

    def capture(self) -> Capture:
        """What has been made, of the chosen person."""
        return open_capture(self.out / "capture", template=self.options.person)

    def pictures(self, lens: Lens) -> dict[int, Path]:
        """Of a camera, by frame."""
        return {int(path.stem): path for path in sorted((self.body / lens.name).glob("*.jpg"))}


@dataclass(frozen=True)
class Step:
    """One of a preparation."""

    do: Callable[[Preparing], tuple[list[str], np.ndarray]]
    """What it says, and its picture (h, w, 3)."""
    inputs: tuple[str, ...]
    """Folders of the source; "" its own files."""
    options: tuple[str, ...] = ()
    """What of `Options` it depends on."""
    fits: bool = False
    """Whether it rests on the person, too."""


def _cameras(work: Preparing) -> tuple[list[str], np.ndarray]:
    footage = work.footage()
    found = find_cameras(work.source, {name: one.size for name, one in footage.items()})
    lenses = tuple(lens for lens in found.lenses if lens.name in footage)
    check(
        len(lenses) > 1,
        found.files[0],
        "",
        f"two cameras or more called {', '.join(list(footage)[:6])}",
        ", ".join(lens.name for lens in found.lenses[:6]),
    )
    said = [f"{found.kind}: {len(lenses)} cameras" + ("" if found.scaled else "; its world has neither unit nor axes")]
    said += _fisheyes(lenses)
    said += [f"{lens.name}: no pictures, left out" for lens in found.lenses if lens not in lenses]
    said += [f"{name}: not calibrated, left out" for name in footage if name not in {lens.name for lens in lenses}]
    for lens in lenses:
        size = footage[lens.name].size
        check(
            size == (lens.camera.width, lens.camera.height),
            found.files[0],
            f"{lens.name}.size",
            f"{size[0]}x{size[1]} pixels, as its pictures have",
            f"{lens.camera.width}x{lens.camera.height}",
        )
    write_json(
        work.out / "steps" / "cameras.json",
        {"kind": found.kind, "scaled": found.scaled, "cameras": calibration(lenses)},
    )
    return said, plan(lenses)


def _fisheyes(lenses: tuple[Lens, ...]) -> list[str]:
    """What their pinholes keep."""
    angles, shares = [], []
    for lens in lenses:
        if lens.fisheye is not None:
            focal, middle = np.diag(lens.camera.intrinsics)[:2], lens.camera.intrinsics[:2, 2]
            size = np.array([lens.camera.width, lens.camera.height])
            angles.append(np.degrees(np.arctan(middle / focal) + np.arctan((size - middle) / focal)).max())
            shares.append(focal[0] / lens.fisheye[0, 0])
    if not angles:
        return []
    return [
        f"{len(angles)} fisheyes: undistorted to pinholes that keep {min(angles):.0f}° or more along the longer side, "
        f"their middle {min(shares):.2f} times as large as taken, or more"
    ]


def _pictures(work: Preparing) -> tuple[list[str], np.ndarray]:
    if work.body.exists():
        shutil.rmtree(work.body)  # of another stride, or of pictures that are gone
    footage, problems, shown, counts = work.footage(), list[str](), [], {}
    for lens in tqdm(work.cameras().lenses, desc="pictures", unit="camera", leave=False):
        name, found = lens.name, list[int]()
        for frame, pixels in footage[name].frames(work.options.stride, problems):
            if _fits(pixels, lens, f"frame {frame}", problems):
                save_jpeg(work.body / name / f"{frame:08d}.jpg", pixels)
                if not found:
                    shown.append((f"{name}  frame {frame}", pixels))
                found.append(frame)
        check(found, work.source, name, "a picture that can be read", problems[-1] if problems else "none")
        counts[name] = max(found) + 1
    said = [f"{min(counts.values())} to {max(counts.values())} frames a camera"]
    if len(set(counts.values())) > 1:
        said.append(
            "cameras differ in how many frames they have: they have to begin together: "
            + ", ".join(f"{name} {count}" for name, count in counts.items())
        )
    return [*said, *_first_of(problems)], tiles(shown)


def _fits(pixels: np.ndarray, lens: Lens, what: str, problems: list[str]) -> bool:
    """Whether a picture or matte is as large as the camera's; if not, it is one of the problems."""
    size, expected = (pixels.shape[1], pixels.shape[0]), (lens.camera.width, lens.camera.height)
    if size != expected:
        problems.append(f"{lens.name} {what}: expected {expected[0]}x{expected[1]} pixels, found {size[0]}x{size[1]}")
    return size == expected


def _first_of(problems: list[str]) -> list[str]:
    """Those that are printed."""
    more = len(problems) - SHOWN_FAULTS
    return [*problems[:SHOWN_FAULTS], *([f"… and {more} more"] if more > 0 else [])]


def _mattes(work: Preparing) -> tuple[list[str], np.ndarray]:
    given, problems = work.beside(MATTES), list[str]()
    shown, faults, ways = [], [], dict.fromkeys((IMPORTED, DIFFERENT, OWN), 0)
    for lens in tqdm(work.cameras().lenses, desc="mattes", unit="camera", leave=False):
        name, frames = lens.name, work.pictures(lens)
        folder = work.body / name / "mask"
        if folder.exists():
            shutil.rmtree(folder)
        way, mattes = _camera_mattes(work, lens, given.get(name), problems)
        last: tuple[str, np.ndarray] | None = None
        found = set[int]()
        for frame, matte in mattes:
            if frame not in frames or not _fits(matte, lens, f"matte of frame {frame}", problems):
                continue
            save_matte(folder / "pha" / f"{frame:08d}.png", matte)
            found.add(frame)
            faults += [f"{name} frame {frame}: {fault}" for fault in quality(matte).faults()]
            if last is None or frame == max(frames) // 2:
                last = (f"{name}  frame {frame}", outlined(read_image(frames[frame]), matte))
        ways[way] += len(found)
        shown += [last] if last else []
        missing = len(set(frames) - found)
        faults += [f"{name}: {missing} frames without a matte"] if missing else []
    expected = "mattes/CAMERA/…, mattes/CAMERA.mp4 or background/CAMERA.png"
    check(any(ways.values()), work.source, "", expected, problems[0] if problems else "none of them")
    said = [f"{count} mattes, {way}" for way, count in ways.items() if count]
    if work.first is None and any(one.first for one in given.values()):
        said.append("beside videos: files of mattes are numbered from 1")
    return [*said, *_first_of(problems), f"{len(faults)} doubtful", *faults[:SHOWN_FAULTS]], tiles(shown)


def _camera_mattes(
    work: Preparing, lens: Lens, given: Footage | None, problems: list[str]
) -> tuple[str, Iterator[tuple[int, np.ndarray]]]:
    """Where a camera's mattes come from, and they by frame, white the person."""
    stride, empty = work.options.stride, find_footage(work.source, BACKDROPS).get(lens.name)
    if given is not None:
        return IMPORTED, _given(given, stride, problems)
    if empty is not None:
        backdrop = next(iter(empty.frames()))[1][..., :3]
        if not _fits(backdrop, lens, "picture of the empty scene", problems):
            return DIFFERENT, iter(())
        frames = work.pictures(lens).items()
        return DIFFERENT, ((frame, difference_matte(read_image(path), backdrop)) for frame, path in frames)
    own = work.footage()[lens.name].frames(stride, [])  # what cannot be read was said before
    return OWN, ((frame, pixels[..., 3]) for frame, pixels in own if pixels.shape[2] == 4)


def _given(footage: Footage, stride: int, problems: list[str]) -> Iterator[tuple[int, np.ndarray]]:
    """A camera's mattes by frame, white the person."""
    rule = matte_rule(_grey(pixels) for _, (_, pixels) in zip(range(RULE_MATTES), footage.frames(stride, [])))
    for frame, pixels in footage.frames(stride, problems):
        yield frame, as_matte(_grey(pixels), rule)


def _grey(pixels: np.ndarray) -> np.ndarray:
    """(h, w) of a matte's picture: its alpha channel where it has one."""
    return np.asarray(pixels[..., 3] if pixels.shape[2] == 4 else pixels.max(2))


def _keypoints(work: Preparing) -> tuple[list[str], np.ndarray]:
    lenses = work.cameras().lenses
    points, confidence, problems = work.detections(landmarks().names)
    write_arrays(work.out / "steps" / "keypoints.npz", {"points": points, "confidence": confidence})
    joints = {"points": points[:, :, :55].astype(np.float32), "confidence": confidence[:, :, :55].astype(np.float32)}
    names = {"names": np.array(JOINT_NAMES), "cameras": np.array([lens.name for lens in lenses])}
    write_arrays(work.body / KEYPOINTS, {**names, **joints})
    shown = []
    for view, lens in enumerate(lenses):
        frames = work.pictures(lens)
        frame = min(len(points) // 2, max(frames, default=0))
        if frame in frames:
            shown.append(
                (
                    f"{lens.name}  frame {frame}",
                    dotted(read_image(frames[frame]), points[frame, view], confidence[frame, view]),
                )
            )
    said = [f"{len(points)} frames, {(confidence > 0).mean():.0%} of {confidence.shape[2]} landmarks found"]
    return [*said, *_first_of(problems)], tiles(shown)


def _fit(work: Preparing) -> tuple[list[str], np.ndarray]:
    cameras = work.cameras()
    kept = read_arrays(work.out / "steps" / "keypoints.npz", ("points", "confidence"), LARGEST_BYTES)
    wanted = work.options.held_out
    held_out = choice.frames(wanted, len(kept["points"]), "--held-out-frames") if wanted else ()
    person = load_person(work.options.person)
    found = fit_initial(cameras.lenses, kept["points"], kept["confidence"], cameras.scaled, work.options.height, person)
    rates = [rate for one in work.footage().values() if (rate := one.fps)]
    fps = (work.options.fps or (rates[0] if rates else 30.0)) / work.options.stride
    write_json(work.body / "calibration_full.json", calibration(found.lenses))
    write_arrays(work.body / "smpl_params.npz", found.parameters(fps))
    provenance = {"maker": "avatarrex-studio capture prepare", "calibration": cameras.kind, "source": work.source.name}
    write_json(
        work.out / "capture" / "capture.json",
        {"format": FORMAT, "provenance": provenance, "held_out_frames": {"body": held_out}},
    )
    middle, most = 1000 * np.nanpercentile(found.residuals(), (50, 95))
    agree = found.points.agree[found.points.found]
    said = [
        *([] if person.name == "default" else [f"on the files of --person {person.name} ({person.hash})"]),
        *found.notes,
        f"triangulated: {found.points.found.mean():.0%} of {len(landmarks().names)} landmarks, by {agree.mean():.1f} cameras in the mean",
        f"landmarks {middle:.0f} mm from the fitted person in the median, {most:.0f} mm at 95 %",
    ]
    capture = work.capture()
    count = capture.rigs["body"].frames
    return said, contact_sheet(
        capture, "body", tuple(np.unique(np.linspace(0, count - 1, SHOWN_FRAMES).round().astype(int)).tolist())
    )


def _face(work: Preparing) -> tuple[list[str], np.ndarray]:
    try:
        points, confidence, problems = work.detections(FACE_NAMES)
    except InputError as error:  # files in which a body was found
        points, confidence, problems = np.zeros((0, 2)), np.zeros(0), [str(error.found)]
    if not confidence.any():
        (work.out / FACE).unlink(missing_ok=True)
        nothing = "no landmarks of a face in the keypoints: expressions and jaw stay at rest"
        return [nothing, *_first_of(problems)], tiles(())
    capture = work.capture()
    points, confidence = (_of_length(values, capture.rigs["body"].frames) for values in (points, confidence))
    found, said, shown = find_expressions(capture, work.cameras().lenses, points, confidence)
    parameters = read_arrays(work.body / "smpl_params.npz")
    write_arrays(work.body / "smpl_params.npz", {**parameters, "arkit52": found.weights})
    kept = {"names": np.array(FACE_NAMES), "points": points, "confidence": confidence, "offsets": found.offsets}
    write_arrays(work.out / FACE, {**kept, "places": found.places, "believed": found.believed})
    return [*said, *_first_of(problems)], tiles(shown, 6)


def _of_length(values: np.ndarray, frames: int) -> np.ndarray:
    """The first `frames` (t, …), zeros where there are fewer: the last ones may have no landmarks."""
    return np.concatenate([values[:frames], np.zeros((max(frames - len(values), 0), *values.shape[1:]))])


STEPS: dict[str, Step] = {
    "cameras": Step(_cameras, ("", "calibration", "sparse", *PICTURES)),
    "pictures": Step(_pictures, PICTURES, ("stride",)),
    "mattes": Step(_mattes, (*MATTES, *BACKDROPS)),
    "keypoints": Step(_keypoints, ("keypoints",)),
    FIT: Step(_fit, (), ("fps", "height", "held_out"), True),
    "face": Step(_face, ("keypoints",)),
}
"""In their order."""
