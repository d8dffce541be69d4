"""Another body's size on a person's template: shape, offsets of the joints, offsets of the skin, and a face (face_offsets.py).

The skin follows the joints' offsets by the smooth field that interpolates them, φ(r) = r with an affine part, in which a
bone takes its flesh along evenly; then its own offsets are added. Eyeballs turn about their joints: they and their lids
stay there where the skin has offsets (`eyes_stay`); lips, brows and mouth stay the vertices that they are (`labels_stay`).
Letters: v vertices, j joints, n offsets. Metres, root frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from avatarrex.errors import InputError
from avatarrex.signals.joints import BODY_GROUPS, FINGERS, JOINT_NAMES
from avatarrex.templates.face_offsets import FaceOffsets, flag
from avatarrex.templates.model import EYES, TemplateModel

SPREAD_SIGMA = 0.05
"""Metres: σ of a surface offset in the files of fits before 2026-11-30."""
NEAREST = 8
"""Offsets that move a vertex."""
LIMB_DISTANCE = 0.02
"""Metres that a limb's share of the skinning counts as in `places`, so that fingers, thighs, arm and chest move apart."""
EYE_STAYS, EYE_FREE = 0.022, 0.044
"""Metres from an eye's middle up to which the skin stays, lids to their creases, and from which it moves as it is told."""


@dataclass(frozen=True, eq=False)
class SurfaceOffsets:
    """A smooth field that moves the skin at rest and leaves the joints: offsets of some vertices, spread over all."""

    vertices: tuple[int, ...]
    """Indices into the body template."""
    offsets: np.ndarray
    """(n, 3) metres."""
    eyes_stay: bool = False
    """Whether eyes and lids stay at the eyes' joints, whatever the skin around does; False in the files of before."""
    limbs_apart: bool = False
    """Whether a vertex follows the nearest offsets in `places`, which are nearly all of its own limb or finger; False in the files of
    fits before 2026-11-30, of offsets that were 6 cm apart."""

    def __post_init__(self) -> None:
        value = np.asarray(self.offsets, dtype=np.float64)
        if value.shape != (len(self.vertices), 3) or not value.size or not (np.abs(value) < 1).all():
            raise InputError("person fit", "surface.offsets", f"({len(self.vertices)}, 3) below 1 m", value.shape)
        object.__setattr__(self, "offsets", value)

    def weights(self, body: TemplateModel) -> csr_array:
        """(v, n) at the rest vertices of the original `body`, of the `NEAREST` offsets; sum 1, less about eyes that stay.

        (1 − (d/D)²)² with D the distance of the next one, so that an offset's weight is zero where another takes its turn; in the files
        of before Gaussians.
        """
        least, most = NEAREST + int(self.limbs_apart), len(body.v_template) - 1
        if min(self.vertices) < 0 or max(self.vertices) > most or len({*self.vertices}) < least:
            expected = f"{least} or more different indices, 0 to {most}"
            raise InputError("person fit", "surface.vertices", expected, self.vertices[:8])
        place = places(body) if self.limbs_apart else body.v_template.double().numpy()
        away, nearest = cKDTree(place[list(self.vertices)]).query(place, least)
        nearest = nearest[:, :NEAREST]
        if self.limbs_apart:
            value = (1 - (away[:, :-1] / away[:, -1:].clip(1e-9)) ** 2) ** 2 + 1e-9
        else:
            value = np.exp(-0.5 * (away / SPREAD_SIGMA) ** 2) + 1e-9
        value /= value.sum(1, keepdims=True)
        if self.eyes_stay:
            value *= 1 - sum(_near_eyes(body).values(), np.zeros(len(place)))[:, None]
        rows = np.repeat(np.arange(len(place)), NEAREST)
        return csr_array((value.ravel(), (rows, nearest.ravel())), shape=(len(place), len(self.vertices)))

    def moved(self, body: TemplateModel) -> np.ndarray:
        """(v, 3) what vertices of the original `body` move by."""
        return np.asarray(self.weights(body) @ self.offsets)


