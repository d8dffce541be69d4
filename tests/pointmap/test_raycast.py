"""Ray casters against the float64 cell walk, on whole figures."""

import dataclasses

import numpy as np
import pytest
import torch
from raycast_cases import VIEWS, agree, errors, reference

from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.pointmap.raycast import available, raycast
from avatarrex.reference.solids import body_grid, sphere, union
from avatarrex.volume.sdf_volume import BodyGrid, SdfVolume


@pytest.mark.parametrize("camera", VIEWS, ids=["whole", "hand", "head"])
def test_the_capsule_man_within_the_targets(man, impl, camera):
    one, truth = agree(man, camera, impl), reference(man, camera)
    both = one.hit & truth.hit
    assert both.sum() > 300
    assert (one.normal - truth.normal)[both].abs().mean() < 1e-4
    assert (one.part_weight - truth.part_weight)[both].abs().mean() < 1e-4
    assert (one.depth - truth.depth)[both].abs().max() < 1e-4
    assert (truth.part_weight[both].amax(0) > 0.9).any()


def test_the_comparison_sees_a_grid_that_is_one_voxel_off(man):
    body = dataclasses.replace(man.body, origin=man.body.origin + np.array([0, 0, man.body.voxel]))
    truth = reference(man, VIEWS[0])
    apart, missed, _ = errors(raycast(SdfVolume(body, man.parts), VIEWS[0], "torch"), truth)
    assert apart.mean() > 1e-3
    assert missed > 0


def test_depth_and_position_tell_the_same(man, impl):
    camera = VIEWS[0]
    one = raycast(man, camera, impl)
    pixel, depth = camera.pixels(one.position[one.hit].double().numpy())
    np.testing.assert_allclose(one.depth[one.hit], depth, atol=1e-6)
    y, x = np.nonzero(one.hit.numpy())
    np.testing.assert_allclose(pixel, np.stack([x, y], 1) + 0.5, atol=1e-4)


def test_normals_are_unit_and_face_the_camera(man, impl):
    camera = VIEWS[0]
    one = raycast(man, camera, impl)
    normal = one.normal[one.hit]
    torch.testing.assert_close(normal.norm(dim=-1), torch.ones(len(normal)))
    gaze = one.position[one.hit] - torch.as_tensor(camera.centre).float()
    assert ((normal * gaze).sum(-1) > 0.1 * gaze.norm(dim=-1)).float().mean() < 0.01


def test_a_ball_where_it_is(impl):
    volume = SdfVolume(body_grid(sphere((0.3, 0.3, 0.3), 0.2), (0, 0, 0), 0.02, (31, 31, 31)))
    camera = Camera.orbit(33, 21, 1.5, 30, (0.3, 0.3, 0.3), 64, 64)
    one = raycast(volume, camera, impl)
    radius = (one.position[one.hit] - 0.3).norm(dim=-1)
    # Linear interpolation of a convex function reads high, so the ball shrinks: by at most h²/8 Δs, Δs = 2/R, and a
    # little for the curvature's growth within the cell.
    assert radius.max() < 0.2 + 1e-6
    assert radius.min() > 0.2 - 1.1 * 0.02**2 / 8 * (2 / 0.2)
    assert radius.min() < 0.2 - 1e-4
    outward = (one.position[one.hit] - 0.3) / radius[:, None]
    assert (one.normal[one.hit] * outward).sum(-1).min() > 0.995


def test_a_root_a_kilometre_away_gives_the_same_image(man, impl):
    near = VIEWS[0]
    away = np.eye(4)
    away[:3, 3] = [1000.0, -3.0, 777.0]
    moved = Camera(near.intrinsics, near.camera_from_world @ np.linalg.inv(away), near.width, near.height)
    one, two = raycast(man, near, impl), raycast(man, moved.seen_from(away), impl)
    assert torch.equal(one.hit, two.hit)
    # 1e-3 of a voxel
    assert (one.depth - two.depth).abs().max() < 2e-5
    assert (one.position - two.position).abs().max() < 2e-5


def test_a_camera_a_kilometre_away_is_as_exact(man, impl):
    far = Camera.orbit(20, 10, 1000.0, 1.0, (0, -0.05, 0), 64, 64)
    zoom = np.diag([8.0, 8.0, 1.0])
    zoom[:2, 2] = 32 - 8 * 32
    agree(man, Camera(zoom @ far.intrinsics, far.camera_from_world, 64, 64), impl)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (7, 5), (65, 3)])
def test_odd_sizes(man, impl, width, height):
    camera = Camera.orbit(20, 10, 1.0, 20, (0, 0.2, 0), width, height)
    one = agree(man, camera, impl)
    assert one.position.shape == (height, width, 3)
    assert one.hit.any()


