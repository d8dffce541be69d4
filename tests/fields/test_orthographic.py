"""Orthographic views: where a point lands, which surface is in front, and the loops against the torch z-buffer."""

import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

from avatarrex.fields.orthographic import (
    CHANNELS,
    VIEW_NAMES,
    HeadBox,
    before,
    project,
    render_places,
    render_views,
    seen,
)
from avatarrex.templates.face import pose_face
from avatarrex.templates.person import load_person

UNIT = HeadBox(torch.zeros(3), 1.0)
IMPLS = ["auto", "reference"]
RED, GREEN, BLUE = torch.eye(3)


def quad(centre: tuple[float, float, float], axis: int, half: float = 0.1) -> Tensor:
    """Four corners of a square across `axis`."""
    u, v = (k for k in range(3) if k != axis)
    corner = torch.tensor(centre, dtype=torch.float32).repeat(4, 1)
    for row, (a, b) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1))):
        corner[row, u] += a * half
        corner[row, v] += b * half
    return corner


def quads(*squares: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """Vertices, faces and albedo of coloured squares."""
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    return (
        torch.cat([corner for corner, _ in squares]),
        torch.cat([faces + 4 * k for k in range(len(squares))]),
        torch.cat([colour.expand(4, 3) for _, colour in squares]),
    )


def pixel(image: Tensor, x: float, y: float) -> Tensor:
    """The texel at image coordinates in [−1, 1], x right and y down."""
    size = image.shape[-1]
    return image[:, int((y + 1) / 2 * size), int((x + 1) / 2 * size)]


def test_directions_of_the_views() -> None:
    """+X (the person's left) is right in the front view; the nose (+Z) points left in the left view."""
    point = torch.tensor([[0.5, 0.25, 0.75]])
    want = {"front": (0.5, -0.25), "left": (-0.75, -0.25), "right": (0.75, -0.25)}
    for name, place in zip(VIEW_NAMES, project(point)):
        torch.testing.assert_close(place[0], torch.tensor(want[name]))


@pytest.mark.parametrize("impl", IMPLS)
def test_a_mark_lands_where_project_says(impl: str) -> None:
    for axis, view in ((2, "front"), (0, "left"), (0, "right")):
        centre = (-0.3, 0.4, 0.2)
        image = render_views(*quads((quad(centre, axis), RED)), UNIT, size=64, impl=impl)[VIEW_NAMES.index(view)]
        x, y = project(torch.tensor([centre]))[VIEW_NAMES.index(view), 0].tolist()
        torch.testing.assert_close(pixel(image, x, y)[:3], RED)
        torch.testing.assert_close(pixel(image, x, y)[3:6].abs(), torch.eye(3)[axis])
        assert image[6].sum() == pytest.approx((0.2 * 32) ** 2, rel=0.2)
        assert pixel(image, -x, y).abs().sum() == 0


@pytest.mark.parametrize("impl", IMPLS)
def test_the_nearest_surface_wins(impl: str) -> None:
    """Red to the person's left (+X), blue to the right: the left view sees red, the right view blue."""
    sheets = quads((quad((0.5, 0, 0), 0), RED), (quad((-0.5, 0, 0), 0), BLUE))
    views = render_views(*sheets, UNIT, size=32, impl=impl)
    torch.testing.assert_close(pixel(views[1], 0, 0)[:3], RED)
    torch.testing.assert_close(pixel(views[2], 0, 0)[:3], BLUE)
    sheets = quads((quad((0, 0, -0.5), 2), RED), (quad((0, 0, 0.5), 2), GREEN))
    torch.testing.assert_close(pixel(render_views(*sheets, UNIT, size=32, impl=impl)[0], 0, 0)[:3], GREEN)


@pytest.mark.parametrize("impl", IMPLS)
def test_empty_views_are_zero_and_finite(impl: str) -> None:
    """Nothing in sight, and a mesh of no area."""
    far = quads((quad((5, 5, 5), 2), RED))
    flat = (torch.zeros(4, 3), far[1], far[2])
    for mesh in (far, flat):
        views = render_views(*mesh, UNIT, size=16, impl=impl)
        assert views.shape == (3, CHANNELS, 16, 16)
        assert views.abs().max() == 0


def head() -> tuple[Tensor, Tensor, Tensor, HeadBox]:
    face = load_person().face
    expression = torch.zeros(52)
    expression[::3] = 0.3
    vertices = pose_face(face, expression, torch.tensor([0.2, 0, 0]), torch.zeros(2, 3), torch.zeros(10))
    return vertices, face.faces, face.albedo, HeadBox.around(vertices, 0.01)


@pytest.mark.parametrize("impl", IMPLS)
def test_the_same_mesh_gives_the_same_bits(impl: str) -> None:
    assert torch.equal(render_views(*head(), size=64, impl=impl), render_views(*head(), size=64, impl=impl))


@pytest.mark.parametrize("size", [40, 256])
def test_the_loops_draw_the_reference(size: int) -> None:
    """Every pixel shows the same triangle; the values are rounded otherwise."""
    have, want = render_views(*head(), size=size), render_views(*head(), size=size, impl="reference")
    assert torch.equal(have[:, 6], want[:, 6])
    torch.testing.assert_close(have, want, atol=1e-5, rtol=0)


def test_normals_are_unit_and_face_the_viewer() -> None:
    """A ball's visible normals: unit, and towards the camera of each view."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.8)
    vertices, faces = torch.tensor(ball.vertices.copy()).float(), torch.tensor(ball.faces.copy())
    views = render_views(vertices, faces, (vertices + 1) / 2, UNIT, size=64, impl="reference")
    for view, towards in zip(views, ((0.0, 0, 1), (1.0, 0, 0), (-1.0, 0, 0))):
        normal = view[3:6, view[6] > 0].T
        torch.testing.assert_close(normal.norm(dim=-1), torch.ones(len(normal)))
        assert (normal @ torch.tensor(towards)).min() > -0.05
        place = 2 * view[:3, view[6] > 0].T - 1
        torch.testing.assert_close(normalize(place, dim=-1), normal, atol=0.02, rtol=0)


def test_how_far_behind_what_a_view_shows() -> None:
    """A square across the gaze: behind it, before it, beside it where nothing is shown, and where no view reaches."""
    vertices, faces, _ = quads((quad((0, 0, 0.5), 2), RED))
    points = torch.tensor([[0.0, 0, 0.2], [0, 0, 0.7], [0.95, 0, 0], [3, 0, 0]])
    gap = before(points, render_places(vertices, faces, UNIT), UNIT)[0]
    torch.testing.assert_close(gap[:2], torch.tensor([0.3, -0.2]), atol=1e-5, rtol=0)
    assert gap[2:].tolist() == [-torch.inf, torch.inf]


def test_what_is_seen_faces_a_view_and_is_not_hidden() -> None:
    """Squares across the gaze, wound to the front: one, smaller ones half a millimetre and 20 cm behind it, one aside."""
    squares = [quad((0, 0, 0.5), 2), quad((0, 0, 0.4995), 2, 0.05), quad((0, 0, 0.3), 2, 0.05), quad((0.5, 0, 0.3), 2)]
    vertices, faces, _ = quads(*((square, RED) for square in squares))
    found = seen(vertices, faces, render_places(vertices, faces, UNIT), UNIT, 0.001).reshape(4, 4)
    assert found.all(1).tolist() == [True, True, False, True]
    assert not found[2].any()
    away = faces.flip(1)
    assert not seen(vertices, away, render_places(vertices, away, UNIT), UNIT, 0.001).any()
