"""An avatar against a capture: pictures from its cameras under its signals, measured by split (`capture/readers/splits.py`).

| split | part | the frame was | the camera was |
|---|---|---|---|
| `train` | | trained on | trained on |
| `validation` | | kept for the training's own figures | trained on |
| `test` | `held-out pose` | held out | trained on |
| | `held-out view` | not held out | held out |
| | `held-out both` | held out | held out |

Pictures are compared over black: the captured one is premultiplied by its matte, at the evaluated size by a box filter.
Where the capture has true meshes, the surfaces are compared too, per frame, over all cameras that are evaluated.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Capture, Rig
from avatarrex.capture.readers.splits import Splits
from avatarrex.errors import check
from avatarrex.metrics.baselines import Observation
from avatarrex.metrics.drawing import Drawer, Drawing, Truth, fitted, over_black
from avatarrex.metrics.measures import Measured, Networks, means, measure
from avatarrex.metrics.mesh import Surface, depth_surface, distances, sampled

Item = TypeVar("Item")
TEST = ("held-out pose", "held-out view", "held-out both")
"""Parts of the test."""
SPLITS = ("train", "validation", "test", *TEST)
FRAMES_EACH = 4
"""Frames evaluated of each split, unless chosen."""
OBSERVATIONS = 360
"""Training pictures of the rig that the baselines' colours come from, at most: as many as a body's static detail is registered to
(`training/core/projection.py`)."""
OBSERVED_SIZE = 1024
"""Pixels of their longer side at most: finer than the texels."""
SURFACE_PIXELS = 150_000
"""Points a camera contributes to a surface at most."""


@dataclass(eq=False)
class Evaluation:
    """Every measured picture and surface."""

    rig: Rig
    frames: tuple[int, ...]
    views: tuple[int, ...]
    size: tuple[int, int]
    """Width and height of the first camera's pictures."""
    missing: dict[str, str]
    """Measures without a value: the weights that are not there."""
    pictures: list[Measured] = field(default_factory=list)
    surfaces: list[dict[str, Any]] = field(default_factory=list)
    """`subject`, `frame`, `split`, and `to_truth`, `from_truth` with `mean_mm`, `p95_mm`, `angle_deg`."""
    samples: dict[tuple[int, int], dict[str, np.ndarray]] = field(default_factory=dict)
    """By (view, frame): pictures (h, w, 4) in [0, 1] of `truth` and every subject, for a contact sheet."""

    @property
    def subjects(self) -> tuple[str, ...]:
        """In the order they were drawn."""
        return tuple(dict.fromkeys(picture.subject for picture in self.pictures))

    def grouped(self, key: str) -> dict[Any, dict[str, dict[str, float | None]]]:
        """Means by `split` (of `SPLITS`; the test's pictures are in their part, too), `view` or `frame`, then by subject."""
        groups: dict[Any, list[Measured]] = {}
        for picture in self.pictures:
            place = getattr(picture, key)
            for group in ("test", place) if place in TEST else (place,):
                groups.setdefault(group, []).append(picture)
        ordered = [split for split in SPLITS if split in groups] if key == "split" else list(groups)
        return {
            place: {subject: means(p for p in groups[place] if p.subject == subject) for subject in self.subjects}
            for place in ordered
        }

    def add_surfaces(self, frame: int, truth: Surface, drawn: dict[str, list[tuple[Drawing, Camera]]]) -> None:
        """Compare what the cameras saw of each subject with the true surface."""
        for name, drawings in drawn.items():
            if found := compare_surfaces(truth, drawings):
                split = _frame_split(self.rig, frame)
                self.surfaces.append({"subject": name, "frame": frame, "split": split, **found})

    def surface_means(self) -> dict[str, dict[str, dict[str, dict[str, float]]]]:
        """Split of the frame (`train`, `validation` or `held-out pose`), subject, direction, measure: means over frames."""
        found: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
        for split in ("train", "validation", "held-out pose"):
            for subject in self.subjects:
                rows = [row for row in self.surfaces if row["split"] == split and row["subject"] == subject]
                if rows:
                    found.setdefault(split, {})[subject] = {
                        way: {key: float(np.mean([row[way][key] for row in rows])) for key in rows[0][way]}
                        for way in ("to_truth", "from_truth")
                    }
        return found


