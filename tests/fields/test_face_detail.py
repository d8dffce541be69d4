"""Static detail of the face: it moves with expression, jaw and eyes, is stored as bytes, and avatars without it are as before."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar, save_avatar
from avatarrex.capture.fit.lips import touching
from avatarrex.counters import Counters
from avatarrex.fields.detail_texture import texel_count
from avatarrex.fields.face import surface_normal
from avatarrex.fields.face_sheets import share_beside
from avatarrex.fields.light import Irradiance
from avatarrex.ops.closest_triangle import closest_triangle
from avatarrex.ops.outer_triangle import outer_triangle
from avatarrex.ops.search_tree import SearchTree
from avatarrex.parts import face as parts_face
from avatarrex.parts.carried import REACH
from avatarrex.parts.face import THROUGH, Face, FaceState, Met, PosedTriangles
from avatarrex.parts.part import SurfacePoints
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.model import TEETH
from avatarrex.templates.person import load_person
from avatarrex.training.core.projection import seen_and_behind_lips

SPACING = 0.004
BACK = torch.tensor([0.0, 0.0, -1.0])
"""A gaze from before the face."""


def avatar(detailed: bool = True) -> Avatar:
    made = Avatar.create(load_person(), "compact", 0)
    if detailed:
        every = torch.ones(len(made.face.own), dtype=torch.bool)
        made.face.add_detail(SPACING, every, ~every)
    return made


def albedo(rest: Tensor) -> Tensor:
    """Linear in the rest position, so that texels interpolate it exactly."""
    return 2.0 * rest + torch.tensor([0.3, 0.3, -0.3])


def facing(made: Avatar, vertices: Tensor, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the field's surface face as the nearest triangle of the posed mesh that is the face's; here networks say nothing."""
    shown = made.person.face.faces[made.face.own].numpy()
    mesh = vertices.double().numpy()
    tree = SearchTree.of_triangles(mesh, shown)

    def normal(distance: Callable[[Tensor], Tensor], position: Tensor) -> Tensor:
        a, b, c = mesh[shown[closest_triangle(tree, position.double().numpy())[0]]].swapaxes(0, 1)
        return torch.nn.functional.normalize(torch.from_numpy(np.cross(b - a, c - a)), dim=1).to(position)

    monkeypatch.setattr(parts_face, "surface_normal", normal)


def posed(made: Avatar, monkeypatch: pytest.MonkeyPatch) -> tuple[Face, FaceState, Tensor, Tensor]:
    """The face with an open jaw and turned eyes; points on it, and where they are at rest."""
    template, face = made.person.face, made.parts["face"]
    assert isinstance(face, Face)
    coefficients = torch.zeros(61)
    coefficients[52], coefficients[55:61] = 0.3, torch.tensor([0.1, 0.2, 0, 0.1, 0.2, 0])
    vertices = template.posed(coefficients, torch.zeros(10)).float()
    state = face.prepare(vertices, coefficients, Counters(), "reference")
    facing(made, vertices, monkeypatch)
    shown = template.faces[made.face.own]
    weight = torch.tensor([0.5, 0.3, 0.2])
    at_rest, moved = ((mesh[shown] * weight[:, None]).sum(1) for mesh in (template.v_template.float(), vertices))
    return face, state, moved, at_rest


@torch.no_grad()
def test_texels_move_with_the_expression(monkeypatch: pytest.MonkeyPatch) -> None:
    """Texels painted linear in the rest position say it at the points of an open mouth, but where two sheets touch."""
    made = avatar()
    detail = made.face.detail
    assert detail is not None
    detail.texel.copy_(albedo(torch.from_numpy(detail.lattice.position).float()))
    face, state, moved, at_rest = posed(made, monkeypatch)
    places, _ = face.places(state, moved, BACK.expand_as(moved))
    assert places is not None
    off = (detail(places) - albedo(at_rest)).abs().amax(1)
    assert (at_rest - moved).norm(dim=1).max() > 0.02, "the jaw is open"
    assert (off < 1e-4).float().mean() > 0.99


