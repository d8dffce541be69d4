"""The same small capture written in each layout of the field: keys, shapes, units, axes and quirks as published."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from capture.tiny_capture import cameras, motion, npz, parameters, png
from PIL import Image
from scipy.spatial.transform import Rotation

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import silhouette, template_surface
from avatarrex.capture.importers.faces import EYES, FLIP
from avatarrex.capture.readers.rigs import SMPLX_PELVIS
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import load_person

BACKDROP = (70, 96, 120)


@dataclass(frozen=True, eq=False)
class Scene:
    """What every layout tells."""

    signals: list[Signals]
    cameras: dict[str, Camera]
    images: dict[tuple[str, int], np.ndarray]
    mattes: dict[tuple[str, int], np.ndarray]

    @property
    def pairs(self) -> list[tuple[str, int]]:
        return list(self.images)


def scene(scale: int = 2, seed: int = 3, rig: str = "body") -> Scene:
    """Three frames of the default person, who moves a little, before three cameras (of a face one)."""
    signals = motion(np.random.default_rng(seed), np.zeros(10))
    found: tuple[dict, dict] = ({}, {})
    for frame, one in enumerate(signals):
        vertices, _ = template_surface(load_person(), one)
        for name, camera in cameras(rig, scale).items():
            mask = silhouette(vertices, load_person().body.faces.numpy(), camera)
            shade = np.linspace(120, 220, mask.shape[0])[:, None, None] * np.array([1.0, 0.7, 0.5])
            found[0][name, frame] = np.where(mask[..., None], shade, BACKDROP).astype(np.uint8)
            found[1][name, frame] = np.uint8(255 * mask)
    return Scene(signals, cameras(rig, scale), *found)


def put(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def jpg(pixels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=95, subsampling=0)
    return stream.getvalue()


def pickled(value: object) -> bytes:
    """As `np.save` writes an object."""
    stream = io.BytesIO()
    np.save(stream, np.array(value, dtype=object), allow_pickle=True)
    return stream.getvalue()


def smplx(one: Scene) -> dict[str, np.ndarray]:
    """SMPL-X parameters: the pelvis is at its J_0 + transl."""
    arrays = parameters(one.signals, False)
    kept = {
        name: value
        for name, value in arrays.items()
        if not name.startswith("arkit") and name not in ("leye_pose", "reye_pose")
    }
    return {**kept, "transl": arrays["transl"] - SMPLX_PELVIS}


def written_avatarrex(one: Scene, out: Path) -> None:
    entries = {name: _json_camera(camera) for name, camera in one.cameras.items()}
    put(out / "calibration_full.json", json.dumps(entries).encode())
    put(out / "smpl_params.npz", npz(**{name: value.astype(np.float32) for name, value in smplx(one).items()}))
    put(out / "missing_img_files.txt", b"c1/00000002.jpg\n")
    for name, frame in one.pairs:
        put(out / name / f"{frame:08d}.jpg", jpg(one.images[name, frame]))
        put(out / name / "mask" / "pha" / f"{frame:08d}.jpg", jpg(np.repeat(one.mattes[name, frame][..., None], 3, 2)))


def written_thuman(one: Scene, out: Path) -> None:
    names = {name: f"cam{view:02d}" for view, name in enumerate(one.cameras)}
    put(
        out / "calibration.json",
        json.dumps({names[name]: _json_camera(camera) for name, camera in one.cameras.items()}).encode(),
    )
    put(out / "smpl_params.npz", npz(**smplx(one)))
    for name, frame in one.pairs:
        put(out / "images" / names[name] / f"{frame:08d}.jpg", jpg(one.images[name, frame]))
        put(out / "masks" / names[name] / f"{frame:08d}.jpg", jpg(one.mattes[name, frame]))


SMPL_PELVIS = np.array([-0.0018, -0.2233, 0.0282])
"""J_0 of neutral SMPL as published, metres."""
Z_UP = Rotation.from_euler("x", 90, degrees=True)
"""From our world to one with +Z up."""


def written_zju(one: Scene, out: Path, rooted: bool = False, slash: str = "/") -> None:
    """+Z up, T in millimetres, pixel centres at integers, labels for mattes, SMPL's Rh about the origin.

    `rooted`: a part of the root's turn is in the poses; `slash`: between folders, as the system of who recorded has it.
    """
    turn, names = Z_UP.as_matrix(), {name: f"Camera_B{view + 1}" for view, name in enumerate(one.cameras)}
    cams: dict[str, list] = {"K": [], "D": [], "R": [], "T": []}
    for camera in one.cameras.values():
        intrinsics = camera.intrinsics.copy()
        intrinsics[:2, 2] -= 0.5
        cams["K"].append(intrinsics.tolist())
        cams["D"].append(np.zeros((5, 1)).tolist())
        cams["R"].append(camera.camera_from_world[:3, :3] @ turn.T)
        cams["T"].append(1000 * camera.camera_from_world[:3, 3:])
    frames = range(len(one.signals))
    ims = [{"ims": np.array([f"{names[name]}{slash}{frame:06d}.jpg" for name in one.cameras])} for frame in frames]
    put(out / "annots.npy", pickled({"cams": cams, "ims": ims}))
    for frame, signals in enumerate(one.signals):
        own = Rotation.from_rotvec([0.2, -0.3, 0.4] if rooted else np.zeros(3))
        root = Z_UP * Rotation.from_rotvec(signals.global_orient.copy()) * own.inv()
        pelvis = Z_UP.apply(signals.translation.copy())
        poses = np.concatenate([own.as_rotvec(), signals.body_pose.ravel(), np.zeros(6)])
        said = {
            "poses": poses[None],
            "Rh": root.as_rotvec()[None],
            "Th": (pelvis - root.apply(SMPL_PELVIS))[None],
            "shapes": np.zeros((1, 10)),
        }
        put(out / "new_params" / f"{frame}.npy", pickled(said))
    for name, frame in one.pairs:
        put(out / names[name] / f"{frame:06d}.jpg", jpg(one.images[name, frame]))
        put(
            out / "mask_cihp" / names[name] / f"{frame:06d}.png", png_bytes(np.where(one.mattes[name, frame] > 0, 5, 0))
        )


def png_bytes(labels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(labels.astype(np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def written_actorshq(one: Scene, out: Path) -> None:
    names = {name: f"Cam{view + 1:03d}" for view, name in enumerate(one.cameras)}
    lines = io.StringIO()
    table = csv.writer(lines)
    table.writerow(["name", "w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py"])
    for name, camera in one.cameras.items():
        world = np.linalg.inv(camera.camera_from_world)
        k, w, h = camera.intrinsics, camera.width, camera.height
        turn = Rotation.from_matrix(world[:3, :3]).as_rotvec()
        table.writerow([names[name], w, h, *turn, *world[:3, 3], k[0, 0] / w, k[1, 1] / h, k[0, 2] / w, k[1, 2] / h])
    put(out / "calibration.csv", lines.getvalue().encode())
    put(out / "smpl_params.npz", npz(**smplx(one)))
    for name, frame in one.pairs:
        camera = names[name]
        put(out / "rgbs" / camera / f"{camera}_rgb{frame:06d}.jpg", jpg(one.images[name, frame]))
        put(out / "masks" / camera / f"{camera}_mask{frame:06d}.png", png_bytes(one.mattes[name, frame]))


def head_poses(one: Scene) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each frame a head model's root turn (3,) and what leads from its world, without that turn, to ours (4, 4)."""
    joints = load_person().body.joint_template.double().numpy()
    offset = EYES - joints[23:25].mean(0)
    neck, found = joints[12] + offset, []
    for signals in one.signals:
        root = Rotation.from_rotvec(0.3 * signals.global_orient)
        whole = Rotation.from_rotvec(signals.global_orient.copy())
        moved = np.eye(4)
        moved[:3, :3] = (whole * root.inv()).as_matrix()
        pelvis = root.apply(joints[0] + offset - neck) + neck
        moved[:3, 3] = signals.translation - moved[:3, :3] @ pelvis
        found.append((root.as_rotvec(), moved))
    return found


