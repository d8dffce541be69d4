"""Faces outside of what they were trained on: the range that is known, and how the template carries the rest."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.counters import Counters
from avatarrex.errors import InputError
from avatarrex.fields.light import Irradiance
from avatarrex.levels import LEVELS
from avatarrex.parts.carried import OFF, Carried, PosedMesh, Seen
from avatarrex.parts.face import SHADOW, Face, FaceState, face_state
from avatarrex.parts.known_expressions import ROOM, KnownExpressions
from avatarrex.parts.part import SurfacePoints
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.library import coefficients
from avatarrex.templates.albedo import inside_mouth
from avatarrex.templates.face import covered
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import pose_person
from avatarrex.training.core.provenance import expressions
from avatarrex.volume.build import build_volume

PERSON = load_person("default")
GAP = 0.012
"""Metres by which the jaw of boxes opens."""


def shown(**units: float) -> Signals:
    """A frame with some coefficients."""
    return Signals.rest().replace(expression=coefficients(units))


def vector(frame: Signals) -> torch.Tensor:
    """ψ, jaw and eyes in one."""
    return torch.as_tensor(PERSON.face.coefficients(frame))


def test_what_frames_show_is_known_and_a_little_more() -> None:
    known = KnownExpressions.of([shown(jawOpen=0.5), shown(jawOpen=0.2, mouthPucker=0.03)])
    assert "jawOpen" not in known.never_shown
    assert {"mouthPucker", "eyeBlinkLeft"} <= set(known.never_shown)
    jaw, blink = EXPRESSION_NAMES.index("jawOpen"), EXPRESSION_NAMES.index("eyeBlinkLeft")
    wide = known.nearest(vector(shown(jawOpen=1.0, eyeBlinkLeft=1.0)))
    assert wide[jaw] == pytest.approx((1 + ROOM) * 0.5)
    assert wide[blink] == 0
    inside = vector(shown(jawOpen=0.1))
    assert torch.equal(known.nearest(inside), inside), "rest is always known"
    turned = Signals.rest().replace(eye_pose=np.array([[0.0, -0.4, 0], [0, 0, 0]]))
    looked = KnownExpressions.of([turned]).nearest(
        vector(turned.replace(eye_pose=np.array([[0.0, -0.9, 0.2], [0, 0.3, 0]])))
    )
    assert looked[-6:].tolist() == pytest.approx([0, -0.4 * (1 + ROOM), 0, 0, 0, 0])


@pytest.mark.parametrize(
    "broken", [{}, [], {"least": [0.0] * 61}, {"least": [0.0] * 61, "most": [0.0] * 60}, {"least": ["a"] * 61, "most": [0.0] * 61},
               {"least": [0.0] * 61, "most": [float("nan")] * 61}, {"least": [0.0] * 61, "most": [0.0] * 61, "shape": [0.0] * 9}]
)  # fmt: skip
def test_a_range_that_cannot_be_is_refused(broken: object) -> None:
    known = KnownExpressions.of([shown(jawOpen=0.5)])
    again = KnownExpressions.from_json(json.loads(json.dumps(known.to_json())), "avatar.json")
    assert (again.most.tolist(), again.least.tolist()) == (known.most.tolist(), known.least.tolist())
    tall = KnownExpressions.of([Signals.rest().replace(shape=np.eye(10)[0])])
    assert KnownExpressions.from_json(tall.to_json(), "avatar.json").shape.tolist() == [1.0] + [0.0] * 9
    before = {name: tall.to_json()[name] for name in ("least", "most")}
    assert not KnownExpressions.from_json(before, "avatar.json").shape.any(), "files of before do not say it"
    with pytest.raises(InputError, match=r"avatar\.json: training: expressions: (least|most|shape)"):
        KnownExpressions.from_json(broken, "avatar.json")


def test_an_avatar_keeps_its_range_and_refuses_a_broken_one(tmp_path) -> None:
    avatar = Avatar.create(PERSON, "compact")
    assert avatar.known_expressions is None
    known = expressions([shown(jawOpen=0.5)], None)
    avatar.meta["training"] = {"expressions": known}
    save_avatar(avatar, tmp_path / "a.avatar")
    found = load_avatar(tmp_path / "a.avatar")
    assert found.known_expressions is not None
    assert found.known_expressions.to_json() == known
    assert expressions(None, found) == known, "a training of the body alone keeps what the face was trained on"
    assert expressions(None, None) is None
    avatar.meta["training"] = {"expressions": {"least": [0]}}
    save_avatar(avatar, tmp_path / "b.avatar")
    with pytest.raises(InputError, match=r"b\.avatar: avatar\.json: training: expressions: least"):
        load_avatar(tmp_path / "b.avatar")


def jaws(gap: float) -> PosedMesh:
    """Two boxes of 4 × 2 × 4 cm, the lower one `gap` metres below the upper."""
    upper, lower = (trimesh.creation.box((0.04, 0.02, 0.04)) for _ in range(2))
    upper.apply_translation((0, 0.01, 0))
    lower.apply_translation((0, -0.01 - gap, 0))
    both = trimesh.util.concatenate([upper, lower]).subdivide().subdivide()
    faces = torch.as_tensor(np.array(both.faces))
    return PosedMesh(torch.as_tensor(np.array(both.vertices)), faces, torch.ones(len(faces), dtype=torch.bool))


def box_distance(points: torch.Tensor, centre: float, half: float) -> torch.Tensor:
    """Of a box 4 cm wide and deep about (0, `centre`, 0), `half` high."""
    off = (points - points.new_tensor([0.0, centre, 0.0])).abs() - points.new_tensor([0.02, half, 0.02])
    return off.clamp(min=0).norm(dim=-1) + off.amax(-1).clamp(max=0)


def test_a_mouth_that_nobody_saw_open_opens() -> None:
    """What was learnt of the closed one is a solid block, 1 mm thicker than the mesh."""
    carried = Carried(jaws(GAP), jaws(0.0))
    noise = torch.Generator().manual_seed(0)
    points = 0.06 * (torch.rand(4000, 3, generator=noise, dtype=torch.float64) - 0.5) - torch.tensor([0, GAP / 2, 0])
    way = carried.back(points)
    found = way.distance(box_distance(way.place, 0.0, 0.02) - 0.001)
    upper, lower = box_distance(points, 0.01, 0.01), box_distance(points, -0.01 - GAP, 0.01)
    true = torch.minimum(upper, lower)
    between = (points[:, 1] < -OFF) & (points[:, 1] > OFF - GAP) & (points[:, [0, 2]].abs() < 0.015).all(-1)
    assert between.sum() > 30
    assert (found[between] > 0).all(), "air between the lips"
    deep, outside = true < -0.004, true > 0.004
    assert (found[deep] < 0).all()
    assert (found[outside] > 0).all()
    still = (points[:, 1] > 0.002) & (upper < lower - 1e-3)
    assert torch.equal(way.place[still], points[still])
    assert still.sum() > 100


def test_lips_part_by_less_than_flesh_may_be_thick() -> None:
    """Half a millimetre behind their front, 1.5 mm off both."""
    carried, between = (
        Carried(jaws(0.003), jaws(0.0)),
        torch.tensor([[0.0, -0.0015, 0.0195]], dtype=torch.float64),
    )
    way = carried.back(between)
    assert way.distance(box_distance(way.place, 0.0, 0.02)) == pytest.approx(0.0015, abs=1e-9)


def test_thickness_is_carried() -> None:
    """Half a millimetre over a jaw's outer side is where half a millimetre over it was."""
    carried, side = Carried(jaws(GAP), jaws(0.0)), torch.tensor([[0.0205, -0.01 - GAP, 0.0]], dtype=torch.float64)
    way = carried.back(side)
    torch.testing.assert_close(way.place, side + side.new_tensor([0, GAP, 0]))
    assert way.distance(torch.tensor([0.0])) == pytest.approx(0, abs=1e-9)