@dataclass(frozen=True, eq=False)
class PersonFit:
    """Another body's size on a person's template: a shape, then an offset of every joint from where the shape has it."""

    shape: np.ndarray
    """β, (10,) standard deviations."""
    joint_offsets: np.ndarray
    """(55, 3) metres, root frame; the pelvis stays: its row is zero. Joints of eyes also take what a face moves its eyeballs by."""
    surface: SurfaceOffsets | None = None
    face: FaceOffsets | None = None
    """What its face differs by, at rest and with expressions; None: the template's."""
    labels_stay: bool = True
    """Whether lips, brows and mouth are the vertices that they are on the template. False in the files of fits before 2026-11-28: there
    they are where the resized face has its teeth and eyes, and a fitted chin may be labelled as mouth. A face with a mesh of its own always
    has its own labels."""

    def __post_init__(self) -> None:
        for name, shape in (("shape", (10,)), ("joint_offsets", (55, 3))):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != shape or not np.isfinite(value).all() or np.abs(value).max() > 20:
                raise InputError("person fit", name, f"{shape} finite numbers, none beyond 20", value.shape)
            object.__setattr__(self, name, value)
        if self.joint_offsets[0].any():
            raise InputError("person fit", "joint_offsets", "a pelvis that stays (row 0 zero)", self.joint_offsets[0])

    def to_json(self) -> dict[str, Any]:
        """Plain lists; `from_json` gives the same fit back, bit for bit."""
        fit: dict[str, Any] = {"shape": self.shape.tolist(), "joint_offsets": self.joint_offsets.tolist()}
        if self.surface is not None:
            fit["surface"] = {"vertices": list(self.surface.vertices), "offsets": self.surface.offsets.tolist()}
            if self.surface.eyes_stay:
                fit["surface"]["eyes_stay"] = True
            if self.surface.limbs_apart:
                fit["surface"]["limbs_apart"] = True
        if self.face is not None:
            fit["face"] = self.face.to_json()
        if self.labels_stay:
            fit["labels_stay"] = True
        return fit

    @classmethod
    def from_json(cls, data: Any, source: str | Path) -> PersonFit:
        """From `to_json`'s object. Raises `InputError`."""
        if not isinstance(data, dict) or set(data) - {"surface", "face", "labels_stay"} != {"shape", "joint_offsets"}:
            raise InputError(source, "person_fit", "an object with shape and joint_offsets", repr(data)[:60])
        try:
            shape, offsets = (np.array(data[name], dtype=np.float64) for name in ("shape", "joint_offsets"))
            surface, face = None, None
            if "surface" in data:
                moved = np.array(data["surface"]["offsets"], dtype=np.float64)
                stay, apart = (flag(data["surface"], name, f"surface.{name}") for name in ("eyes_stay", "limbs_apart"))
                surface = SurfaceOffsets(tuple(map(int, data["surface"]["vertices"])), moved, stay, apart)
            if "face" in data:
                face = FaceOffsets.from_json(data["face"])
            return cls(shape, offsets, surface, face, flag(data, "labels_stay", "labels_stay"))
        except (TypeError, ValueError, KeyError, OverflowError) as error:
            if not isinstance(error, InputError):
                raise InputError(source, "person_fit", "lists of numbers", "another form") from None
            raise InputError(source, f"person_fit.{error.field}", error.expected, error.found) from None

    def moved(self, body: TemplateModel) -> TemplateModel:
        """`body` (float64) with this size and face."""
        shape = torch.from_numpy(self.shape)
        vertices = (body.v_template + body.shapedirs[..., :10] @ shape).numpy()
        joints = (body.joint_template + body.joint_shapedirs[..., :10] @ shape).numpy()
        placed = joints + self.joint_offsets
        from scipy.interpolate import RBFInterpolator  # takes 0.3 s: not before a person is fitted

        follows = RBFInterpolator(joints, self.joint_offsets, kernel="linear", degree=1)(vertices)
        if self.surface is not None:
            follows += self.surface.moved(body)
            if self.surface.eyes_stay:
                far = vertices + follows - body.v_template.numpy()
                for eye, near in _near_eyes(body).items():
                    joint = JOINT_NAMES.index(eye)
                    wanted = placed[joint] - body.joint_template[joint].numpy()
                    follows += near[:, None] * (wanted - far[body.groups[eye]].mean(0))
        expressions, joints_follow = body.expression_dirs, body.joint_expression_dirs
        if self.face is not None:
            rest, own = self.face.shapes(body)
            gain = torch.from_numpy(self.face.gain(expressions.shape[2]))
            follows, expressions = follows + rest, expressions * gain + torch.from_numpy(own)
            joints_follow = None if joints_follow is None else joints_follow * gain
            for eye in EYES:
                if self.face.eye_joints and eye in body.groups:  # it turns about the middle of its ball
                    placed[JOINT_NAMES.index(eye)] += rest[body.groups[eye]].mean(0)
        moved = torch.from_numpy(vertices + follows), torch.from_numpy(placed)
        return replace(
            body,
            v_template=moved[0],
            joint_template=moved[1],
            expression_dirs=expressions,
            joint_expression_dirs=joints_follow,
        )


def places(body: TemplateModel) -> np.ndarray:
    """(v, 3 + limbs) rest vertices of the original `body`, metres, and `LIMB_DISTANCE` times the share of each limb and finger in their
    skinning weights: Euclidean distances there are those in space, and more from one limb to another."""
    limbs: list[tuple[str, ...]] = list(BODY_GROUPS.values())
    limbs += [tuple(f"{side}_{finger}{k}" for k in (1, 2, 3)) for side in ("left", "right") for finger in FINGERS]
    columns = [[JOINT_NAMES.index(joint) for joint in limb] for limb in limbs]
    weights = body.weights.double().numpy()
    share = np.stack([weights[:, column].sum(1) for column in columns], 1)
    return np.concatenate([body.v_template.double().numpy(), LIMB_DISTANCE * share], 1)


def _near_eyes(body: TemplateModel) -> dict[str, np.ndarray]:
    """By eye (v,): 1 on its ball and lids, 0 farther away; no more than 1 together."""
    rest, near = body.v_template.double().numpy(), {}
    for eye in EYES:
        ball = body.of_groups([eye]).numpy()
        if ball.any():
            away = np.linalg.norm(rest - rest[ball].mean(0), axis=1)
            t = np.clip((away - EYE_STAYS) / (EYE_FREE - EYE_STAYS), 0, 1)
            near[eye] = 1 - t * t * (3 - 2 * t)
    total = np.maximum(sum(near.values()), 1) if near else 1
    return {eye: value / total for eye, value in near.items()}
