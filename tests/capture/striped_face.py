"""Somebody whose skin has a soft pattern of stripes, in a few expressions before three cameras."""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.camera import Camera
from avatarrex.capture.fit.check import template_surface
from avatarrex.capture.fit.paint import Posed
from avatarrex.capture.fit.photo import Photo
from avatarrex.capture.zbuffer import visible_faces
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES
from avatarrex.templates.face_offsets import FaceOffsets
from avatarrex.templates.model import pose_by_signals
from avatarrex.templates.person import Person, load_person, resize_person
from avatarrex.templates.person_fit import PersonFit

STRIPES = 2 * np.pi / 0.04
"""Radians a metre at rest."""
JAW = EXPRESSION_NAMES.index("jawOpen")
HEAD = load_person().body.joint_template.double().numpy()[JOINT_NAMES.index("head")]
TURN = 1.2
"""Radians: far enough that slopes in the world's axes are not those of rest."""
LAMP = np.array([0.5, 0.2, 0.1])
"""By how much a normal along the world's axes is brighter."""
Y_TURN = Rotation.from_rotvec([0, TURN, 0]).as_matrix()
CAMERAS = [
    Camera.orbit(np.degrees(TURN) + angle, 5, 0.7, 30, tuple(Y_TURN @ (HEAD + np.array([0, 0.05, 0.05]))), 200, 240)
    for angle in (-50, 0, 50)
]
NECK = JOINT_NAMES.index("neck") - 1
"""Row of the body's pose."""
EXPRESSIONS: tuple[dict[str, float], ...] = ({}, {"jawOpen": 0.8}, {"mouthSmileLeft": 0.9, "mouthSmileRight": 0.9})


def person(face: FaceOffsets | None = None) -> Person:
    return resize_person(load_person(), PersonFit(np.zeros(10), np.zeros((55, 3)), face=face))


def signals(names: dict[str, float]) -> Signals:
    expression = np.zeros(52)
    for name, value in names.items():
        expression[EXPRESSION_NAMES.index(name)] = value
    turned = np.zeros((21, 3))
    turned[NECK] = 0.1, 0.2, -0.1
    return Signals.rest().replace(expression=expression, global_orient=np.array([0, TURN, 0]), body_pose=turned)


def photo(somebody: Person, one: Signals, camera: Camera, gain: float = 1.0) -> Photo:
    """In a soft pattern that lies on the skin."""
    faces, rest = somebody.body.faces.numpy(), load_person().body.v_template.double().numpy()
    face, share, _ = visible_faces(template_surface(somebody, one)[0], faces, camera)
    colour = gain * (0.5 + 0.1 * np.sin(STRIPES * np.einsum("hwk,hwkc->hwc", share, rest[faces[face]])))
    picture, matte = np.rint(255 * colour * (face >= 0)[..., None]).astype(np.uint8), 255 * (face >= 0).astype(np.uint8)
    return Photo(camera, partial(np.asarray, picture), partial(np.asarray, matte))


def pictures(
    somebody: Person,
    gains: tuple[float, ...] = (1.0, 1.0, 1.0),
    cameras: list[Camera] = CAMERAS,
    expressions: tuple[dict[str, float], ...] = EXPRESSIONS,
) -> list[Posed]:
    posed = [signals(names) for names in expressions]
    return [(one, tuple(photo(somebody, one, *each) for each in zip(cameras, gains))) for one in posed]


def outer() -> np.ndarray:
    """Vertices of the face's skin that cameras see, none within the mouth."""
    body, face = load_person().body, load_person().face
    vertices, faces = template_surface(person(), signals({}))[0], body.faces.numpy()
    seen = np.concatenate([visible_faces(vertices, faces, camera)[0].ravel() for camera in CAMERAS])
    own = face.body_vertex_ids.numpy()[(face.blend_weight.numpy() > 0.9) & ~face.mouth.numpy()]
    return np.intersect1d(own, faces[np.unique(seen[seen >= 0])])


def chin() -> int:
    """The vertex of the skin that an open jaw takes farthest."""
    return int(outer()[load_person().body.expression_dirs[outer()][..., JAW].norm(dim=1).argmax()])


def cheek() -> int:
    rest = load_person().body.v_template.double().numpy()[outer()]
    return int(outer()[np.abs(rest - HEAD - np.array([0.045, 0.03, 0.07])).sum(1).argmin()])


def off(one: Person, two: Person, names: dict[str, float], about: int) -> float:
    """Mean millimetres between both faces' skin within 15 mm of a vertex."""
    rest = load_person().body.v_template.double().numpy()
    near = outer()[np.linalg.norm(rest[outer()] - rest[about], axis=1) < 0.015]
    posed = (pose_by_signals(each.body, signals(names)).vertices[near] for each in (one, two))
    return float(1000 * np.linalg.norm(np.subtract(*(each.double().numpy() for each in posed)), axis=1).mean())
