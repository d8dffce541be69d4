"""Signed distance to a mesh: closed forms, invariance, libigl in float64, slivers, gradients, rejected mutants."""

import numpy as np
import pytest
import torch
import trimesh
from torch.nn.functional import normalize

from avatarrex.errors import InputError
from avatarrex.ops.closest_point import available, closest_point
from avatarrex.ops.pseudonormal import pseudonormals, winding_number
from avatarrex.templates.mesh import vertex_normals

IMPLS = available()
BAND = (-0.05, 0.025)


def tensors(mesh: trimesh.Trimesh, dtype: torch.dtype = torch.float64) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.tensor(np.array(mesh.vertices), dtype=dtype), torch.tensor(np.array(mesh.faces))


def box() -> tuple[torch.Tensor, torch.Tensor]:
    return tensors(trimesh.creation.box((0.2, 0.1, 0.3)))


def cloud(count: int, half: float, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return (torch.rand(count, 3, generator=generator, dtype=torch.float64) * 2 - 1) * half


def box_distance(point: torch.Tensor) -> torch.Tensor:
    """The closed form for the box of `box()`."""
    outside = point.abs() - torch.tensor([0.1, 0.05, 0.15], dtype=point.dtype)
    return outside.clamp_min(0).norm(dim=-1) + outside.amax(-1).clamp_max(0)


def wedge() -> tuple[torch.Tensor, torch.Tensor]:
    """A roof whose ridge is a knife edge: seen from beside the ridge one of its two faces looks away."""
    vertices = torch.tensor(
        [[0, 0, 0], [1, 0, 0], [1, 0, 0.1], [0, 0, 0.1], [0, 1, 0.05], [1, 1, 0.05]], dtype=torch.float64
    )
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [0, 4, 5], [0, 5, 1], [3, 2, 5], [3, 5, 4], [0, 3, 4], [1, 5, 2]])
    return vertices, faces


def sliver_sphere() -> tuple[torch.Tensor, torch.Tensor]:
    """An icosphere, 5 cm, a tenth of whose edges are split very near one end: triangles of aspect 1e-4."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    vertices, faces = [*mesh.vertices], [tuple(f) for f in mesh.faces]
    edges = {tuple(sorted(e)) for f in faces for e in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))}
    split: set[tuple[int, ...]] = set()
    for a, b in sorted(edges)[::10]:
        sharing = [f for f in faces if a in f and b in f]
        if any(f in split for f in sharing):
            continue
        middle = len(vertices)
        vertices.append(vertices[a] + 1e-4 * (vertices[b] - vertices[a]))
        for f in sharing:
            faces.remove(f)
            pair = [tuple(middle if k == a else k for k in f), tuple(middle if k == b else k for k in f)]
            faces += pair
            split |= set(pair)
    return torch.tensor(np.array(vertices)), torch.tensor(faces)


@pytest.mark.parametrize("impl", IMPLS)
def test_box_closed_form(impl: str) -> None:
    vertices, faces = box()
    point = cloud(3000, 0.3)
    found = closest_point(vertices, faces, point, impl=impl)
    torch.testing.assert_close(found.sdf, box_distance(point), atol=1e-12, rtol=0)


@pytest.mark.parametrize("impl", IMPLS)
def test_sphere_closed_form(impl: str) -> None:
    """A fine icosphere departs from the sphere by less than edge²/(8 r)."""
    vertices, faces = tensors(trimesh.creation.icosphere(subdivisions=3, radius=0.05))
    point = cloud(800, 0.1)
    edge = (vertices[faces] - vertices[faces].roll(1, 1)).norm(dim=-1).max()
    error = closest_point(vertices, faces, point, impl=impl).sdf - (point.norm(dim=-1) - 0.05)
    assert error.abs().max() < edge**2 / (8 * 0.05) * 1.4
    assert error.min() > -1e-12, "the inscribed polyhedron is never nearer than the sphere, seen from outside"


def test_barycentrics_give_the_closest_point() -> None:
    vertices, faces = box()
    point = cloud(500, 0.3)
    found = closest_point(vertices, faces, point)
    surface = (vertices[faces[found.face]] * found.barycentric[..., None]).sum(1)
    torch.testing.assert_close((point - surface).norm(dim=-1), found.sdf.abs(), atol=1e-12, rtol=0)
    torch.testing.assert_close(found.barycentric.sum(-1), torch.ones(500, dtype=torch.float64))
    assert found.barycentric.min() >= 0


@pytest.mark.parametrize("impl", IMPLS)
def test_sign_at_edges_and_vertices(impl: str) -> None:
    """Points just off a knife edge and its end corners, inside and outside."""
    vertices, faces = wedge()
    across = torch.tensor([[0.5, 1.0, 0.05]], dtype=torch.float64)
    for direction, sign in (((0, 1, 0), 1), ((0, 0.05, 1), 1), ((0, 0.05, -1), 1), ((0, -1, 0), -1)):
        point = across + 0.01 * normalize(torch.tensor([direction], dtype=torch.float64), dim=-1)
        assert closest_point(vertices, faces, point, impl=impl).sdf.sign().item() == sign, direction
    corner = torch.tensor([[1.0, 1.0, 0.05]], dtype=torch.float64)
    for direction in ((1, 0.2, 0), (1, 1, 1), (0.2, 0.2, -1), (0.1, 0.05, 1)):
        point = corner + 0.01 * normalize(torch.tensor([direction], dtype=torch.float64), dim=-1)
        assert closest_point(vertices, faces, point, impl=impl).sdf.item() > 0, direction


def test_interpolated_normal_fails_where_the_pseudonormal_does_not() -> None:
    """The paper's sign rule as a mutant: one large face turns the normal of a corner away from its small faces."""
    vertices = torch.tensor([[0, 0, 0], [1, -1, 0], [1, 1, 0], [0.1, 0, -0.05]], dtype=torch.float64)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [1, 0, 3], [2, 1, 3]])
    point = cloud(1000, 0.05) - torch.tensor([0, 0, 0.03], dtype=torch.float64)
    truth = winding_number(vertices, faces, point) > 0.5
    found = closest_point(vertices, faces, point)
    assert ((found.sdf < 0) == truth).all()
    corner = faces[found.face]
    normal = (vertex_normals(vertices, faces)[corner] * found.barycentric[..., None]).sum(1)
    surface = (vertices[corner] * found.barycentric[..., None]).sum(1)
    mutant = ((point - surface) * normal).sum(-1) < 0
    assert (mutant != truth).sum() > 50