@dataclass(frozen=True)
class Choice:
    """What is evaluated of a rig."""

    frames: Iterable[int] | None = None
    """Some of each split unless given."""
    views: Iterable[int] | None = None
    """All unless given."""
    size: int | None = None
    """Bound of the longer side, pixels."""
    sheet: int = 0
    """How many pictures to keep for a contact sheet."""


def evaluate(
    capture: Capture,
    rig: Rig,
    subjects: Sequence[Drawer],
    networks: Networks,
    choice: Choice = Choice(),
    progress: bool = False,
) -> Evaluation:
    """Draw and measure the `subjects` in the chosen pictures. Raises `InputError` where the rig has none of them."""
    frames = _chosen("frame", choice.frames, default_frames(rig), rig.frames)
    views = _chosen("view", choice.views, range(len(rig.views)), len(rig.views))
    pairs = [(view, frame) for frame in frames for view in views if rig.available(view, frame)]
    check(pairs, capture.path, rig.name, "pictures of the chosen frames and views", "none")
    first = fitted(rig.views[views[0]].camera, choice.size)
    result = Evaluation(rig, frames, views, (first.width, first.height), networks.missing)
    kept = _kept(rig, pairs, choice.sheet)
    with tqdm(total=len(pairs), unit="picture", disable=not progress) as bar:
        for frame in frames:
            surface = _true_surface(capture, rig, frame)
            drawn: dict[str, list[tuple[Drawing, Camera]]] = {subject.name: [] for subject in subjects}
            for view in (view for view, of in pairs if of == frame):
                camera = fitted(rig.views[view].camera, choice.size)
                truth = captured(rig, view, frame, camera)
                images = {"truth": truth.layers()}
                for subject in subjects:
                    drawing = subject.draw(rig.signals[frame], camera)
                    place = subject.name, rig.views[view].name, frame, split_of(rig, view, frame)
                    result.pictures.append(Measured(*place, *measure(drawing, truth, networks)))
                    images[subject.name] = drawing.image.numpy()
                    if surface is not None:
                        drawn[subject.name].append(_thinned(drawing, camera))
                if (view, frame) in kept:
                    result.samples[view, frame] = images
                bar.update()
            if surface is not None:
                result.add_surfaces(frame, surface, drawn)
    return result


def split_of(rig: Rig, view: int, frame: int) -> str:
    """Which of `SPLITS` a picture belongs to; of the test the part."""
    if view in rig.held_out_views:
        return "held-out both" if frame in rig.held_out_frames else "held-out view"
    return _frame_split(rig, frame)


def default_frames(rig: Rig) -> tuple[int, ...]:
    """`FRAMES_EACH` of each split, evenly spread."""
    splits = Splits.of(rig)
    return tuple(sorted(frame for split in vars(splits).values() for frame in spread(split.frames, FRAMES_EACH)))


def _frame_split(rig: Rig, frame: int) -> str:
    """Of a camera that was trained on."""
    if frame in rig.held_out_frames:
        return "held-out pose"
    return "validation" if frame in Splits.of(rig).validation.frames else "train"


def captured(rig: Rig, view: int, frame: int, camera: Camera) -> Truth:
    """A captured picture over black, at the size of `camera`."""
    return over_black(rig.image(view, frame), rig.matte(view, frame), camera.width, camera.height)


