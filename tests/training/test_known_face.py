"""Where a face's mesh is the person's own, pass I keeps the surface by what of it can be seen."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh

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
from avatarrex.training.core.pass_one import ON_EYES, SKIN_POINTS, FacePass
from avatarrex.training.core.supervision import beneath, hidden_at_rest
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
    assert rest & eye
    opened, blink = compared(stage, 1, jawOpen=0.9), compared(stage, 2, eyeBlinkLeft=1.0)
    teeth = {vertex for name in ("upper_teeth", "lower_teeth", "tongue") for vertex in face.model.groups[name].tolist()}
    assert not opened & (teeth | set(torch.nonzero(face.mouth)[:, 0].tolist()))
    wide = compared(stage, 4, jawOpen=0.9, eyeWideLeft=1.0, eyeWideRight=1.0)
    assert not wide & set(torch.nonzero(hidden_at_rest(stage.avatar.face, face.v_template.float()))[:, 0].tolist())
    assert not blink & eye, "a closed lid lies over all of it"
    assert len(compared(stage, 5, eyeSquintLeft=1.0) & eye) > 0.5 * len(rest & eye)
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


def test_what_lies_beneath_something_is_found_along_its_normal() -> None:
    """A ball under a plate 1 mm above its pole: of its vertices those beneath the plate, whatever lies beneath the plate's edge."""
    ball, plate = trimesh.creation.icosphere(3, 0.012), trimesh.creation.box((0.008, 0.008, 0.0005))
    plate.apply_translation((0, 0, 0.01325))
    both = trimesh.util.concatenate([ball, plate])
    mesh, faces = torch.from_numpy(both.vertices.copy()), torch.from_numpy(both.faces.copy())
    of_ball = torch.arange(len(mesh)) < len(ball.vertices)
    found = beneath(mesh, faces, of_ball)
    x, y, z = (mesh / mesh.norm(dim=1, keepdim=True) * 0.013).unbind(1)  # where the normal meets the plate's height
    away = torch.maximum(x.abs(), y.abs())
    assert found[of_ball & (z > 0.012) & (away < 0.0035)].all()
    assert found.any()
    assert not found[~of_ball | (away > 0.0045) | (z < 0)].any()
    raised = mesh + torch.where(of_ball, 0, 0.004)[:, None] * torch.tensor([0.0, 0.0, 1.0]).to(mesh)
    assert not beneath(raised, faces, of_ball).any(), "out of reach"


def test_eyeballs_beneath_lids_are_not_compared(stage: FacePass, monkeypatch: pytest.MonkeyPatch) -> None:
    eye = stage.avatar.person.face.model.of_groups(EYES)
    assert eye[sorted(compared(stage, 8))].any()
    monkeypatch.setattr("avatarrex.training.core.pass_one.beneath", lambda mesh, faces, some: some)
    assert not eye[sorted(compared(stage, 9))].any()


def test_points_lie_evenly_on_the_mesh_and_a_quarter_on_eyeballs(stage: FacePass) -> None:
    faces, eye = stage.avatar.face.faces, stage.avatar.person.face.model.of_groups(EYES)
    opened, closed = frame_of(stage.avatar, 6), frame_of(stage.avatar, 7, eyeBlinkLeft=1.0, eyeBlinkRight=1.0)
    for frame, share in ((opened, ON_EYES), (closed, 0.0)):
        mesh, shown = frame.posed.parts["face"], torch.zeros(len(eye), dtype=torch.bool)
        shown[stage._shown_skin(frame)] = True
        corner = mesh[faces[shown[faces].all(1) & ~eye[faces].all(1)]]
        area = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).norm(dim=1)
        points = stage._mesh_points(frame, torch.Generator().manual_seed(0))
        assert len(points) == SKIN_POINTS
        found = closest_point(mesh, faces, points)
        assert found.sdf.abs().max() < 1e-6
        assert found.barycentric.square().sum(1).mean().item() == pytest.approx(1 / 2, abs=0.03)  # 1/3 in the middle
        on_eye = eye[faces[found.face]].all(1)
        assert on_eye.float().mean().item() == pytest.approx(share, abs=0.05)
        middle = (area[:, None] * corner.mean(1)).sum(0) / area.sum()
        assert (points[~on_eye].mean(0) - middle).norm() < 0.006


def test_where_nothing_is_shown_nothing_is_compared(frame: TrainingFrame) -> None:
    blind = stage_of(load_avatar())
    blind._skin[frame.index] = torch.zeros(0, dtype=torch.long)
    assert skin_term(blind, frame) == 0
