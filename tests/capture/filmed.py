"""A folder as somebody who filmed has it: images or videos, mattes, a calibration and keypoints, made from the clothed subject."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from capture.clothed import Clothed
from PIL import Image
from scipy.spatial.transform import Rotation

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.fit.face_marks import FACE_NAMES, VERTICES
from avatarrex.capture.fit.landmarks import landmarks, landmarks_of
from avatarrex.capture.importers.detections import BODY_25, BODY_33, HAND_21, IBUG, MESH
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import Person, load_person

BACKDROP = np.array([90, 110, 130], np.uint8)


def exact_landmarks(motion: Iterable[Signals], person: Person | None = None) -> np.ndarray:
    """(t, l, 3) world metres, of the default person or another."""
    person = person or load_person()
    found, marks = [], landmarks_of(person)
    for signals in motion:
        vertices, joints = template_surface(person, signals.replace(expression=np.zeros(52)))
        found.append(np.concatenate([joints, vertices[marks.vertices[55:]]]))
    return np.array(found)


def exact_faces(motion: Iterable[Signals]) -> np.ndarray:
    """(t, l, 3) world metres, of the face's landmarks."""
    rows = list(VERTICES.values())
    return np.array([template_surface(load_person(), signals)[0][rows] for signals in motion])


def detected(places: np.ndarray, cameras: list[Camera], pixels: float, wrong: float, seed: int = 1) -> np.ndarray:
    """(t, c, l, 3) what a detector says of places (t, l, 3): column, row, confidence; a share is anywhere in the picture."""
    rng = np.random.default_rng(seed)
    found = np.ones((len(places), len(cameras), places.shape[1], 3))
    for view, camera in enumerate(cameras):
        found[:, view, :, :2] = camera.pixels(places)[0] + pixels * rng.standard_normal((*places.shape[:2], 2))
    anywhere = rng.random(found.shape[:3]) < wrong
    found[anywhere, :2] = rng.uniform(0, 1, (int(anywhere.sum()), 2)) * (cameras[0].width, cameras[0].height)
    return found


def openpose(triples: np.ndarray, names: tuple[str, ...] = landmarks().names) -> dict:
    """One picture's file, of (l, 3)."""

    def flat(wanted: tuple[str | None, ...]) -> list[float]:
        rows = [triples[names.index(name)] - [0.5, 0.5, 0] if name in names else np.zeros(3) for name in wanted]
        return [round(float(value), 3) for value in np.ravel(rows)]

    hands = {
        f"hand_{side}_keypoints_2d": flat(tuple(f"{side}_{name}" for name in HAND_21)) for side in ("left", "right")
    }
    person = {
        "person_id": [-1],
        "pose_keypoints_2d": flat(BODY_25),
        "face_keypoints_2d": flat((*IBUG, None, None)),
        **hands,
    }
    return {"version": 1.3, "people": [person]}


def mediapipe(triples: np.ndarray, size: tuple[int, int], names: tuple[str, ...] = landmarks().names) -> dict:
    """One frame of a camera's file, of (l, 3)."""

    def one(name: str | None) -> dict[str, float]:
        x, y, sure = triples[names.index(name)] if name in names else (0.0, 0.0, 0.0)
        return {"x": float(x / size[0]), "y": float(y / size[1]), "z": 0.0, "visibility": float(sure)}

    hands = {f"{side}_hand_landmarks": [one(f"{side}_{name}") for name in HAND_21] for side in ("left", "right")}
    face = [one(MESH.get(k)) for k in range(478)] if FACE_NAMES[0] in names else []
    return {"pose_landmarks": [one(BODY_33.get(k)) for k in range(33)], "face_landmarks": face, **hands}


def toml(cameras: dict[str, Camera]) -> str:
    """As Caliscope and Pose2Sim write it."""
    lines = []
    for name, camera in cameras.items():
        k, pose = camera.intrinsics.copy(), camera.camera_from_world
        k[:2, 2] -= 0.5
        turn = Rotation.from_matrix(pose[:3, :3]).as_rotvec().tolist()
        lines += [
            f"[{name}]",
            f'name = "{name}"',
            f"size = [{camera.width}.0, {camera.height}.0]",
            f"matrix = {k.tolist()}",
        ]
        lines += [
            "distortions = [0.0, 0.0, 0.0, 0.0]",
            f"rotation = {turn}",
            f"translation = {pose[:3, 3].tolist()}",
            "fisheye = false",
            "",
        ]
    return "\n".join([*lines, "[metadata]", "adjusted = false", "error = 0.0", ""])