@torch.no_grad()
def test_colours_are_the_texels_where_the_networks_say_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    made = avatar()
    detail = made.face.detail
    assert detail is not None
    for parameter in made.face.colour_net.mlp[-1].parameters():
        parameter.zero_()
    detail.texel.copy_(torch.tensor([1.0, 0.0, -2.0]))
    face, state, moved, _ = posed(made, monkeypatch)
    gaze = torch.nn.functional.normalize(-moved, dim=-1)
    points = SurfacePoints(moved, gaze, gaze, moved, torch.eye(3), made.light.over(np.eye(4)))
    own = made.face.colour(
        face.decode_colour(state, Counters()),
        moved,
        points.direction,
        face.places(state, moved, BACK.expand_as(moved))[0],
    )
    torch.testing.assert_close(own, torch.sigmoid(torch.tensor([1.0, 0.0, -2.0])).expand_as(own))


@torch.no_grad()
def test_a_face_is_lit_as_it_is_turned(monkeypatch: pytest.MonkeyPatch) -> None:
    """By its own harmonics, not the body's, on the surface's normal as the head is turned; albedo stays."""
    made = avatar()
    face, state, moved, _ = posed(made, monkeypatch)
    turn = torch.from_numpy(Rotation.from_rotvec([0.2, 0.9, -0.1]).as_matrix()).float()

    def colour(light: Irradiance, head: Tensor) -> Tensor:
        gaze = torch.nn.functional.normalize(-moved, dim=-1)
        points = SurfacePoints(moved, gaze, gaze, moved @ head.T, head, light)
        return face.colour(state, points, Counters())

    drawn = 0.2 * torch.randn(2, 8, 3, generator=torch.Generator().manual_seed(6))
    dark = Irradiance(torch.zeros(8, 3))
    albedo = colour(dark, turn)
    assert torch.equal(colour(Irradiance(drawn[0]), turn), albedo)
    normal = parts_face.surface_normal(lambda place: place[:, 0], moved)
    expected = albedo * Irradiance(drawn[1])(normal @ turn.T)
    torch.testing.assert_close(colour(Irradiance(drawn[0], drawn[1]), turn), expected, atol=1e-5, rtol=0)
    assert (expected - albedo).abs().mean() > 0.02


def test_only_the_face_has_texels() -> None:
    """Ears and scalp are the body's."""
    made = avatar()
    assert made.face.detail is not None
    own = made.person.face.blend_weight[made.person.face.faces].amax(1) > 0
    assert torch.equal(made.face.detail.edge > 0, own)
    assert 0.5 < own.float().mean() < 0.9


def test_files_have_albedos_as_bytes(tmp_path: Path) -> None:
    made = avatar()
    assert made.face.detail is not None
    with torch.no_grad():
        made.face.detail.texel.copy_(
            torch.randn(made.face.detail.texel.shape, generator=torch.Generator().manual_seed(0))
        )
    save_avatar(made, tmp_path / "a.avatar")
    back = load_avatar(tmp_path / "a.avatar").face.detail
    assert back is not None
    wanted, found = (torch.sigmoid(texture.texel.detach()) for texture in (made.face.detail, back))
    assert (wanted - found).abs().max() < 0.51 / 255
    plain = avatar(False)
    save_avatar(plain, tmp_path / "b.avatar")
    assert load_avatar(tmp_path / "b.avatar").face.detail is None
    assert (tmp_path / "a.avatar").stat().st_size < 1.6 * (tmp_path / "b.avatar").stat().st_size


def test_a_copy_keeps_its_texels() -> None:
    made = avatar()
    copy = made.frozen_copy()
    assert made.face.detail is not None
    assert copy.face.detail is not None
    with torch.no_grad():
        made.face.detail.texel += 1
    assert np.abs(copy.face.detail.texel.numpy()).max() == 0


@pytest.mark.parametrize("detailed", [True, False])
def test_colour_parameters_are_networks_and_texels(detailed: bool) -> None:
    made = avatar(detailed).face
    names = {id(p): name for name, p in made.named_parameters()}
    found = {names[id(p)].split(".")[0] for p in made.colour_parameters()}
    assert found == ({"colour_net", "detail"} if detailed else {"colour_net"})