def heads(seed: int = 3) -> Scene:
    """Whose body, fingers and face stay at rest, as the layouts of heads have it."""
    one = scene(2, seed, "face")
    still = [
        signals.replace(
            body_pose=np.zeros((21, 3)),
            left_hand_pose=np.zeros((15, 3)),
            right_hand_pose=np.zeros((15, 3)),
            expression=np.zeros(52),
        )
        for signals in one.signals
    ]
    return still_scene(one, still)


def still_scene(one: Scene, signals: list[Signals]) -> Scene:
    images, mattes = {}, {}
    for name, frame in one.pairs:
        vertices, _ = template_surface(load_person(), signals[frame])
        mask = silhouette(vertices, load_person().body.faces.numpy(), one.cameras[name])
        images[name, frame] = np.where(mask[..., None], (220, 150, 110), BACKDROP).astype(np.uint8)
        mattes[name, frame] = np.uint8(255 * mask)
    return Scene(signals, one.cameras, images, mattes)


def written_imavatar(one: Scene, out: Path) -> None:
    """fx negative, OpenGL's axes."""
    ((name, camera),) = one.cameras.items()
    k, w, h = camera.intrinsics, camera.width, camera.height
    frames = []
    for frame, (root, moved) in enumerate(head_poses(one)):
        signals = one.signals[frame]
        pose = np.concatenate([root, np.zeros(3), signals.jaw_pose, signals.eye_pose.ravel()])
        world = (FLIP @ camera.camera_from_world @ moved)[:3]
        entry = {
            "file_path": f"./image/{frame + 1}",
            "world_mat": world.tolist(),
            "expression": [0.1] * 50,
            "pose": pose.tolist(),
            "bbox": [0, 0, 1, 1],
        }
        frames.append(entry)
        put(out / "image" / f"{frame + 1}.png", png(one.images[name, frame]))
        put(out / "mask" / f"{frame + 1}.png", png_bytes(one.mattes[name, frame]))
    said = {
        "frames": frames,
        "shape_params": [0.0] * 100,
        "intrinsics": [-k[0, 0] / w, k[1, 1] / h, k[0, 2] / w, k[1, 2] / h],
    }
    put(out / "flame_params.json", json.dumps(said).encode())