def face_of(known: KnownExpressions | None) -> Face:
    """The default person's, untrained."""
    torch.manual_seed(0)
    made = Avatar.create(PERSON, "compact").parts["face"]
    assert isinstance(made, Face)
    return replace(made, known=known)


def state_of(face: Face, frame: Signals, before: FaceState | None = None, size: float = 1.0) -> FaceState:
    """Prepared for a frame, of a head so many times as large."""
    vector_ = vector(frame)
    rest = PERSON.face.v_template
    vertices = size * PERSON.face.posed(vector_.to(rest), rest.new_zeros(0))
    return face.prepare(vertices, vector_, Counters(), before=before)


def test_known_expressions_are_as_before_and_others_carry_the_nearest() -> None:
    """Planes, distances and colours of an unknown blink are those of the open eye, moved; the rest of the face is as it was."""
    frame = shown(eyeBlinkLeft=1.0)
    plain, known = face_of(None), face_of(KnownExpressions.of([frame]))
    closed, same = state_of(plain, frame), state_of(known, frame)
    assert same.carried is None
    assert torch.equal(same.planes.geometry, closed.planes.geometry)
    face = face_of(KnownExpressions.of([Signals.rest()]))
    carried, open_ = state_of(face, frame), state_of(face, Signals.rest())
    assert carried.carried is not None
    assert torch.allclose(carried.planes.driven, open_.planes.driven, atol=1e-6), "the networks see a known face"
    rest, posed = open_.triangles.vertices, closed.triangles.vertices
    moved = np.linalg.norm(posed - rest, axis=1)
    lid = torch.as_tensor(posed[moved.argmax()])[None].float()
    origin = torch.as_tensor(rest[moved.argmax()])[None].float()
    way = carried.carried.back(lid)
    torch.testing.assert_close(way.place, origin, rtol=0, atol=1e-5)
    assert abs(float(way.lift)) < 1e-3
    chin = torch.as_tensor(rest[moved == 0][np.argmin(rest[moved == 0][:, 1] - rest[moved == 0][:, 2])])[None].float()
    assert torch.equal(face.evaluate(carried, chin), face.evaluate(open_, chin))
    assert not torch.equal(face.evaluate(carried, lid), face.evaluate(open_, lid))


