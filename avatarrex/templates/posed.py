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
from avatarrex.templates.model import PosedTemplate, pose_template
from avatarrex.templates.parts import PART_JOINT, PARTS
from avatarrex.templates.person import Person
from avatarrex.templates.transform import world_from_root


@dataclass(frozen=True)
class TemplateKey:
    """What a posed mesh depends on, compared by its bytes."""

    coefficients: bytes
    shape: bytes


@dataclass(frozen=True)
class PosedPerson:
    """The posed meshes with the key each was made from."""

    body: PosedTemplate
    parts: dict[str, Float[Tensor, "v 3"]]
    """Vertices by part name, metres: hands in wrist frames, face in the head frame."""
    body_rotation: Float[Tensor, "21 3 3"]
    """θ, the input of the detail embedding."""
    coefficients: dict[str, Float[Tensor, "..."]]
    """What drives each part: φ (15, 3) of a hand, rotation vectors; (61,) of the face: ψ, then jaw and eyes as rotation vectors."""
    keys: dict[str, TemplateKey]
    """Of `body` and of each part."""

    def __post_init__(self) -> None:
        body = {"body": self.body.vertices, "joints": self.body.joint_transforms, "skinning": self.body.skinning}
        require_finite("posed person", **body)
        require_finite("posed person", **self.parts)
        require_finite("posed person, coefficients", **self.coefficients, **{"body rotation": self.body_rotation})

    def root_from_part(self, name: str) -> np.ndarray:
        """Rigid (4, 4) float64 of the joint frame that part `name` lives in."""
        return self.body.joint_transforms[PART_JOINT[name]].double().cpu().numpy()

    def world_from_root(self, signals: Signals) -> np.ndarray:
        """Rigid (4, 4) float64: the global orientation about the pelvis, then the translation."""
        pelvis = self.body.joints[0].double().cpu().numpy()
        return np.asarray(world_from_root(signals.global_orient, signals.translation, pelvis), dtype=np.float64)


def pose_person(
    person: Person,
    signals: Signals,
    counters: Counters,
    previous: PosedPerson | None,
    dtype: torch.dtype = torch.float32,
) -> PosedPerson:
    """Pose each template whose coefficients differ from `previous`."""

    def tensor(values: np.ndarray) -> Tensor:
        return torch.as_tensor(np.array(values), dtype=dtype)

    driving = {name: person.part(name).coefficients(signals) for name in PARTS}
    shape = signals.shape.tobytes()
    keys = {
        name: TemplateKey(values.tobytes(), shape) for name, values in {"body": signals.body_pose, **driving}.items()
    }
    old = previous.keys if previous else {}
    if previous and old["body"] == keys["body"]:
        body, rotation = previous.body, previous.body_rotation
    else:
        rotation = matrix_from_rotvec(tensor(signals.body_pose))
        pose = torch.zeros(len(person.body.parents), 3, dtype=dtype)
        pose[1:22] = tensor(signals.body_pose)
        no_expression = torch.zeros(person.body.expression_dirs.shape[2], dtype=dtype)
        body = pose_template(person.body, pose, tensor(signals.shape), no_expression)
        counters.add("templates_posed", 1)
    coefficients = {name: tensor(values) for name, values in driving.items()}
    parts: dict[str, Tensor] = {}
    for name in PARTS:
        if previous and old[name] == keys[name]:
            parts[name] = previous.parts[name]
        else:
            parts[name] = person.part(name).posed(coefficients[name], tensor(signals.shape))
            counters.add("templates_posed", 1)
    return PosedPerson(body, parts, rotation, coefficients, keys)