@torch.no_grad()
def test_what_lies_off_the_texels_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """A point 1 cm before the nose, and a face without the triangles of the mouth: none of its points."""
    made = Avatar.create(load_person(), "compact", 0)
    shown, behind = seen_and_behind_lips(made)
    made.face.add_detail(SPACING, shown, torch.zeros_like(behind))
    detail, template = made.face.detail, made.person.face
    assert detail is not None
    assert torch.equal(detail.edge > 0, made.face.own & shown)
    detail.texel.copy_(torch.ones_like(detail.texel))
    face, state, moved, _ = posed(made, monkeypatch)
    places, _ = face.places(state, moved, BACK.expand_as(moved))
    assert places is not None
    said = detail(places)[:, 0]
    teeth = torch.cat([template.model.groups[name] for name in ("upper_teeth", "lower_teeth")])
    of_teeth = torch.isin(template.faces[made.face.own], teeth).all(1)
    eyes = torch.cat([template.model.groups[name] for name in ("left_eye", "right_eye")])
    of_eyes = torch.isin(template.faces[made.face.own], eyes).all(1)
    assert of_teeth.sum() > 100
    assert not (made.face.own & shown)[made.face.own][of_teeth].any()
    assert (said[of_teeth] < 0.5).float().mean() > 0.3
    torch.testing.assert_close(said[of_eyes], torch.ones_like(said[of_eyes]))
    nose = moved[moved[:, 2].argmax()][None]
    for away, expected in ((0.004, 1.0), (0.0075, 0.5), (0.011, 0.0)):
        before, _ = face.places(state, nose + torch.tensor([0, 0, away]), BACK[None])
        assert before is not None
        assert float(detail(before)[0, 0]) == pytest.approx(expected, abs=0.15)


