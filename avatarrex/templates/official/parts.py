"""Body, hands and face of a person from published models: SMPL-X with MANO's hands and Faceverse's face (paper sec. 3).

The body is SMPL-X with its first ten shape directions. A hand has MANO's mesh, weights and pose blend shapes on SMPL-X's vertices, so that
both meshes agree where their fields blend. The face is Faceverse's mesh, laid on SMPL-X's head by eight landmarks (turn, place and one size);
shape moves it as it moves the nearest skin. What a folder lacks is cut out of the body. Letters: v vertices. Metres.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.albedo import inside_mouth, paint_albedo
from avatarrex.templates.face import HEAD, JAW, LEFT_EYE, RIGHT_EYE, FaceTemplate, cut_face, paint_face
from avatarrex.templates.hand import HandTemplate, cut_hand, paint_hand
from avatarrex.templates.model import TemplateModel
from avatarrex.templates.official import expression_matrix
from avatarrex.templates.official.correspondence import HAND_JOINTS, hand_ids
from avatarrex.templates.official.faceverse import FaceverseFile, read_faceverse
from avatarrex.templates.official.known_models import KNOWN
from avatarrex.templates.official.mano import VERTICES, ManoFile, read_hands
from avatarrex.templates.official.smplx import SmplxFile, read_smplx
from avatarrex.templates.submodel import submodel

SHAPES = 10
"""Coefficients β of the signals."""
FACE_JOINTS = [HEAD, JAW, LEFT_EYE, RIGHT_EYE]
COMMON = {False: (27, 30, 36, 39, 42, 45, 48, 54), True: (168, 1, 33, 133, 362, 263, 61, 291)}
"""Landmarks that both lists have, bridge and tip of the nose, corners of eyes and mouth: on iBUG's, and (True) on MediaPipe's."""
IBUG, FIRST_INNER = 68, 17
"""Landmarks of iBUG's list; SMPL-X has them from this one on."""


@dataclass(frozen=True, eq=False)
class PersonModels:
    """What makes a person: a body, and what lies on it, whatever its size."""

    body: TemplateModel
    """Its J_0 is the origin, as the default person's."""
    j0: np.ndarray
    """(3,) metres: where the file has its pelvis."""
    j0_dirs: np.ndarray
    """(3, 10): how that follows the shape."""
    hands: dict[str, tuple[ManoFile, np.ndarray]]
    """By side: MANO's hand and its vertices on the body. Both or none."""
    face: FaceTemplate | None
    """Faceverse's, on `body`."""
    sex: str
    """`neutral`, `male` or `female`: of the body."""
    hash: str
    """Of what the files contain, not of what was made of it: its last bits are another machine's to round."""

    def parts(self, body: TemplateModel) -> tuple[HandTemplate, HandTemplate, FaceTemplate]:
        """Left hand, right hand and face on `body`, which is `self.body` in some size."""
        left, right = (
            hand_of(*self.hands[side], body) if side in self.hands else cut_hand(body, side)
            for side in ("left", "right")
        )
        return left, right, cut_face(body) if self.face is None else carried_face(self.face, self.body, body)

    def pelvis(self, shape: np.ndarray) -> np.ndarray:
        """J_0 (3,), metres, of a shape (10,), as the file has it."""
        return np.asarray(self.j0 + self.j0_dirs @ shape)


def read_models(folder: str | Path) -> PersonModels:
    """From a models folder. Raises `InputError`."""
    found = {model.name: path for model in KNOWN if (path := model.find(Path(folder)))}
    if "smplx" not in found:
        raise InputError(folder, KNOWN[0].files[0], f"the file to be there ({KNOWN[0].published})", "nothing there")
    file = read_smplx(found["smplx"])
    body, digest = driven_body(file), hashlib.sha256(file.hash.encode())
    hands, face = {}, None
    if {"mano_left", "mano_right"} <= set(found):
        for side, mano in read_hands(found["mano_left"], found["mano_right"]).items():
            ids = hand_ids(mano.model, body, side, found.get("hand_ids"))
            hands[side] = (mano, ids)
            digest.update(mano.hash.encode() + ids.tobytes())
    if "faceverse" in found:
        read = read_faceverse(found["faceverse"])
        face = face_of(read, body, file)
        digest.update(read.hash.encode() + file.landmark_faces.tobytes() + file.landmark_weights.tobytes())
    j0, j0_dirs = file.model.joint_template[0].double(), file.model.joint_shapedirs[0, :, :SHAPES].double()
    sex = found["smplx"].stem.rpartition("_")[2].lower()
    return PersonModels(body, j0.numpy(), j0_dirs.numpy(), hands, face, sex, digest.hexdigest()[:16])


def driven_body(file: SmplxFile) -> TemplateModel:
    """SMPL-X as the signals drive it: J_0 at the origin, ten shapes, and 52 expressions that move nothing, since the face is a
    part of its own."""
    model = file.model
    return replace(
        model,
        v_template=model.v_template - model.joint_template[0],
        joint_template=model.joint_template - model.joint_template[0],
        shapedirs=model.shapedirs[..., :SHAPES] - model.joint_shapedirs[0, :, :SHAPES],
        joint_shapedirs=model.joint_shapedirs[..., :SHAPES] - model.joint_shapedirs[0, :, :SHAPES],
        expression_dirs=torch.zeros(len(model.v_template), 3, len(EXPRESSION_NAMES)),
        expression_names=EXPRESSION_NAMES,
        joint_expression_dirs=None,
    )