@pytest.mark.parametrize("bound", [None, (-0.01, 0.02)])
@pytest.mark.parametrize("half", [0.06, 1.0])
def test_points_in_no_order_find_the_same(half: float, bound: tuple[float, float] | None) -> None:
    """However dense the points, with gradients and without."""
    vertices, faces = sliver_sphere()
    point = cloud(1500, half)
    want = closest_point(vertices, faces, point, bound, impl="reference").sdf
    for differentiable in (False, True):
        found = closest_point(vertices, faces, point.clone().requires_grad_(differentiable), bound)
        torch.testing.assert_close(found.sdf.detach(), want, atol=1e-12, rtol=0)


def test_normals_that_are_known_are_not_made_again(monkeypatch) -> None:
    vertices, faces = sliver_sphere()
    known, point = pseudonormals(vertices, faces), cloud(600, 0.1)
    want = closest_point(vertices, faces, point).sdf
    monkeypatch.setattr("avatarrex.ops.closest_point.pseudonormals", None)
    assert closest_point(vertices, faces, point, normals=known).sdf.equal(want)


@pytest.mark.parametrize("impl", [impl for impl in IMPLS if impl != "reference"])
@pytest.mark.parametrize("mesh", ["sphere", "torus", "sliver"])
def test_agrees_with_the_reference(impl: str, mesh: str) -> None:
    vertices, faces = {
        "sphere": lambda: tensors(trimesh.creation.icosphere(subdivisions=3, radius=0.05), torch.float32),
        "torus": lambda: tensors(trimesh.creation.torus(0.08, 0.02, 24, 12), torch.float32),
        "sliver": lambda: tuple(x.float() if x.is_floating_point() else x for x in sliver_sphere()),
    }[mesh]()
    axis = torch.linspace(-0.11, 0.11, 13)
    lattice = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    point = torch.cat([lattice, cloud(803, 0.12).float(), vertices[:50], (vertices[faces[:50]]).mean(1)])
    want = closest_point(vertices, faces, point, impl="reference")
    have = closest_point(vertices, faces, point, impl=impl)
    torch.testing.assert_close(have.sdf, want.sdf, atol=2e-8, rtol=0)
    assert ((have.sdf * want.sdf < 0) & (want.sdf.abs() > 1e-8)).sum() == 0


def test_a_sliver_mesh_is_a_sphere_still() -> None:
    vertices, faces = sliver_sphere()
    height = closest_heights(vertices, faces)
    assert height.min() < 2e-4, "the mesh has slivers"
    point = cloud(1500, 0.1)
    found = closest_point(vertices, faces, point, impl="tree")
    smooth = closest_point(*tensors(trimesh.creation.icosphere(subdivisions=3, radius=0.05)), point, impl="tree")
    torch.testing.assert_close(found.sdf, smooth.sdf, atol=1e-10, rtol=0)