@torch.no_grad()
def test_a_closed_lid_has_the_texels_of_lids() -> None:
    """Between lid and eyeball, 1.5 mm beneath closed lids: with the eyeball white and all else black, a blink is black."""
    made = Avatar.create(load_person(), "compact", 0)
    made.face.add_detail(SPACING, *seen_and_behind_lips(made))
    detail, template = made.face.detail, made.person.face
    assert detail is not None
    eyes = torch.cat([template.model.groups[name] for name in ("left_eye", "right_eye")])
    ball = torch.isin(template.faces, eyes).all(1)
    white = np.repeat(ball.numpy(), texel_count(detail.edge.long().numpy()))
    detail.texel.copy_(torch.where(torch.from_numpy(white), 1.0, -1.0)[:, None].expand(-1, 3))
    coefficients = torch.zeros(61)
    coefficients[[EXPRESSION_NAMES.index(f"eyeBlink{side}") for side in ("Left", "Right")]] = 1.0
    mesh = template.posed(coefficients, torch.zeros(10)).numpy()
    pupils = np.stack([mesh[template.model.groups[name]].max(0) * [0, 0, 1] for name in ("left_eye", "right_eye")])
    pupils[:, :2] = [mesh[template.model.groups[name]].mean(0)[:2] for name in ("left_eye", "right_eye")]
    aside = np.stack(np.meshgrid(np.linspace(-0.004, 0.004, 9), np.linspace(-0.001, 0.003, 5), [0.001]), -1).reshape(
        -1, 3
    )
    points = (pupils[:, None] + aside).reshape(-1, 3)
    triangles = PosedTriangles(mesh, template.faces.numpy())
    assert made.face.sheets is not None
    shown = made.face.sheets.outer
    found = triangles.outer(shown, points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    nearest = closest_triangle(SearchTree.of_triangles(mesh, template.faces.numpy()[shown]), points)[0]
    assert ball[shown[nearest]].float().mean() > 0.3
    assert not ball[found[0]].any()
    assert (detail(detail.places_on(*found)) < 0).all()


def first_facing(corner: np.ndarray, origin: np.ndarray, way: np.ndarray) -> int:
    """Of triangles (f, 3, 3) the first that a ray meets from outside, −1 for none; Möller and Trumbore, one ray."""
    a, ab, ac = corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    across = np.cross(way, ac)
    volume = (ab * across).sum(1)
    volume[volume == 0] = np.inf
    to = np.cross(origin - a, ab)
    u, v, along = ((origin - a) * across).sum(1) / volume, (to @ way) / volume, (ac * to).sum(1) / volume
    met = (u >= 0) & (v >= 0) & (u + v <= 1) & (along > -THROUGH[0]) & (np.cross(ab, ac) @ way < 0)
    return int(np.where(met, along, np.inf).argmin()) if met.any() else -1


def lipped() -> Avatar:
    """With texels as a training lays them, which say what they are of: skin, teeth, tongue or cavity."""
    made = Avatar.create(load_person(), "compact", 0)
    made.face.add_detail(SPACING, *seen_and_behind_lips(made))
    detail, sheets, model = made.face.detail, made.face.sheets, made.person.face.model
    assert detail is not None
    assert sheets is not None
    teeth, tongue = (model.of_groups(names)[model.faces].all(1).numpy() for names in (TEETH, ("tongue",)))
    said = np.stack([teeth, tongue, sheets.behind & ~teeth & ~tongue], 1).astype(np.float32)
    with torch.no_grad():
        detail.texel.copy_(torch.from_numpy(np.repeat(said, texel_count(detail.edge.long().numpy()), 0)))
    return made


def opened(made: Avatar, jaw: float = 0.5) -> tuple[Face, FaceState, Tensor]:
    """The face with an open jaw, and points of a sheet that closes the mouth from lip to lip, as the learnt surface does."""
    template, face = made.person.face, made.parts["face"]
    assert isinstance(face, Face)
    coefficients = torch.zeros(61)
    coefficients[EXPRESSION_NAMES.index("jawOpen")] = jaw
    mesh = template.posed(coefficients, torch.zeros(10)).float()
    index = {vertex: row for row, vertex in enumerate(template.body_vertex_ids.tolist())}
    pairs = touching(made.person.body)
    upper, lower = (mesh[[index[int(vertex)] for vertex in column]] for column in pairs.T)
    apart = (upper - lower).norm(dim=1) > 0.018 * jaw
    assert apart.sum() > 10
    return face, face.prepare(mesh, coefficients, Counters(), "reference"), (upper + lower)[apart] / 2


@torch.no_grad()
def test_past_open_lips_is_seen_what_lies_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From several sides, as by rays cast one by one: teeth, tongue, cavity or, from above, a lip. So from a file."""
    made = lipped()
    save_avatar(made, tmp_path / "a.avatar")
    loaded = load_avatar(tmp_path / "a.avatar")
    monkeypatch.setattr(parts_face, "surface_normal", lambda distance, position: -BACK.expand_as(position))
    faces, behind = made.person.face.faces.numpy(), made.face.sheets.behind
    detail, (face, state, middle), again = made.face.detail, opened(made), opened(loaded)
    corner, found = state.triangles.vertices[faces], set()
    for gaze in ((0.0, 0.0, -1.0), (0.3, 0.0, -1.0), (-0.3, 0.3, -1.0), (0.0, -0.4, -1.0), (0.0, -1.0, -1.0)):
        way = torch.nn.functional.normalize(torch.tensor(gaze), dim=0)
        places, same = (one.places(at, middle, way.expand_as(middle))[0] for one, at in ((face, state), again[:2]))
        assert torch.equal(places.texel, same.texel)
        assert places.share.sum(1).max() < 1.001
        torch.testing.assert_close(places.share, same.share, atol=1e-3, rtol=0)
        rays = np.array([first_facing(corner, place.double().numpy(), way.double().numpy()) for place in middle])
        seen, deep = detail(places).numpy(), behind[rays] & (rays >= 0)
        assert (seen[deep].sum(1) > 0.6).all(), "lips have the rest"
        assert (seen[~deep & (rays >= 0)].sum(1) < 0.1).all(), "no tooth is seen through a lip"
        first = torch.from_numpy(faces[rays[deep]])
        of_tongue = made.person.face.model.of_groups(("tongue",))[first].all(1).numpy()
        assert np.array_equal(seen[deep].argmax(1) == 1, of_tongue)
        found |= set(seen[deep].argmax(1).tolist()) | ({"lip"} if (~deep & (rays >= 0)).any() else set())
    assert len(found) >= 3


@torch.no_grad()
def test_a_closed_mouth_shows_nothing_of_what_it_hides(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor does skin elsewhere, however far the surface stands off along its normal, or beside."""
    made = lipped()
    face, detail, sheets = made.parts["face"], made.face.detail, made.face.sheets
    assert isinstance(face, Face)
    mesh = made.person.face.v_template.float()
    state = face.prepare(mesh, torch.zeros(61), Counters(), "reference")
    corner = mesh[made.person.face.faces[sheets.outer]]
    normal = torch.nn.functional.normalize(
        torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), dim=1
    )
    monkeypatch.setattr(parts_face, "surface_normal", lambda distance, position: normal)
    for height in (0.0, 0.004):
        for tilt in (0.0, 0.4):
            gaze = torch.nn.functional.normalize(torch.tensor([0.0, tilt, 0.0]) - normal, dim=1)
            places, _ = face.places(state, corner.mean(1) + height * normal, gaze)
            assert places.share.sum(1).median() > 0.99
            assert (detail(places).sum(1) < 0.1).float().mean() > 0.98