def test_the_planes_of_a_carried_face_are_made_once() -> None:
    """Expressions and shapes that one known face carries share what the networks made of it; other faces have their own."""
    face, plain = face_of(KnownExpressions.of([Signals.rest()])), face_of(None)
    blink, laugh = shown(eyeBlinkLeft=1.0), shown(jawOpen=0.5, mouthSmileLeft=0.7)
    first, alone = state_of(face, blink), state_of(face, laugh)
    shared = state_of(face, laugh, first)
    assert shared.planes is first.planes
    assert shared.carried.known is first.carried.known
    assert shared.carried.now is not first.carried.now
    torch.testing.assert_close(shared.planes.geometry, alone.planes.geometry, rtol=0, atol=1e-5)
    points = torch.from_numpy(alone.triangles.vertices[::50]).float() + 0.003
    torch.testing.assert_close(face.evaluate(shared, points), face.evaluate(alone, points), rtol=0, atol=1e-5)
    face.decode_colour(shared, counters := Counters())
    face.decode_colour(first, counters)
    assert counters["unet_runs"] == 3, "colours, too"
    assert first.planes.serve(first.planes.vertices, first.planes.coefficients)
    assert not first.planes.serve(first.planes.vertices, first.planes.coefficients + 0.1), "a field may have them alone"
    assert state_of(face, laugh, first, size=1.001).planes is first.planes, "of another shape, too"
    assert (
        state_of(plain, laugh, state_of(plain, laugh), size=1.001).planes.vertices[0, 0] != first.planes.vertices[0, 0]
    )
    smiling = face_of(KnownExpressions.of([shown(mouthSmileLeft=0.7)]))
    assert state_of(smiling, laugh, state_of(smiling, blink)).planes is not state_of(smiling, blink).planes
    assert state_of(plain, laugh, state_of(plain, blink)).carried is None
    assert not torch.equal(state_of(plain, laugh, state_of(plain, blink)).planes.driven, first.planes.driven)


def shaped(face: Face, frame: Signals, shape: list[float]) -> FaceState:
    """Prepared for a frame of a body shape (its first coefficients)."""
    vertices = PERSON.face.posed(vector(frame).float(), torch.tensor(shape))
    return face.prepare(vertices, vector(frame), Counters())


