"""Where a face's mesh is the person's own, pass I keeps the surface by what of it can be seen."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.counters import Counters
from avatarrex.ops.closest_point import closest_point
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.face_offsets import FaceOffsets
from avatarrex.templates.model import EYES
from avatarrex.templates.person import load_person, resize_person
from avatarrex.templates.person_fit import PersonFit
from avatarrex.templates.posed import pose_person
from avatarrex.training.core.frames import FrameStore, TrainingFrame
from avatarrex.training.core.pass_one import FacePass
from avatarrex.training.core.supervision import hidden_at_rest
from avatarrex.training.recipe import QUICK
from avatarrex.volume.build import AvatarVolume

OFFSETS = FaceOffsets((5,), np.zeros((1, 3)), np.zeros((0, 52)), np.zeros((1, 3, 0)))


def stage_of(avatar: Avatar) -> FacePass:
    return FacePass(avatar, object.__new__(FrameStore), QUICK.face[0], 0)


@pytest.fixture(scope="module")
def stage() -> FacePass:
    return stage_of(load_avatar())


def frame_of(avatar: Avatar, index: int, **expression: float) -> TrainingFrame:
    """Posed, without a volume."""
    value = np.zeros(52)
    for name, share in expression.items():
        value[EXPRESSION_NAMES.index(name)] = share
    posed = pose_person(avatar.person, Signals.rest().replace(expression=value), Counters(), None)
    return TrainingFrame(index, posed, np.eye(4), object.__new__(AvatarVolume), 0)


def compared(stage: FacePass, index: int, **expression: float) -> set[int]:
    """Vertices of the face's mesh in an expression whose distance is compared."""
    return set(stage._shown_skin(frame_of(stage.avatar, index, **expression)).tolist())


def test_what_can_be_seen_is_compared_and_nothing_within_lips(stage: FacePass) -> None:
    face = stage.avatar.person.face
    rest = compared(stage, 0)
    eye = set(face.model.groups["left_eye"].tolist())
    assert len(rest) > 500
    assert not rest & eye, "compared by pixels"
    opened = compared(stage, 1, jawOpen=0.9)
    teeth = {vertex for name in ("upper_teeth", "lower_teeth", "tongue") for vertex in face.model.groups[name].tolist()}
    assert not opened & (teeth | set(torch.nonzero(face.mouth)[:, 0].tolist()))
    wide = compared(stage, 4, jawOpen=0.9, eyeWideLeft=1.0, eyeWideRight=1.0)
    assert not wide & set(torch.nonzero(hidden_at_rest(stage.avatar.face, face.v_template.float()))[:, 0].tolist())
    assert all(face.blend_weight[vertex] > 0.99 for vertex in rest)


def test_a_face_is_known_where_it_is_given_or_fitted() -> None:
    sized = PersonFit(np.zeros(10), np.zeros((55, 3)))
    assert load_person().own_face
    assert not resize_person(load_person(), sized).own_face
    assert resize_person(load_person(), replace(sized, face=OFFSETS)).own_face


@pytest.fixture
def frame(stage: FacePass, monkeypatch: pytest.MonkeyPatch) -> TrainingFrame:
    """Posed, with what drives the face's networks."""
    found = frame_of(stage.avatar, 3)
    planes = SimpleNamespace(driven=stage.avatar.face.driven(found.posed.parts["face"].float(), torch.zeros(61)))
    monkeypatch.setattr(AvatarVolume, "states", {})
    monkeypatch.setattr("avatarrex.training.core.pass_one.face_state", lambda _: SimpleNamespace(planes=planes))
    return found


def skin_term(stage: FacePass, frame: TrainingFrame) -> float | None:
    terms = stage.field(frame, torch.Generator().manual_seed(0))[1]
    return float(terms["skin"].detach()) if "skin" in terms else None


def test_only_a_known_face_is_compared(stage: FacePass, frame: TrainingFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    term = skin_term(stage, frame)
    assert term is not None
    assert 0 < term < 0.5  # below 2 mm: the avatar was trained on this face
    monkeypatch.setattr(FrameStore, "pairs", [(0, 0), (0, 1)])
    sized = PersonFit(np.zeros(10), np.zeros((55, 3)))
    stranger, fitted = (
        replace(stage.avatar, person=resize_person(load_person(), fit)) for fit in (sized, replace(sized, face=OFFSETS))
    )
    assert skin_term(stage_of(stranger), frame) is None
    assert skin_term(stage_of(fitted), frame) is not None
    monkeypatch.setattr(FrameStore, "pairs", [(0, 1), (5, 1)])  # one camera
    assert skin_term(stage_of(fitted), frame) is None
    assert skin_term(stage_of(stage.avatar), frame) == term


def test_about_eyes_is_compared_what_the_front_shows(stage: FacePass, frame: TrainingFrame) -> None:
    """Eyeballs between their lids, less of one that is half open, nothing of a closed one; and the lids themselves."""
    faces, eye = stage.avatar.face.faces, stage.avatar.person.face.model.of_groups(EYES)
    found = []
    for number, blink in enumerate((0.0, 0.5, 1.0)):
        one = frame_of(stage.avatar, 10 + number, eyeBlinkLeft=blink)
        points = stage._seen_of_eyes(one)
        on = closest_point(one.posed.parts["face"], faces, points)
        assert on.sdf.abs().max() < 1e-6
        ball = eye[faces[on.face]].all(1)
        left = points[:, 0] > 0
        found.append(((ball & left).sum().item(), (ball & ~left).sum().item(), (~ball & left).sum().item()))
    (opened, other, lids), (half, _, _), (closed, still, covering) = found
    assert min(opened, other) > 60
    assert 10 < half < 0.8 * opened
    assert (closed, still) == (0, other)
    assert lids > 60
    assert covering > 100
    before = skin_term(stage, frame)
    stage._eyes[frame.index] = stage._seen_of_eyes(frame) + torch.tensor([0, 0, 0.005])
    after = skin_term(stage, frame)
    del stage._eyes[frame.index]
    assert before is not None
    assert after is not None
    assert after > before + 0.1, "points 5 mm off the eyes count"


def test_where_nothing_is_shown_nothing_is_compared(frame: TrainingFrame) -> None:
    blind = stage_of(load_avatar())
    blind._skin[frame.index], blind._eyes[frame.index] = torch.zeros(0, dtype=torch.long), torch.zeros(0, 3)
    assert skin_term(blind, frame) == 0
