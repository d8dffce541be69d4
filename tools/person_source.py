"""The source body: the MakeHuman base mesh of any adult, taken from its A-pose to our T-pose with 55 joints.

Build-time only: needs `anny` (see convert_person.py), whose "smplx" and "smpl" topologies must never be requested: they
are downloads under a non-commercial licence. 163 bones merge into the 55 joints of SMPL-X; one fixed rotation per joint
lifts the arms, lays the palms down and flattens the fingers, so that everything stays linear in shape.

Letters: v vertices of the whole base mesh (helpers included). Metres, +Y up, facing +Z, the person's left is +X.
"""

from __future__ import annotations

from pathlib import Path

import anny
import numpy as np
import torch
from anny.models.facial_actions import FACIAL_ACTION_LABELS

from avatarrex.signals.joints import EXPRESSION_NAMES, FINGERS, JOINT_NAMES

BASE_MESH = Path(anny.__file__).parent / "data/mpfb2/3dobjs/base.obj"
MASKS = Path(anny.__file__).parent / "data/mpfb2/textures"
PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15]
for wrist in (20, 21):
    for _ in FINGERS:
        PARENTS += [wrist, len(PARENTS), len(PARENTS) + 1]
JOINT = {name: index for index, name in enumerate(JOINT_NAMES)}
SOURCE_AXES = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])
"""MakeHuman (z up, facing −y) to ours."""
MEAN_ADULT = {
    "gender": 0.5, "age": 0.67, "muscle": 0.55, "weight": 0.45, "height": 0.45, "proportions": 0.75,
    "cupsize": 0.4, "firmness": 0.6,
    "african": 0.33, "asian": 0.33, "caucasian": 0.34,
}  # fmt: skip


def head_bones() -> dict[str, str]:
    """SMPL-X joint -> the bone whose head is that joint."""
    bones = {
        "pelvis": "spine05", "spine1": "spine04", "spine2": "spine03", "spine3": "spine02", "neck": "neck01",
        "head": "head", "jaw": "jaw",
    }  # fmt: skip
    limbs = {
        "hip": "upperleg01", "knee": "lowerleg01", "ankle": "foot", "foot": "toe2-1", "collar": "clavicle",
        "shoulder": "upperarm01", "elbow": "lowerarm01", "wrist": "wrist", "eye": "eye",
    }  # fmt: skip
    for side, letter in (("left", "L"), ("right", "R")):
        bones |= {f"{side}_{joint}": f"{bone}.{letter}" for joint, bone in limbs.items()}
        for digit, finger in zip("12345", ("thumb", "index", "middle", "ring", "pinky")):
            bones |= {f"{side}_{finger}{k}": f"finger{digit}-{k}.{letter}" for k in (1, 2, 3)}
    return bones


def merge_bones(labels: list[str], parents: list[int]) -> np.ndarray:
    """For each source bone the joint that takes its weight: its own, or its nearest mapped ancestor's."""
    mapped = {bone: joint for joint, bone in head_bones().items()}
    mapped |= {"root": "pelvis", "spine01": "spine3", "neck02": "neck", "neck03": "neck"}
    for side, letter in (("left", "L"), ("right", "R")):
        mapped |= {f"pelvis.{letter}": "pelvis", f"shoulder01.{letter}": f"{side}_collar", f"breast.{letter}": "spine3"}
        mapped |= {f"toe{toe}-1.{letter}": f"{side}_foot" for toe in range(1, 6)}
    joints = []
    for bone in range(len(labels)):
        while labels[bone] not in mapped:
            bone = parents[bone]
        joints.append(JOINT[mapped[labels[bone]]])
    return np.array(joints)


def skew(x: np.ndarray) -> np.ndarray:
    return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