def test_half_precision_is_cast_as_stored(man, impl):
    half = SdfVolume(
        BodyGrid(man.body.origin, man.body.voxel, man.body.sdf.half()),
        tuple(dataclasses.replace(part, field=part.field.half()) for part in man.parts),
    )
    one = agree(half, VIEWS[0], impl)
    full = raycast(man, VIEWS[0], impl)
    both = one.hit & full.hit
    assert 1e-8 < (one.position - full.position)[both].norm(dim=-1).median() < 2e-5


def test_only_changes_are_uploaded(man):
    if "gl" not in available():
        pytest.skip("no OpenGL 4.3 here")
    raycast(man, VIEWS[0], "gl")
    assert raycast(man, VIEWS[1], "gl").counters["bytes_uploaded"] == 0
    part = dataclasses.replace(man.parts[0], field=man.parts[0].field.clone())
    again = raycast(SdfVolume(man.body, (part, *man.parts[1:])), VIEWS[1], "gl")
    sides = [side + int(side & (side - 1) == 0) for side in part.field.shape[:3]]  # no power of two (gl/grids.py)
    assert again.counters["bytes_uploaded"] == np.prod(sides) * 8
    moved = dataclasses.replace(part, box_from_root=part.box_from_root @ np.diag([1.0, 1, 1, 1]))
    assert raycast(SdfVolume(man.body, (moved, *man.parts[1:])), VIEWS[1], "gl").counters["bytes_uploaded"] == 0


def test_only_covered_pixels_are_read_back(man):
    if "gl" not in available():
        pytest.skip("no OpenGL 4.3 here")
    one = raycast(man, VIEWS[0], "gl")
    covered = int((one.coverage > 0).sum())
    assert one.counters["bytes_read_back"] < 48 * 1.6 * covered + 200
    assert one.counters["ray_steps"] >= one.counters["rays"] > one.hit.numel()


def test_without_opengl_torch_serves_and_says_so(man, monkeypatch):
    monkeypatch.setenv("AVATARREX_GL", "off")
    assert available() == ("torch", "reference")
    assert raycast(man, VIEWS[0]).renderer == "torch on the CPU"
    with pytest.raises(InputError, match="AVATARREX_GL=off"):
        raycast(man, VIEWS[0], "gl")
    with pytest.raises(InputError, match="raycast: impl: expected auto, gl, torch or reference, found cuda"):
        raycast(man, VIEWS[0], "cuda")


def test_the_renderer_is_named(man):
    assert reference(man, VIEWS[0]).renderer == "float64 reference"
    if "gl" in available():
        assert raycast(man, VIEWS[0]).renderer.startswith("OpenGL compute, ")


def test_two_views_in_turn_do_not_disturb_each_other(man, impl):
    small = Camera.orbit(0, 0, 2.6, 40, (0, 0, 0), 24, 24)
    first = raycast(man, small, impl)
    raycast(SdfVolume(body_grid(union(sphere((0, 0, 0), 0.1)), (-0.2,) * 3, 0.02, (21,) * 3)), VIEWS[0], impl)
    again = raycast(man, small, impl)
    for name in ("position", "normal", "coverage", "part_weight", "hit"):
        assert torch.equal(getattr(first, name), getattr(again, name))


def test_the_shaders_read_parts_and_view_as_numpy_wrote_them():
    if "gl" not in available():
        pytest.skip("no OpenGL 4.3 here")
    from avatarrex.pointmap.raycast_gl import BOXES, LISTS, PART, RECORD, VIEW, gl_caster

    program = gl_caster()._program("surface", PARTS=BOXES[-1], CONTACTS=1, BRICKS=1, FLOAT_FILTER=0)
    assert program["Parts"].size == 3 * PART.itemsize
    assert program["View"].size == VIEW.itemsize
    assert RECORD.itemsize % 16 == 0
    assert LISTS.fields["steps"][1] == (2 + 4 * len(BOXES)) * 16


@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize("name", ["beams", "trace", "exact", "edges", "subrays", "surface", "plain"])
def test_the_shaders_serve_another_number_of_parts(name, count):
    if "gl" not in available():
        pytest.skip("no OpenGL 4.3 here")
    from avatarrex.pointmap.raycast_gl import gl_caster

    every = 0 if name in ("beams", "edges") else (1 << count) - 1
    kind = {
        "PARTS": every,
        "CONTACTS": int(every > 0),
        "BRICKS": 1,
        "BOXED": 1,
        "FLOAT_FILTER": 0,
        "ANTIALIAS": 1,
        "METHOD": 2,
    }
    gl_caster()._program(name, PART_COUNT=count, CONTACT_UNIT=3 + count, **kind).release()


def test_eight_texel_fetches_give_what_a_float_filter_gives(man, monkeypatch):
    """The path of hardware whose filter rounds, tried where it does not."""
    if "gl" not in available():
        pytest.skip("no OpenGL 4.3 here")
    from avatarrex.pointmap.raycast_gl import gl_caster

    monkeypatch.setattr(gl_caster(), "float_filter", 0)
    agree(man, VIEWS[0], "gl")
