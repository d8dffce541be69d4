"""A person's templates under one driving signal: body in the root frame, hands in wrist frames, face in the head frame.

The body is posed with flat hands and a neutral face, so that neither φ nor ψ touches the body field
(docs/architecture.md, 'How the parts compose').
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatarrex.counters import Counters
from avatarrex.ops.finite import require_finite
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.signals.driving import Signals
from avatarrex.templates.face import pose_face
from avatarrex.templates.hand import pose_hand
from avatarrex.templates.model import PosedTemplate, pose_template
from avatarrex.templates.person import Person
from avatarrex.templates.transform import world_from_root

PART_JOINT = {"left_hand": 20, "right_hand": 21, "face": 15}
"""The joint whose frame a part lives in: wrists and head (SMPL-X order)."""


@dataclass(frozen=True)
class PosedPerson:
    """The posed meshes with the key each was made from."""

    body: PosedTemplate
    parts: dict[str, Float[Tensor, "v 3"]]
    """Vertices by part name, metres: hands in wrist frames, face in the head frame."""
    body_rotation: Float[Tensor, "21 3 3"]
    """θ, what the detail embedding is predicted from."""
    hand_pose: dict[str, Float[Tensor, "15 3"]]
    """φ by hand, rotation vectors."""
    face_coefficients: Float[Tensor, " 61"]
    """ψ, then jaw and eyes as rotation vectors."""
    keys: dict[str, bytes]

    def __post_init__(self) -> None:
        body = {"body": self.body.vertices, "joints": self.body.joint_transforms, "skinning": self.body.skinning}
        coefficients = {
            **self.hand_pose,
            "body rotation": self.body_rotation,
            "face coefficients": self.face_coefficients,
        }
        require_finite("posed person", **body)
        require_finite("posed person", **self.parts)
        require_finite("posed person, coefficients", **coefficients)

    def root_from_part(self, name: str) -> np.ndarray:
        """Rigid (4, 4) float64 of the joint frame that part `name` lives in."""
        return self.body.joint_transforms[PART_JOINT[name]].double().cpu().numpy()

    def world_from_root(self, signals: Signals) -> np.ndarray:
        """Rigid (4, 4) float64: the global orientation about the pelvis, then the translation."""
        pelvis = self.body.joints[0].double().cpu().numpy()
        return np.asarray(world_from_root(signals.global_orient, signals.translation, pelvis), dtype=np.float64)


def pose_person(person: Person, signals: Signals, counters: Counters, previous: PosedPerson | None) -> PosedPerson:
    """Pose each template whose coefficients differ from `previous`."""
    keys = _keys(signals)
    old = previous.keys if previous else {}
    shape = _tensor(signals.shape)
    if previous and old["body"] == keys["body"]:
        body, rotation = previous.body, previous.body_rotation
    else:
        rotation = matrix_from_rotvec(_tensor(signals.body_pose))
        pose = torch.zeros(len(person.body.parents), 3)
        pose[1:22] = _tensor(signals.body_pose)
        body = pose_template(person.body, pose, shape, torch.zeros(person.body.expression_dirs.shape[2]))
        counters.add("templates_posed", 1)
    parts: dict[str, Tensor] = {}
    hand_pose = {name: _tensor(getattr(signals, f"{name}_pose")) for name in ("left_hand", "right_hand")}
    for name in PART_JOINT:
        if previous and old[name] == keys[name]:
            parts[name] = previous.parts[name]
            continue
        counters.add("templates_posed", 1)
        if name == "face":
            parts[name] = pose_face(
                person.face, _tensor(signals.expression), _tensor(signals.jaw_pose), _tensor(signals.eye_pose), shape
            )
        else:
            parts[name] = pose_hand(getattr(person, name), hand_pose[name], shape)
    face = np.concatenate([signals.expression, signals.jaw_pose, signals.eye_pose.ravel()])
    return PosedPerson(body, parts, rotation, hand_pose, _tensor(face), keys)


def _keys(signals: Signals) -> dict[str, bytes]:
    shape = signals.shape.tobytes()
    return {
        "body": signals.body_pose.tobytes() + shape,
        "left_hand": signals.left_hand_pose.tobytes() + shape,
        "right_hand": signals.right_hand_pose.tobytes() + shape,
        "face": signals.expression.tobytes() + signals.jaw_pose.tobytes() + signals.eye_pose.tobytes() + shape,
    }


def _tensor(values: np.ndarray) -> Tensor:
    return torch.as_tensor(np.array(values), dtype=torch.float32)
