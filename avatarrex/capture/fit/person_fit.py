"""The size of a captured person, from the joints of its T-pose: ten shape directions, then what is left per joint.

    β = argmin Σ_bones |(J_i − J_parent)(β) − bone_i|² + σ²|β|²        offset_i = joint_i − J_i(β)

Letters: j joints. Metres.
"""

from __future__ import annotations

import numpy as np

from avatarrex.errors import InputError
from avatarrex.templates.person import Person, resize_person
from avatarrex.templates.person_fit import PersonFit

RIG_NOISE = 0.1
"""σ, metres: rigs place the joints of the same body differently. On person_f001's joints (`docs/capture.md`) 0.03 and 0.3
give the same surface within 0.5 mm; without it β leaves ±20."""
HEIGHT = (1.2, 2.2)
"""Metres a person is tall."""


def fit_person(person: Person, joints: np.ndarray, source: str) -> Person:
    """`person` resized to T-pose `joints` (55, 3), metres, in any place. Raises `InputError` for no human's."""
    body = person.body.double()
    template, directions = body.joint_template.numpy(), body.joint_shapedirs[..., :10].numpy()
    wanted = joints - joints[0]
    child, parent = np.arange(1, len(wanted)), np.array(body.parents[1:])
    bones = (directions[child] - directions[parent]).reshape(-1, 10)
    missing = ((wanted[child] - wanted[parent]) - (template[child] - template[parent])).reshape(-1)
    shape = np.linalg.solve(bones.T @ bones + RIG_NOISE**2 * np.eye(10), bones.T @ missing)
    offsets = wanted - (template + directions @ shape - (template[0] + directions[0] @ shape))
    if np.linalg.norm(offsets, axis=1).max() > 0.6:
        worst = int(np.linalg.norm(offsets, axis=1).argmax())
        raise InputError(
            source, "tpose_joints", "joints of a T-pose in SMPL-X order, +Y up, facing +Z", f"joint {worst} elsewhere"
        )
    offsets[0] = 0
    return resize_person(person, PersonFit(shape, offsets))


def height(person: Person) -> float:
    """Metres from the soles to the top of the head, at rest."""
    rest = person.body.v_template[:, 1]
    return float(rest.max() - rest.min())


def check_height(person: Person, source: str) -> None:
    """Raise `InputError` for somebody who is not as tall as people are."""
    metres = height(person)
    if not HEIGHT[0] <= metres <= HEIGHT[1]:
        raise InputError(source, "", f"a person {HEIGHT[0]} to {HEIGHT[1]} m tall", f"{metres:.2f} m")
