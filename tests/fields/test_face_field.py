"""Face field: planes see what the views show on the right side; gradients of first and second order."""

from functools import cache

import pytest
import torch
from torch import Tensor

from avatarrex.fields.face import OUTPUT, FaceField
from avatarrex.fields.orthographic import VIEW_NAMES, VIEW_PIXELS, project
from avatarrex.fields.presets import PRESETS
from avatarrex.fields.unet import UNet
from avatarrex.templates.face import pose_face
from avatarrex.templates.person import load_person


@cache
def field(preset: str = "compact") -> FaceField:
    torch.manual_seed(0)
    return FaceField(load_person().face, PRESETS[preset])


@cache
def neutral() -> Tensor:
    face = load_person().face
    return pose_face(face, torch.zeros(52), torch.zeros(3), torch.zeros(2, 3), torch.zeros(10))


def near(count: int) -> Tensor:
    generator = torch.Generator().manual_seed(count)
    rows = torch.nonzero(load_person().face.blend_weight > 0.5)[:, 0]
    rows = rows[torch.randint(len(rows), (count,), generator=generator)]
    return neutral()[rows] + 0.005 * torch.randn(count, 3, generator=generator)


@pytest.mark.parametrize(("preset", "texels"), [("paper", 256), ("compact", 128)])
def test_shapes(preset: str, texels: int) -> None:
    face = field(preset)
    views = face.views(neutral(), impl="reference")
    assert views.shape == (3, 7, VIEW_PIXELS, VIEW_PIXELS)
    with torch.no_grad():
        planes = face.geometry_planes(views)
        assert planes.shape[0] == 3
        assert planes.shape[2:] == (texels, texels)
        assert face.sdf(planes, near(5)).shape == (5,)
        colour = face.colour(face.colour_planes(views), near(5), torch.eye(3)[[0, 1, 2, 0, 1]])
    assert colour.shape == (5, 3)
    assert ((colour > 0) & (colour < 1)).all()


def test_the_face_fills_the_cube() -> None:
    """Everything blended lies inside the views, with the composition's band to spare."""
    place = field().box.normalise(neutral()[load_person().face.blend_weight > 0])
    assert place.abs().max() < 1 - 0.02 / field().box_half
    assert place.abs().max() > 0.6


@pytest.mark.parametrize("view", range(3))
def test_a_texel_is_felt_where_its_view_projects_to(view: int) -> None:
    """A mark in one plane at Π_v(p) changes the field at p, and nowhere off that line of sight (left is left)."""
    face = field()
    points = face.box_centre + 0.5 * face.box_half * torch.tensor([[0.6, 0.4, 0.8], [-0.6, 0.4, -0.8]])
    planes = torch.zeros(3, PRESETS["compact"].face.geometry_planes, 64, 64)
    before = face.sdf(planes, points)
    x, y = project(face.box.normalise(points))[view, 0].tolist()
    row, column = int((y + 1) * 32), int((x + 1) * 32)
    planes[view, :, row - 1 : row + 2, column - 1 : column + 2] = 1
    change = (face.sdf(planes, points) - before).abs()
    assert change[0] > 1e-5 * OUTPUT, VIEW_NAMES[view]
    assert change[1] == 0, VIEW_NAMES[view]


