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
from avatarrex.counters import Counters
from avatarrex.fields.detail_texture import texel_count
from avatarrex.fields.face import surface_normal
from avatarrex.fields.light import Irradiance
from avatarrex.ops.closest_triangle import closest_triangle
from avatarrex.ops.search_tree import SearchTree
from avatarrex.parts import face as parts_face
from avatarrex.parts.face import Face, FaceState, PosedTriangles
from avatarrex.parts.part import SurfacePoints
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.templates.person import load_person
from avatarrex.training.core.projection import without_mouth

SPACING = 0.004


def avatar(detailed: bool = True) -> Avatar:
    made = Avatar.create(load_person(), "compact", 0)
    if detailed:
        made.face.add_detail(SPACING, torch.ones(len(made.face.own), dtype=torch.bool))
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
    places, _ = face.places(state, moved)
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
    points = SurfacePoints(
        moved, torch.nn.functional.normalize(-moved, dim=-1), moved, torch.eye(3), made.light.over(np.eye(4))
    )
    own = made.face.colour(face.decode_colour(state, Counters()), moved, points.direction, face.places(state, moved)[0])
    torch.testing.assert_close(own, torch.sigmoid(torch.tensor([1.0, 0.0, -2.0])).expand_as(own))


@torch.no_grad()
def test_a_face_is_lit_as_it_is_turned(monkeypatch: pytest.MonkeyPatch) -> None:
    """By its own harmonics, not the body's, on the surface's normal as the head is turned; albedo stays."""
    made = avatar()
    face, state, moved, _ = posed(made, monkeypatch)
    turn = torch.from_numpy(Rotation.from_rotvec([0.2, 0.9, -0.1]).as_matrix()).float()

    def colour(light: Irradiance, head: Tensor) -> Tensor:
        points = SurfacePoints(moved, torch.nn.functional.normalize(-moved, dim=-1), moved @ head.T, head, light)
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
    shown = without_mouth(made)
    made.face.add_detail(SPACING, shown)
    detail, template = made.face.detail, made.person.face
    assert detail is not None
    assert torch.equal(detail.edge > 0, made.face.own & shown)
    detail.texel.copy_(torch.ones_like(detail.texel))
    face, state, moved, _ = posed(made, monkeypatch)
    places, _ = face.places(state, moved)
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
        before, _ = face.places(state, nose + torch.tensor([0, 0, away]))
        assert before is not None
        assert float(detail(before)[0, 0]) == pytest.approx(expected, abs=0.15)


@torch.no_grad()
def test_a_closed_lid_has_the_texels_of_lids() -> None:
    """Between lid and eyeball, 1.5 mm beneath closed lids: with the eyeball white and all else black, a blink is black."""
    made = Avatar.create(load_person(), "compact", 0)
    made.face.add_detail(SPACING, without_mouth(made))
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
    found = triangles.outer(detail.lattice.shown, points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    nearest = closest_triangle(SearchTree.of_triangles(mesh, template.faces.numpy()[detail.lattice.shown]), points)[0]
    assert ball[detail.lattice.shown[nearest]].float().mean() > 0.3
    assert not ball[found[0]].any()
    assert (detail(detail.places_on(*found)) < 0).all()


def test_a_surface_has_its_normal() -> None:
    """Of a ball of 8 cm, in both precisions."""
    points = torch.nn.functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    for kind in (torch.float32, torch.float64):
        found = surface_normal(lambda position: position.norm(dim=1) - 0.08, 0.08 * points.to(kind))
        assert found.dtype == kind
        torch.testing.assert_close(found, points.to(kind), rtol=0, atol=1e-2)