def observations(rig: Rig, count: int = OBSERVATIONS) -> Iterator[Observation]:
    """Training pictures spread over frames and views; of everything where all is held out."""
    pairs = [(v, f) for f in range(rig.frames) for v in range(len(rig.views)) if rig.available(v, f)]
    training = [pair for pair in pairs if split_of(rig, *pair) == "train"] or pairs
    for view, frame in _observed(training, count):
        camera = fitted(rig.views[view].camera, OBSERVED_SIZE)
        if camera is rig.views[view].camera:
            yield Observation(rig.signals[frame], camera, rig.image(view, frame), rig.matte(view, frame))
        else:
            yield Observation.of(rig.signals[frame], camera, captured(rig, view, frame, camera).layers())


def compare_surfaces(truth: Surface, drawn: list[tuple[Drawing, Camera]]) -> dict[str, dict[str, float]]:
    """Both directions, or nothing where the subject is seen by no camera."""
    own = Surface.joined([depth_surface(d.position, d.normal, d.hit, camera) for d, camera in drawn])
    if not len(own.faces):
        return {}
    points = np.concatenate([d.position[d.hit] for d, _ in drawn]).astype(np.float64)
    normals = np.concatenate([d.normal[d.hit] for d, _ in drawn]).astype(np.float64)
    true_points, true_normals = (np.concatenate(x) for x in zip(*(truth.seen_by(camera) for _, camera in drawn)))
    return {
        "to_truth": distances(*sampled(points, normals), truth),
        "from_truth": distances(*sampled(true_points, true_normals), own),
    }


def _true_surface(capture: Capture, rig: Rig, frame: int) -> Surface | None:
    truth = capture.ground_truth.get(rig.name)
    return None if truth is None else Surface.of(truth.vertices[frame], truth.faces)


def _thinned(drawing: Drawing, camera: Camera) -> tuple[Drawing, Camera]:
    """Every k-th pixel, so that a camera contributes at most `SURFACE_PIXELS`."""
    step = int(np.ceil(np.sqrt(drawing.hit.size / SURFACE_PIXELS)))
    if step == 1:
        return drawing, camera
    pick = (slice(step // 2, None, step), slice(step // 2, None, step))
    position, normal, hit = (np.ascontiguousarray(x[pick]) for x in (drawing.position, drawing.normal, drawing.hit))
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, 2] -= step // 2 + 0.5  # the picked pixel's centre becomes the first one's
    intrinsics[:2] /= step
    intrinsics[:2, 2] += 0.5
    thin = Camera(intrinsics, camera.camera_from_world, hit.shape[1], hit.shape[0])
    return Drawing(drawing.image[pick], position, normal, hit), thin


def _chosen(what: str, given: Iterable[int] | None, default: Iterable[int], count: int) -> tuple[int, ...]:
    chosen = tuple(dict.fromkeys(default if given is None else given))
    for index in chosen:
        check(0 <= index < count, "evaluate", what, f"0 to {count - 1}", index)
    check(chosen, "evaluate", what, "at least one", "none")
    return chosen


def _kept(rig: Rig, pairs: list[tuple[int, int]], count: int) -> set[tuple[int, int]]:
    """Pictures for a contact sheet, by chance, the same each time: of held-out frames where there are any."""
    held_out = [pair for pair in pairs if pair[1] in rig.held_out_frames] or pairs
    return {held_out[k] for k in np.random.default_rng(0).permutation(len(held_out))[:count]}


def _observed(training: list[tuple[int, int]], count: int) -> list[tuple[int, int]]:
    """At most `count` pictures, as many of each view, its frames evenly spread and other than the next view's."""
    views = sorted({view for view, _ in training})
    each = max(count // len(views), 1)
    chosen = []
    for number, view in enumerate(views[:count]):
        frames = [frame for of, frame in training if of == view]
        places = (np.arange(each) + number / len(views)) / each * len(frames)
        chosen += [(view, frames[place]) for place in np.unique(places.astype(int))]
    return chosen


def spread(items: Sequence[Item], count: int) -> list[Item]:
    """At most `count` of them, evenly spread, both ends among them."""
    return [items[k] for k in np.unique(np.linspace(0, len(items) - 1, count).round().astype(int))] if items else []