def written_nerface(one: Scene, out: Path) -> None:
    """No mattes but a picture of the empty scene."""
    ((name, camera),) = one.cameras.items()
    k, w, h = camera.intrinsics, camera.width, camera.height
    frames = []
    for frame, (root, moved) in enumerate(head_poses(one)):
        turned = np.eye(4)
        joints = load_person().body.joint_template.double().numpy()
        neck = joints[12] + EYES - joints[23:25].mean(0)
        turned[:3, :3] = Rotation.from_rotvec(root).as_matrix()
        turned[:3, 3] = neck - turned[:3, :3] @ neck
        world = np.linalg.inv(FLIP @ camera.camera_from_world @ moved @ turned)
        frames.append(
            {
                "file_path": f"./train/f_{frame:04d}",
                "transform_matrix": world.tolist(),
                "expression": [0.0] * 76,
                "bbox": [0, 0, 1, 1],
            }
        )
        put(out / "train" / f"f_{frame:04d}.png", png(one.images[name, frame]))
    put(out / "bg" / "00050.png", png(np.full((h, w, 3), BACKDROP, np.uint8)))
    said = {"camera_angle_x": 0.3, "frames": frames, "intrinsics": [-k[0, 0], k[1, 1], k[0, 2] / w, k[1, 2] / h]}
    put(out / "transforms_train.json", json.dumps(said).encode())


def _json_camera(camera: Camera) -> dict:
    return {
        "K": camera.intrinsics.ravel().tolist(), "R": camera.camera_from_world[:3, :3].ravel().tolist(),
        "T": camera.camera_from_world[:3, 3].tolist(), "distCoeff": [0.0] * 5, "imgSize": [camera.width, camera.height], "rectifyAlpha": 0.0,
    }  # fmt: skip


BODIES: dict[str, Callable[[Scene, Path], None]] = {
    "AvatarReX": written_avatarrex, "THuman4.0": written_thuman, "ZJU-MoCap": written_zju, "ActorsHQ": written_actorshq,
}  # fmt: skip
FACES: dict[str, Callable[[Scene, Path], None]] = {"IMAvatar": written_imavatar, "NeRFace": written_nerface}