def easymocap(cameras: dict[str, Camera]) -> dict[str, str]:
    """OpenCV's YAML, in two files."""

    def matrix(key: str, values: np.ndarray) -> str:
        data = ", ".join(f"{value:.12g}" for value in values.ravel())
        return (
            f"{key}: !!opencv-matrix\n  rows: {values.shape[0]}\n  cols: {values.shape[1]}\n  dt: d\n  data: [{data}]\n"
        )

    head = "%YAML:1.0\n---\nnames:\n" + "".join(f'  - "{name}"\n' for name in cameras)
    intri, extri = head, head
    for name, camera in cameras.items():
        k, pose = camera.intrinsics.copy(), camera.camera_from_world
        k[:2, 2] -= 0.5
        intri += matrix(f"K_{name}", k) + matrix(f"dist_{name}", np.zeros((1, 5)))
        extri += matrix(f"R_{name}", Rotation.from_matrix(pose[:3, :3]).as_rotvec()[:, None])
        extri += matrix(f"Rot_{name}", pose[:3, :3]) + matrix(f"T_{name}", pose[:3, 3:])
    return {"intri.yml": intri, "extri.yml": extri}


def colmap(cameras: dict[str, Camera], scale: float = 0.2) -> dict[str, str]:
    """COLMAP's text: another unit, another orientation."""
    turn = Rotation.from_rotvec([0.9, -0.4, 0.3])
    intri, extri = "# cameras\n", "# images\n"
    for number, (name, camera) in enumerate(cameras.items(), 1):
        k, pose = camera.intrinsics, camera.camera_from_world
        intri += f"{number} PINHOLE {camera.width} {camera.height} {k[0, 0]} {k[1, 1]} {k[0, 2]} {k[1, 2]}\n"
        x, y, z, w = (Rotation.from_matrix(pose[:3, :3]) * turn.inv()).as_quat()
        tx, ty, tz = scale * pose[:3, 3]
        extri += f"{number} {w} {x} {y} {z} {tx} {ty} {tz} {number} {name}.jpg\n\n"
    return {"cameras.txt": intri, "images.txt": extri}


def film(
    one: Clothed,
    out: Path,
    calibration: Callable[[dict[str, Camera]], dict[str, str]] | None = None,
    backdrop: bool = False,
    faces: bool = False,
    person: Person | None = None,
) -> Path:
    """Images, mattes (or a picture of the empty scene), OpenPose files, and Caliscope's calibration unless another is given.

    `faces`: landmarks of the face are in these files; `person`: whose the body's are, the default one's unless given.
    """
    files = {"calibration.toml": toml(one.lenses)} if calibration is None else calibration(one.lenses)
    out.mkdir(parents=True)
    for name, text in files.items():
        (out / name).write_text(text)
    found = detected(exact_landmarks(one.motion, person), list(one.lenses.values()), 2.0 * one.size[1] / 512, 0.05)
    names = landmarks().names
    if faces:
        marks = detected(exact_faces(one.motion), list(one.lenses.values()), 2.0 * one.size[1] / 512, 0.05, 2)
        found, names = np.concatenate([found, marks], 2), (*names, *FACE_NAMES)
    for view, name in enumerate(one.lenses):
        for folder in (out / "images" / name, out / "mattes" / name, out / "keypoints" / name, out / "background"):
            folder.mkdir(parents=True, exist_ok=True)
        for frame in range(one.frames):
            matte = one.mattes[name, frame]
            share = matte[..., None] / 255
            picture = np.uint8(share * np.array([210, 150, 120]) + (1 - share) * BACKDROP)
            Image.fromarray(picture).save(out / "images" / name / f"frame{frame:04d}.png")
            if not backdrop:
                Image.fromarray(matte).save(out / "mattes" / name / f"{frame:04d}.png")
            said = json.dumps(openpose(found[frame, view], names))
            (out / "keypoints" / name / f"{name}_{frame:012d}_keypoints.json").write_text(said)
        if backdrop:
            Image.fromarray(np.broadcast_to(BACKDROP, (*one.mattes[name, 0].shape, 3)).copy()).save(
                out / "background" / f"{name}.png"
            )
    return out