def hand_of(mano: ManoFile, ids: np.ndarray, body: TemplateModel) -> HandTemplate:
    """MANO's hand on SMPL-X's vertices `ids`, in the wrist's frame."""
    rows, rim = torch.from_numpy(ids), mano.model.faces[mano.model.faces[:, 1] == VERTICES, 0]

    def closed(values: Tensor) -> Tensor:
        return torch.cat([values[rows], values[rows[rim]].mean(0, keepdim=True)])

    still = replace(body, expression_dirs=body.expression_dirs[..., :0], expression_names=())
    model = submodel(still, HAND_JOINTS[mano.side], closed, mano.model.faces, {})
    model = replace(model, weights=mano.model.weights, posedirs=mano.model.posedirs, pose_columns=None)
    blend_weight = torch.cat([paint_hand(body, mano.side)[rows], torch.zeros(1)])
    return HandTemplate(mano.side, model, blend_weight, torch.cat([rows, torch.tensor([-1])]))


def face_of(face: FaceverseFile, body: TemplateModel, file: SmplxFile) -> FaceTemplate:
    """Faceverse's face on SMPL-X's head, in the head's frame. Raises `InputError` where it has not the 52 named expressions."""
    own = face.model
    if own.expression_names != EXPRESSION_NAMES:
        expected = f"52 expressions by their names, or {expression_matrix.FILE} (`avatarrex-studio models matrix` writes one to edit)"
        raise InputError("Faceverse", "exp_name_list", expected, f"{own.expression_dirs.shape[2]} without names")
    turn, size, here, there = _placing(face, body, file)
    head = body.joint_template[HEAD].double().numpy()
    places = (own.v_template.double().numpy() - here) @ turn.T * size + there
    near = torch.from_numpy(cKDTree(body.v_template.numpy()).query(places)[1])
    model = TemplateModel(
        v_template=torch.from_numpy((places - head).astype(np.float32)),
        faces=own.faces,
        shapedirs=body.shapedirs[near] - body.joint_shapedirs[HEAD],
        expression_dirs=torch.from_numpy(size * turn).float() @ own.expression_dirs,
        weights=own.weights,
        joint_template=_joints(own, turn, size, here, there, body) - body.joint_template[HEAD],
        joint_shapedirs=body.joint_shapedirs[FACE_JOINTS] - body.joint_shapedirs[HEAD],
        parents=own.parents,
        joint_names=own.joint_names,
        expression_names=own.expression_names,
        groups=own.groups,
    )
    albedo = paint_albedo(model.v_template, model.joint_template[2:], model.groups)
    inside = inside_mouth(model.v_template, model.groups)
    return FaceTemplate(model, paint_face(body)[near], albedo, torch.full((len(near),), -1), inside)


def carried_face(face: FaceTemplate, old: TemplateModel, new: TemplateModel) -> FaceTemplate:
    """A face on `old`, taken along by the nearest skin as `new`, the same body in another size, has moved; its ω painted there."""
    if new is old:
        return face
    near = torch.from_numpy(
        cKDTree(old.v_template.numpy()).query((face.v_template + old.joint_template[HEAD]).numpy())[1]
    )
    joints = new.joint_template - old.joint_template
    model = replace(
        face.model,
        v_template=face.v_template + (new.v_template - old.v_template)[near] - joints[HEAD],
        joint_template=face.model.joint_template + joints[FACE_JOINTS] - joints[HEAD],
    )
    return replace(face, model=model, blend_weight=paint_face(new)[near])


def _placing(
    face: FaceverseFile, body: TemplateModel, file: SmplxFile
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Turn (3, 3), size, and the middles of the landmarks here and there: x ↦ size · turn (x − here) + there."""
    if len(file.landmark_faces) < 51:
        raise InputError("SMPL-X", "lmk_faces_idx", "51 landmarks of the face", len(file.landmark_faces))
    if len(face.landmarks) < IBUG:
        raise InputError("Faceverse", "keypoints", f"{IBUG}, 468 or 478 landmarks", len(face.landmarks))
    rows = np.array(COMMON[False]) - FIRST_INNER
    corners = body.v_template.double().numpy()[body.faces.numpy()[file.landmark_faces[rows]]]
    theirs = np.einsum("lkc,lk->lc", corners, file.landmark_weights[rows])
    own = face.model.v_template.double().numpy()[face.landmarks[list(COMMON[face.mediapipe])]]
    here, there = own.mean(0), theirs.mean(0)
    turn, _ = Rotation.align_vectors(theirs - there, own - here)
    size = np.linalg.norm(theirs - there) / np.linalg.norm(own - here)
    return turn.as_matrix(), float(size), here, there


def _joints(
    own: TemplateModel, turn: np.ndarray, size: float, here: np.ndarray, there: np.ndarray, body: TemplateModel
) -> Tensor:
    """Head and jaw are SMPL-X's; eyes turn about their own middles where Faceverse has them."""
    joints = body.joint_template[FACE_JOINTS].clone()
    for k, name in ((2, "left_eye"), (3, "right_eye")):
        if name in own.groups:
            joints[k] = torch.from_numpy((own.joint_template[k].double().numpy() - here) @ turn.T * size + there)
    return joints
