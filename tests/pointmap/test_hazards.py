"""Rays that go wrong easily: thin, grazing, parallel, starting inside, touching limbs, boxes past the grid."""

import dataclasses
from importlib import resources

import numpy as np
import pytest
import torch
from raycast_cases import agree

from avatarrex.camera import Camera
from avatarrex.gl.context import gl_context, gl_unavailable
from avatarrex.pointmap.raycast import raycast
from avatarrex.pointmap.raycast_reference import first_crossing
from avatarrex.pointmap.rays import RayPlane, pixel_centres
from avatarrex.pointmap.rays import slab as slab_test
from avatarrex.reference.solids import body_grid, capsule, part_box, rotation, slab, sphere, union
from avatarrex.volume.sdf_volume import Contact, SdfVolume

SIDE = 0.6
GRID = ((0, 0, 0), 0.02, (31, 31, 31))
MIDDLE = (0.3, 0.3, 0.3)


def everywhere(p):
    return torch.ones_like(p[:, 0])


def box(name, solid, centre, side=0.16, degrees=30.0):
    """A cube of 5 mm voxels, turned, in which the solid counts wholly."""
    place = np.eye(4)
    place[:3, :3] = rotation(1, degrees) @ rotation(2, 20)
    place[:3, 3] = np.asarray(centre) - place[:3, :3] @ np.full(3, side / 2)
    return part_box(name, solid, everywhere, place, 0.005, (round(side / 0.005) + 1,) * 3)


def test_the_reference_finds_a_tilted_plane_exactly():
    normal = torch.tensor([0.48, 0.6, 0.64], dtype=torch.float64)
    grid = body_grid(lambda p: (p - 0.3) @ normal, *GRID)
    volume = SdfVolume(dataclasses.replace(grid, sdf=grid.sdf.double()))
    volume.body.sdf.copy_(volume.body.sdf.round(decimals=12))
    camera = Camera.orbit(20, 40, 1.5, 20, MIDDLE, 16, 16)
    rays = RayPlane.of(camera, volume.middle).rays(pixel_centres(camera, torch.float64))
    t = first_crossing(volume, rays)
    assert t.isfinite().sum() > 100
    hit = t.isfinite()
    # float32 storage of the plane's distances
    assert ((rays.at(t)[hit] - 0.3) @ normal).abs().max() < 3e-8


@pytest.mark.parametrize("offset", [0.0, 0.003, 0.007])
def test_a_slab_of_0_6_voxels_is_never_missed(impl, offset):
    volume = SdfVolume(body_grid(slab(0.3 + offset - 0.006, 0.3 + offset + 0.006), *GRID))
    for elevation in (3.0, 35.0, 80.0):
        agree(volume, Camera.orbit(25, elevation, 1.4, 20, MIDDLE, 40, 40), impl)


def test_a_sheet_thinner_than_the_smallest_step_is_never_missed(impl):
    """On a layer of voxels a slab of 2 mm is stored as it is; one pass with steps of 5 mm leaps over it."""
    volume = SdfVolume(body_grid(slab(0.299, 0.301), *GRID))
    for elevation in (20.0, 60.0, 85.0):
        assert agree(volume, Camera.orbit(25, elevation, 1.4, 20, MIDDLE, 40, 40), impl).hit.float().mean() > 0.3


def test_grazing_rays(impl):
    volume = SdfVolume(body_grid(union(slab(-1, 0.3), sphere((0.3, 0.31, 0.3), 0.05)), *GRID))
    for elevation in (0.0, 0.3, 2.0):
        agree(volume, Camera.orbit(0, elevation, 1.0, 20, (0.3, 0.305, 0.3), 41, 41), impl)


def test_rays_along_the_axes_and_on_cell_faces(impl):
    volume = SdfVolume(body_grid(sphere(MIDDLE, 0.2), *GRID), (box("face", sphere(MIDDLE, 0.19), MIDDLE, degrees=0),))
    camera = Camera(
        np.array([[50.0, 0, 15.5], [0, 50, 15.5], [0, 0, 1]]),
        np.array([[1.0, 0, 0, -0.3], [0, -1, 0, 0.3], [0, 0, -1, 1.5], [0, 0, 0, 1]]),
        31,
        31,
    )
    one = agree(volume, camera, impl)
    assert one.hit[15, 15]
    assert torch.isfinite(one.position).all()
    assert torch.isfinite(one.normal).all()


