"""A person's size and poses from keypoints alone: triangulated, measured, fitted. No network has a say in it.

Size: ten shape directions and the lengths of limbs, by the median distances of landmarks over all frames. World: metres with +Y up; a
calibration without a scale (COLMAP's) takes its own from the person. Letters: t frames, c cameras, l landmarks, b bones.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.capture.fit.keypoint_pose import Bones, Poses, fit_poses
from avatarrex.capture.fit.landmarks import landmarks, landmarks_of
from avatarrex.capture.fit.person_fit import HEIGHT, height
from avatarrex.capture.fit.triangulation import Points, triangulate
from avatarrex.capture.importers.axes import TURNS
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.undistort import straighten
from avatarrex.errors import InputError
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES, JOINT_ROWS
from avatarrex.templates.person import Person, load_person

MEASURED = (
    ("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "middle1"), ("ankle", "big_toe"),
)  # fmt: skip
"""Ends of limbs, of either side."""
ACROSS = (
    ("left_hip", "right_hip"),
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "left_shoulder"),
    ("right_hip", "right_shoulder"),
)
LENGTHENED = MEASURED[:4]
"""Limbs that take the length that was measured."""
LENGTH_SIGMA = 0.015
"""Metres that a limb's length is off: detectors do not mark the joints' centres."""
LONGER = (0.85, 1.18)
"""What a limb's length may be of that of the shape."""
LEAST_FRAMES = 1
SNAP = np.cos(np.radians(25))
"""How near the trunk has to be to an axis that is then up."""


@dataclass(frozen=True, eq=False)
class Initial:
    """What keypoints say."""

    lenses: tuple[Lens, ...]
    """Cameras in the world of the poses."""
    bones: Bones
    shape: np.ndarray
    """β, (10,), in the person's own directions."""
    poses: Poses
    points: Points
    height: float
    """Metres, of the person."""
    notes: tuple[str, ...]

    def parameters(self, fps: float) -> dict[str, np.ndarray]:
        """`smpl_params.npz`."""
        pose = self.poses.rotvecs()
        flat = {name: pose[:, rows].reshape(len(pose), -1) for name, rows in JOINT_ROWS.items() if name != "eye_pose"}
        return {
            **flat, "transl": self.poses.place, "tpose_joints": self.bones.joints, "flat_hand_mean": np.array(True), "fps": np.array(fps),
            "arkit52": np.zeros((len(pose), 52)), "arkit_names": np.array(EXPRESSION_NAMES),
        }  # fmt: skip

    def residuals(self) -> np.ndarray:
        """(t, l) metres from the fitted to the triangulated landmarks; NaN where there is none."""
        turned, places = self.poses.posed(self.bones)
        marks = self.bones.marks
        there = places[:, marks.joints] + np.einsum("tlij,lj->tli", turned[:, marks.joints], marks.offsets)
        return np.where(self.points.found, np.linalg.norm(there - self.points.position, axis=2), np.nan)


def fit_initial(
    lenses: tuple[Lens, ...],
    points: np.ndarray,
    confidence: np.ndarray,
    scaled: bool = True,
    tall: float | None = None,
    person: Person | None = None,
) -> Initial:
    """From points (t, c, l, 2) in the pictures as taken, landmarks in their order, with confidence (t, c, l).

    `scaled`: the cameras' world is in metres, with an axis up; `tall` the person's height in metres, where somebody has measured it;
    `person` the template, or the default one. Raises `InputError` where no two cameras agree on a trunk.
    """
    person = person or load_person()
    notes: list[str] = []
    ideal = np.stack([straighten(lens, points[:, view]) for view, lens in enumerate(lenses)], 1)
    seen = np.isfinite(ideal).all(-1)
    ideal, confidence = np.where(seen[..., None], ideal, 0), confidence * seen
    found = triangulate(tuple(lens.camera for lens in lenses), ideal, confidence)
    trunk = landmarks().rows(("left_hip", "right_hip", "left_shoulder", "right_shoulder"))
    whole = found.found[:, trunk].all(1)
    if whole.sum() < LEAST_FRAMES:
        raise InputError("keypoints", "", "a frame in which two cameras agree on hips and shoulders", "none")
    turn = _up(found.position[whole][:, trunk], scaled, notes)
    scale = _scale(found, person, scaled, tall, notes)
    lenses = tuple(_moved(lens, turn, scale) for lens in lenses)
    position = scale * turn.apply(found.position.reshape(-1, 3)).reshape(found.position.shape)
    matrix = turn.as_matrix()
    found = Points(position, matrix @ found.information @ matrix.T / scale**2, found.agree)
    bones, shape, size = fit_size_to(found, person)
    if not HEIGHT[0] <= size <= HEIGHT[1]:
        raise InputError(
            "keypoints",
            "",
            f"a person {HEIGHT[0]} to {HEIGHT[1]} m tall",
            f"{size:.2f} m: the cameras' unit is another",
        )
    notes.append(f"person: {size:.2f} m tall, by the lengths of limbs")
    return Initial(lenses, bones, shape, fit_poses(bones, found), found, size, tuple(notes))


