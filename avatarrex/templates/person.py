"""A person's templates together: body, both hands, face, and the painted weights that compose them.

The packaged person, one from an `.npz` in its layout, or a folder of models as they are published (docs/formats.md). A `PersonFit` gives
it another body's size: what lies on the body is made once more on the one of that size, but for which vertices are lips, brows and mouth.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from avatarrex.errors import InputError
from avatarrex.files.assets import DATA, read_npz
from avatarrex.files.gate import what_is
from avatarrex.files.stamp import Stamp, stamp
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.templates.face import FaceTemplate, cut_face, labelled_as, paint_face
from avatarrex.templates.hand import HandTemplate, cut_hand
from avatarrex.templates.model import TemplateModel
from avatarrex.templates.model_arrays import hash_arrays, read_model, real
from avatarrex.templates.official.known_models import models_folder
from avatarrex.templates.official.parts import read_models
from avatarrex.templates.parts import PARTS
from avatarrex.templates.person_fit import PersonFit

Parts = tuple[HandTemplate, HandTemplate, FaceTemplate]
"""Left hand, right hand and face."""
OWN_SHAPE, SMPLX_SHAPE = "shape10", "betas"
"""What a capture calls the shape of the packaged person, and of SMPL-X."""


def cut_parts(body: TemplateModel) -> Parts:
    """Hands and face that are cut out of a body."""
    return cut_hand(body, "left"), cut_hand(body, "right"), cut_face(body)


def at_the_origin(_: np.ndarray) -> np.ndarray:
    """J_0 of a person whose files have it there, whatever the shape."""
    return np.zeros(3)


@dataclass(frozen=True, eq=False)
class Person:
    """Everything that poses one person."""

    body: TemplateModel
    left_hand: HandTemplate
    right_hand: HandTemplate
    face: FaceTemplate
    blend_weight: Float[Tensor, "v 3"]
    """Painted ω of left hand, right hand and face on the body template."""
    name: str
    hash: str
    """SHA-256 of the arrays that pose it (and of its fit), first 16 hex digits."""
    fit: PersonFit | None = None
    """What made it another size than the one called `name`."""
    make_parts: Callable[[TemplateModel], Parts] = cut_parts
    """Hands and face on this body in any size."""
    shape_key: str = OWN_SHAPE
    """What a capture calls the shape in this person's directions."""
    pelvis: Callable[[np.ndarray], np.ndarray] = at_the_origin
    """Where its files have J_0 (3,) with a shape (10,), metres; here it is the origin."""
    sex: str = ""
    """`neutral`, `male` or `female`, of the published model that it is; empty for others."""

    @property
    def packaged(self) -> bool:
        """Whether it is the studio's own, in its own skin."""
        return self.name == "default" and self.fit is None

    def part(self, name: str) -> HandTemplate | FaceTemplate:
        """The template of one of `PARTS`."""
        parts: dict[str, HandTemplate | FaceTemplate] = {"left_hand": self.left_hand, "right_hand": self.right_hand}
        return {**parts, "face": self.face}[name]

    @property
    def naked(self) -> Person:
        """The person of this size with the template's own skin."""
        if self.fit is None or (self.fit.surface is None and self.fit.face is None):
            return self
        return resize_person(load_person(self.name), replace(self.fit, surface=None, face=None))

    @property
    def with_template_face(self) -> Person:
        """The same person, its face the template's own."""
        if self.fit is None or self.fit.face is None:
            return self
        return resize_person(load_person(self.name), replace(self.fit, face=None))

    @property
    def own_face(self) -> bool:
        """Whether its face is the captured person's: as it is given, or fitted to pictures (capture/fit/face_fit.py)."""
        return self.fit is None or self.fit.face is not None

    @cached_property
    def thin_limbs(self) -> Bool[np.ndarray, " v"]:
        """Vertices of forearms and wrists, the thinnest limbs: those that an elbow or a wrist moves most."""
        joints = [JOINT_NAMES.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("elbow", "wrist")]
        return np.isin(self.body.weights.argmax(1).numpy(), joints)

    @property
    def hand_weight(self) -> Float[Tensor, " v"]:
        """Painted ω of either hand on the body template."""
        return self.blend_weight[:, :2].amax(-1)


def load_person(source: str | Path = "default") -> Person:
    """The packaged person ("default"), one from an `.npz` in the same layout, or one of SMPL-X, MANO and Faceverse files: of the user's
    models folder ("models") or another folder; read once, and again where files have changed.

    Raises `InputError`.
    """
    known = {"default": lambda: DATA / "person.npz", "models": models_folder}
    path = known.get(str(source), lambda: Path(source))()
    return _load(str(source), path, stamp(path))


def other_files(name: str) -> str:
    """Which files the person `name` is of, for keys of work that goes on with no others; empty for the packaged one. Raises `InputError`."""
    return "" if name == "default" else f" {name} {load_person(name).hash}"


@lru_cache(maxsize=4)
@torch.inference_mode(False)
def _load(name: str, path: Path, _: Stamp) -> Person:
    if name == "models" or what_is(path) == "a folder":
        found = read_models(path)
        person = _whole(found.body, found.parts, name, found.hash)
        return replace(person, shape_key=SMPLX_SHAPE, pelvis=found.pelvis, sex=found.sex)
    arrays = read_npz(path, "person")
    body = read_model(arrays, path)
    if len(body.parents) != 55:
        raise InputError(path, "weights", "55 joints in SMPL-X order", len(body.parents))
    return _whole(body, cut_parts, name, hash_arrays(arrays))


def resize_person(person: Person, fit: PersonFit) -> Person:
    """`person` with the size of `fit`: its new mean shape (β = 0) has the fit's joints exactly.

    Raises `InputError` for a person that is resized already.
    """
    if person.fit is not None:
        raise InputError("person", "fit", "a person of the original size", "one that is resized")
    moved = fit.moved(person.body.double())
    vertices, joints, directions = (
        real(each.numpy()) for each in (moved.v_template, moved.joint_template, moved.expression_dirs)
    )
    follows = moved.joint_expression_dirs
    resized = replace(
        person.body,
        v_template=vertices,
        joint_template=joints,
        expression_dirs=directions,
        joint_expression_dirs=None if follows is None else real(follows.numpy()),
    )
    digest = hashlib.sha256((person.hash + json.dumps(fit.to_json())).encode())

    def parts(body: TemplateModel) -> Parts:
        left, right, face = person.make_parts(body)
        if fit.labels_stay and (face.body_vertex_ids >= 0).all():
            face = labelled_as(face, person.body, body)
        return left, right, face

    whole = _whole(resized, parts, person.name, digest.hexdigest()[:16])
    return replace(
        whole, fit=fit, shape_key=person.shape_key, pelvis=person.pelvis, sex=person.sex, make_parts=person.make_parts
    )


def _whole(body: TemplateModel, make_parts: Callable[[TemplateModel], Parts], name: str, hash: str) -> Person:
    """The person of a body and its parts, whose ω are painted on the body, too."""
    parts = make_parts(body)
    painted = body.v_template.new_zeros(len(body.v_template), len(PARTS))
    every: tuple[HandTemplate | FaceTemplate, ...] = parts
    for column, part in enumerate(every):
        on_body = part.body_vertex_ids >= 0
        painted[part.body_vertex_ids[on_body], column] = part.blend_weight[on_body]
    if (parts[2].body_vertex_ids < 0).all():  # a face with a mesh of its own
        painted[:, 2] = paint_face(body)
    return Person(body, *parts, painted, name, hash, make_parts=make_parts)