def closest_heights(vertices: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """Height over longest edge of every face."""
    a, b, c = vertices[faces].unbind(1)
    longest = torch.stack([b - a, c - b, a - c]).norm(dim=-1).amax(0)
    return torch.linalg.cross(b - a, c - a).norm(dim=-1) / longest**2


@pytest.mark.parametrize("impl", IMPLS)
def test_repeated_and_degenerate_triangles_change_nothing(impl: str) -> None:
    """A doubled face, a face with a repeated corner, and a face of no area whose corner splits an edge."""
    vertices, faces = wedge()
    point = cloud(1500, 0.5) + torch.tensor([0.5, 0.6, 0.05], dtype=torch.float64)
    want = closest_point(vertices, faces, point, impl=impl).sdf
    middle = len(vertices)
    vertices = torch.cat([vertices, vertices[4:6].mean(0, keepdim=True)])
    split = torch.cat([faces[:4], torch.tensor([[3, 2, 5], [3, 5, middle], [3, middle, 4]]), faces[6:]])
    dirty = torch.cat(
        [split, torch.tensor([[4, middle, 5]]), split[:3], split[:3].roll(1, 1), torch.tensor([[1, 1, 2]])]
    )
    found = closest_point(vertices, dirty, point, impl=impl)
    torch.testing.assert_close(found.sdf, want, atol=1e-12, rtol=0)


@pytest.mark.parametrize("impl", ["reference", "tree"])
def test_without_the_remedies_dirty_meshes_turn_inside_out(impl: str) -> None:
    """The ridge's face of no area has no normal: its pseudonormal is half, and the sign near the ridge is a guess."""
    vertices, faces = wedge()
    middle = len(vertices)
    vertices = torch.cat([vertices, vertices[4:6].mean(0, keepdim=True)])
    dirty = torch.cat([faces[:4], torch.tensor([[3, 2, 5], [3, 5, middle], [3, middle, 4]]), faces[6:]])
    dirty = torch.cat([dirty, torch.tensor([[4, middle, 5]])])
    normals = pseudonormals(vertices, dirty)
    point = torch.tensor([[0.3, 1.001, 0.04], [0.3, 1.001, 0.06]], dtype=torch.float64)
    found = closest_point(vertices, dirty, point, impl=impl)
    assert normals.unsure(dirty, found.face, found.barycentric).all()
    assert (found.sdf > 0).all()


@pytest.mark.parametrize("impl", IMPLS)
def test_faces_with_their_own_corners_are_still_one_surface(impl: str) -> None:
    """Three vertices for every face, as files without an index have them: beside the knife edge one face looks away."""
    vertices, faces = wedge()
    point = cloud(1500, 0.5) + torch.tensor([0.5, 0.6, 0.05], dtype=torch.float64)
    want = closest_point(vertices, faces, point, impl=impl).sdf
    found = closest_point(vertices[faces].reshape(-1, 3), torch.arange(3 * len(faces)).reshape(-1, 3), point, impl=impl)
    torch.testing.assert_close(found.sdf, want, atol=1e-12, rtol=0)


@pytest.mark.parametrize("impl", IMPLS)
def test_bound_saturates_and_keeps_the_inside(impl: str) -> None:
    vertices, faces = tensors(trimesh.creation.icosphere(subdivisions=2, radius=0.1))
    axis = torch.linspace(-0.2, 0.2, 13, dtype=torch.float64)
    point = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    free = closest_point(vertices, faces, point, impl="reference").sdf
    found = closest_point(vertices, faces, point, BAND, impl=impl)
    torch.testing.assert_close(found.sdf, free.clamp(*BAND), atol=1e-12, rtol=0)
    narrow = closest_point(vertices, faces, point, (-0.02, 0.02), impl=impl).sdf
    torch.testing.assert_close(narrow, free.clamp(-0.02, 0.02), atol=1e-12, rtol=0)  # float32 has no 0.02
    surface = (vertices[faces[found.face]] * found.barycentric[..., None]).sum(1)
    beyond = free > BAND[1]
    stray = (normalize(surface, dim=-1) - normalize(point, dim=-1)).norm(dim=-1)[beyond]
    assert stray.max() < 1, "beyond the bound the surface point is one near by"


@pytest.mark.parametrize("impl", IMPLS)
def test_rigid_motion_changes_nothing(impl: str) -> None:
    vertices, faces = tensors(trimesh.creation.torus(0.08, 0.02, 16, 8))
    point = cloud(600, 0.12)
    turn = torch.tensor(trimesh.transformations.random_rotation_matrix(num=1)[:3, :3].copy(), dtype=torch.float64)
    shift = torch.tensor([0.3, -1.1, 0.7], dtype=torch.float64)
    want = closest_point(vertices, faces, point, impl=impl).sdf
    have = closest_point(vertices @ turn.T + shift, faces, point @ turn.T + shift, impl=impl).sdf
    torch.testing.assert_close(have, want, atol=1e-12, rtol=0)


def test_flipped_faces_flip_the_sign() -> None:
    vertices, faces = box()
    point = cloud(300, 0.3)
    torch.testing.assert_close(
        closest_point(vertices, faces.flip(1), point).sdf, -closest_point(vertices, faces, point).sdf
    )


def test_gradients() -> None:
    """gradcheck in float64 by points and by vertices, away from the medial axis."""
    vertices, faces = tensors(trimesh.creation.icosahedron())
    turned = 0.1 * vertices @ torch.linalg.qr(cloud(3, 1.0, 5))[0]
    point = cloud(4, 0.15, 3).requires_grad_()
    mesh = turned.requires_grad_()
    assert torch.autograd.gradcheck(lambda p, v: closest_point(v, faces, p).sdf, (point, mesh), eps=1e-7, atol=1e-5)


def test_gradient_has_unit_length_on_the_surface_too() -> None:
    vertices, faces = box()
    point = torch.cat([cloud(50, 0.3), vertices[faces].mean(1)]).requires_grad_()
    (slope,) = torch.autograd.grad(closest_point(vertices, faces, point).sdf.sum(), point)
    torch.testing.assert_close(slope.norm(dim=-1), torch.ones(len(point), dtype=torch.float64), atol=1e-6, rtol=0)


@pytest.mark.parametrize("count", [0, 1, 7, 65])
def test_odd_sizes(count: int) -> None:
    vertices, faces = box()
    point = cloud(count, 0.3)
    found = closest_point(vertices, faces, point, impl="tree")
    assert found.face.shape == (count,)
    torch.testing.assert_close(found.sdf, box_distance(point), atol=1e-12, rtol=0)


def test_repeated_points_and_one_triangle() -> None:
    vertices = torch.tensor([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=torch.float64)
    point = torch.tensor([[0.25, 0.25, 0.5]], dtype=torch.float64).expand(300, 3)
    found = closest_point(vertices, torch.tensor([[0, 1, 2]]), point, impl="tree")
    torch.testing.assert_close(found.sdf, torch.full((300,), 0.5, dtype=torch.float64))


def test_bad_input_is_named() -> None:
    vertices, faces = box()
    with pytest.raises(InputError, match="finite"):
        closest_point(vertices, faces, torch.full((1, 3), torch.nan, dtype=torch.float64))
    with pytest.raises(InputError, match="triangle"):
        closest_point(vertices, faces[:0], torch.zeros(1, 3, dtype=torch.float64))


def test_winding_number_of_a_box() -> None:
    vertices, faces = box()
    point = cloud(200, 0.3)
    torch.testing.assert_close(
        winding_number(vertices, faces, point), (box_distance(point) < 0).double(), atol=1e-9, rtol=0
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hand", "body", "sliver"])
def test_64k_points_against_libigl(name: str) -> None:
    """The acceptance figure: ≤ 1e-6 m and no sign error on 64 k points against libigl's pseudonormals in float64."""
    igl = pytest.importorskip("igl", reason="libigl is the oracle (extra `sdf`)")
    from avatarrex.templates.person import load_person

    person = load_person()
    model = {"hand": person.left_hand.model, "body": person.body}.get(name)
    vertices, faces = sliver_sphere() if model is None else (model.v_template, model.faces)
    vertices = vertices.float()
    low, high = vertices.amin(0) - 0.03, vertices.amax(0) + 0.03
    spacing = float(((high - low).prod() / 64000) ** (1 / 3))
    axes = [torch.arange(float(a), float(b), spacing) for a, b in zip(low, high)]
    point = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    mesh = vertices.double().numpy(), faces.numpy()
    truth = igl.signed_distance(point.double().numpy(), *mesh, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)[0]
    truth = torch.from_numpy(np.asarray(truth))
    have = closest_point(vertices, faces, point, BAND, impl="tree").sdf.double()
    error = (have - truth.clamp(*BAND)).abs().max().item()
    flips = ((have * truth < 0) & (truth.abs() > 1e-7)).sum().item()
    print(f"{name}: {len(point)} points, max error {error:.1e} m, sign errors {flips}")
    assert error <= 1e-6
    assert flips == 0