def test_another_shape_carries_the_face_that_was_learnt() -> None:
    """Distances and colours of skin points are those of the trained shape; eyes go with the lids."""
    face, blink = face_of(KnownExpressions.of([shown(eyeBlinkLeft=1.0)])), shown(eyeBlinkLeft=1.0)
    small, own = shaped(face, blink, [-2.5, 1.0]), shaped(face, blink, [])
    assert own.reshaped is None
    assert small.reshaped is not None
    here = PERSON.face.posed(vector(blink).float(), torch.tensor([-2.5, 1.0]))
    there = PERSON.face.posed(vector(blink).float(), torch.zeros(0))
    assert (here - there).norm(dim=-1).max() > 0.01
    skin = PERSON.face.skin.unique()[::40]
    torch.testing.assert_close(small.trained(here[skin]), there[skin], rtol=0, atol=1e-6)
    torch.testing.assert_close(face.evaluate(small, here[skin]), face.evaluate(own, there[skin]), rtol=0, atol=1e-6)
    direction, still, light = (
        torch.tensor([[0.0, 0.0, 1.0]]).expand(len(skin), 3),
        torch.eye(3),
        Irradiance(torch.zeros(8, 3)),
    )
    colours = [
        face.colour(state, SurfacePoints(points[skin], direction, direction, direction, still, light), Counters())
        for state, points in ((small, here), (own, there))
    ]
    torch.testing.assert_close(*colours, rtol=0, atol=1e-3)
    assert not torch.isin(PERSON.face.model.groups["left_eye"], PERSON.face.skin).any()
    plain = shaped(face_of(None), blink, [-2.5])
    assert plain.reshaped is None, "of an avatar that does not say what it was trained on"


def test_fields_that_changed_make_their_planes_anew() -> None:
    avatar = Avatar.create(PERSON, "compact", 0)
    avatar.meta["training"] = {"expressions": KnownExpressions.of([Signals.rest()]).to_json()}
    planes, runs, before = [], [], None
    for jaw, version in ((0.2, 0), (0.4, 0), (0.6, 1)):
        avatar.versions["face"] = version
        counters = Counters()
        posed = pose_person(PERSON, shown(jawOpen=jaw), counters, None)
        before = build_volume(avatar, posed, LEVELS["fast"], counters, before, frozenset({"left_hand", "right_hand"}))
        planes.append(face_state(before.states).planes)
        runs.append(counters["unet_runs"])
    assert planes[0] is planes[1]
    assert planes[1] is not planes[2]
    assert runs == [3, 0, 3]


def test_a_mouth_that_nobody_saw_has_the_template_s_colours() -> None:
    """Of tongue and teeth; the rest keeps what was learnt."""
    frame = shown(jawOpen=1.0)
    face = face_of(KnownExpressions.of([Signals.rest()]))
    state = state_of(face, frame)
    template, posed = face.template, torch.as_tensor(state.triangles.vertices)
    assert state.carried is not None
    rows = torch.stack(
        [template.model.groups[name][0] for name in ("tongue", "lower_teeth")] + [torch.argmax(posed[:, 2])]
    )
    corner = (template.faces[None] == rows[:, None, None]).any(2).int().argmax(1)
    weight = (template.faces[corner] == rows[:, None]).double()
    seen = Seen(posed[rows].float(), corner, weight)
    learnt = torch.full((3, 3), 0.5)
    found = face._in_mouth(state.carried, seen, learnt)
    torch.testing.assert_close(found[:2], SHADOW * template.albedo[rows[:2]].float())
    assert torch.equal(found[2], learnt[2]), "the nose"
    little = state_of(face_of(KnownExpressions.of([shown(jawOpen=0.75)])), frame)
    assert little.carried is not None
    assert torch.equal(face._in_mouth(little.carried, seen, learnt), learnt), "one that was seen nearly as wide"


def test_a_chin_among_the_teeth_is_no_mouth() -> None:
    """The box of teeth and tongue may reach to the chin of a fitted person."""
    template = PERSON.face
    chin = int(torch.argmax(template.v_template[:, 2] - template.v_template[:, 1]))
    fitted, teeth = template.v_template.clone(), template.model.groups["lower_teeth"]
    lowest, foremost = fitted[teeth, 1].amin(), fitted[teeth, 2].amax()
    fitted[teeth] += torch.tensor([0.0, fitted[chin, 1] - lowest - 0.001, fitted[chin, 2] - foremost + 0.001])
    assert inside_mouth(fitted, template.model.groups)[chin]
    inside = inside_mouth(fitted, template.model.groups)
    assert not replace(template, model=replace(template.model, v_template=fitted), inside=inside).mouth[chin]
    assert not template.mouth[chin]
    assert template.mouth.sum() > 300
    front = covered(torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 0.02], [0.3, 0.0, 0.0]]), *wall(0.01))
    assert front.tolist() == [True, False, False]


def wall(at: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Two triangles of a square of 20 cm at that depth."""
    corners = torch.tensor([[-0.1, -0.1, at], [0.1, -0.1, at], [0.1, 0.1, at], [-0.1, 0.1, at]])
    return corners, torch.tensor([[0, 1, 2], [2, 3, 0]])
