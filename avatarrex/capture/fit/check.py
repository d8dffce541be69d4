"""How well a capture fits together: the posed template against its mattes, joints and meshes.

For some frames of every camera of the training's split (`splits.py`): share of the picture inside the matte, intersection over
union (IoU) of the template's silhouette with the matte (> 128), and the same for the capture's own mesh where it has one, which
tests the cameras alone. Letters: h w pixels, v vertices, f faces. World metres.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from PIL import Image
from tqdm import tqdm

from avatarrex.camera import Camera
from avatarrex.capture.fit.alignment import Alignment, alignment
from avatarrex.capture.fit.person_fit import height
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Splits
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.signals.driving import Signals
from avatarrex.templates.model import PosedTemplate, pose_by_signals
from avatarrex.templates.person import Person, load_person
from avatarrex.templates.transform import world_from_root

FOREGROUND = 128
"""A matte's value above which a pixel is the person."""
SILHOUETTE_PIXELS = 768
"""Pixels of the longer side at most, for silhouettes: at 1500×2048 the IoU differs by under 0.001 and costs 7 times more."""


@dataclass(frozen=True)
class Silhouette:
    """One picture's comparison."""

    view: int
    frame: int
    coverage: float
    """Share of the picture inside the matte."""
    template: float
    """IoU of the person's template."""
    unfitted: float | None
    """The same before the person's size was fitted."""
    mesh: float | None
    """IoU of the capture's own mesh."""
    alignment: Alignment | None
    """Of the person's template; None where either shows nothing."""


@dataclass(frozen=True)
class RigReport:
    """What was found about one rig; its cameras are those of the training's split."""

    rig: str
    frames: int
    trained: int
    """How many of the frames are the training's."""
    fps: float
    views: tuple[int, ...]
    """The cameras' numbers, in whose order the following are."""
    cameras: tuple[str, ...]
    sizes: tuple[str, ...]
    distances: tuple[float, ...]
    """Metres from each camera to the pelvis, median over frames."""
    missing: tuple[int, ...]
    """Pictures of the training's frames that each camera lacks."""
    held_out_frames: tuple[int, ...]
    held_out_cameras: tuple[str, ...]
    silhouettes: tuple[Silhouette, ...]
    joint_error_mm: tuple[float, float] | None
    """Mean and largest distance of the template's joints from the capture's."""

    @property
    def compared(self) -> tuple[int, ...]:
        """The compared frames."""
        return tuple(dict.fromkeys(item.frame for item in self.silhouettes))

    def mean(self, what: str, view: int | None = None) -> float | None:
        """Mean of a `Silhouette`'s number over the compared frames, of one camera or of all."""
        values = [getattr(item, what) for item in self.silhouettes if view in (None, item.view)]
        return None if not values or None in values else float(np.mean(values))

    def lean(self, view: int) -> float:
        """Median degrees by which a camera's outlines lean, clockwise; 0 where nothing is elongated."""
        leans = [item.alignment.lean_deg for item in self.silhouettes if item.view == view and item.alignment]
        return float(np.median([lean for lean in leans if lean is not None] or [0.0]))

    def shift(self, view: int) -> tuple[float, float]:
        """Median shift of a camera's outlines, right and down, in units of the square root of the matte's area."""
        shifts = [item.alignment.shift for item in self.silhouettes if item.view == view and item.alignment]
        right, down = np.median(shifts or [(0.0, 0.0)], axis=0)
        return float(right), float(down)


@dataclass(frozen=True)
class CaptureReport:
    """What was found about a capture."""

    path: str
    person_height: float
    """Metres."""
    rigs: tuple[RigReport, ...]
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def check_capture(capture: Capture, rigs: tuple[str, ...] | None = None, frames: int = 4) -> CaptureReport:
    """Compare `frames` frames of the training's split, in each of its cameras; the capture may be sealed to that.

    Raises `InputError` for a picture that cannot be decoded.
    """
    chosen = [capture.rigs[name] for name in rigs or capture.rigs]
    reports = tuple(_check_rig(capture, rig, frames) for rig in chosen)
    return CaptureReport(str(capture.path), height(capture.person), reports, capture.notes)


def posed_in_world(person: Person, signals: Signals) -> tuple[PosedTemplate, np.ndarray]:
    """The whole template with hands and face as `signals` say, in the root frame, and `world_from_root` (4, 4)."""
    posed = pose_by_signals(person.body, signals)
    pelvis = posed.joints[0].double().numpy()
    return posed, world_from_root(signals.global_orient, signals.translation, pelvis)