def test_the_slab_test_survives_zero_components():
    origin = torch.tensor([[-1.0, 0.0, 0.5], [-1.0, 0.0, 0.5], [-1.0, 2.0, 0.5], [0.5, 0.5, 0.5]], dtype=torch.float64)
    direction = torch.tensor([[1.0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 0, -1]], dtype=torch.float64)
    entry, exit = slab_test(origin, direction, torch.ones(3, dtype=torch.float64))
    assert torch.isfinite(entry).all()
    assert torch.isfinite(exit).all()
    assert (entry <= exit).tolist() == [True, True, False, True]
    assert entry[0] == 1
    assert exit[0] == 2
    assert entry[3] < 0 < exit[3]


def test_the_shaders_slab_test_survives_zero_components():
    """The same rays through shaders/lib/slab.glsl."""
    if gl_unavailable() is not None:
        pytest.skip("no OpenGL 4.3 here")
    context = gl_context()
    program = context.compute_shader(
        "\n".join(
            [
                "#version 430",
                "layout(local_size_x = 1) in;",
                resources.files("avatarrex_shaders").joinpath("lib/slab.glsl").read_text(),
                "layout(std430, binding = 0) buffer Rays { vec4 ray[]; };",
                "void main() {",
                "    uint k = 2u * gl_GlobalInvocationID.x;",
                "    ray[k].xy = slab(ray[k].xyz, ray[k + 1u].xyz, vec3(1));",
                "}",
            ]
        )
    )
    rays = [
        [[-1, 0, 0.5], [1, 0, 0]], [[-1, 0, 0], [1, 0, 0]], [[-1, 2, 0.5], [1, 0, 0]], [[0.5, 0, 1], [0, 0, -1]],
        [[0, 0, -1], [0, 0, 1]], [[0.5, 0.5, 0.5], [0, 0, 0]],
    ]  # fmt: skip
    values = np.zeros((len(rays), 2, 4), "f4")
    values[..., :3] = rays
    buffer = context.buffer(values.tobytes())
    buffer.bind_to_storage_buffer(0)
    program.run(len(rays))
    context.memory_barrier()
    entry, exit = np.frombuffer(buffer.read(), "f4").reshape(-1, 2, 4)[:, 0, :2].T
    assert np.isfinite([entry, exit]).all()
    assert (entry <= exit).tolist() == [True, True, False, True, True, True]
    assert entry[:2].tolist() == [1, 1]


def test_nothing_there(impl):
    volume = SdfVolume(body_grid(everywhere, *GRID))
    one = raycast(volume, Camera.orbit(0, 0, 1.5, 40, MIDDLE, 16, 16), impl)
    assert not one.hit.any()
    assert not one.coverage.any()
    assert not one.position.any()


def test_looking_away(impl, man):
    assert not raycast(man, Camera.orbit(0, 0, 3.0, 40, (0, 0, 6.5), 16, 16), impl).hit.any()


def test_a_camera_inside_sees_what_lies_outside(impl):
    two = union(sphere((0.15, 0.3, 0.3), 0.1), sphere((0.45, 0.3, 0.3), 0.1))
    inside = Camera.orbit(-90, 0, 0.3, 90, (0.45, 0.3, 0.3), 33, 33)
    np.testing.assert_allclose(inside.centre, (0.15, 0.3, 0.3), atol=1e-12)
    one = agree(SdfVolume(body_grid(two, *GRID)), inside, impl)
    assert abs(float(one.depth[16, 16]) - 0.2) < 1e-3
    assert not agree(SdfVolume(body_grid(sphere(MIDDLE, 0.2), *GRID)), inside.seen_from(np.eye(4)), impl).hit[0, 0]


def test_a_camera_in_a_box_and_in_front_of_one(impl):
    part = box("left_hand", sphere(MIDDLE, 0.04), MIDDLE)
    volume = SdfVolume(body_grid(everywhere, *GRID), (part,))
    one = agree(volume, Camera.orbit(10, 5, 0.07, 60, MIDDLE, 32, 32), impl)
    assert abs(float(one.depth[16, 16]) - 0.03) < 1e-3


