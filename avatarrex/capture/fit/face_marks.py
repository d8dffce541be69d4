"""Where the landmarks of a face are on a person's template: 52 of iBUG's 68, which have a place on the skin.

iBUG's outline, 0 to 16, is where the cheek ends in the picture: another place of the skin for each camera. Of it only the chin's tip is
used. The others are vertices of the default person, of both sides alike, chosen where the picture of its face shows brows, lids, nose and
lips: vertices are 1 to 3 mm apart at lids and lips, 4 to 6 mm along the brows. Letters: l landmarks, e expression coefficients. Metres,
head frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from scipy.spatial import cKDTree

from avatarrex.capture.fit.person_fit import fit_person
from avatarrex.templates.person import Person, load_person

VERTICES: dict[int, int] = {
    8: 5225,
    17: 262, 18: 224, 19: 222, 20: 223, 21: 228, 22: 7001, 23: 6997, 24: 6996, 25: 6998, 26: 7031,
    27: 132, 28: 131, 29: 201, 30: 297, 31: 360, 32: 314, 33: 343, 34: 7077, 35: 7121,
    36: 24, 37: 6, 38: 54, 39: 68, 40: 47, 41: 36, 42: 6852, 43: 6838, 44: 6790, 45: 6808, 46: 6820, 47: 6831,
    48: 3735, 49: 5340, 50: 450, 51: 455, 52: 7210, 53: 11943, 54: 10403, 55: 7233, 56: 7245, 57: 496, 58: 490, 59: 478,
    60: 499, 61: 470, 62: 474, 63: 7226, 64: 7248, 65: 7236, 66: 493, 67: 481,
}  # fmt: skip
"""Of the default person's body, by iBUG's number: chin; right and left brow; nose; right and left eye; lips without, then within."""
NUMBERS = tuple(VERTICES)
"""iBUG's, in the order of all arrays (l)."""


def face_name(number: int) -> str:
    """Of one of iBUG's landmarks."""
    return f"face_{number}"


FACE_NAMES = tuple(map(face_name, NUMBERS))


@dataclass(frozen=True, eq=False)
class FaceMarks:
    """Of one person."""

    rest: np.ndarray
    """(l, 3) with a neutral face."""
    directions: np.ndarray
    """(l, 3, e) how far a coefficient of 1 moves each."""


@lru_cache(maxsize=4)
@torch.inference_mode(False)
def face_marks(person: Person) -> FaceMarks:
    """Of the default person in any size: its own vertices; of another: the nearest to where the default person with its joints has them."""
    face = person.face
    if person.name == "default":
        rows = _rows(person)
    else:
        alike = fit_person(load_person(), person.body.joint_template.double().numpy(), person.name)
        skin = np.arange(len(face.v_template))
        inner = [group.numpy() for name, group in face.model.groups.items() if name != "body"]
        skin = np.setdiff1d(skin, np.concatenate(inner)) if inner else skin
        rows = skin[cKDTree(face.v_template[skin].numpy()).query(face_marks(alike).rest)[1]]
    return FaceMarks(face.v_template[rows].double().numpy(), face.model.expression_dirs[rows].double().numpy())


def _rows(person: Person) -> np.ndarray:
    """Of `VERTICES` in the face that was cut out of the body."""
    row = {vertex: k for k, vertex in enumerate(person.face.body_vertex_ids.tolist())}
    return np.array([row[vertex] for vertex in VERTICES.values()])