def template_surface(person: Person, signals: Signals) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) and joints (55, 3) of the posed template, world metres."""
    posed, world = posed_in_world(person, signals)
    vertices, joints = (
        points.double().numpy() @ world[:3, :3].T + world[:3, 3] for points in (posed.vertices, posed.joints)
    )
    return vertices, joints


def silhouette(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> np.ndarray:
    """(h, w) bool: pixel centres that the mesh covers."""
    return visible_faces(vertices, faces, camera)[0] >= 0


def iou(one: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union of two masks; 1 where both are empty."""
    union = (one | other).sum()
    return float((one & other).sum() / union) if union else 1.0


def compared_frames(frames: int, count: int) -> tuple[int, ...]:
    """At most `count` of the first `frames` numbers, evenly spread."""
    return tuple(np.unique(np.linspace(0, frames - 1, min(count, frames)).round().astype(int)).tolist())


def shown_frames(rig: Rig, count: int) -> tuple[int, ...]:
    """At most `count` of the training's frames, evenly spread."""
    frames = Splits.of(rig).train.frames
    return tuple(frames[place] for place in compared_frames(len(frames), count))


def _check_rig(capture: Capture, rig: Rig, count: int) -> RigReport:
    persons = {"template": capture.person}
    if capture.person.fit is not None:
        persons["unfitted"] = load_person(capture.person.name)
    train, silhouettes = Splits.of(rig).train, []
    for frame in tqdm(shown_frames(rig, count), desc=f"check {rig.name}", unit="frame", leave=False):
        meshes = {
            name: (template_surface(person, rig.signals[frame])[0], person.body.faces.numpy())
            for name, person in persons.items()
        }
        if truth := capture.ground_truth.get(rig.name):
            meshes["mesh"] = (truth.vertices[frame], truth.faces)
        available = (view for view in train.views if rig.available(view, frame))
        silhouettes += [_compare(rig, view, frame, meshes) for view in available]
    some = [rig.signals[frame] for frame in shown_frames(rig, 8)]
    pelvis = np.stack([template_surface(capture.person, signals)[1][0] for signals in some] or [np.full(3, np.nan)])
    views = [rig.views[view] for view in train.views]
    return RigReport(
        rig=rig.name,
        frames=rig.frames,
        trained=len(train.frames),
        fps=rig.signals.fps,
        views=train.views,
        cameras=tuple(view.name for view in views),
        sizes=tuple(f"{view.camera.width}x{view.camera.height}" for view in views),
        distances=tuple(float(np.linalg.norm(np.median(pelvis, 0) - view.camera.centre)) for view in views),
        missing=tuple(sum((view, frame) in rig.missing for frame in train.frames) for view in train.views),
        held_out_frames=tuple(sorted(rig.held_out_frames)),
        held_out_cameras=tuple(rig.views[view].name for view in sorted(rig.held_out_views)),
        silhouettes=tuple(silhouettes),
        joint_error_mm=joint_error(capture, rig),
    )


def _compare(rig: Rig, view: int, frame: int, meshes: dict[str, tuple[np.ndarray, np.ndarray]]) -> Silhouette:
    camera = reduced(rig.views[view].camera)
    matte = rig.matte(view, frame)
    inside = np.array(Image.fromarray(matte).resize((camera.width, camera.height), Image.Resampling.BOX)) > FOREGROUND
    drawn = {name: silhouette(*mesh, camera) for name, mesh in meshes.items()}
    found = {name: iou(mask, inside) for name, mask in drawn.items()}
    coverage, lies = float((matte > FOREGROUND).mean()), alignment(drawn["template"], inside)
    return Silhouette(view, frame, coverage, found["template"], found.get("unfitted"), found.get("mesh"), lies)


def reduced(camera: Camera, side: int = SILHOUETTE_PIXELS) -> Camera:
    """The same view with its longer side at most `side` pixels."""
    factor = min(1.0, side / max(camera.width, camera.height))
    return camera.resized(round(camera.width * factor), round(camera.height * factor))


def joint_error(capture: Capture, rig: Rig) -> tuple[float, float] | None:
    """Mean and largest distance, mm, of the posed person's joints from the capture's over all frames; None without any."""
    distances = joint_distances(capture, rig, range(rig.frames))
    return None if distances is None else (float(1000 * distances.mean()), float(1000 * distances.max()))


def joint_distances(capture: Capture, rig: Rig, frames: Iterable[int]) -> np.ndarray | None:
    """(t, 55) metres between the posed person's joints and the capture's; None without any."""
    truth = capture.ground_truth.get(rig.name)
    if truth is None or truth.joints is None:
        return None
    # no expression: a regressor's joints would follow it, and the shape alone places ours
    neutral = {frame: rig.signals[frame].replace(expression=np.zeros(52)) for frame in frames}
    posed = [template_surface(capture.person, signals)[1] - truth.joints[frame] for frame, signals in neutral.items()]
    return np.asarray(np.linalg.norm(posed, axis=2))