def test_a_box_past_the_edge_of_the_grid(impl):
    centre = (0.6, 0.35, 0.3)
    volume = SdfVolume(
        body_grid(sphere((0.2, 0.3, 0.3), 0.1), *GRID), (box("right_hand", sphere(centre, 0.05), centre),)
    )
    one = agree(volume, Camera.orbit(20, 15, 1.5, 40, (0.4, 0.3, 0.3), 64, 64), impl)
    beyond = one.hit & (one.position[..., 0] > 0.601)
    assert beyond.sum() > 10
    assert ((one.position[beyond] - torch.tensor(centre)).norm(dim=-1) - 0.05).abs().max() < 5e-4


def test_a_box_wholly_outside_the_grid(impl):
    centre = (0.9, 0.3, 0.3)
    volume = SdfVolume(body_grid(everywhere, *GRID), (box("face", sphere(centre, 0.05), centre),))
    assert agree(volume, Camera.orbit(0, 0, 2.0, 40, (0.6, 0.3, 0.3), 48, 48), impl).hit.any()


def test_overlapping_boxes_are_a_union_in_any_order(impl):
    one_at, two_at = (0.28, 0.3, 0.3), (0.34, 0.31, 0.32)
    left = box("left_hand", sphere(one_at, 0.05), one_at)
    right = box("right_hand", sphere(two_at, 0.05), two_at, degrees=-40)
    camera = Camera.orbit(15, 20, 1.0, 20, MIDDLE, 48, 48)
    one = agree(SdfVolume(body_grid(everywhere, *GRID), (left, right)), camera, impl)
    other = raycast(SdfVolume(body_grid(everywhere, *GRID), (right, left)), camera, impl)
    assert torch.equal(one.position, other.position)
    assert (one.part_weight[one.hit][:, :2].amax(0) > 0.999).all()
    nearest = torch.stack([(one.position[one.hit] - torch.tensor(at)).norm(dim=-1) for at in (one_at, two_at)]).amin(0)
    assert (nearest - 0.05).abs().max() < 1e-3


def test_a_hand_on_a_hip_carves_no_flesh(impl):
    hip, hand = (0.25, 0.3, 0.3), (0.36, 0.3, 0.34)
    body = body_grid(sphere(hip, 0.1), *GRID)
    part = box("left_hand", sphere(hand, 0.04), hand, side=0.2)
    pair = torch.stack([torch.full_like(body.sdf, 0.5), body.sdf], -1)
    touching = dataclasses.replace(part, contact=Contact(np.array([0, 0, 0]), pair))
    camera = Camera.orbit(30, 20, 1.2, 25, MIDDLE, 40, 40)
    one = agree(SdfVolume(body, (touching,)), camera, impl)
    alone = raycast(SdfVolume(body), camera, impl)
    assert (one.hit | ~alone.hit).all()
    assert (one.depth <= alone.depth + 1e-5)[alone.hit].all()
    # The literal equation carves the hip that the hand touches.
    carved = agree(SdfVolume(body, (part,)), camera, impl)
    assert (carved.depth > alone.depth + 1e-2)[alone.hit & carved.hit].any()


def bars_over(sheet):
    """Bars that rays pass closely, over a slab."""
    bars = [capsule((0.1 * k, 0.42, 0.0), (0.1 * k, 0.42, 0.6), 0.02) for k in range(1, 6)]
    return SdfVolume(body_grid(union(sheet, *bars), *GRID))


def test_a_sheet_behind_bars_is_never_missed(impl):
    """A ray that nearly meets several things is walked exactly past the last of them."""
    volume = bars_over(slab(0.299, 0.301))
    for elevation in (40.0, 60.0):
        assert agree(volume, Camera.orbit(25, elevation, 1.4, 20, MIDDLE, 64, 64), impl).hit.float().mean() > 0.3


@pytest.mark.skipif(gl_unavailable() is not None, reason=f"no OpenGL: {gl_unavailable()}")
def test_the_exact_walk_ends_where_nothing_is_near():
    """51 000 samples, 56 000 to the end of the grid."""
    camera = Camera.orbit(25, 40, 1.4, 20, MIDDLE, 64, 64)
    steps = raycast(bars_over(slab(-1, -0.5)), camera, "gl", antialias=False).counters["ray_steps"]
    assert steps < 53_000