def fit_size_to(points: Points, person: Person) -> tuple[Bones, np.ndarray, float]:
    """Bones, β (10,) and height in metres, by the median lengths of limbs."""
    body = person.body.double()
    template, directions = body.joint_template.numpy(), body.joint_shapedirs[..., :10].numpy()
    bones = bones_of(person)
    marks = bones.marks
    shape: np.ndarray = np.zeros(10)
    for _ in range(4):
        rows, off = [], []
        for start, stop, length in _lengths(points):
            way = bones.rest[stop] - bones.rest[start]
            change = directions[marks.joints[stop]] - directions[marks.joints[start]]
            rows.append(way @ change / np.linalg.norm(way))
            off.append(length - np.linalg.norm(way))
        matrix, right = np.array(rows).reshape(-1, 10) / LENGTH_SIGMA, np.array(off) / LENGTH_SIGMA
        shape = np.linalg.solve(matrix.T @ matrix + np.eye(10), matrix.T @ (right + matrix @ shape))
        joints = template + directions @ shape
        bones = replace(bones, joints=joints - joints[0])
    rest = (body.v_template + body.shapedirs[..., :10] @ body.v_template.new_tensor(shape)).numpy()[:, 1]
    return _lengthened(bones, points), shape, float(rest.max() - rest.min())


def bones_of(person: Person) -> Bones:
    """Of a template in its own size."""
    joints = person.body.joint_template.double().numpy()
    return Bones(joints - joints[0], person.body.parents, landmarks_of(person))


def _lengths(points: Points) -> Iterable[tuple[int, int, float]]:
    """Landmarks, and the median distance between them, of limbs that were seen."""
    pairs = [(f"{side}_{a}", f"{side}_{b}") for a, b in MEASURED for side in ("left", "right")]
    for one, other in (*pairs, *ACROSS):
        start, stop = landmarks().rows((one, other))
        both = points.found[:, start] & points.found[:, stop]
        if both.any():
            yield (
                start,
                stop,
                float(np.median(np.linalg.norm(points.position[both, start] - points.position[both, stop], axis=1))),
            )


def _lengthened(bones: Bones, points: Points) -> Bones:
    """Limbs as long as they were measured, either side alike."""
    joints = bones.joints.copy()
    lengths = {(start, stop): length for start, stop, length in _lengths(points)}
    for one, other in LENGTHENED:
        ratios = []
        for side in ("left", "right"):
            start, stop = landmarks().rows((f"{side}_{one}", f"{side}_{other}"))
            if (start, stop) in lengths:
                ratios.append(lengths[start, stop] / np.linalg.norm(bones.joints[stop] - bones.joints[start]))
        if not ratios:
            continue
        longer = float(np.clip(np.mean(ratios), *LONGER)) - 1
        for side in ("left", "right"):
            start, stop = (JOINT_NAMES.index(f"{side}_{name}") for name in (one, other))
            moved = longer * (bones.joints[stop] - bones.joints[start])
            for joint in range(55):
                ancestor = joint
                while ancestor not in (stop, -1):
                    ancestor = bones.parents[ancestor]
                if ancestor == stop:
                    joints[joint] += moved
    return Bones(joints, bones.parents, bones.marks)


def _up(trunk: np.ndarray, scaled: bool, notes: list[str]) -> Rotation:
    """What turns the world to +Y up, by hips and shoulders (t, 4, 3): by quarter turns where its axes mean something."""
    way = trunk[:, 2:].mean(1) - trunk[:, :2].mean(1)
    way = np.median(way / np.linalg.norm(way, axis=1, keepdims=True), axis=0)
    way /= np.linalg.norm(way)
    axis = int(np.abs(way).argmax())
    name = f"{'-' if way[axis] < 0 else '+'}{'XYZ'[axis]}"
    if scaled and abs(way[axis]) > SNAP:
        if name == "+Y":
            return Rotation.identity()
        notes.append(f"axes: the person stands along {name} of the calibration's world, turned to +Y up")
        return TURNS[name]
    notes.append("axes: no axis of the calibration's world is up: turned so that the person's trunk is")
    return Rotation.align_vectors([[0.0, 1.0, 0.0]], [way])[0]


def _scale(points: Points, person: Person, scaled: bool, tall: float | None, notes: list[str]) -> float:
    """Metres of a unit of the cameras' world."""
    rest = bones_of(person).rest
    own = float(
        np.median([np.linalg.norm(rest[start] - rest[stop]) / length for start, stop, length in _lengths(points)])
    )
    if not scaled:
        tall = tall or height(person)
        found = own * tall / height(person)
        notes.append(f"unit: the calibration has none; {found:.4g} m each, for a person {tall:.2f} m tall")
        return found
    for unit, name in ((1e-3, "millimetres"), (1e-2, "centimetres")):
        if 0.7 < own / unit < 1.4:
            notes.append(f"unit: camera positions in {name}, converted to metres")
            return unit
    return 1.0


def _moved(lens: Lens, turn: Rotation, scale: float) -> Lens:
    """The camera in the world that was turned, then scaled."""
    matrix = lens.camera.camera_from_world.copy()
    matrix[:3, :3] = matrix[:3, :3] @ turn.inv().as_matrix()
    matrix[:3, 3] *= scale
    return replace(lens, camera=replace(lens.camera, camera_from_world=matrix))