def align(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The smallest rotation that takes direction a to direction b."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    k = skew(np.cross(a, b))
    return np.eye(3) + k + k @ k / (1 + a @ b)


def frame(x: np.ndarray, up: np.ndarray) -> np.ndarray:
    x = x / np.linalg.norm(x)
    up = up - x * (up @ x)
    up /= np.linalg.norm(up)
    return np.stack([x, up, np.cross(x, up)], 1)


def tpose_rotations(head: np.ndarray) -> np.ndarray:
    """Global rotation of every joint from the source's A-pose to our T-pose, (55, 3, 3)."""
    rotation = np.tile(np.eye(3), (55, 1, 1))

    def at(name: str) -> np.ndarray:
        return head[JOINT[name]]

    for side, sign in (("left", 1.0), ("right", -1.0)):
        along = np.array([sign, -0.06, 0])
        upper = align(at(f"{side}_elbow") - at(f"{side}_shoulder"), along)
        unit = along / np.linalg.norm(along)
        forearm = upper @ (at(f"{side}_wrist") - at(f"{side}_elbow"))
        bend, hinge = forearm - unit * (forearm @ unit), np.array([0, 0, 1.0])
        hinge = hinge - unit * (hinge @ unit)
        twist = np.arctan2(np.cross(bend, hinge) @ unit, bend @ hinge)
        k = skew(unit)
        shoulder = (np.eye(3) + np.sin(twist) * k + (1 - np.cos(twist)) * k @ k) @ upper
        rotation[JOINT[f"{side}_shoulder"]] = shoulder
        elbow = align(shoulder @ (at(f"{side}_wrist") - at(f"{side}_elbow")), along) @ shoulder
        rotation[JOINT[f"{side}_elbow"]] = elbow
        knuckle = at(f"{side}_middle1") - at(f"{side}_wrist")
        back = np.cross(at(f"{side}_index1") - at(f"{side}_pinky1"), knuckle) * sign
        palm_down = frame(np.array([sign, 0, 0]), np.array([0, 1.0, 0]))
        wrist = palm_down @ frame(knuckle, back).T
        if (wrist @ back)[1] < 0:
            wrist = palm_down @ frame(knuckle, -back).T
        rotation[JOINT[f"{side}_wrist"]] = wrist
        for finger in ("index", "middle", "ring", "pinky"):
            a, b, c = (at(f"{side}_{finger}{k}") for k in (1, 2, 3))
            direction = wrist @ (b - a)
            flat = direction * np.array([1, 0.1, 1])
            first = align(direction, flat) @ wrist
            middle = first @ (c - b)
            middle_flat = 0.8 * flat / np.linalg.norm(flat) + 0.2 * middle / np.linalg.norm(middle)
            second = align(middle, middle_flat) @ first
            for k, value in ((1, first), (2, second), (3, second)):
                rotation[JOINT[f"{side}_{finger}{k}"]] = value
        for k in (1, 2, 3):
            rotation[JOINT[f"{side}_thumb{k}"]] = wrist
        leg = align(at(f"{side}_ankle") - at(f"{side}_hip"), np.array([sign * 0.06, -1, -0.04]))
        rotation[JOINT[f"{side}_hip"]] = rotation[JOINT[f"{side}_knee"]] = leg
    return rotation


class Source:
    """The source body: rest vertices and bone heads of any adult, taken to our T-pose."""

    def __init__(self) -> None:
        self.model = anny.Anny(rig="makehuman", topology="makehuman-full", facial_actions="all", phenotypes="all").to(
            dtype=torch.float64
        )
        labels = list(self.model.bone_labels)
        joints = merge_bones(labels, list(self.model.bone_parents))
        index, weight = self.model.vertex_bone_indices.numpy(), self.model.vertex_bone_weights.numpy()
        self.weights = np.zeros((len(index), 55))
        for column in range(index.shape[1]):
            np.add.at(self.weights, (np.arange(len(index)), joints[index[:, column]]), weight[:, column])
        self.weights[self.weights < 2e-3] = 0
        self.weights /= self.weights.sum(1, keepdims=True)
        heads = head_bones()
        self.head_ids = [labels.index(heads[name]) for name in JOINT_NAMES]
        self.rotation = tpose_rotations(self.rest(MEAN_ADULT)[1])

    def rest(self, phenotype: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
        values = torch.tensor([[phenotype[label] for label in self.model.phenotype_labels]], dtype=torch.float64)
        with torch.no_grad():
            coefficients = self.model._get_phenotype_blendshape_coefficients(
                values, torch.zeros(1, 0, dtype=torch.float64), torch.zeros(1, 52, dtype=torch.float64)
            )
            rest = self.model.get_rest_model(coefficients)
        heads = rest["rest_bone_heads"][0].numpy()[self.head_ids]
        return rest["rest_vertices"][0].numpy() @ SOURCE_AXES.T, heads @ SOURCE_AXES.T

    def tpose(self, phenotype: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and joints in T-pose, pelvis at the origin."""
        vertices, head = self.rest(phenotype)
        joints = np.zeros((55, 3))
        for j, parent in enumerate(PARENTS):
            joints[j] = head[j] if parent < 0 else joints[parent] + self.rotation[parent] @ (head[j] - head[parent])
        offset = joints - np.einsum("jab,jb->ja", self.rotation, head)
        posed = np.einsum("vab,vb->va", self.vertex_rotation(), vertices) + self.weights @ offset
        return posed - joints[0], joints - joints[0]

    def vertex_rotation(self) -> np.ndarray:
        return (self.weights @ self.rotation.reshape(55, 9)).reshape(-1, 3, 3)

    def expressions(self) -> np.ndarray:
        """(52, v, 3) offsets in Apple's order, T-pose frame."""
        order = [i for i, name in enumerate(self.model.blendshape_labels) if name.startswith("facial_action")]
        by_name = dict(zip(FACIAL_ACTION_LABELS, order))
        if set(by_name) != set(EXPRESSION_NAMES):
            raise SystemExit(f"face units differ from Apple's 52: {sorted(set(EXPRESSION_NAMES) ^ set(by_name))}")
        offsets = self.model.blendshapes[[by_name[name] for name in EXPRESSION_NAMES]].numpy() @ SOURCE_AXES.T
        return np.einsum("vab,evb->eva", self.vertex_rotation(), offsets)


def read_groups(path: Path) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], np.ndarray]:
    """Faces (quads) and their texture indices by group, and the texture coordinates."""
    faces: dict[str, list[list[int]]] = {}
    uv_faces: dict[str, list[list[int]]] = {}
    uv, group = [], ""
    for line in path.read_text().splitlines():
        if line.startswith("g "):
            group = line.split()[1]
        elif line.startswith("vt "):
            uv.append([float(x) for x in line.split()[1:3]])
        elif line.startswith("f "):
            corners = [corner.split("/") for corner in line.split()[1:]]
            faces.setdefault(group, []).append([int(c[0]) - 1 for c in corners])
            uv_faces.setdefault(group, []).append([int(c[1]) - 1 if len(c) > 1 and c[1] else 0 for c in corners])
    return {g: np.array(f) for g, f in faces.items()}, {g: np.array(f) for g, f in uv_faces.items()}, np.array(uv)


def triangles(quads: np.ndarray) -> np.ndarray:
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