def test_unet_keeps_left_and_right() -> None:
    """A network fed a mark at one side answers most at that side, with and without the strided stem."""
    for stem in (1, 2):
        torch.manual_seed(3)
        net = UNet(7, (8, 8, 8), 4, stem)
        blank = torch.zeros(1, 7, 64, 64)
        marked = blank.clone()
        marked[..., 40:48, 8:16] = 1
        with torch.no_grad():
            answer = (net(marked) - net(blank)).abs().sum(1)[0]
        rows, columns = torch.meshgrid(*[(torch.arange(64 // stem) + 0.5) * stem] * 2, indexing="ij")
        centre = [(answer * axis).sum() / answer.sum() for axis in (rows, columns)]
        assert centre[0] == pytest.approx(44, abs=6)
        assert centre[1] == pytest.approx(12, abs=6)


@pytest.mark.parametrize("preset", ["paper", "compact"])
def test_every_parameter_receives_a_gradient(preset: str) -> None:
    face = field(preset)
    views = face.views(neutral(), impl="reference")
    view = torch.nn.functional.normalize(torch.randn(40, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    loss = face.sdf(face.geometry_planes(views), near(40)).square().sum()
    loss = loss + face.colour(face.colour_planes(views), near(40), view).square().sum()
    face.zero_grad()
    loss.backward()
    for name, parameter in face.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name
    face.zero_grad()


def test_the_sets_of_networks_are_separate() -> None:
    names = [name for name, _ in field().named_parameters()]
    assert all(name.startswith(("geometry.", "colour_net.")) for name in names)
    views = field().views(neutral(), impl="reference")
    field().zero_grad()
    field().sdf(field().geometry_planes(views), near(5)).sum().backward()
    assert all(p.grad is None or not p.grad.any() for p in field().colour_net.parameters())
    field().zero_grad()


def test_eikonal_loss_differentiates_twice() -> None:
    face = FaceField(load_person().face, PRESETS["compact"]).double()
    planes = torch.randn(3, PRESETS["compact"].face.geometry_planes, 8, 8, dtype=torch.float64).requires_grad_()
    point = near(20).double().requires_grad_()
    (slope,) = torch.autograd.grad(face.sdf(planes, point).sum(), point, create_graph=True)
    (slope.norm(dim=-1) - 1).square().mean().backward()
    assert planes.grad is not None
    assert planes.grad.abs().max() > 0


def test_slope_by_finite_differences() -> None:
    face = FaceField(load_person().face, PRESETS["compact"]).double()
    planes = torch.randn(3, PRESETS["compact"].face.geometry_planes, 8, 8, dtype=torch.float64)
    point = near(4).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda p: face.sdf(planes, p), point, eps=1e-8, atol=1e-5)


def test_an_expression_changes_the_views_and_the_field() -> None:
    person = load_person().face
    expression = torch.zeros(52)
    expression[::4] = 0.5
    moved = pose_face(person, expression, torch.zeros(3), torch.zeros(2, 3), torch.zeros(10))
    views = [field().views(v, impl="reference") for v in (neutral(), moved)]
    assert (views[0] != views[1]).any()
    with torch.no_grad():
        sdf = [field().sdf(field().geometry_planes(v), near(50)) for v in views]
    assert not torch.equal(*sdf)


@pytest.mark.parametrize("preset", ["paper", "compact"])
def test_compiled_loops_find_what_the_differentiable_networks_find(preset: str) -> None:
    face, points = field(preset), near(3000)
    gaze = torch.nn.functional.normalize(torch.randn(3000, 3), dim=-1)
    views = face.views(neutral(), impl="reference")
    planes, colours = face.geometry_planes(views), face.colour_planes(views)
    want, wanted_colour = face.sdf(planes, points), face.colour(colours, points, gaze)
    assert want.requires_grad
    with torch.no_grad():
        torch.testing.assert_close(face.sdf(planes, points), want.detach(), atol=1e-6 * OUTPUT, rtol=1e-5)
        torch.testing.assert_close(face.colour(colours, points, gaze), wanted_colour.detach(), atol=1e-5, rtol=0)
        assert face.sdf(planes, points[:0]).shape == (0,)


def test_three_unets_side_by_side_make_the_planes_of_one_after_the_other() -> None:
    before, views = torch.get_num_threads(), torch.rand(3, 7, 256, 256)
    torch.set_num_threads(2)
    try:
        with torch.no_grad():
            together = field().colour_planes(views)
    finally:
        torch.set_num_threads(before)
    alone = field().colour_planes(views)
    assert alone.requires_grad, "in turn, as training needs it"
    torch.testing.assert_close(together, alone.detach(), atol=1e-6, rtol=1e-5)
