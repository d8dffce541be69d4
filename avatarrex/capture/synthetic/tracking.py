"""What a rig's files know about the subject: its parameters as they were tracked, and the exact truth beside them.

Exact tracking is what drew the pictures. Noisy tracking is off by independent Gaussian noise in every frame: each joint turned
by `JOINT_DEGREES` about a random axis, the root moved by `ROOT_METRES`, every coefficient by `COEFFICIENT` (root mean square,
times the variation's factor). Letters: t frames, v vertices, f faces.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.capture.synthetic.plan import RigPlan
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES, JOINT_ROWS
from avatarrex.templates.model import pose_by_signals

JOINT_DEGREES, ROOT_METRES, COEFFICIENT = 2.0, 0.01, 0.1


def tracked(rig: RigPlan) -> dict[str, np.ndarray]:
    """`smpl_params.npz`, float64, in the default person's joints and coefficients; its shape only where it is that person."""
    factor = rig.variation.tracking_noise
    exact = _motion(rig)
    motion = _noisy(exact, factor, np.random.default_rng([rig.seed, 4, len(rig.name)])) if factor else exact
    count = len(rig.motion)
    shape = {"shape10": np.array(rig.motion[0].shape)} if rig.variation.subject == "default" else {}
    return {
        **_arrays(*motion[:2]), "betas": np.zeros((1, 10)), "expression": np.zeros((count, 10)), **shape,
        "arkit52": motion[2], "arkit_names": np.array(EXPRESSION_NAMES),
        "flat_hand_mean": np.array(True), "fps": np.array(rig.motion.fps),
    }  # fmt: skip


def truth(rig: RigPlan) -> dict[str, np.ndarray]:
    """`ground_truth.npz`: the posed mesh of every frame, world metres; of a variation also its joints and exact parameters."""
    subject = rig.subject
    meshes = {
        "vertices": rig.world_vertices,
        "faces": subject.faces.astype(np.int32),
        "tpose_vertices": subject.vertices.astype(np.float32),
        "tpose_joints": subject.person.body.joint_template.double().numpy(),
        "joint_names": np.array(JOINT_NAMES),
        "part_of_face": subject.part_of_face.astype(np.int16),
        "parts": np.array(subject.parts),
    }
    if not rig.variation.to_json():
        return meshes
    pose, translation, expression = _motion(rig)
    return {**meshes, "joints": joints(rig), **_arrays(pose, translation), "arkit52": expression}


def _motion(rig: RigPlan) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose (t, 55, 3), translation (t, 3) and coefficients (t, 52)."""
    pose = np.stack([signals.full_pose() for signals in rig.motion])
    translation = np.stack([signals.translation for signals in rig.motion])
    return pose, translation, np.stack([signals.expression for signals in rig.motion])


def _arrays(pose: np.ndarray, translation: np.ndarray) -> dict[str, np.ndarray]:
    named = {name: pose[:, rows].reshape(len(pose), -1) for name, rows in JOINT_ROWS.items() if name != "eye_pose"}
    return {**named, "transl": translation}


def _noisy(
    exact: tuple[np.ndarray, np.ndarray, np.ndarray], factor: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same with noise; coefficients stay in [0, 1]."""
    pose, translation, expression = exact
    turn = np.radians(factor * JOINT_DEGREES) / np.sqrt(3) * rng.standard_normal(pose.shape)
    turned = Rotation.from_rotvec(pose.reshape(-1, 3)) * Rotation.from_rotvec(turn.reshape(-1, 3))
    moved = translation + factor * ROOT_METRES / np.sqrt(3) * rng.standard_normal(translation.shape)
    shaped = expression + factor * COEFFICIENT * rng.standard_normal(expression.shape)
    return turned.as_rotvec().reshape(pose.shape), moved, np.clip(shaped, 0, 1)


def joints(rig: RigPlan) -> np.ndarray:
    """(t, 55, 3) where the subject's own joints are, world metres."""
    placed = []
    for frame in range(len(rig.motion)):
        world = rig.world_from_root(frame)
        posed = pose_by_signals(rig.subject.model, rig.motion[frame].replace(expression=Signals.rest().expression))
        placed.append(posed.joints.double().numpy() @ world[:3, :3].T + world[:3, 3])
    return np.stack(placed)