@torch.no_grad()
def test_avatars_of_before_have_the_nearest_texels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of all that they have, drawn out over an open mouth."""
    made = lipped()
    state = {name: value for name, value in made.face.state_dict().items() if name != "detail_behind"}
    made.face.load_state_dict(state)
    detail, sheets = made.face.detail, made.face.sheets
    assert not sheets.end
    assert np.array_equal(sheets.outer, detail.lattice.shown)
    monkeypatch.setattr(parts_face, "surface_normal", lambda distance, position: -BACK.expand_as(position))
    face, posed_face, middle = opened(made)
    tree = SearchTree.of_triangles(posed_face.triangles.vertices, made.person.face.faces.numpy()[sheets.outer])
    points = middle.double().numpy()
    row, weight = outer_triangle(tree, points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), REACH)
    corner = posed_face.triangles.vertices[made.person.face.faces.numpy()[sheets.outer[row]]]
    expected = detail.places_on(sheets.outer[row], weight, points - np.einsum("pk,pkc->pc", weight, corner))
    places, _ = face.places(posed_face, middle, BACK.expand_as(middle))
    assert torch.equal(places.texel, expected.texel)
    assert torch.equal(places.share, expected.share)


@torch.no_grad()
def test_a_ray_that_misses_sees_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The closest tooth lies 4 mm aside; 1 mm aside it counts, 10 cm along, too."""
    made = lipped()
    face, state, middle = opened(made)
    tooth = np.flatnonzero(made.person.face.teeth[made.person.face.faces].all(1).numpy())[: len(middle)]
    monkeypatch.setattr(parts_face, "surface_normal", lambda distance, position: -BACK.expand_as(position))
    detail = made.face.detail
    assert detail is not None
    for aside, expected in ((0.001, 0.6), (0.004, 0.0)):

        def seen(triangles: PosedTriangles, points: np.ndarray, back: np.ndarray, aside: float = aside) -> Met:
            corner = np.full((len(points), 3), 1 / 3)
            return np.resize(tooth, len(points)), corner, np.tile([aside, 0.0, 0.1], (len(points), 1))

        monkeypatch.setattr(PosedTriangles, "seen", seen)
        places, _ = face.places(state, middle, BACK.expand_as(middle))
        assert places is not None
        said = detail(places)[:, 0]
        assert (said >= expected).all()
        assert expected or not said.any()


def test_texels_end_beside_their_places() -> None:
    """1 to 4 mm aside, whatever lies along."""
    along = np.tile([0.0, 0.6, 0.8], (4, 1))
    off = np.outer([0.0, 0.001, 0.0025, 0.004], [1.0, 0.0, 0.0]) + 0.03 * along
    np.testing.assert_allclose(share_beside(off, along), [1, 1, 0.5, 0], atol=1e-9)


def test_a_surface_has_its_normal() -> None:
    """Of a ball of 8 cm, in both precisions."""
    points = torch.nn.functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    for kind in (torch.float32, torch.float64):
        found = surface_normal(lambda position: position.norm(dim=1) - 0.08, 0.08 * points.to(kind))
        assert found.dtype == kind
        torch.testing.assert_close(found, points.to(kind), rtol=0, atol=1e-2)
